"""`challenger-bench verify model` for SparseDrive and DiffusionDrive: golden frames with the state carried along."""

import math
from dataclasses import replace
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from torch import nn

from adapters.extensions.golden_sets.parity_set import GoldenNetwork
from adapters.extensions.golden_sets.sparse_order import Order, follow
from adapters.extensions.golden_sets.sparse_quantities import (
    OTHERS,
    SHARE_OF_SPREAD,
    frame_quantities,
    map_quantities,
)
from adapters.extensions.golden_sets.sparse_set import SparseSet, Statistic
from adapters.extensions.golden_sets.sparse_trace import Trace, traced
from adapters.extensions.golden_sets.tensors import Quantity, Whole, compare_tensor
from adapters.models import Model, resolve
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.keyframe_pose import KeyframeMotion
from adapters.networks.sparse.model import DiffusionDrive, SparseNetwork, pose_of
from benchmark.geometry import Floats
from benchmark.verification.checks import Comparison
from benchmark.verification.golden import GoldenArrays

SWAPPED: Final = 0.03
MOVED: Final = "rows that changed places at near ties (share)"
MODULES: Final = "modules: mean and deviation of what they give (of the deviation)"
LARGEST: Final = "modules: largest number that they give (of the deviation)"


def sparse_sets(config: SparseConfig) -> GoldenNetwork[SparseSet]:
    """Golden sets of networks of other sizes, but for those of images, than the published ones."""
    return GoldenNetwork(SparseSet.read, partial(_built, config), _compare_frames)


def _built(config: SparseConfig, model: Model, golden: SparseSet) -> nn.Module:
    height, width = golden.manifest.image_hw
    sizes = replace(config, image_height_px=height, image_width_px=width)
    network: nn.Module = resolve(model.net.build)(sizes)
    return network


def _compare_frames(comparison: Comparison, network: SparseNetwork, golden: SparseSet) -> None:
    for frame in range(len(golden.outputs)):
        _compare_frame(comparison.at(f"{golden.folder.name}, frame {frame}"), network, golden, frame)


def _compare_frame(comparison: Comparison, network: SparseNetwork, golden: SparseSet, frame: int) -> None:
    """Compute a frame and compare it."""
    stored, before = golden.outputs[frame], network.memory
    inputs, noise = golden.frame(frame, network.config)
    if isinstance(network, DiffusionDrive) and noise is None:
        raise ValueError(f"no array frame{frame}_diffusion_noise")
    device = next(network.parameters()).device
    with traced(network, golden.calls[frame]) as trace:
        predictions = network.predict(replace(inputs, images=inputs.images.to(device)), noise)
    order = Order.of(network, predictions, stored)
    fresh = before is not None and KeyframeMotion.between(before.pose, pose_of(inputs), device).fresh
    follow(network, predictions, before if fresh else None, order, stored)
    ours = map_quantities(trace.maps["img_backbone"], trace.maps["img_neck"])
    ours |= frame_quantities(network, predictions, order, inputs.command, None if before is None else fresh)
    comparison.errors(MOVED, order.moved, SWAPPED)
    if "plan_reg" not in stored.names:
        raise ValueError("no array plan_reg")
    for name, own in ours.items():
        if name in stored.names:
            statistic = golden.statistics[frame].get(name)
            whole = None if statistic is None else _whole(own, statistic)
            compare_tensor(comparison, name, own, _stored(name, own.values, stored), whole)
    if unknown := sorted(stored.names - ours.keys()):
        comparison.note(MOVED, f"not compared in {comparison.where}: {', '.join(unknown)}")
    _compare_calls(comparison, trace, golden, frame)


def _whole(own: Quantity, said: Statistic) -> Whole:
    """Differences over the whole of an array, most of which may not be stored."""
    values = own.values.astype(np.float64)
    if values.size != math.prod(said.shape):
        raise ValueError(f"an array has the shape {said.shape}, the network's {list(values.shape)}")
    most = np.array([values.mean() - said.mean, values.std(ddof=1) - said.std])
    first = values.reshape(-1)[: len(said.first)] - np.array(said.first)
    return Whole(most, np.array([np.abs(values).max() - said.absmax, *first]), said.std or 1.0)


def _stored(name: str, own: NDArray[Any], stored: GoldenArrays) -> tuple[NDArray[Any], Floats]:
    """The part of our numbers that is stored, all or every n-th along an axis, and the stored ones."""
    numbers = stored.floats(name, *[None] * own.ndim)
    steps = [math.ceil(have / kept) if kept else have + 1 for have, kept in zip(own.shape, numbers.shape, strict=True)]
    part = own[tuple(slice(None, None, step) for step in steps)]
    if part.shape != numbers.shape:
        raise ValueError(f"array {name} has the shape {numbers.shape}, and the network gives {own.shape}")
    return part, numbers


def _compare_calls(comparison: Comparison, trace: Trace, golden: SparseSet, frame: int) -> None:
    """Compare what modules gave, in the order of their calls, as far as they are called alike here."""
    taken: dict[str, int] = {}
    compared = 0
    for call in golden.calls[frame]:
        number = taken[call.module] = taken.get(call.module, -1) + 1
        own = trace.calls.get(call.module, [])
        if number >= len(own):
            continue
        mean, deviation, largest, count = own[number]
        at = comparison.at(f"{call.module} of {comparison.where}")
        # The official code repeats plans and times for each mode and command.
        if math.prod(call.shape) % count:
            raise ValueError(f"{at.where} has the shape {call.shape}, the network {count} numbers")
        unit, total = call.std or 1.0, math.prod(call.shape)
        deviation *= math.sqrt(total / (total - 1)) if total > 1 else 1.0
        at.errors(MODULES, np.array([mean - call.mean, deviation - call.std]) / unit, SHARE_OF_SPREAD)
        at.errors(LARGEST, (largest - call.absmax) / unit, OTHERS)
        compared += 1
    if golden.calls[frame]:
        comparison.note(MODULES, f"{compared} of {len(golden.calls[frame])} calls in {comparison.where}")


GOLDEN: Final = sparse_sets(SparseConfig())
