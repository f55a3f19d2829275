"""Background vehicles that may become adversaries, why the others may not, when they launch, and their reach.

Appendix "The Adv-nuSc Dataset": up to 10 background vehicles that come close to the ego.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, Final

import numpy as np
import shapely
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from benchmark.constants import FOUR_WHEELED_CATEGORIES, FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import WHEELBASE, DriverLimits
from benchmark.geometry import Bools, Floats, to_local, wrap_angle
from benchmark.machine.storage import content_seed
from benchmark.scene import Scene
from generation.labels.labelling import compute_ego_speed
from generation.search.hyperparameters import HyperParameters, LaunchRule, VehicleChoiceRule
from generation.search.recorded_ego_path import RecordedEgoPath, get_ego_path
from generation.search.recorded_motion import (
    compute_center_distance,
    compute_initial_state,
    is_driving_forward,
    is_in_canvas,
    is_vulnerable,
    measure_to_ego_path,
)
from generation.search.reference_scoring import CAR, find_reference_launch, is_in_reference_canvas, is_near_and_on_road
from generation.search.threat_settings import CandidateProposal

SOONEST_S: Final = 1.0
LATEST_S: Final = 6.0
SOON_S: Final = 3.0
"""Arrival time within which a vehicle takes over at once."""
ROOMS_M: Final = (3.0, 10.0, 20.0)
"""How far ahead of the ego's front it may arrive."""
ACCELERATION_M_S2: Final = 2.0
BRAKING_M_S2: Final = 3.5
ACROSS_M_S2: Final = 3.0
"""Limits of the way there; below a driver's limits, because no arc is followed exactly."""
MOST_BEARING_RAD: Final = np.deg2rad(75.0)
MOST_TURN_RAD: Final = np.deg2rad(100.0)
"""Arriving against the ego's direction is no way in front of it but a head-on crash."""
FOLLOWING_RAD: Final = np.deg2rad(60.0)
"""Heading error within which an arriving vehicle can drive on along the ego's path; others must stop there."""
ROAD_SHARES: Final = (0.2, 0.4, 0.6, 0.8, 1.0)
MARGIN_M: Final = 5.0
"""Of the area around the ego that is not counted on."""


@dataclass(frozen=True, slots=True)
class TakeoverStart:
    """A vehicle at F frames at which it might take over. (F, 3) poses of its box centre, (F,) speeds in m/s."""

    frames: NDArray[np.int64]
    poses: Floats
    speed: Floats
    length_m: float


