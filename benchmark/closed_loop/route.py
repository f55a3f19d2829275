"""The route, the recorded ego's path, and the world as driven, as a `Scene` for planners, sensors and scores."""

from dataclasses import dataclass, replace
from typing import Final, Protocol, Self, runtime_checkable

import numpy as np

from benchmark.closed_loop.simulation_state import TICK_US, YAW, EpisodeMotion, X, Y
from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.datasets.sample_truth import compute_command
from benchmark.geometry import Floats, quaternion_from_yaw, to_local
from benchmark.planning import Command, Ride
from benchmark.scene import Annotations, EgoTrack, Scene

EXTENSION_M: Final = 100.0
"""Of the path, straight on where the recording ends."""
_BACK_M: Final = 10.0
_AHEAD_M: Final = 40.0
"""Where along the path the ego may be half a second later: paths cross themselves."""
_SAME_PLACE_M: Final = 0.1
_SHORTEST_M: Final = 1e-6


@dataclass(frozen=True, slots=True)
class RoutePosition:
    """Place beside the route: metres along the path and metres from it."""

    station: float
    aside: float


@dataclass(frozen=True, slots=True)
class Route:
    """Recorded path of the rear axle, global, at (T,) seconds since its first frame.

    ``poses`` are (T, 3), ``heights`` and ``station``, metres along it and equal where it stands, (T,). Commands are
    about the path of the lidar. ``step_seconds`` are (K,), of the keyframes.
    """

    first_us: int
    seconds: Floats
    poses: Floats
    heights: Floats
    station: Floats
    lidar_ahead_m: float
    step_seconds: Floats

    @classmethod
    def of(cls, scene: Scene) -> Self:
        """The route of a scene."""
        poses = scene.ego.pose
        driven = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
        return cls(
            first_us=int(scene.timestamps_us[0]),
            seconds=scene.seconds,
            poses=poses,
            heights=scene.ego.position[:, 2],
            station=driven,
            lidar_ahead_m=float(scene.lidar.translation[0]),
            step_seconds=scene.seconds[scene.keyframes],
        )

    @property
    def end_m(self) -> float:
        """Station of the recording's end."""
        return float(self.station[-1])

    def seconds_of(self, time_us: int) -> float:
        """Seconds since the first frame of a time."""
        return (time_us - self.first_us) * 1e-6

    def place(self, point: Floats, near_m: float | None = None) -> RoutePosition:
        """The nearest point of the path to an x, y, 100 m of extension included.

        ``near_m`` is the station half a second ago, around which alone is looked; the whole path without it.
        """
        start, step, station = self._pieces()
        length = np.hypot(*step.T)
        share = np.clip(((point[:2] - start) * step).sum(axis=1) / np.maximum(length, _SHORTEST_M) ** 2, 0.0, 1.0)
        away = np.hypot(*(start + share[:, None] * step - point[:2]).T)
        if near_m is not None:
            inside = (station + length >= near_m - _BACK_M) & (station <= near_m + _AHEAD_M)
            away = np.where(inside, away, np.inf)
        nearest = int(np.argmin(away))
        return RoutePosition(float(station[nearest] + share[nearest] * length[nearest]), float(away[nearest]))

    def at(self, station: Floats) -> Floats:
        """(..., 2) points of the path after so many metres; straight on before its start and beyond its end."""
        start, step, begins = self._pieces()
        points = np.concatenate([start, start[-1:] + step[-1:]])
        knots = np.append(begins, begins[-1] + EXTENSION_M)
        on_path = np.stack([np.interp(station, knots, points[:, axis]) for axis in range(2)], axis=-1)
        past = np.maximum(np.asarray(station) - knots[-1], 0.0)
        return np.asarray(on_path + past[..., None] * self._extend_straight())

    def height(self, point: Floats) -> float:
        """Height of the road beside a point (2 or more,): engines are planar, hills are not."""
        return float(self.heights_beside(point[None])[0])

    def heights_beside(self, points: Floats) -> Floats:
        """(M,) the same beside (M, 2 or more) points."""
        away = np.hypot(points[:, :1] - self.poses[:, 0], points[:, 1:2] - self.poses[:, 1])
        return np.asarray(self.heights[away.argmin(axis=1)])

    def recorded_at(self, seconds: Floats) -> Floats:
        """(..., 2) recorded rear axle at times since the first frame; past the end in its last half second's motion."""
        inside = np.stack([np.interp(seconds, self.seconds, self.poses[:, axis]) for axis in range(2)], axis=-1)
        before = np.searchsorted(self.seconds, self.seconds[-1] - PLAN_STEP_S)
        elapsed = max(float(self.seconds[-1] - self.seconds[before]), _SHORTEST_M)
        velocity = (self.poses[-1, :2] - self.poses[before, :2]) / elapsed
        past = np.maximum(np.asarray(seconds) - self.seconds[-1], 0.0)
        return np.asarray(inside + past[..., None] * velocity)

    def recorded_station(self, seconds: float) -> float:
        """How far along the path the recorded ego is at a time; at most its end."""
        return float(np.interp(seconds, self.seconds, self.station))

    def command(self, station: float, seconds: float) -> Command:
        """The driving command: where the recorded ego went within 3 s of the point at a station.

        The rule is that of data sets (`benchmark.datasets.sample_truth.compute_command`), seen from the recorded lidar
        there. Of a place where it stood for a while, the moment nearest to now counts. Past the end of the recording it
        is straight on. Seconds are since the first frame.
        """
        passed = self._find_passing_time(station, seconds)
        steps = passed + PLAN_STEP_S * np.arange(1, PLAN_STEPS + 1)
        # Half of a frame's time: keyframes are not to the microsecond half a second apart.
        valid = steps <= self.step_seconds[-1] + 0.04
        lidar = self._lidar(np.append(steps, passed))
        local = to_local(lidar[:-1, :2], lidar[-1])
        return compute_command(np.column_stack([-local[:, 1], local[:, 0]]), valid)

    def _find_passing_time(self, station: float, seconds: float) -> float:
        """When the recorded ego was at a station; of a stay there, the moment nearest to a time."""
        inside = np.clip(station, 0.0, self.station[-1])
        first = np.searchsorted(self.station, inside - _SAME_PLACE_M)
        last = np.searchsorted(self.station, inside + _SAME_PLACE_M, side="right") - 1
        if last <= first:
            frame = int(np.clip(np.searchsorted(self.station, inside, side="right") - 1, 0, len(self.station) - 2))
            length = max(float(self.station[frame + 1] - self.station[frame]), _SHORTEST_M)
            share = min(float(inside - self.station[frame]) / length, 1.0)
            return float(self.seconds[frame] + share * (self.seconds[frame + 1] - self.seconds[frame]))
        return float(np.clip(seconds, self.seconds[first], self.seconds[last]))

    def _lidar(self, seconds: Floats) -> Floats:
        """(M, 3) recorded lidar poses at times."""
        columns = [self.poses[:, 0], self.poses[:, 1], np.unwrap(self.poses[:, 2])]
        poses = np.column_stack([np.interp(seconds, self.seconds, column) for column in columns])
        poses[:, :2] += self.lidar_ahead_m * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
        return poses

    def _pieces(self) -> tuple[Floats, Floats, Floats]:
        """(M, 2) starts of the path's pieces, (M, 2) their steps and (M,) the stations of their starts."""
        moved = np.append(np.diff(self.station) > _SHORTEST_M, True)
        start, station = self.poses[moved, :2], self.station[moved]
        end = start[-1] + EXTENSION_M * self._extend_straight()
        return start, np.diff(np.concatenate([start, end[None]]), axis=0), station

    def _extend_straight(self) -> Floats:
        return np.array([np.cos(self.poses[-1, 2]), np.sin(self.poses[-1, 2])])


