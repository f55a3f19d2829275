"""Tensors, and outputs of inner modules, compared with golden numbers, all or a part, and statistics of the whole."""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from torch import Tensor, nn

from benchmark.geometry import Bools, Floats
from benchmark.verification.checks import Comparison


@contextmanager
def hook_modules(network: nn.Module, hooks: Iterable[tuple[str, Callable[[Any], None]]]) -> Iterator[None]:
    """Hand on the outputs of modules, by their names, of the network that runs within the context."""
    handles = []
    try:
        for name, keep in hooks:

            def hook(_module: nn.Module, _inputs: object, output: Any, keep: Callable[[Any], None] = keep) -> None:
                keep(output)

            handles.append(network.get_submodule(name).register_forward_hook(hook))
        yield
    finally:
        for handle in handles:
            handle.remove()


@contextmanager
def tap_features(network: nn.Module, head: str = "", parts: Iterable[str] = ()) -> Iterator[dict[str, Tensor]]:
    """Feature maps, and outputs of `parts` of a `head`, by golden names, of the network that runs in the context."""
    taps: dict[str, Tensor] = {}

    def levels(name: str) -> tuple[str, Callable[[Any], None]]:
        return f"img_{name}", lambda maps: taps.update(
            {f"{name}{level}": feature_map for level, feature_map in enumerate(maps)}
        )

    def tokens(name: str) -> tuple[str, Callable[[Any], None]]:
        return f"{head}.{name}", lambda states: taps.update({name: states})

    with hook_modules(network, [levels("backbone"), levels("neck"), *map(tokens, parts)]):
        yield taps


OUTLIERS: Final = "all values of such quantities (of their spread)"
OUTLIER_TOLERANCE: Final = 0.02


@dataclass(frozen=True, slots=True)
class Tolerance:
    """Allowed error, as a share of the golden standard deviation, or in the tensor's unit if not `of_spread`.

    It holds for a `share` of the values; the others, which a network with random weights pushes over a bend, may be off
    by `allowed_of_others`, of the spread. With `rows` a row counts as one value, its worst.
    """

    allowed: float
    of_spread: bool = True
    share: float = 1.0
    unit: str = ""
    rows: bool = False
    others: str = OUTLIERS
    allowed_of_others: float = OUTLIER_TOLERANCE

    def title(self, name: str) -> str:
        """A quantity's name with what its errors are."""
        share = f"{100 * self.share:g} % of {'rows' if self.rows else 'values'}" if self.share < 1 else ""
        parts = [share, "of its spread" if self.of_spread else self.unit]
        details = ", ".join(part for part in (reversed(parts) if self.rows else parts) if part)
        return f"{name} ({details})" if details else name


@dataclass(frozen=True, slots=True)
class Quantity:
    """One tensor of ours, of the golden shape but for axes of length one; whole numbers must be equal.

    Entries of the first axis are `undecided` where a comparison is too close to call: where one disagrees it is left
    out, and the note counts its values. A `listed` first axis may differ in length from frame to frame.
    """

    values: NDArray[Any]
    tolerance: Tolerance
    undecided: Bools | None = None
    listed: bool = False

    @classmethod
    def of(cls, tensor: Tensor, tolerance: Tolerance, undecided: Bools | None = None) -> "Quantity":
        """From a tensor on any device."""
        return cls(tensor.detach().cpu().numpy(), tolerance, undecided)

    @property
    def equal(self) -> bool:
        """Whether it must be equal."""
        return self.values.dtype.kind in "iub"

    def title(self, name: str) -> str:
        """Name of its errors."""
        return name if self.equal else self.tolerance.title(name)


@dataclass(frozen=True, slots=True)
class TensorDifferences:
    """Differences of a whole tensor from a set's statistics: of `most` numbers all values are part, of `few` one each.

    `spread` is the golden standard deviation.
    """

    most: Floats
    few: Floats
    spread: float


def compare_tensor(
    comparison: Comparison,
    name: str,
    quantity: Quantity,
    stored: tuple[NDArray[Any], Floats],
    whole: TensorDifferences | None = None,
    spread: float | None = None,
    hanging: Bools | None = None,
) -> None:
    """Compare a tensor; `stored` are the stored part of ours and the stored numbers, `hanging` which are undecided.

    `whole` is from the set's statistics; `spread` is the golden standard deviation, of the stored numbers by default.
    """
    (ours, golden), title, allowed, where = stored, quantity.title(name), quantity.tolerance, comparison.where
    undecided = np.zeros(ours.shape, np.bool_) if hanging is None else hanging
    if quantity.equal:
        comparison.verdicts(title, (ours != golden) & ~undecided)
        return
    spread = (float(np.std(golden)) if spread is None else spread) or 1.0
    unit = spread if allowed.of_spread else 1.0
    errors = np.abs(ours.astype(np.float64) - golden)
    worst_allowed = allowed.allowed_of_others * spread if allowed.share < 1 else allowed.allowed * unit
    left_out = undecided & (errors > worst_allowed)
    decided = _rows(errors) if allowed.rows else errors[~left_out]
    # The smallest errors, as many as a share of all; NaN counts as large.
    most = np.sort(decided)[: math.ceil(allowed.share * len(decided))] if allowed.share < 1 else decided
    of_others, at = allowed.allowed_of_others, f"{name} of {where}"
    comparison.errors(title, most / unit, allowed.allowed)
    if allowed.share < 1:
        comparison.errors(allowed.others, decided / spread, of_others, where=at)
    if left_out.any():
        comparison.note(title, f"{np.count_nonzero(left_out)} too close to call left out in {where}")
    elif whole is not None:
        unit = whole.spread if allowed.of_spread else 1.0
        comparison.errors(title, whole.most / unit, allowed.allowed)
        # The largest value of a tensor is one value, to which the tolerance of most does not apply.
        few = (allowed.others, whole.spread, of_others) if allowed.share < 1 else (title, unit, allowed.allowed)
        comparison.errors(few[0], whole.few / few[1], few[2], where=at)


def _rows(errors: Floats) -> Floats:
    """The worst of each row of a batch of one, or of rows."""
    rows = errors[0] if len(errors) == 1 else errors
    return np.asarray(rows.reshape(len(rows), -1).max(1))


def have_same_lengths(ours: Sequence[int], golden: Sequence[int]) -> bool:
    """Whether two shapes are the same but for axes of length one."""
    return [length for length in ours if length != 1] == [length for length in golden if length != 1]
