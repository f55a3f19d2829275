"""``ctg-realism@code``: the "realism deviation" that papers on nuScenes quote, with every quirk of its public code.

For comparison with the literature, never for a ranking: sizes of accelerations are projected on the axes of the world,
speeds above 4 m/s fall out of the histograms, and noise of 5 cm costs more than anything a driver does. How to
quote it: ``docs/realism.md``. Single precision is part of the definition.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats

NAME: Final = "ctg-realism@code"
STEP_S: Final = 0.5
SAMPLES_PER_STEP: Final = 5
"""Tracks come at 10 Hz; every fifth sample is kept."""
BINS: Final = 20
_MOVING_M_S: Final = 0.5
_RANGES: Final = {
    "velocity": (0.0, 4.0),
    "lon_accel": (-2.0, 2.0),
    "lat_accel": (-2.0, 2.0),
    "jerk": (-1.0, 1.0),
    "rel_pos_norm": (0.0, 50.0),
    "rel_lon_pos_abs": (0.0, 50.0),
    "rel_lat_pos": (0.0, 50.0),
    "rel_yaw_abs": (0.0, np.pi),
    "rel_yaw_vel_abs": (0.0, np.pi),
    "rel_vel_norm": (0.0, 4.0),
    "rel_lon_vel": (-4.0, 4.0),
    "rel_lat_vel": (-4.0, 4.0),
    "rel_accel_norm": (0.0, 2.0),
    "rel_lon_accel": (-2.0, 2.0),
    "rel_lat_accel": (-2.0, 2.0),
    "rel_jerk": (-1.0, 1.0),
}
AGENT_NAMES: Final = tuple(_RANGES)[:4]
RELATIVE_NAMES: Final = tuple(_RANGES)[4:]
MEANS: Final = {
    "mean_real_dev": ("lon_accel", "lat_accel", "jerk"),
    "mean_real_dev_int": ("rel_lon_accel", "rel_lat_accel", "rel_jerk"),
}
"""The two numbers that are quoted, and what they are means of."""

Singles = NDArray[np.float32]
Histograms = dict[str, Floats]


class CtgVersion(StrEnum):
    """Which public code: `CTG` is the one that published numbers come from."""

    OLD = "old"
    HEAD = "head"
    CTG = "ctg"
    MTD = "mtd"


class CtgMask(StrEnum):
    """Which agents count; `CURRENT_SPEED` is the default of the public script."""

    NONE = "None"
    CURRENT_SPEED = "current_speed"
    ANY_SPEED = "any_speed"


class CtgNormalisation(StrEnum):
    """Whether histograms are averaged over scenes or summed."""

    SCENE = "scene"
    DATASET = "dataset"


@dataclass(frozen=True, slots=True)
class SceneTracks:
    """One scene, 10 Hz: (N, T, 2) metres and (N, T) headings in the world, radians, NaN where an agent is absent."""

    position: Floats
    yaw: Floats


def compute_histograms(
    scenes: Sequence[SceneTracks],
    version: CtgVersion = CtgVersion.CTG,
    normalisation: CtgNormalisation = CtgNormalisation.SCENE,
    mask: CtgMask = CtgMask.CURRENT_SPEED,
    edges: Mapping[str, Floats] | None = None,
) -> Histograms:
    """(20,) shares of the histograms of scenes, at least one, by name; relative ones in the version `CTG` alone.

    ``mask`` says which agents count; versions without masks do not look at it. Edges, (21,) by name, are those of
    the code by default.
    """
    edges = bin_edges() if edges is None else edges
    counts = [_count_scene(scene, version, mask, edges) for scene in scenes]
    shares = {}
    for name in counts[0]:
        of_scenes = np.array([scene_counts[name] for scene_counts in counts])
        totals = of_scenes.sum(axis=1, keepdims=True)
        if normalisation is CtgNormalisation.SCENE:
            shares[name] = np.mean(of_scenes / np.where(totals > 0, totals, 1.0), axis=0)
        else:
            shares[name] = of_scenes.sum(axis=0) / max(float(totals.sum()), 1.0)
    return shares


def compute_deviations(
    first: Histograms, second: Histograms, edges: Mapping[str, Floats] | None = None
) -> dict[str, float]:
    """Earth mover's distances, by name, of generated scenes and recordings, the quoted means among them.

    The edges are those of `compute_histograms`.
    """
    edges = bin_edges() if edges is None else edges
    distances = {}
    for name, shares in first.items():
        widths = np.diff(np.asarray(edges[name])[1:])
        moved = np.abs(np.cumsum(_normalise(shares) - _normalise(second[name])))[:-1]
        distances[name] = float((widths * moved).sum())
    means = {
        mean: float(np.mean([distances[name] for name in names]))
        for mean, names in MEANS.items()
        if all(name in distances for name in names)
    }
    return {**distances, **means}


def bin_edges() -> dict[str, Floats]:
    """(21,) edges by name: those that the public code makes in single precision."""
    import torch

    return {
        name: torch.linspace(low, high, BINS + 1, dtype=torch.float32).double().numpy()
        for name, (low, high) in _RANGES.items()
    }


def _normalise(shares: Floats) -> Floats:
    total = float(shares.sum())
    return shares / total if total > 0 else shares


def _count_scene(scene: SceneTracks, version: CtgVersion, mask: CtgMask, edges: Mapping[str, Floats]) -> Histograms:
    position = scene.position[:, ::SAMPLES_PER_STEP].astype(np.float32)
    yaw = scene.yaw[:, ::SAMPLES_PER_STEP].astype(np.float32)
    values = _compute_agent_values(position, yaw, version)
    masked = version in (CtgVersion.CTG, CtgVersion.MTD)
    counts = _find_counted(position, values["velocity"], mask) if masked else np.ones(yaw.shape, np.bool_)
    counts_of_feature = {name: _build_histogram(values[name], counts, edges[name]) for name in AGENT_NAMES}
    if version is CtgVersion.CTG:
        relative, of_other = _compute_relative_values(position, yaw, counts)
        counts_of_feature |= {name: _build_histogram(relative[name], of_other, edges[name]) for name in RELATIVE_NAMES}
    return counts_of_feature


def _build_histogram(values: Singles, counts: Bools, edges: Floats) -> Floats:
    counted_values = values[counts]
    # Values after an absent sample are NaN and dropped, like values out of range.
    return np.histogram(counted_values[np.isfinite(counted_values)], np.asarray(edges, np.float32))[0].astype(
        np.float64
    )


def _compute_agent_values(position: Singles, yaw: Singles, version: CtgVersion) -> dict[str, Singles]:
    if version is CtgVersion.OLD:
        # That code pads with the first difference itself, and differentiates positions instead of velocities.
        velocity = _differences(position, position[:, 1:2] - position[:, :1])
        acceleration = _differences(position, velocity[:, 1:2] - velocity[:, :1])
        size = _norm(acceleration)
        jerk = _differences(size, size[:, 1:2] - size[:, :1])
    else:
        velocity = _differentiate(position)
        acceleration = _differentiate(velocity)
        size = _norm(acceleration)
        jerk = _differentiate(size)
    return {
        "velocity": _norm(velocity),
        "lon_accel": size * np.cos(yaw),
        "lat_accel": size * np.sin(yaw),
        "jerk": jerk,
    }


def _find_counted(position: Singles, speed: Singles, mask: CtgMask) -> Bools:
    """(N, T) samples that count: an agent on the line x + y = 0 is lost, and one that comes after the second sample."""
    filled = np.nan_to_num(position)
    there = filled[..., 0] + filled[..., 1] != 0
    counts = there & there[:, 1:2]
    if mask is CtgMask.CURRENT_SPEED:
        counts &= speed[:, :1] > _MOVING_M_S
    elif mask is CtgMask.ANY_SPEED:
        counts &= (speed > _MOVING_M_S).any(axis=1, keepdims=True)
    return np.asarray(counts)


def _compute_relative_values(position: Singles, yaw: Singles, counts: Bools) -> tuple[dict[str, Singles], Bools]:
    """Values of ordered pairs of observer and other, and where the other counts."""
    relative_position = _to_observer_frames(np.nan_to_num(position), yaw)
    turn = np.asarray((yaw[None] - yaw[:, None] + np.pi) % (2 * np.pi) - np.pi, np.float32)
    pairs = ~np.eye(len(position), dtype=np.bool_)
    place, turn = relative_position[pairs], turn[pairs]
    of_other = np.broadcast_to(counts, (len(position), *counts.shape))[pairs]
    velocity = _differentiate(place)
    acceleration = _differentiate(velocity)
    size = _norm(acceleration)
    values = {
        "rel_pos_norm": _norm(place),
        "rel_lon_pos_abs": np.abs(place[..., 0]),
        "rel_lat_pos": np.abs(place[..., 1]),
        "rel_yaw_abs": np.abs(turn),
        "rel_yaw_vel_abs": np.abs(_differentiate(turn)),
        "rel_vel_norm": _norm(velocity),
        "rel_lon_vel": velocity[..., 0],
        "rel_lat_vel": velocity[..., 1],
        "rel_accel_norm": size,
        "rel_lon_accel": acceleration[..., 0],
        "rel_lat_accel": acceleration[..., 1],
        "rel_jerk": _differentiate(size),
    }
    return values, of_other


def _to_observer_frames(position: Singles, yaw: Singles) -> Singles:
    """(N, N, T, 2) places in the frames of observers, through inverted matrices as the code does it.

    The rounding of that inversion decides about the bins of cars that all but stand.
    """
    import torch

    absent = np.isnan(yaw)
    cos, sin = np.cos(yaw), np.sin(yaw)
    zero, one = np.zeros_like(yaw), np.ones_like(yaw)
    rows = [[cos, -sin, position[..., 0]], [sin, cos, position[..., 1]], [zero, zero, one]]
    frame = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2).astype(np.float32)
    frame[absent] = np.eye(3, dtype=np.float32)
    inverse = torch.linalg.inv(torch.from_numpy(frame))
    inverse[torch.from_numpy(absent)] = torch.nan
    points = torch.from_numpy(np.concatenate([position, one[..., None]], axis=-1).astype(np.float32))
    return np.asarray(torch.einsum("itab,jtb->ijta", inverse, points).numpy()[..., :2], np.float32)


def _differentiate(values: Singles) -> Singles:
    """Differences a second along the second axis; the first one is repeated."""
    return _differences(values, values[:, :1] - (values[:, 1:2] - values[:, :1]))


def _differences(values: Singles, before: Singles) -> Singles:
    earlier = np.concatenate([before, values[:, :-1]], axis=1)
    return np.asarray((values - earlier) / np.float32(STEP_S), np.float32)


def _norm(values: Singles) -> Singles:
    return np.asarray(np.linalg.norm(values, axis=-1), np.float32)