@runtime_checkable
class RouteFollower(Protocol):
    """A baseline that gets the recorded path with times in closed loop: its results are about that path alone."""

    def follow(self, route: Route) -> None:
        """Called after `benchmark.planning.Planner.reset`, before the first plan."""


_SEEN: Final = 4
"""nuScenes' visibility of what is seen whole."""


def build_driven_scene(recorded: Scene, route: Route, motion: EpisodeMotion) -> Scene:
    """Scene of the recorded frames before, then all instants of a motion; planning instants are keyframes.

    The motion begins at a keyframe of the recording, of which nothing later is taken but the map, the cameras, the list
    of agents, and the height of the road along the recorded path.
    """
    first = int(np.searchsorted(recorded.timestamps_us, motion.times_us[0]))
    ticks = len(motion.ticks)
    driven = EgoTrack(
        np.column_stack([motion.ego[:, [X, Y]], route.heights_beside(motion.ego)]),
        quaternion_from_yaw(motion.ego[:, YAW]),
    )
    head, size = recorded.first_frames(first), recorded.agents.size
    known = head.annotations
    position = motion.position[:, motion.ticks]
    present = motion.present[:, motion.ticks]
    counts = np.where(present, 1, 0)
    later = Annotations(
        position=position,
        rotation=quaternion_from_yaw(motion.yaw[:, motion.ticks]),
        size=np.repeat(size[:, None], ticks, axis=1),
        valid=present,
        attribute=np.full(present.shape, "", dtype=np.str_),
        visibility=_SEEN * counts,
        num_lidar_pts=counts,
        num_radar_pts=np.zeros_like(counts),
    )
    joined = {
        name: np.concatenate([getattr(known, name), getattr(later, name)], axis=1)
        for name in Annotations.__dataclass_fields__
    }
    return replace(
        recorded,
        timestamps_us=np.concatenate([head.timestamps_us, motion.times_us]),
        keyframes=np.concatenate([head.keyframes, first + motion.ticks]),
        ego=EgoTrack(
            np.concatenate([head.ego.position, driven.position]), np.concatenate([head.ego.rotation, driven.rotation])
        ),
        agents=replace(
            recorded.agents,
            position=np.concatenate([head.agents.position, motion.position], axis=1),
            yaw=np.concatenate([head.agents.yaw, motion.yaw], axis=1),
            valid=np.concatenate([head.agents.valid, motion.present], axis=1),
        ),
        annotations=Annotations(**joined),
        sweep_poses=None,
    )


