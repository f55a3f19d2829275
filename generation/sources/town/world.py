"""Road users of a scene: tracks accepted so far, and the rule that no track is added that would touch them."""

from dataclasses import dataclass, field

import numpy as np
import shapely

from benchmark.constants import FRAME_HZ
from benchmark.geometry import Bools, Floats, box_corners, boxes_overlap
from generation.sources.town.curves import interpolate_grid
from generation.sources.town.network import Town
from generation.sources.town.paths import EGO_BODY, VehicleBody, VehiclePath, compute_body_boxes
from generation.sources.town.speed import (
    CHECKS_PER_SECOND,
    FRAMES,
    count_reachable_stations,
    find_blocked_stations,
    plan_speed,
)

ANNOTATION_RANGE_M = 65.0
_CHECK_FRAMES = FRAME_HZ // CHECKS_PER_SECOND
_SMALLEST_GAP_M = 0.25
_KERB_TOLERANCE_M = 0.1


@dataclass(frozen=True, slots=True)
class ParticipantTrack:
    """Motion of a participant: (FRAMES, 5) boxes, or (1, 5) for one that stands still; ``parked`` has no driver."""

    category: str
    height: float
    boxes: Floats
    parked: bool


@dataclass(slots=True)
class TownWorld:
    """Everything placed so far; the ego's (FRAMES, 3) rear-axle poses and (FRAMES, 5) footprint once planned."""

    town: Town
    ego_rear: Floats | None = None
    ego_boxes: Floats | None = None
    tracks: list[ParticipantTrack] = field(default_factory=list)

    def drive(self, path: VehiclePath, *, start_mps: int, eagerness: float, pace: Floats) -> Floats | None:
        """Plan a vehicle among those there: (FRAMES, 3) rear-axle poses, ``None`` if it cannot drive without a touch.

        ``eagerness`` is a factor on the speed limit that it likes to drive, ``pace`` (SECONDS,) one on that.
        """
        stations = self.stations(path, start_mps=start_mps, eagerness=eagerness, pace=pace)
        return None if stations is None else interpolate_grid(path.rear, stations)

    def stations(self, path: VehiclePath, *, start_mps: int, eagerness: float, pace: Floats) -> Floats | None:
        """As `drive`, but where on its path the vehicle is: (FRAMES,) in steps of `STATION_M`."""
        count = count_reachable_stations(path)
        blocked = np.zeros((FRAMES // _CHECK_FRAMES + 1, count), dtype=np.bool_)
        for boxes in self._collect_obstacles():
            checks = boxes[:, ::_CHECK_FRAMES]
            if boxes.shape[1] > 1:
                checks = np.concatenate([checks, checks[:, -1:]], axis=1)
            blocked |= find_blocked_stations(path, checks, np.ones(checks.shape[:2], dtype=np.bool_))
        stations = plan_speed(path, blocked, start_mps=start_mps, desired_mps=eagerness * path.speed_limit, pace=pace)
        if stations is None:
            return None
        boxes = compute_body_boxes(interpolate_grid(path.rear, stations), path.body)
        return stations if self.is_free(boxes, path.body) else None

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

    def place_ego(self, rear: Floats) -> None:
        """Fix the ego's motion, (FRAMES, 3) rear-axle poses."""
        self.ego_rear, self.ego_boxes = rear, compute_body_boxes(rear, EGO_BODY)
