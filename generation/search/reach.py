"""Which vehicles can get in the way of the recorded ego, how soon, and whether they can stay near it afterwards.

What is asked is rough on purpose, one arc at a steady change of speed: it says whom to try and from when, and the
search finds out the rest. ``docs/generation.md``, "Who and from when".
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import WHEELBASE, DriverLimits
from benchmark.geometry import Bools, Floats, to_local, wrap_angle
from benchmark.scene import Scene
from generation.search.ego_way import EgoWay, ego_way
from generation.search.hyperparameters import HyperParameters
from generation.search.recorded_motion import drives_forward, in_canvas, initial_state

SOONEST_S: Final = 1.0
LATEST_S: Final = 6.0
SOON_S: Final = 3.0
"""Who is there as soon as this takes over at once."""
ROOMS_M: Final = (3.0, 10.0, 20.0)
"""How far ahead of the ego's front it may arrive."""
ACCELERATION_M_S2: Final = 2.0
BRAKING_M_S2: Final = 3.5
ACROSS_M_S2: Final = 3.0
"""What the way there may ask for; less than a driver's limits, because no arc is driven as it is drawn."""
MOST_BEARING_RAD: Final = np.deg2rad(75.0)
MOST_TURN_RAD: Final = np.deg2rad(100.0)
"""Arriving against the ego's direction is no way in front of it but a head-on crash."""
FOLLOWING_RAD: Final = np.deg2rad(60.0)
"""Who arrives along the ego's path within this can drive on with it; others must stop where they are."""
ROAD_SHARES: Final = (0.2, 0.4, 0.6, 0.8, 1.0)
MARGIN_M: Final = 5.0
"""Of the area around the ego that is not counted on."""


@dataclass(frozen=True, slots=True)
class Start:
    """A vehicle at F frames at which it might take over. (F, 3) poses of its box centre, (F,) speeds in m/s."""

    frames: NDArray[np.int64]
    poses: Floats
    speed: Floats
    length_m: float


def reach_s(scene: Scene, way: EgoWay, start: Start, half_extent_m: float) -> Floats:
    """Time until a vehicle can be in the ego's way, driving an arc at a steady change of speed on the road.

    (F,) seconds, infinite where it cannot, or where it could not stay in the area afterwards (``half_extent_m``:
    half the side of the square around the ego).
    """
    step = FRAMES_PER_KEYFRAME
    ahead = np.arange(round(SOONEST_S * FRAME_HZ), round(LATEST_S * FRAME_HZ) + 1, step)
    last = len(way.station) - 1
    at = start.frames[:, None] + ahead
    frame = np.minimum(at, last)
    rooms = np.array(ROOMS_M)
    station = way.station[frame][..., None] + 0.5 * (way.length_m + start.length_m) + rooms
    goal = np.stack([np.interp(station, way.stations, way.points[:, axis]) for axis in range(2)], axis=-1)
    heading = np.interp(station, way.stations, np.unwrap(way.headings))
    seconds = np.broadcast_to((ahead / FRAME_HZ)[None, :, None], station.shape)
    possible, arriving = _drivable_arcs(start, goal, seconds)
    turn = np.abs(wrap_angle(arriving - heading))
    possible &= (turn <= MOST_TURN_RAD) & (at <= last)[..., None]
    row, time, room = np.nonzero(possible)
    shares = np.array(ROAD_SHARES)[:, None]
    begin, end = start.poses[row, :2], goal[row, time, room]
    on_road = scene.road_map.is_drivable(begin[:, None] + shares * (end - begin)[:, None]).all(axis=-1)
    follows = turn[row, time, room] <= FOLLOWING_RAD
    on_road[~follows & on_road] &= _stays(scene, frame[row, time], end, half_extent_m)[~follows & on_road]
    possible[row, time, room] = on_road
    soonest = np.where(possible.any(axis=-1), ahead / FRAME_HZ, np.inf)
    return np.asarray(soonest.min(axis=1))


