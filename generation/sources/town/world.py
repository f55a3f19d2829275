"""Road users of a scene: tracks accepted so far, and the rule that no track is added that would touch them."""

from dataclasses import dataclass, field

import numpy as np
import shapely

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME, PLAN_STEPS
from benchmark.geometry import Bools, Floats, box_corners, boxes_overlap
from generation.sources.town.curves import interpolate_grid
from generation.sources.town.network import Town
from generation.sources.town.paths import EGO_BODY, STATION_M, VehicleBody, VehiclePath, compute_body_boxes
from generation.sources.town.speed import (
    CHECKS_PER_SECOND,
    FRAMES,
    DriverHabits,
    count_reachable_stations,
    find_blocked_stations,
    plan_speed,
    widen_in_time,
)

ANNOTATION_RANGE_M = 65.0
_CHECK_FRAMES = FRAME_HZ // CHECKS_PER_SECOND
_SMALLEST_GAP_M = 0.25
_KERB_TOLERANCE_M = 0.1
_HALT_M = (8.4, 3.4)
"""Before the end of a lane: where the front axle is not while the light is red."""
_ROOM_M = (np.array([3.5, 1.1]), np.array([1.0, 0.4]))
_ROOM_AT_MPS = 5.0
_DRIVES_ON_MPS2 = 1.0


@dataclass(frozen=True, slots=True)
class ParticipantTrack:
    """Motion of a participant: (FRAMES, 5) boxes, or (1, 5) for one that stands still; ``parked`` has no driver."""

    category: str
    height: float
    boxes: Floats
    parked: bool


@dataclass(frozen=True, slots=True)
class TrafficLights:
    """Lights of a junction: ``first`` is the phase that has green until ``change_s``, the other one from then on.

    Between them all have red for ``clearance_s``.
    """

    first: int
    change_s: float
    clearance_s: float = 3.0

    def is_red(self, phase: int, seconds: Floats) -> Bools:
        """(Q,) whether lanes of a phase have to wait."""
        if phase == self.first:
            return np.asarray(seconds >= self.change_s)
        return np.asarray(seconds < self.change_s + self.clearance_s)