def compute_reach_s(scene: Scene, way: RecordedEgoPath, start: TakeoverStart, half_extent_m: float) -> Floats:
    """Time until a vehicle can be in the ego's way, driving an arc at a steady change of speed on the road.

    (F,) seconds, infinite where it cannot, or could not stay in the area, of half side ``half_extent_m``, afterwards.
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
    possible, arriving = _find_drivable_arcs(start, goal, seconds)
    turn = np.abs(wrap_angle(arriving - heading))
    possible &= (turn <= MOST_TURN_RAD) & (at <= last)[..., None]
    row, time, room = np.nonzero(possible)
    shares = np.array(ROAD_SHARES)[:, None]
    begin, end = start.poses[row, :2], goal[row, time, room]
    on_road = scene.road_map.is_drivable(begin[:, None] + shares * (end - begin)[:, None]).all(axis=-1)
    follows = turn[row, time, room] <= FOLLOWING_RAD
    on_road[~follows & on_road] &= _is_staying(scene, frame[row, time], end, half_extent_m)[~follows & on_road]
    possible[row, time, room] = on_road
    soonest = np.where(possible.any(axis=-1), ahead / FRAME_HZ, np.inf)
    return np.asarray(soonest.min(axis=1))


def _find_drivable_arcs(start: TakeoverStart, goal: Floats, seconds: Floats) -> tuple[Bools, Floats]:
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


def _is_staying(scene: Scene, frames: NDArray[np.int64], points: Floats, half_extent_m: float) -> Bools:
    """(P,) whether points stay in the area around the ego from (P,) frames to the end of the scene."""
    pose = scene.ego.pose
    inside = np.stack(
        [np.abs(to_local(points, ego_pose)).max(axis=-1) <= half_extent_m - MARGIN_M for ego_pose in pose], axis=1
    )
    return np.asarray((inside | (np.arange(len(pose)) < frames[:, None])).all(axis=1))


def find_launch_in_reach(scene: Scene, agent: int, hyper: HyperParameters) -> int | None:
    """First frame from which a vehicle is in the ego's way within 3 s, else the soonest; ``None`` if it can never be.

    Frames are looked at every half second. The vehicle has been there for the history, drives forwards, stands on the
    road in the area around the ego, and enough of the scene is left.
    """
    valid = scene.agents.valid[agent]
    eligible = np.convolve(valid, np.ones(hyper.history_frames + 1), mode="full")[: len(valid)] > hyper.history_frames
    position = scene.agents.position[agent, :, :2]
    eligible &= is_in_canvas(scene, position, hyper.half_extent_m - MARGIN_M)
    eligible[len(valid) - hyper.shortest_drive_frames :] = False
    frames = np.flatnonzero(eligible)
    frames = frames[frames % FRAMES_PER_KEYFRAME == 0]
    frames = frames[scene.road_map.is_drivable(position[frames])]
    frames = np.array([frame for frame in frames.tolist() if is_driving_forward(scene, agent, frame)], np.int64)
    if not len(frames):
        return None
    way = get_ego_path(scene)
    seconds = compute_reach_s(scene, way, _build_start(scene, agent, frames), hyper.half_extent_m)
    seconds = np.where(frames + FRAME_HZ * seconds <= find_last_opportunity(way, hyper), seconds, np.inf)
    best = int(np.argmax(seconds <= SOON_S)) if (seconds <= SOON_S).any() else int(np.argmin(seconds))
    return int(frames[best]) if np.isfinite(seconds[best]) else None


def find_last_opportunity(way: RecordedEgoPath, hyper: HyperParameters) -> int:
    """The last frame at which an ego that does not react would run into what keeps its air ahead; -1 for none.

    Where no overrun is asked for (``least_overrun_m``) it is the last frame of the scene.
    """
    if not hyper.least_overrun_m:
        return len(way.speed) - 1
    air = hyper.clearance_m + hyper.headway_s * way.speed
    return int(np.flatnonzero(way.overrun >= air + hyper.least_overrun_m).max(initial=-1))


def compute_reach_at(scene: Scene, agent: int, frame: int, hyper: HyperParameters) -> float:
    """`compute_reach_s` of one vehicle at one frame."""
    start = _build_start(scene, agent, np.array([frame], np.int64))
    return float(compute_reach_s(scene, get_ego_path(scene), start, hyper.half_extent_m)[0])


def _build_start(scene: Scene, agent: int, frames: NDArray[np.int64]) -> TakeoverStart:
    agents = scene.agents
    speed = np.array([compute_initial_state(scene, agent, frame, None).speed for frame in frames.tolist()])
    poses = np.column_stack([agents.position[agent, frames, :2], agents.yaw[agent, frames]])
    return TakeoverStart(frames, poses, speed, float(agents.size[agent, 0]))


class ExclusionReason(StrEnum):
    """Why an object of a scene is not tried as an adversary."""

    NOT_FOUR_WHEELED = "not-a-four-wheeler"
    ALREADY_ADVERSARY = "already-an-adversary"
    NEVER_NEAR = "never-near-the-ego"
    PARKED = "parked"
    OFF_ROAD = "off-the-drivable-area"
    OUT_OF_REACH = "cannot-get-in-the-way-of-the-ego"
    NO_LAUNCH = "no-frame-to-launch-at"
    EGO_STANDS = "ego-stands-after-the-launch"
    NOT_DRAWN = "not-drawn-by-the-seed"
    NO_CAR = "not-a-car"


def draw_candidates(scene: Scene, eligible: Sequence[int], hyper: HyperParameters, seed: int) -> tuple[int, ...]:
    """At most ``hyper.candidate_limit`` of the eligible agent indices, ascending; ``seed`` says which."""
    rng = np.random.default_rng(content_seed("candidates", scene.name, scene.token, seed))
    # Weighted draw without replacement: the shortest exponential waiting times, with the weights as rates.
    measure = compute_nearness if hyper.launch is LaunchRule.REACH else compute_staying_share
    if hyper.proposal is not CandidateProposal.SAMPLED:
        measure = _compute_nearness_to_path
    weight = np.array([measure(scene, agent, hyper) for agent in eligible]) ** hyper.staying_preference
    drawn = np.argsort(rng.exponential(size=len(eligible)) / weight, kind="stable")[: hyper.candidate_limit]
    return tuple(sorted(eligible[index] for index in drawn))


def find_exclusion_reason(scene: Scene, agent: int, hyper: HyperParameters) -> ExclusionReason | None:
    """First reason against an adversary; ``None`` if it comes close on the road and launches at a driving ego."""
    agents = scene.agents
    on_request = hyper.vulnerable and hyper.proposal is CandidateProposal.RETIMED
    if not (agents.categories[agent] in FOUR_WHEELED_CATEGORIES or (on_request and is_vulnerable(scene, agent))):
        return ExclusionReason.NOT_FOUR_WHEELED
    if agents.ids[agent] in scene.adversaries:
        return ExclusionReason.ALREADY_ADVERSARY
    if hyper.proposal is not CandidateProposal.SAMPLED:
        return None if np.isfinite(measure_to_ego_path(scene, agent, hyper)) else ExclusionReason.OUT_OF_REACH
    return (
        _find_own_exclusion(scene, agent, hyper)
        if hyper.choice is VehicleChoiceRule.OURS
        else _find_reference_exclusion(scene, agent)
    )


def _find_reference_exclusion(scene: Scene, agent: int) -> ExclusionReason | None:
    if scene.agents.categories[agent] != CAR:
        return ExclusionReason.NO_CAR
    near, on_road = is_near_and_on_road(scene, agent)
    if not on_road:
        return ExclusionReason.OFF_ROAD if is_in_reference_canvas(scene, agent).any() else ExclusionReason.NEVER_NEAR
    if not near:
        return ExclusionReason.NEVER_NEAR
    return None if find_reference_launch(scene, agent) is not None else ExclusionReason.NO_LAUNCH


def _find_own_exclusion(scene: Scene, agent: int, hyper: HyperParameters) -> ExclusionReason | None:
    agents = scene.agents
    canvas = is_in_canvas(scene, agents.position[agent, :, :2], hyper.half_extent_m) & agents.valid[agent]
    by_reach = hyper.launch is LaunchRule.REACH
    if not canvas.any() or (not by_reach and compute_center_distance(scene, agent)[canvas].min() >= hyper.proximity_m):
        return ExclusionReason.NEVER_NEAR
    path = agents.position[agent, agents.valid[agent], :2]
    if not hyper.parked and np.ptp(path, axis=0).max() < hyper.least_motion_m:
        return ExclusionReason.PARKED
    shapely.prepare(scene.road_map.drivable_area)
    if scene.road_map.is_drivable(agents.position[agent, canvas, :2]).mean() < hyper.least_drivable_share:
        return ExclusionReason.OFF_ROAD
    launch = find_launch_frame(scene, agent, hyper)
    if launch is None:
        return ExclusionReason.OUT_OF_REACH if by_reach else ExclusionReason.NO_LAUNCH
    if not (compute_ego_speed(scene)[launch:] >= hyper.moving_ego_m_s).any():
        return ExclusionReason.EGO_STANDS
    return None


def compute_staying_share(scene: Scene, agent: int, hyper: HyperParameters) -> float:
    """Share, more than 0, of the frames after its launch that a vehicle's recording is in the area around the ego."""
    launch = find_launch_frame(scene, agent, hyper)
    inside = is_in_canvas(scene, scene.agents.position[agent, :, :2], hyper.half_extent_m) & scene.agents.valid[agent]
    return float(inside[launch:].mean())


