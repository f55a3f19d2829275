"""Comparing tensors with what golden sets store of them: all numbers or every n-th, and three statistics."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from adapters.extensions.golden_sets.parity_set import ParitySet
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenArrays

SAMPLED: Final = "__sub"
STATISTICS: Final = "__stats"
OUTLIERS: Final = "all values of such quantities (of their spread)"
OUTLIER_TOLERANCE: Final = 0.02


@dataclass(frozen=True, slots=True)
class Tolerance:
    """What is allowed.

    Attributes:
        allowed: Largest error.
        of_spread: Whether it is a share of the standard deviation of the golden tensor, or in the tensor's unit.
        share: Of the values for which it holds. The others, which a network with random weights pushes over a bend,
            may be off by `OUTLIER_TOLERANCE` of the spread.
    """

    allowed: float
    of_spread: bool = True
    share: float = 1.0


@dataclass(frozen=True, slots=True)
class Quantity:
    """One tensor of ours, to be compared.

    Attributes:
        values: The golden shape but for axes of length one.
        tolerance: What is allowed; whole numbers must be equal.
        undecided: Along the first axis of `values`, what hangs on a comparison too close to call. Where such an entry
            disagrees it is left out, and the note says how many values were.
        listed: Whether the first axis is a list whose length may differ from frame to frame.
    """

    values: NDArray[Any]
    tolerance: Tolerance
    undecided: Bools | None = None
    listed: bool = False

    @classmethod
    def of(cls, tensor: Tensor, tolerance: Tolerance, undecided: Bools | None = None) -> "Quantity":
        """From a tensor on any device."""
        return cls(tensor.detach().cpu().numpy(), tolerance, undecided)


def compare_frame(
    comparison: Comparison, golden: ParitySet, stored: GoldenArrays, ours: Mapping[str, Quantity], where: str
) -> None:
    """Compare all stored quantities of one frame.

    Args:
        comparison: Gets the errors.
        golden: The set.
        stored: Its numbers for the frame.
        ours: Quantities by the names of the set.
        where: The frame, for notes.

    Raises:
        InputError: If the set's numbers are damaged, or it stores none that is known here.
    """
    names = {name.removesuffix(SAMPLED).removesuffix(STATISTICS) for name in stored.names}
    known = [name for name in ours if name in names]
    if not known:
        raise InputError(f"{stored.path} stores no quantity of this network; pass the set of this model")
    for name in known:
        _compare(comparison, golden, stored, name, ours[name], where)
    unknown = sorted(names - ours.keys())
    if unknown:
        comparison.note(_title(known[0], ours[known[0]]), f"not compared in {where}: {', '.join(unknown)}")


def golden_list(stored: GoldenArrays, name: str, *rest: int) -> Floats:
    """A stored list of any length; the lengths of its other axes follow."""
    return stored.floats(name, None, *rest)


def _title(name: str, quantity: Quantity) -> str:
    if quantity.values.dtype.kind in "iub":
        return name
    tolerance = quantity.tolerance
    share = [f"{100 * tolerance.share:g} % of values"] if tolerance.share < 1 else []
    details = ", ".join([*share, *(["of its spread"] if tolerance.of_spread else [])])
    return f"{name} ({details})" if details else name


def _compare(
    comparison: Comparison, golden: ParitySet, stored: GoldenArrays, name: str, quantity: Quantity, where: str
) -> None:
    values, title, tolerance = quantity.values, _title(name, quantity), quantity.tolerance
    kept, numbers = _golden_numbers(golden, stored, name, quantity)
    if kept is None:
        comparison.errors(
            title, np.array([np.inf]), tolerance.allowed, where=f"{where}, where the list has another length"
        )
        return
    if values.dtype.kind in "iub":
        hanging = np.zeros(values.size, np.bool_) if quantity.undecided is None else quantity.undecided
        comparison.verdicts(title, (values.reshape(-1)[kept] != numbers) & ~hanging[kept], where=where)
        return
    statistics = stored.floats(f"{name}{STATISTICS}", 3) if f"{name}{STATISTICS}" in stored.names else None
    deviation = float(statistics[1]) if statistics is not None else float(np.std(numbers))
    spread = deviation if deviation > 0 else 1.0
    unit = spread if tolerance.of_spread else 1.0
    errors = np.abs(values.reshape(-1)[kept].astype(np.float64) - numbers)
    worst_allowed = OUTLIER_TOLERANCE * spread if tolerance.share < 1 else tolerance.allowed * unit
    left_out = np.zeros(len(errors), np.bool_)
    if quantity.undecided is not None:
        hanging = np.repeat(quantity.undecided, values.size // len(quantity.undecided))[kept]
        left_out = hanging & (errors > worst_allowed)
    decided = errors[~left_out]
    measured = decided if tolerance.share == 1 else _largest_but_few(decided, tolerance.share)
    comparison.errors(title, measured / unit, tolerance.allowed, where=where)
    if tolerance.share < 1:
        comparison.errors(OUTLIERS, decided / spread, OUTLIER_TOLERANCE, where=f"{name} of {where}")
    if left_out.any():
        comparison.note(title, f"{np.count_nonzero(left_out)} too close to call left out in {where}")
    elif statistics is not None:
        whole = values.astype(np.float64)
        own = np.array([whole.mean(), whole.std(), np.abs(whole).max(initial=0.0)])
        # The largest value of a tensor is one value, to which the tolerance of most does not apply.
        most = own[:2] if tolerance.share < 1 else own
        comparison.errors(title, (most - statistics[: len(most)]) / unit, tolerance.allowed, where=where)
        if tolerance.share < 1:
            comparison.errors(OUTLIERS, (own - statistics) / spread, OUTLIER_TOLERANCE, where=f"{name} of {where}")


def _largest_but_few(errors: Floats, share: float) -> Floats:
    """The smallest errors, as many as a share of all; NaN counts as large."""
    return np.sort(errors)[: int(np.ceil(share * len(errors)))]


def _golden_numbers(
    golden: ParitySet, stored: GoldenArrays, name: str, quantity: Quantity
) -> tuple[NDArray[np.int64] | None, Floats]:
    """Which of our flat numbers are stored, and the stored ones; none where a list has another length than ours."""
    values, layout = quantity.values, golden.stored(name)
    if quantity.listed:
        numbers = golden_list(stored, name, *values.shape[1:])
        return (np.arange(values.size) if len(numbers) == len(values) else None), numbers.reshape(-1)
    own = [length for length in values.shape if length != 1]
    if own != [length for length in layout.shape if length != 1]:
        raise InputError(
            f"{golden.folder / 'manifest.json'} gives {name} the shape {layout.shape}, and the network has "
            f"{list(values.shape)}; pass the set of this model"
        )
    if f"{name}{SAMPLED}" in stored.names:
        kept = np.arange(values.size)[:: layout.stride]
        return kept, stored.floats(f"{name}{SAMPLED}", len(kept))
    return np.arange(values.size), stored.floats(name, *layout.shape).reshape(-1)
