"""Where queries start: cluster centres of a data set, as the published checkpoints hold them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from adapters.networks.sparse.boxes import BOX_CODE
from adapters.networks.sparse.config import SparseConfig
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed

BOXES: Final = "head.det_head.instance_bank.anchor"
LINES: Final = "head.map_head.instance_bank.anchor"
FORECASTS: Final = "head.motion_plan_head.motion_anchor"
PLANS: Final = "head.motion_plan_head.plan_anchor"
FROZEN: Final = (FORECASTS, PLANS)
"""These stay as they are in training; the others move."""
ALIKE_M: Final = 1e-4
FARTHEST_M: Final = 55.0
"""Boxes that are farther away make no anchors."""
LINE_END_M: Final = 4.0
"""Lines start straight along y, from minus this to this around their centres."""
ROUNDS: Final = 100
CHUNK: Final = 4096


@dataclass(frozen=True, slots=True)
class AnchorSamples:
    """Sightings in a data set of the things that queries are for; lidar frame, metres.

    `box_centres` are (N, 3), `line_centres` (N, 2) means of the points of map elements; `futures` (N, agent steps, 2)
    by class, cumulative positions in the agent's frame, x forward; `plans` (N, steps, 2) by command, cumulative.
    """

    box_centres: ArrayLike
    line_centres: ArrayLike
    futures: list[ArrayLike]
    plans: list[ArrayLike]


def cluster_anchors(sightings: AnchorSamples, config: SparseConfig) -> dict[str, Tensor]:
    """Anchors clustered from sightings: float32 tensors under the names of the network.

    An agent class that is seen too rarely repeats the futures it has, and one that is never seen stands still.
    """
    centres = _numbers(sightings.box_centres, "boxes", 3)
    boxes = np.zeros((config.anchors, BOX_CODE))
    near = centres[np.hypot(centres[:, 0], centres[:, 1]) <= FARTHEST_M]
    boxes[:, :3] = find_cluster_centres(near, config.anchors, f"boxes within {FARTHEST_M:g} m")
    boxes[:, 3:7] = 1.0
    middles = find_cluster_centres(_numbers(sightings.line_centres, "map elements", 2), config.lines, "map elements")
    along = np.linspace(-LINE_END_M, LINE_END_M, config.points_per_line)
    lines = middles[:, None] + np.stack([np.zeros_like(along), along], -1)
    if len(sightings.futures) != config.agent_classes or len(sightings.plans) != config.commands:
        raise InputError(
            f"anchors need futures of {config.agent_classes} agent classes and plans of {config.commands} commands, "
            f"not of {len(sightings.futures)} and {len(sightings.plans)}"
        )
    futures = [
        _modes(_numbers(samples, f"futures of agent class {kind}", config.agent_steps, 2), config.modes, kind)
        for kind, samples in enumerate(sightings.futures)
    ]
    plans = [
        find_cluster_centres(_numbers(samples, name, config.steps, 2), config.modes, name)
        for name, samples in ((f"plans of command {command}", plans) for command, plans in enumerate(sightings.plans))
    ]
    anchors = {
        BOXES: boxes,
        LINES: lines.reshape(config.lines, -1),
        FORECASTS: np.stack(futures),
        PLANS: np.stack(plans),
    }
    return {name: torch.from_numpy(values).float() for name, values in anchors.items()}


def add_anchors(checkpoint: Mapping[str, Tensor], anchors: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Tensors of a checkpoint, with anchors where it has none of its own.

    Anchors of another shape, or other ones where training leaves them as they are, are an `InputError`.
    """
    for name, anchor in anchors.items():
        present = checkpoint.get(name)
        if present is None:
            continue
        if present.shape != anchor.shape:
            raise InputError(
                f"the checkpoint has {name} of shape {tuple(present.shape)} but the anchors have shape "
                f"{tuple(anchor.shape)}; load it without anchors, it has its own"
            )
        apart = float((present.double() - anchor.double()).abs().amax())
        if name in FROZEN and not apart <= ALIKE_M:
            raise InputError(
                f"the checkpoint was trained with other anchors: {name} differs by up to {apart:.3g} m; load it "
                "without anchors, it has its own"
            )
    return {**anchors, **checkpoint}


def find_cluster_centres(points: Floats, clusters: int, what: str) -> Floats:
    """Centres of clusters (k-means, Lloyd 1982, from spread starts, Arthur and Vassilvitskii 2007).

    (clusters, ...) of (N, ...) metres, the same for the same points; `what` is for the seed and for messages.
    """
    flat = points.reshape(len(points), math.prod(points.shape[1:]))
    different = len(np.unique(flat, axis=0)) if len(flat) else 0
    if different < clusters:
        raise InputError(
            f"the data set has {different} different {what} but anchors need {clusters}; use a larger data set"
        )
    centres = _spread_starts(flat, clusters, np.random.default_rng(content_seed("anchors", what, clusters)))
    for _ in range(ROUNDS):
        nearest = np.concatenate([_squared_distances(part, centres).argmin(1) for part in _chunks(flat)])
        counts = np.bincount(nearest, minlength=clusters)
        sums = np.stack([np.bincount(nearest, axis, clusters) for axis in flat.T], 1)
        # A cluster that lost its points keeps its place.
        moved = np.where(counts[:, None] > 0, sums / np.maximum(counts, 1)[:, None], centres)
        settled = np.allclose(moved, centres, rtol=0, atol=1e-9)
        centres = moved
        if settled:
            break
    return centres.reshape(clusters, *points.shape[1:])


def _modes(futures: Floats, modes: int, kind: int) -> Floats:
    """(modes, steps, 2) futures of an agent class, however rare it is."""
    if len(futures) == 0:
        return np.zeros((modes, *futures.shape[1:]))
    different = np.unique(futures, axis=0)
    if len(different) >= modes:
        return find_cluster_centres(futures, modes, f"futures of agent class {kind}")
    repeated: Floats = different[np.arange(modes) % len(different)]
    return repeated


def _spread_starts(points: Floats, clusters: int, generator: np.random.Generator) -> Floats:
    """Points of which each is likely far from those before it."""
    centres = [points[generator.integers(len(points))]]
    apart = np.square(points - centres[0]).sum(1)
    while len(centres) < clusters:
        centres.append(points[generator.choice(len(points), p=apart / apart.sum())])
        apart = np.minimum(apart, np.square(points - centres[-1]).sum(1))
    return np.array(centres)


def _squared_distances(points: Floats, centres: Floats) -> Floats:
    """Squared distances, up to a term that is the same for all centres."""
    squares: Floats = np.square(centres).sum(1) - 2 * points @ centres.T
    return squares


def _chunks(points: Floats) -> list[Floats]:
    return [points[start : start + CHUNK] for start in range(0, len(points), CHUNK)]


def _numbers(values: ArrayLike, what: str, *axes: int) -> Floats:
    array: NDArray[Any] = np.asarray(values, np.float64)
    array = array.reshape(0, *axes) if array.size == 0 else array
    if array.shape[1:] != axes or not np.isfinite(array).all():
        raise InputError(f"anchors need {what} of shape N x {' x '.join(map(str, axes))} without NaN or infinity")
    return array
