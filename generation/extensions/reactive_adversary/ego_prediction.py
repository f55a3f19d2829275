"""Where an adversary takes the ego to be at every frame of a scene: where it has been, and what is expected of it."""

from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.closed_loop.agent_policy import ActivePlan, TrafficSnapshot, extend_waypoints
from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, PLAN_STEP_S
from benchmark.geometry import Floats, quaternion_from_yaw, to_global, wrap_angle
from benchmark.road_map import DrivableRaster
from benchmark.scene import EgoTrack, Scene
from generation.extensions.reactive_adversary.settings import EgoPrediction
from generation.search.recorded_ego_path import get_ego_path

_TURN_US: Final = 300_000
"""Over how long a turn is looked at: one instant says little of it."""
_STILL_M: Final = 0.05
"""Shorter ways have no direction."""
ON_ROUTE_M: Final = 1.5
ON_ROUTE_RAD: Final = 0.35
"""Largest distance and heading error at which an ego follows the route."""
AS_RECORDED_M: Final = 1.0
"""An ego this near to where it was recorded at the same time drives as recorded."""
TURNS_RAD_S: Final = (-0.4, 0.4)
TURNS_OVER_S: Final = 2.0
"""Turns that nothing announces, and for how long there must be road for them."""
MOST_TURN_RAD: Final = np.pi / 2
"""Largest predicted turn: one right-angled corner."""


@dataclass(frozen=True, slots=True)
class EgoObservations:
    """The ego as it has been seen: (E,) instants, ending with now, (E, 3) poses of its rear axle, and m/s now."""

    times_us: NDArray[np.int64]
    poses: Floats
    speed: float

    @classmethod
    def recorded(cls, scene: Scene, until_us: int) -> Self:
        """The recording up to a time."""
        count = max(int(np.searchsorted(scene.timestamps_us, until_us, side="left")), 1)
        return cls(scene.timestamps_us[:count], scene.ego.pose[:count], 0.0)

    def then(self, moment: TrafficSnapshot) -> Self:
        """Knowledge of now."""
        x, y, yaw = moment.ego[[0, 1, 4]]
        back = EGO_CENTER_FROM_REAR_AXLE_M
        pose = np.array([[x - back * np.cos(yaw), y - back * np.sin(yaw), yaw]])
        times = np.append(self.times_us, moment.time_us)
        return type(self)(times, np.concatenate([self.poses, pose]), moment.ego_speed)

    @property
    def yaw_rate(self) -> float:
        """Rad/s over the last 0.3 s."""
        first = int(np.searchsorted(self.times_us, self.times_us[-1] - _TURN_US))
        span = (self.times_us[-1] - self.times_us[first]) / 1e6
        turned = float(wrap_angle(self.poses[-1, 2] - self.poses[first, 2]))
        return turned / float(span) if span > 0.0 else 0.0

    def is_as_recorded(self, scene: Scene) -> bool:
        """Whether the ego is where it was recorded."""
        times = (scene.timestamps_us - self.times_us[-1]) / 1e6
        place = [np.interp(0.0, times, scene.ego.pose[:, axis]) for axis in range(2)]
        return bool(np.hypot(*(self.poses[-1, :2] - place)) <= AS_RECORDED_M)

    def at(self, times_us: NDArray[np.int64]) -> Floats:
        """(K, 3) poses at (K,) times up to now."""
        first = self.times_us[0]
        seconds, sought = (self.times_us - first) / 1e6, (times_us - first) / 1e6
        columns = (self.poses[:, 0], self.poses[:, 1], np.unwrap(self.poses[:, 2]))
        return np.column_stack([np.interp(sought, seconds, column) for column in columns])


def predict_ego(scene: Scene, seen: EgoObservations, plan: ActivePlan | None, knows: EgoPrediction) -> EgoTrack:
    """Ego's track as an adversary takes it to be; one that keeps its motion follows its route if it is on it.

    Route and heights, and a known recording, are of ``scene``; only adversaries that know the ``plan`` in force use it.
    """
    if knows is EgoPrediction.RECORDING:
        return scene.ego
    times = scene.timestamps_us
    past = times <= seen.times_us[-1]
    poses = np.empty((len(times), 3))
    poses[past] = seen.at(times[past])
    seconds = (times[~past] - seen.times_us[-1]) / 1e6
    if knows is EgoPrediction.PLAN and plan is not None:
        poses[~past] = _predict_on_plan(plan, times[~past])
    elif knows is EgoPrediction.NOTHING:
        poses[~past] = seen.poses[-1]
    else:
        on_its_way = None if knows is EgoPrediction.MOTION_ONLY else _predict_on_route(scene, seen, seconds)
        poses[~past] = _predict_steady_motion(seen, seconds) if on_its_way is None else on_its_way
    position = np.column_stack([poses[:, :2], scene.ego.position[:, 2]])
    return replace(scene.ego, position=position, rotation=quaternion_from_yaw(poses[:, 2]))