def compute_nearness(scene: Scene, agent: int, hyper: HyperParameters) -> float:
    """Nearness in time of a launched eligible vehicle to the ego's way: 1 at once, 1/2 after 3 s; more than 0."""
    launch = find_launch_frame(scene, agent, hyper)
    return float("nan") if launch is None else 1.0 / (1.0 + compute_reach_at(scene, agent, launch, hyper) / 3.0)


def _compute_nearness_to_path(scene: Scene, agent: int, hyper: HyperParameters) -> float:
    return 1.0 / (1.0 + measure_to_ego_path(scene, agent, hyper) / 10.0)


def find_launch_frame(scene: Scene, agent: int, hyper: HyperParameters) -> int | None:
    """First frame at which an agent may take over by the rule of ``hyper`` (`hyperparameters.LaunchRule`), if any."""
    match hyper.launch:
        case LaunchRule.NEAR:
            return _find_launch_near_ego(scene, agent, hyper)
        case LaunchRule.REFERENCE:
            return find_reference_launch(scene, agent)
        case LaunchRule.REACH:
            return find_launch_in_reach(scene, agent, hyper)
        case LaunchRule.START:
            inside = is_in_canvas(scene, scene.agents.position[agent, :, :2], hyper.half_extent_m)
            frames = np.flatnonzero(inside & scene.agents.valid[agent])
            last = inside.size - 1 - hyper.shortest_drive_frames
            return int(frames[0]) if len(frames) and frames[0] <= last else None


