"""Scenes as courses: where a drive starts, how long it lasts, who is there."""

from typing import Any

import numpy as np

from benchmark.closed_loop.agent_policy import AgentPolicy
from benchmark.closed_loop.plan_tracking import Ego
from benchmark.closed_loop.track_replay import TrackReplay
from benchmark.closed_loop.world_state import STEP_US, SimulationConfig
from benchmark.constants import EGO_WHEELBASE_M
from benchmark.errors import InputError
from benchmark.geometry import Floats, to_local, wrap_angle
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.scene import Scene

_MOTION_S = 0.25
"""Over how long, to both sides, the recorded motion at a start is taken."""
_SLOWEST_M_S = 0.5
"""Slower than this, a recorded turn says nothing about the wheels."""


def build_simulation_config(
    scene: Scene,
    *,
    policy: AgentPolicy[Any] | None = None,
    keyframe: int = 0,
    duration_s: float | None = None,
    seed: int = 0,
    latency_us: int = 0,
) -> SimulationConfig:
    """The course of a scene from a keyframe on, which starts with the recorded motion and tracks.

    It lasts to the scene's last keyframe by default. A plan takes effect ``latency_us`` later; every contact
    ends the drive.
    """
    if not 0 <= keyframe < len(scene.keyframes):
        raise InputError(f"{scene.name} has {len(scene.keyframes)} keyframes; it has no keyframe number {keyframe}")
    start_us = int(scene.timestamps_us[scene.keyframes[keyframe]])
    last_us = int(scene.timestamps_us[scene.keyframes[-1]])
    end_us = last_us if duration_s is None else start_us + round(duration_s * 1e6)
    agents = scene.agents
    return SimulationConfig(
        scene=scene.name,
        start_us=start_us,
        end_us=end_us,
        start=read_recorded_ego(scene, start_us),
        ids=agents.ids,
        categories=agents.categories,
        policy=policy or build_log_replay(scene, start_us, end_us),
        seed=seed,
        latency_us=latency_us,
    )


def build_log_replay(scene: Scene, start_us: int, end_us: int) -> TrackReplay:
    """A scene's own tracks, to the end of the last step of a drive."""
    steps = -(-(end_us - start_us) // STEP_US)
    tracks = ContinuousTracks.of_scene(scene)
    return TrackReplay.of(tracks, int(scene.timestamps_us[0]), start_us, start_us + steps * STEP_US)


def interpolate_recorded_poses(scene: Scene, times_us: Any) -> Floats:
    """(..., 3) the recorded rear axle at times, linear between frames; at the ends it goes on as fast as it was."""
    frames, poses = scene.timestamps_us, scene.ego.pose
    yaw = np.unwrap(poses[:, 2])
    seconds = (np.asarray(times_us, np.int64) - int(frames[0])) / 1e6
    known = (frames - frames[0]) / 1e6
    held = [np.interp(seconds, known, column) for column in (poses[:, 0], poses[:, 1], yaw)]
    ends = _compute_end_velocities(known, poses[:, :2])
    before, after = np.minimum(seconds - known[0], 0.0), np.maximum(seconds - known[-1], 0.0)
    for axis in range(2):
        held[axis] = held[axis] + before * ends[0][axis] + after * ends[1][axis]
    return np.stack(held, axis=-1)


def _compute_end_velocities(known: Floats, places: Floats) -> tuple[Floats, Floats]:
    """(2,) m/s at the first and at the last frame."""
    inner = (int(np.searchsorted(known, known[0] + _MOTION_S)), int(np.searchsorted(known, known[-1] - _MOTION_S)) - 1)
    first, last = min(max(inner[0], 1), len(known) - 1), max(inner[1], 0)
    return (
        (places[first] - places[0]) / (known[first] - known[0]),
        (places[-1] - places[last]) / (known[-1] - known[last]),
    )


def read_recorded_ego(scene: Scene, time_us: int) -> Ego:
    """The recorded ego with its motion at a time of the scene."""
    reach = round(_MOTION_S * 1e6)
    first, now, last = interpolate_recorded_poses(scene, [time_us - reach, time_us, time_us + reach])
    ahead, behind = to_local(last[:2], now), to_local(first[:2], now)
    speed = max(float(ahead[0] - behind[0]) / (2 * _MOTION_S), 0.0)
    acceleration = float(ahead[0] + behind[0]) / _MOTION_S**2
    inside = int(scene.timestamps_us[0]) <= time_us - reach and time_us + reach <= int(scene.timestamps_us[-1])
    turn = float(wrap_angle(np.array(last[2] - first[2])))
    bend = turn / (2 * _MOTION_S * speed) if speed >= _SLOWEST_M_S else 0.0
    steering = float(np.arctan(EGO_WHEELBASE_M * bend))
    yaw = float(wrap_angle(np.array(now[2])))
    return Ego(float(now[0]), float(now[1]), yaw, speed, acceleration if inside else 0.0, steering)