def predict_turns(scene: Scene, seen: EgoObservations, road: DrivableRaster) -> list[EgoTrack]:
    """Where the ego may go, too, if there is road for its centre: it begins to turn by `TURNS_RAD_S` on either side."""
    later = scene.timestamps_us > seen.times_us[-1]
    seconds = (scene.timestamps_us[later] - seen.times_us[-1]) / 1e6
    found = []
    for rate in TURNS_RAD_S:
        poses = _predict_steady_motion(seen, seconds, seen.yaw_rate + rate)
        if not road.look_up(poses[seconds <= TURNS_OVER_S, :2]).all():
            continue
        position, rotation = scene.ego.position.copy(), scene.ego.rotation.copy()
        position[later, :2], rotation[later] = poses[:, :2], quaternion_from_yaw(poses[:, 2])
        found.append(replace(scene.ego, position=position, rotation=rotation))
    return found


def hide_future(scene: Scene, now_us: int) -> Scene:
    """The scene as it is known at a time to who knows motion only: the ego keeps its speed and its turn from then on.

    No later frame of the ego's recording is read.
    """
    past = max(int(np.searchsorted(scene.timestamps_us, now_us, side="right")), 1)
    times, poses = scene.timestamps_us[:past], scene.ego.pose[:past]
    first = int(np.searchsorted(times, times[-1] - _TURN_US))
    span = (times[-1] - times[first]) / 1e6
    ahead = (poses[-1, :2] - poses[first, :2]) @ [np.cos(poses[-1, 2]), np.sin(poses[-1, 2])]
    seen = EgoObservations(times, poses, max(float(ahead) / span, 0.0) if span > 0.0 else 0.0)
    position = scene.ego.position.copy()
    position[past:] = position[past - 1]
    known = replace(scene, ego=replace(scene.ego, position=position))
    return replace(known, ego=predict_ego(known, seen, None, EgoPrediction.MOTION_ONLY), sweep_poses=None)


def _predict_on_route(scene: Scene, observed: EgoObservations, seconds: Floats) -> Floats | None:
    """(K, 3) poses of an ego that keeps its speed on its route; ``None`` if it is not on it."""
    now = max(int(np.searchsorted(scene.timestamps_us, observed.times_us[-1], side="right")) - 1, 0)
    way, back = get_ego_path(scene), EGO_CENTER_FROM_REAR_AXLE_M
    center = observed.poses[-1].copy()
    center[:2] += back * np.array([np.cos(center[2]), np.sin(center[2])])
    station, offset, turn = (float(values[0]) for values in way.places(center[None], now, now))
    if abs(offset) > ON_ROUTE_M or abs(turn) > ON_ROUTE_RAD:
        return None
    reached = station + observed.speed * seconds
    yaw = np.interp(reached, way.stations, np.unwrap(way.headings))
    place = np.column_stack([np.interp(reached, way.stations, way.points[:, axis]) for axis in range(2)])
    ahead, left = np.column_stack([np.cos(yaw), np.sin(yaw)]), np.column_stack([-np.sin(yaw), np.cos(yaw)])
    return np.column_stack([place + offset * left - back * ahead, yaw])


def _predict_steady_motion(observed: EgoObservations, seconds: Floats, yaw_rate: float | None = None) -> Floats:
    """(K, 3) poses of an ego that keeps its speed, and its turn or another."""
    x, y, yaw = observed.poses[-1]
    rate = observed.yaw_rate if yaw_rate is None else yaw_rate
    turning = np.minimum(seconds, MOST_TURN_RAD / max(abs(rate), 1e-9))
    turned = rate * turning
    small = np.abs(turned) < 1e-9
    safe = np.where(small, 1.0, turned)
    along = observed.speed * turning * np.where(small, 1.0, np.sin(safe) / safe)
    aside = observed.speed * turning * np.where(small, 0.0, (1.0 - np.cos(safe)) / safe)
    straight = observed.speed * (seconds - turning)
    forward, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    after = np.column_stack([np.cos(yaw + turned), np.sin(yaw + turned)])
    place = [x, y] + along[:, None] * forward + aside[:, None] * left + straight[:, None] * after
    return np.column_stack([place, yaw + turned])


def _predict_on_plan(plan: ActivePlan, times_us: NDArray[np.int64]) -> Floats:
    """(K, 3) poses of an ego on its plan, which goes on beyond its end as it ended."""
    steps = (times_us - plan.made_us) / 1e6 / PLAN_STEP_S
    held = extend_waypoints(plan.waypoints, int(np.ceil(steps.max(initial=1.0))) + 1)
    knots = np.concatenate([np.zeros((1, 2)), held])
    ways = np.diff(knots, axis=0)
    moving = np.hypot(*ways.T) >= _STILL_M
    heading = np.arctan2(ways[:, 1], ways[:, 0])
    # A standing ego keeps its previous heading.
    last = np.maximum.accumulate(np.where(moving, np.arange(len(ways)), -1))
    heading = np.where(last >= 0, heading[last], 0.0)
    middle = np.concatenate([[0.0], np.arange(len(ways)) + 0.5])
    yaw = np.interp(steps, middle, np.unwrap(np.concatenate([[0.0], heading])))
    at = np.arange(len(knots))
    place = np.column_stack([np.interp(steps, at, knots[:, axis]) for axis in range(2)])
    return np.column_stack([to_global(place, plan.origin), yaw + plan.origin[2]])
