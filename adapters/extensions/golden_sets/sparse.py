"""`challenger-bench verify model` for SparseDrive and DiffusionDrive: golden frames with the state carried along."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray

from adapters.extensions.golden_sets.own_rounding import Run
from adapters.extensions.golden_sets.parity_set import set_folders
from adapters.extensions.golden_sets.sparse_order import Order, follow
from adapters.extensions.golden_sets.sparse_quantities import Quantity, Rule, frame_quantities, map_quantities
from adapters.extensions.golden_sets.sparse_set import SparseSet, Statistic
from adapters.extensions.golden_sets.sparse_trace import Trace, traced
from adapters.models import Model, resolve
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.keyframe_pose import KeyframeMotion
from adapters.networks.sparse.model import DiffusionDrive, SparseNetwork, pose_of
from benchmark.errors import InputError
from benchmark.machine.devices import single_precision
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.filled_networks import fill, same_names_and_shapes
from benchmark.verification.golden import GoldenArrays

METRES: Final = 1e-3
SPREAD: Final = 1e-3
MOST: Final = {Rule.ROWS: 0.97, Rule.FORECASTS: 0.95}
"""Shares of rows for which `SPREAD` holds."""
SWAPPED: Final = 0.03
OTHERS: Final = 0.05
"""For the rows that are left, of the spread."""
MOVED: Final = "rows that changed places at near ties (share)"
OTHER_ROWS: Final = "all rows, and the largest number, where most count above (of their spread)"
MODULES: Final = "modules: mean and deviation of what they give (of the deviation)"
LARGEST: Final = "modules: largest number that they give (of the deviation)"


def verify_sparse(
    model: Model, golden: Path, device: str = "cpu", run: Run | None = None, config: SparseConfig | None = None
) -> list[Check]:
    """Compare a sparse network with golden sets; as `verify_model`, but for the sizes.

    Args:
        model: ``sparsedrive`` or ``diffusiondrive``.
        golden: A set's folder, or a model's folder whose sets are all compared. A set without weights of its own, as
            that of the full resolution, has the set of its salt beside it.
        device: What the network runs on.
        run: How it is run; plainly by default.
        config: Sizes, but for those of images; the published ones by default.

    Returns:
        One check for each quantity; the first alone if names or shapes differ, since weights cannot be filled then.

    Raises:
        InputError: If the set cannot be used.
    """
    run = run or Run()
    comparison = run.comparison
    for folder in set_folders(golden):
        golden_set = SparseSet.read(folder, model.name)
        height, width = golden_set.manifest.image_hw
        sizes = replace(config or SparseConfig(), image_height_px=height, image_width_px=width)
        network = resolve(model.net.build)(sizes).to(device)
        if not same_names_and_shapes(comparison, network, golden_set.shapes):
            break
        fill(comparison, network, golden_set.recipe, golden_set.shapes, None, folder / "manifest.json")
        with single_precision(), torch.inference_mode(), run.varied(network):
            for frame in range(len(golden_set.outputs)):
                _compare_frame(comparison, network, golden_set, frame)
    return comparison.checks()


def _compare_frame(comparison: Comparison, network: SparseNetwork, golden: SparseSet, frame: int) -> None:
    """Compute a frame and compare it."""
    stored, before, where = golden.outputs[frame], network.memory, f"{golden.folder.name}, frame {frame}"
    if "plan_reg" not in stored.names:
        raise InputError(f"{stored.path} has no array plan_reg; it is not a golden file of this kind, or not all of it")
    inputs, noise = golden.frame(frame, network.config)
    if isinstance(network, DiffusionDrive) and noise is None:
        raise InputError(f"{golden.inputs.path} has no array frame{frame}_diffusion_noise; fetch or make it again")
    device = next(network.parameters()).device
    with traced(network, golden.calls[frame]) as trace:
        predictions = network.predict(replace(inputs, images=inputs.images.to(device)), noise)
    order = Order.of(network, predictions, stored)
    fresh = before is not None and KeyframeMotion.between(before.pose, pose_of(inputs), device).fresh
    follow(network, predictions, before if fresh else None, order, stored)
    ours = map_quantities(trace.maps["img_backbone"], trace.maps["img_neck"])
    ours |= frame_quantities(network, predictions, order, inputs.command, None if before is None else fresh)
    comparison.errors(MOVED, np.array([order.moved]), SWAPPED, where=where)
    for quantity, own in ours.items():
        if quantity in stored.names:
            _compare(comparison, quantity, own, stored, golden.statistics[frame].get(quantity), where)
    unknown = sorted(stored.names - ours.keys())
    if unknown:
        comparison.note(MOVED, f"not compared in {where}: {', '.join(unknown)}")
    _compare_calls(comparison, trace, golden, frame, where)


def _compare(
    comparison: Comparison, name: str, own: Quantity, stored: GoldenArrays, whole: Statistic | None, where: str
) -> None:
    """Compare an array with the part of it that is stored, and with the statistics of the whole."""
    rule = own.rule
    if rule == Rule.EQUAL:
        numbers, part = _stored(name, own.values, stored)
        comparison.verdicts(name, part != numbers, where=where)
        return
    numbers, part = _stored(name, own.values, stored)
    title = f"{name} ({rule.value})"
    errors = np.abs(part.astype(np.float64) - numbers)
    spread = float(np.std(numbers)) or 1.0
    if rule == Rule.METRES:
        comparison.errors(title, errors, METRES, where=where)
    elif rule == Rule.SPREAD:
        comparison.errors(title, errors / spread, SPREAD, where=where)
    else:
        rows = errors[0] if len(errors) == 1 else errors
        worst = np.sort(rows.reshape(len(rows), -1).max(1)) / spread
        comparison.errors(title, worst[: math.ceil(MOST[rule] * len(worst))], SPREAD, where=where)
        comparison.errors(OTHER_ROWS, worst, OTHERS, where=f"{name} of {where}")
    if whole is not None:
        _compare_statistics(comparison, title, own, whole, f"{name} of {where}")


def _compare_statistics(comparison: Comparison, title: str, own: Quantity, whole: Statistic, where: str) -> None:
    """Compare the whole of an array, most of which may not be stored."""
    values = own.values.astype(np.float64)
    if values.size != math.prod(whole.shape):
        raise InputError(f"a golden set gives {where} the shape {whole.shape}, the network {list(values.shape)}")
    unit = 1.0 if own.rule == Rule.METRES else (whole.std or 1.0)
    tolerance = METRES if own.rule == Rule.METRES else SPREAD
    most = np.array([values.mean() - whole.mean, values.std(ddof=1) - whole.std])
    first = values.reshape(-1)[: len(whole.first)] - np.array(whole.first)
    few = np.array([np.abs(values).max() - whole.absmax, *first])
    comparison.errors(title, most / unit, tolerance, where=where)
    if own.rule in MOST:
        comparison.errors(OTHER_ROWS, few / unit, OTHERS, where=where)
    else:
        comparison.errors(title, few / unit, tolerance, where=where)


def _stored(name: str, own: NDArray[Any], stored: GoldenArrays) -> tuple[NDArray[Any], NDArray[Any]]:
    """The stored numbers, and those of ours that they are of: all, or every n-th along an axis."""
    take = {"b": stored.verdicts, "i": stored.integers}.get(own.dtype.kind, stored.floats)
    numbers: NDArray[Any] = take(name, *[None] * own.ndim)
    steps = [math.ceil(have / kept) if kept else have + 1 for have, kept in zip(own.shape, numbers.shape, strict=True)]
    part = own[tuple(slice(None, None, step) for step in steps)]
    if part.shape != numbers.shape:
        raise InputError(
            f"array {name} in {stored.path} has shape {numbers.shape}, and the network gives {own.shape}; pass a set "
            "of this model"
        )
    return numbers, part


def _compare_calls(comparison: Comparison, trace: Trace, golden: SparseSet, frame: int, where: str) -> None:
    """Compare what modules gave, in the order of their calls, as far as they are called alike here."""
    taken: dict[str, int] = {}
    compared = 0
    for call in golden.calls[frame]:
        number = taken[call.module] = taken.get(call.module, -1) + 1
        own = trace.calls.get(call.module, [])
        if number >= len(own):
            continue
        mean, deviation, largest, count = own[number]
        place = f"{call.module} of {where}"
        # The official code repeats plans and times for each mode and command.
        if math.prod(call.shape) % count:
            raise InputError(f"a golden set gives {place} the shape {call.shape}, the network {count} numbers")
        unit, total = call.std or 1.0, math.prod(call.shape)
        deviation *= math.sqrt(total / (total - 1)) if total > 1 else 1.0
        comparison.errors(MODULES, np.array([mean - call.mean, deviation - call.std]) / unit, SPREAD, where=place)
        comparison.errors(LARGEST, np.array([largest - call.absmax]) / unit, OTHERS, where=place)
        compared += 1
    if golden.calls[frame]:
        comparison.note(MODULES, f"{compared} of {len(golden.calls[frame])} calls in {where}")