@dataclass(slots=True)
class TownWorld:
    """Everything placed so far; the ego's (FRAMES, 3) rear-axle poses and (FRAMES, 5) footprint once planned.

    ``lights`` are by junction; one without is passed by who finds a gap. ``expected`` is (2, FRAMES, 7, 5): the ego
    now, and half a second to three later if it kept its speed or drove on gently, with room around it.
    """

    town: Town
    lights: dict[str, TrafficLights] = field(default_factory=dict)
    ego_rear: Floats | None = None
    ego_boxes: Floats | None = None
    expected: Floats | None = None
    tracks: list[ParticipantTrack] = field(default_factory=list)

    def drive(self, path: VehiclePath, *, start_mps: int, habits: DriverHabits) -> Floats | None:
        """Plan a vehicle among those there: (FRAMES, 3) rear-axle poses; ``None`` if it cannot but touch one."""
        stations = self.stations(path, start_mps=start_mps, habits=habits)
        return None if stations is None else interpolate_grid(path.rear, stations)

    def stations(self, path: VehiclePath, *, start_mps: int, habits: DriverHabits) -> Floats | None:
        """As `drive`, but where on its path the vehicle is: (FRAMES,) in steps of `STATION_M`."""
        blocked = self._find_red_stations(path)
        others = np.zeros_like(blocked)
        moving = [track.boxes for track in self.tracks if len(track.boxes) > 1]
        standing = [track.boxes for track in self.tracks if len(track.boxes) == 1]
        for group, gap_s in ((moving, habits.gives_way_s), (standing, 0.0), ([self.ego_boxes], habits.ego_gap_s)):
            known = [boxes for boxes in group if boxes is not None]
            if not known:
                continue
            checks = np.stack(known)[:, ::_CHECK_FRAMES]
            if checks.shape[1] > 1:
                checks = np.concatenate([checks, checks[:, -1:]], axis=1)
            found = find_blocked_stations(path, checks, np.ones(checks.shape[:2], dtype=np.bool_))
            others |= found
            blocked |= widen_in_time(found, gap_s) if gap_s else found
        stations = plan_speed(path, blocked, others, start_mps=start_mps, habits=habits)
        if stations is None:
            return None
        boxes = compute_body_boxes(interpolate_grid(path.rear, stations), path.body)
        return stations if self.is_free(boxes, path.body) else None

    def _find_red_stations(self, path: VehiclePath) -> Bools:
        """(4 * SECONDS + 1, B) where the lights forbid to be."""
        checks = FRAMES // _CHECK_FRAMES + 1
        blocked = np.zeros((checks, count_reachable_stations(path)), dtype=np.bool_)
        for end, lane in path.halts:
            node, phase = self.town.signals[lane]
            first, last = (max(end - round(before / STATION_M), 0) for before in _HALT_M)
            if node in self.lights and first > 0:
                red = self.lights[node].is_red(phase, np.arange(checks) / CHECKS_PER_SECOND)
                blocked[red, first:last] = True
        return blocked

    def is_free(self, boxes: Floats, body: VehicleBody | None = None, *, gap_m: float = _SMALLEST_GAP_M) -> bool:
        """Whether a track, (FRAMES, 5) or (1, 5) boxes, touches none and, for vehicles, keeps to the road where seen.

        ``gap_m`` is the free space demanded around it; without ``body`` it may leave the road.
        """
        grown = boxes + np.array([0.0, 0.0, gap_m, gap_m, 0.0])
        for others in self._collect_obstacles():
            apart = np.hypot(others[..., 0] - grown[:, 0], others[..., 1] - grown[:, 1])
            close = apart < 0.5 * (np.hypot(others[..., 2], others[..., 3]) + np.hypot(grown[:, 2], grown[:, 3]))
            if not close.any():
                continue
            own = np.broadcast_to(grown, (*close.shape, 5))[close]
            if boxes_overlap(np.broadcast_to(others, (*close.shape, 5))[close], own).any():
                return False
        return body is None or self.is_on_road(boxes)

    def _collect_obstacles(self) -> list[Floats]:
        """Boxes of all: (J, FRAMES, 5) of those who move and (J, 1, 5) of those who stand."""
        moving = [track.boxes for track in self.tracks if len(track.boxes) > 1]
        if self.ego_boxes is not None:
            moving.append(self.ego_boxes)
        standing = [track.boxes for track in self.tracks if len(track.boxes) == 1]
        return [np.stack(group) for group in (moving, standing) if group]

    def is_on_road(self, boxes: Floats) -> bool:
        """Whether (N, 5) boxes of a vehicle, a frame apart, are within the kerbs where the vehicle is seen."""
        checked = boxes[::_CHECK_FRAMES]
        if self.ego_rear is not None and len(boxes) > 1:
            checked = checked[self.compute_distance_to_ego(boxes)[::_CHECK_FRAMES] < ANNOTATION_RANGE_M]
        corners = box_corners(checked + np.array([0.0, 0.0, -2 * _KERB_TOLERANCE_M, -2 * _KERB_TOLERANCE_M, 0.0]))
        return bool(shapely.contains_xy(self.town.road_map.drivable_area, corners[..., 0], corners[..., 1]).all())

    def compute_distance_to_ego(self, boxes: Floats) -> Floats:
        """(FRAMES,) metres between box centres and the ego's rear axle."""
        assert self.ego_rear is not None
        return np.asarray(np.hypot(boxes[:, 0] - self.ego_rear[:, 0], boxes[:, 1] - self.ego_rear[:, 1]))

    def present(self, boxes: Floats) -> Bools:
        """(FRAMES,) whether a participant is near enough to be annotated."""
        return np.asarray(self.compute_distance_to_ego(boxes) < ANNOTATION_RANGE_M)

    def expect_ego(self, path: VehiclePath, stations: Floats) -> None:
        """Set ``expected`` from the ego's (FRAMES,) stations."""
        speed = np.gradient(stations)
        ahead = np.arange(PLAN_STEPS + 1) * FRAMES_PER_KEYFRAME
        gained = 0.5 * (ahead / FRAME_HZ) ** 2 * _DRIVES_ON_MPS2 / STATION_M
        later = stations[:, None] + speed[:, None] * ahead + np.stack([np.zeros_like(gained), gained])[:, None]
        self.expected = path.boxes(later.ravel()).reshape(*later.shape, 5)
        # Less room for what was never seen to happen than for what did.
        room = np.minimum(speed[:, None] * STATION_M * FRAME_HZ / _ROOM_AT_MPS, 1.0)
        self.expected[..., 2:4] += room[..., None] * np.where(np.arange(PLAN_STEPS + 1)[:, None] == 0, *_ROOM_M)

    def surprises_ego(self, boxes: Floats) -> bool:
        """Whether a track gets so near the ego, or in its way at a key frame, that a small error would be a contact."""
        if self.expected is None:
            return False
        frames = np.arange(0, FRAMES, FRAMES_PER_KEYFRAME)[:, None]
        then = frames + np.arange(PLAN_STEPS + 1) * FRAMES_PER_KEYFRAME
        own = np.broadcast_to(boxes, (FRAMES, 5))[np.minimum(then, FRAMES - 1)]
        return bool((boxes_overlap(own, self.expected[:, frames[:, 0]]) & (then < FRAMES)).any())

    def place_ego(self, rear: Floats) -> None:
        """Fix the ego's motion, (FRAMES, 3) rear-axle poses."""
        self.ego_rear, self.ego_boxes = rear, compute_body_boxes(rear, EGO_BODY)
