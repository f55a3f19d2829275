"""Tracks of the ego and of everybody near it, rounded to what can be seen."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from benchmark.constants import EGO_BODY_WIDTH_M, EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M
from benchmark.geometry import Bools, Floats
from benchmark.records.scene_pages import PageAgent, PageEgo, Point
from benchmark.scene import Scene

NEAR_M: Final = 80.0
"""Agents are shown while they are so near to the ego."""


def find_origin(scene: Scene) -> Point:
    """Origin of a sheet's positions: the ego's first position, whole metres."""
    x, y = np.rint(scene.ego.position[0, :2])
    return float(x), float(y)


def build_ego_track(scene: Scene, origin: Point) -> PageEgo:
    """Recorded motion of the ego, one pose a frame, rounded to centimetres and milliradians, relative to ``origin``."""
    pose = scene.ego.pose
    return PageEgo(
        x_m=_round_values(pose[:, 0] - origin[0], 2),
        y_m=_round_values(pose[:, 1] - origin[1], 2),
        yaw_rad=_round_values(_wrap_headings(pose[:, 2]), 3),
        length_m=EGO_LENGTH_M,
        width_m=EGO_BODY_WIDTH_M,
        centre_ahead_m=EGO_CENTER_FROM_REAR_AXLE_M,
    )


def build_agent_tracks(scene: Scene, origin: Point) -> tuple[PageAgent, ...]:
    """Tracks of the agents that come near the ego, and last of all adversaries, relative to ``origin``.

    An agent's values go from the first frame in which it is near to the last; an adversary's from the first in which it
    is there.
    """
    agents = scene.agents
    away_m = np.linalg.norm(agents.position[..., :2] - scene.ego.position[None, :, :2], axis=-1)
    visible = agents.valid & (away_m <= NEAR_M)
    adversaries = [name in scene.adversaries for name in agents.ids]
    visible[adversaries] = agents.valid[adversaries]
    order = sorted(range(len(agents)), key=lambda agent: adversaries[agent])
    return tuple(
        _build_agent_track(scene, agent, visible[agent], origin, adversary=adversaries[agent])
        for agent in order
        if visible[agent].any()
    )


def _build_agent_track(scene: Scene, agent: int, shown: Bools, origin: Point, *, adversary: bool) -> PageAgent:
    at = np.flatnonzero(shown)
    frames = slice(int(at[0]), int(at[-1]) + 1)
    agents = scene.agents
    there = agents.valid[agent, frames]
    length_m, width_m, height_m = (round(float(side), 2) for side in agents.size[agent])
    return PageAgent(
        id=agents.ids[agent],
        category=agents.categories[agent],
        size_m=(length_m, width_m, height_m),
        adversary=adversary,
        first=frames.start,
        x_m=_mask_absent(there, _round_values(agents.position[agent, frames, 0] - origin[0], 2)),
        y_m=_mask_absent(there, _round_values(agents.position[agent, frames, 1] - origin[1], 2)),
        yaw_rad=_mask_absent(there, _round_values(_wrap_headings(agents.yaw[agent, frames]), 3)),
    )


def _wrap_headings(yaw: Floats) -> Floats:
    return np.asarray(np.angle(np.exp(1j * yaw)))


def _round_values(values: Floats, digits: int) -> tuple[float, ...]:
    # Adding zero turns a negative zero into zero.
    return tuple((np.round(values, digits) + 0.0).tolist())


def _mask_absent(there: Bools, values: Sequence[float]) -> tuple[float | None, ...]:
    return tuple(value if known else None for known, value in zip(there, values, strict=True))
