"""3-D boxes of agents as a camera sees them: where they are at an exposure, their corners and edges in camera axes."""

from typing import Final

import numpy as np

from benchmark.geometry import Bools, Floats, rotation_matrix
from benchmark.scene import Camera, Scene

_CORNERS: Final = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
"""Of a unit box; neighbours differ in one coordinate."""
BOX_EDGES: Final = tuple((a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1)
"""The twelve pairs of corners that an edge joins."""


def interpolate_agents(scene: Scene, timestamp_us: int) -> tuple[Floats, Floats, Bools]:
    """(N, 3) box centres, (N,) headings and (N,) presence of the agents at a time in microseconds, interpolated.

    Outside the scene as in its first or last frame.
    """
    times = scene.timestamps_us
    after = int(np.clip(np.searchsorted(times, timestamp_us), 1, max(len(times) - 1, 1))) if len(times) > 1 else 0
    before = max(after - 1, 0)
    span = float(times[after] - times[before])
    share = 0.0 if span == 0 else float(np.clip((timestamp_us - times[before]) / span, 0.0, 1.0))
    agents = scene.agents
    position = (1 - share) * agents.position[:, before] + share * agents.position[:, after]
    turn = np.angle(np.exp(1j * (agents.yaw[:, after] - agents.yaw[:, before])))
    nearest = after if share >= 0.5 else before
    return position, agents.yaw[:, before] + share * turn, agents.valid[:, nearest]


def compute_box_corners(position: Floats, yaw: float, size: Floats) -> Floats:
    """(8, 3) global corners of an upright box of (3,) length, width, height; `BOX_EDGES` says which are neighbours."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    turned = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray((_CORNERS * size) @ turned.T + position)


def to_camera(points: Floats, global_T_ego: Floats, camera: Camera) -> Floats:
    """Global (P, 3) points in camera axes, x right, y down, z forward, by the ego's (4, 4) pose at the exposure."""
    in_ego = (points - global_T_ego[:3, 3]) @ global_T_ego[:3, :3]
    return np.asarray((in_ego - camera.translation) @ rotation_matrix(camera.rotation))


def intersect_near_plane(first: Floats, second: Floats, near_m: float) -> Floats:
    """Where the line between a point before and one behind the near plane crosses it; (3,) camera axes each."""
    share = (near_m - first[2]) / (second[2] - first[2])
    return np.asarray(first + share * (second - first))