def hold_last_frame(scene: Scene, ticks: int) -> Scene:
    """A scene that goes on for some ticks as it ends: every agent stays where it is (HUGSIM keeps its last list so)."""
    frames = np.concatenate([np.arange(len(scene.timestamps_us)), np.full(ticks, len(scene.timestamps_us) - 1)])
    keys = np.concatenate([np.arange(len(scene.keyframes)), np.full(ticks, len(scene.keyframes) - 1)])
    more = scene.timestamps_us[-1] + TICK_US * np.arange(1, ticks + 1)
    known, agents = scene.annotations, scene.agents
    return replace(
        scene,
        timestamps_us=np.concatenate([scene.timestamps_us, more]),
        keyframes=np.concatenate([scene.keyframes, len(scene.timestamps_us) + np.arange(ticks)]),
        ego=EgoTrack(scene.ego.position[frames], scene.ego.rotation[frames]),
        agents=replace(
            agents, position=agents.position[:, frames], yaw=agents.yaw[:, frames], valid=agents.valid[:, frames]
        ),
        annotations=Annotations(**{name: getattr(known, name)[:, keys] for name in Annotations.__dataclass_fields__}),
    )


def build_ride(scene: Scene, path: Floats, last: int, recorded_us: int | None = None, step_us: int = 500_000) -> Ride:
    """The motion up to a frame of a scene, and the (P, 3) path of the recording.

    The scene is as it was recorded, or driven since ``recorded_us``.
    """
    past, times_us = slice(last + 1), scene.timestamps_us
    until = int(times_us[last]) if recorded_us is None else recorded_us
    return Ride(times_us[past], scene.ego.position[past], scene.ego.rotation[past], path, until, step_us)