def _find_launch_near_ego(scene: Scene, agent: int, hyper: HyperParameters) -> int | None:
    """First frame at which an agent near the ego may take over.

    It has been there for the history, drives forwards without sliding on the road, and enough of the scene is left.
    """
    valid = scene.agents.valid[agent]
    has_history = (
        np.convolve(valid, np.ones(hyper.history_frames + 1), mode="full")[: len(valid)] > hyper.history_frames
    )
    last = len(valid) - 1 - hyper.shortest_drive_frames
    close = compute_center_distance(scene, agent) < hyper.launch_distance_m
    for frame in np.flatnonzero(has_history & close):
        if frame > last:
            return None
        if is_driving_forward(scene, agent, int(frame)):
            on_road = scene.road_map.is_drivable(scene.agents.position[agent, frame, :2])
            if on_road:
                return int(frame)
    return None


class VehicleEligibility(BaseModel):
    """One four-wheeled vehicle, and the reason why it is not tried (``None`` for one that is).

    Attributes:
        agent: Its index in the scene.
        agent_id: Its instance.
        category: In nuScenes' words.
        reason: Why it is not tried.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    agent: int
    agent_id: str
    category: str
    reason: ExclusionReason | None


class Eligibility(BaseModel):
    """Four-wheeled vehicles of one scene and which of them are tried; ``objects`` counts everything annotated.

    Attributes:
        schema_version: Version of the format.
        scene_name: Recorded scene.
        vehicles: Four-wheeled vehicles.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: int = 1
    scene_name: str
    objects: int
    vehicles: tuple[VehicleEligibility, ...]

    @property
    def chosen(self) -> tuple[VehicleEligibility, ...]:
        """Vehicles to try, by index."""
        return tuple(vehicle for vehicle in self.vehicles if vehicle.reason is None)

    def not_tried(self) -> dict[str, int]:
        """Number of objects that are not tried, by reason."""
        counts = {ExclusionReason.NOT_FOUR_WHEELED.value: self.objects - len(self.vehicles)}
        for vehicle in self.vehicles:
            if vehicle.reason is not None:
                counts[vehicle.reason.value] = counts.get(vehicle.reason.value, 0) + 1
        return {reason: count for reason, count in counts.items() if count}

    def row(self, earlier: tuple[str, ...]) -> dict[str, Any]:
        """One line of ``candidates.jsonl``; ``earlier`` are the instances that are adversaries already."""
        return {
            "scene": self.scene_name,
            "earlier": list(earlier),
            "objects": self.objects,
            "tried": len(self.chosen),
            "not_tried": self.not_tried(),
            "vehicles": [
                {"agent": vehicle.agent_id, "category": vehicle.category, "not_tried": vehicle.reason}
                for vehicle in self.vehicles
            ],
        }


def sum_exclusions(looks: Sequence[Eligibility]) -> dict[str, int]:
    """Number of objects of several scenes that are not tried, by reason."""
    counts: Counter[str] = Counter()
    for look in looks:
        counts.update(look.not_tried())
    return dict(counts)


def compute_eligibility(scene: Scene, hyper: HyperParameters, seed: int) -> Eligibility:
    """Vehicles of a scene that are tried, and why not the others; ``seed`` chooses among more than the limit."""
    reasons: dict[int, ExclusionReason | None] = {
        agent: find_exclusion_reason(scene, agent, hyper) for agent in range(len(scene.agents))
    }
    drawn = set(draw_candidates(scene, [agent for agent, reason in reasons.items() if reason is None], hyper, seed))
    return Eligibility(
        scene_name=scene.name,
        objects=len(scene.agents),
        vehicles=tuple(
            VehicleEligibility(
                agent=agent,
                agent_id=scene.agents.ids[agent],
                category=scene.agents.categories[agent],
                reason=ExclusionReason.NOT_DRAWN if reason is None and agent not in drawn else reason,
            )
            for agent, reason in reasons.items()
            if reason is not ExclusionReason.NOT_FOUR_WHEELED
        ),
    )