def _drivable_arcs(start: Start, goal: Floats, seconds: Floats) -> tuple[Bools, Floats]:
    """Whether arcs to (F, A, R, 2) goals can be driven in so many (F, A, R) seconds, and the headings at their ends."""
    speed, yaw = start.speed[:, None, None], start.poses[:, None, None, 2]
    away = goal - start.poses[:, None, None, :2]
    chord = np.hypot(away[..., 0], away[..., 1])
    bearing = wrap_angle(np.arctan2(away[..., 1], away[..., 0]) - yaw)
    # The arc that leaves along the heading; its length, curvature and the speed that it takes.
    length = chord * np.where(np.abs(bearing) > 1e-3, bearing / np.sin(np.where(bearing == 0.0, 1.0, bearing)), 1.0)
    curvature = 2.0 * np.abs(np.sin(bearing)) / np.maximum(chord, 1e-6)
    limits = DriverLimits()
    fastest = speed * seconds + 0.5 * ACCELERATION_M_S2 * seconds**2
    fastest = np.minimum(fastest, np.maximum(limits.speed_m_s, speed) * seconds)
    braking = np.minimum(seconds, speed / BRAKING_M_S2)
    slowest = speed * braking - 0.5 * BRAKING_M_S2 * braking**2
    tightest = np.tan(limits.steering_rad) / (WHEELBASE * start.length_m)
    mean = length / seconds
    possible = (np.abs(bearing) <= MOST_BEARING_RAD) & (slowest <= length) & (length <= fastest)
    possible &= (curvature <= tightest) & (curvature * mean**2 <= ACROSS_M_S2)
    return possible, wrap_angle(yaw + 2.0 * bearing)


def _stays(scene: Scene, frames: NDArray[np.int64], points: Floats, half_extent_m: float) -> Bools:
    """(P,) whether points stay in the area around the ego from (P,) frames to the end of the scene."""
    pose = scene.ego.pose
    inside = np.stack(
        [np.abs(to_local(points, each)).max(axis=-1) <= half_extent_m - MARGIN_M for each in pose], axis=1
    )
    return np.asarray((inside | (np.arange(len(pose)) < frames[:, None])).all(axis=1))


def launch_in_reach(scene: Scene, agent: int, hyper: HyperParameters) -> int | None:
    """When a vehicle takes over: at the first frame from which it is in the ego's way within 3 s, else the soonest.

    Frames are looked at every half second. As everywhere it has been there for the history, drives forwards, stands
    on the road in the area around the ego, and enough of the scene is left. ``None`` where it can never get in the
    ego's way.
    """
    valid = scene.agents.valid[agent]
    seen = np.convolve(valid, np.ones(hyper.history_frames + 1), mode="full")[: len(valid)] > hyper.history_frames
    position = scene.agents.position[agent, :, :2]
    seen &= in_canvas(scene, position, hyper.half_extent_m - MARGIN_M)
    seen[len(valid) - hyper.shortest_drive_frames :] = False
    frames = np.flatnonzero(seen)
    frames = frames[frames % FRAMES_PER_KEYFRAME == 0]
    frames = frames[scene.road_map.is_drivable(position[frames])]
    frames = np.array([frame for frame in frames.tolist() if drives_forward(scene, agent, frame)], np.int64)
    if not len(frames):
        return None
    way = ego_way(scene)
    seconds = reach_s(scene, way, _start(scene, agent, frames), hyper.half_extent_m)
    seconds = np.where(frames + FRAME_HZ * seconds <= last_opportunity(way, hyper), seconds, np.inf)
    best = int(np.argmax(seconds <= SOON_S)) if (seconds <= SOON_S).any() else int(np.argmin(seconds))
    return int(frames[best]) if np.isfinite(seconds[best]) else None


def last_opportunity(way: EgoWay, hyper: HyperParameters) -> int:
    """The last frame at which an ego that does not react would run into what keeps its air ahead; -1 for none.

    Where no overrun is asked for (``least_overrun_m``) it is the last frame of the scene.
    """
    if not hyper.least_overrun_m:
        return len(way.speed) - 1
    air = hyper.clearance_m + hyper.headway_s * way.speed
    return int(np.flatnonzero(way.overrun >= air + hyper.least_overrun_m).max(initial=-1))


def reach_at(scene: Scene, agent: int, frame: int, hyper: HyperParameters) -> float:
    """`reach_s` of one vehicle at one frame."""
    start = _start(scene, agent, np.array([frame], np.int64))
    return float(reach_s(scene, ego_way(scene), start, hyper.half_extent_m)[0])


def _start(scene: Scene, agent: int, frames: NDArray[np.int64]) -> Start:
    agents = scene.agents
    speed = np.array([initial_state(scene, agent, frame, None).speed for frame in frames.tolist()])
    poses = np.column_stack([agents.position[agent, frames, :2], agents.yaw[agent, frames]])
    return Start(frames, poses, speed, float(agents.size[agent, 0]))
