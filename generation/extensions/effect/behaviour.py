"""Faults of behaviour that drop an adversarial scene: what no driver does for long (``docs/realism.md``)."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.fairness.features import SAMPLE_S, find_stretches, fit_splines
from benchmark.fairness.validity import OFF_ROAD_M, find_lane_turns
from benchmark.geometry import Bools, Floats, box_gap, to_local, wrap_angle
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.metrics.places import NEAR_M, PlaceClassifier, PlaceKind
from benchmark.scene import Scene
from generation.search.recorded_ego_path import get_ego_path
from generation.search.recorded_motion import is_vulnerable
from generation.search.verify import EGO, DiscardReason, VerificationFailure

AGAINST_S: Final = 2.0
PRESSING_S, PRESSING_HEADWAY_S, PRESSING_M_S = 3.0, 0.5, 2.0
"""Slower followers stand in a queue."""
BESIDE_S, BESIDE_M = 8.0, 1.5
STICKING_S, STICKING_M = 3.0, 1.0
MOVING_M_S: Final = 1.0
STANDING_M_S: Final = 0.3
CIRCLING_RAD: Final = np.deg2rad(270.0)
OFF_ROAD_S: Final = 1.0
WEAVING_M_S2, WEAVING_S, WEAVING_SIGNS = 1.0, 4.0, 3
HEAD_ON_RAD, HEAD_ON_M, HEAD_ON_S = np.deg2rad(135.0), 1.75, 1.0
"""At rest against the ego's path, the centre in its lane, so long."""
TURN_RAD: Final = np.deg2rad(45.0)
"""A heading that changes by so much turns; angles to a lane between this and its supplement are across it."""
TURN_BACK_RAD: Final = np.deg2rad(135.0)
"""A heading that changes by so much is a U-turn."""
AROUND_S: Final = 2.0
"""Before and after a stretch, in which it may have been turned into."""
SETTLED_S: Final = 1.0
"""An overtaking ends back in its lane if the vehicle drives along one for so long afterwards."""
WHOLE_WIDTH: Final = 0.8
"""Share of the road's width that is the whole of it."""
WIDEST_M: Final = 35.0
"""What is wider is a place, not a road."""
SPEED_FRAMES: Final = 3
NEAR_BODIES_M: Final = 15.0

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class OtherUsers:
    """M road users within some metres, the ego as the last one, in the frame of a vehicle at F frames.

    (M, F) metres ``ahead`` and ``aside`` of the centres, ``gap`` between the bodies (infinite where one is not there),
    ``turn`` in radians, ``speed`` in m/s; (M, 2) ``size``; ``names``.
    """

    ahead: Floats
    aside: Floats
    gap: Floats
    turn: Floats
    speed: Floats
    size: Floats
    names: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class DrivenStretch:
    """A vehicle of a scene at F consecutive frames at which it is there: (F,) seconds and m/s, (F, 5) boxes."""

    scene: Scene
    agent: int
    frames: Integers
    seconds: Floats
    boxes: Floats
    speed: Floats

    @classmethod
    def of(cls, scene: Scene, agent: int, start: int) -> "DrivenStretch":
        """From a frame on, as long as it is there without a gap."""
        there = start + np.flatnonzero(scene.agents.valid[agent, start:])
        gaps = np.flatnonzero(np.diff(there) > 1)
        there = there[: gaps[0] + 1] if len(gaps) else there
        boxes = ContinuousTracks.of_scene(scene).agents[agent, there]
        return cls(scene, agent, there, scene.seconds[there], boxes, _compute_speed(boxes[:, :2], scene.seconds[there]))

    def others(self) -> OtherUsers:
        """Road users near it."""
        tracks = ContinuousTracks.of_scene(self.scene)
        boxes = np.concatenate([tracks.agents[:, self.frames], tracks.ego[self.frames][None]])
        there = np.concatenate([tracks.valid[:, self.frames], np.ones((1, len(self.frames)), np.bool_)])
        there[self.agent] = False
        away = np.hypot(boxes[..., 0] - self.boxes[:, 0], boxes[..., 1] - self.boxes[:, 1])
        rows = np.flatnonzero((there & (away <= NEAR_BODIES_M)).any(axis=1))
        boxes, there, away = boxes[rows], there[rows], away[rows]
        local = to_local(boxes[..., :2], self.boxes[:, [0, 1, 4]])
        gap = np.full(away.shape, np.inf)
        row, frame = np.nonzero(there & (away <= NEAR_BODIES_M))
        gap[row, frame] = box_gap(self.boxes[frame], boxes[row, frame])
        speed = np.stack([_compute_speed(track[:, :2], self.seconds) for track in boxes]) if len(rows) else away
        turn = np.abs(wrap_angle(boxes[..., 4] - self.boxes[:, 4]))
        ids = (*self.scene.agents.ids, EGO)
        return OtherUsers(
            local[..., 0],
            local[..., 1],
            gap,
            turn,
            speed,
            boxes[:, 0, 2:4],
            tuple(ids[index] for index in rows.tolist()),
        )

    def window(self, first: int, stop: int, around_s: float) -> tuple[int, int]:
        """The frames of a run and so many seconds to both sides, as ``first`` and ``stop``."""
        reach = round(around_s * FRAME_HZ)
        return max(first - reach, 0), min(stop + reach, len(self.frames))

    def span(self, first: int, stop: int) -> float:
        """Seconds of a run."""
        return float(self.seconds[stop - 1] - self.seconds[first])

    def is_at(self, first: int, stop: int, *kinds: PlaceKind) -> bool:
        """Whether the first, middle or last frame of a run is at such a place."""
        for at in dict.fromkeys((first, (first + stop) // 2, stop - 1)):
            x, y = self.boxes[at, :2]
            near = self.scene.road_map.near((x - NEAR_M, y - NEAR_M, x + NEAR_M, y + NEAR_M))
            if PlaceClassifier(near).of(self.boxes[at], self.boxes[at]) in kinds:
                return True
        return False

    def failure(
        self, reason: DiscardReason, at: int, quantity: str, value: float, limit: float, other: str | None = None
    ) -> VerificationFailure:
        """Finding of a fault from one of its frames on."""
        return VerificationFailure(reason, int(self.frames[at]), other, quantity, round(float(value), 3), float(limit))

    def lasting(
        self, reason: DiscardReason, holds: Bools, others: OtherUsers, longer_than: float
    ) -> VerificationFailure | None:
        """Finding if (M, F) flags hold for longer than so many seconds with one and the same other."""
        for row in np.flatnonzero(holds.any(axis=1)).tolist():
            for first, stop in list_runs(holds[row], self.seconds, longer_than):
                span = self.span(first, stop)
                return self.failure(reason, first, "seconds", span, longer_than, others.names[row])
        return None


def find_behaviour_fault(scene: Scene, agent: int, start: int) -> VerificationFailure | None:
    """First fault of behaviour of an adversary from its launch on, in the order of ``docs/realism.md``."""
    return next(iterate_behaviour_faults(scene, agent, start), None)


def iterate_behaviour_faults(scene: Scene, agent: int, start: int) -> Iterator[VerificationFailure]:
    """All faults of behaviour of a vehicle that is there from a frame on, each once."""
    driven = DrivenStretch.of(scene, agent, start)
    if len(driven.frames) < 2 * SPEED_FRAMES or not (driven.speed >= MOVING_M_S).any():
        return
    smallest, largest = map(_bridge_seams, find_lane_turns(driven.boxes, scene.road_map))
    others = driven.others()
    findings = (
        _find_against_traffic(driven, smallest),
        _find_turn_across_road(driven, smallest, largest),
        _find_pressing(driven, others),
        _find_riding_beside(driven, others),
        _find_sticking(driven, others),
        _find_circling(driven),
        None if is_vulnerable(scene, agent) else _find_off_road(driven),
        _find_head_on(driven),
        _find_weaving(driven),
    )
    yield from (finding for finding in findings if finding is not None)


def _find_against_traffic(driven: DrivenStretch, smallest: Floats) -> VerificationFailure | None:
    """Against every lane below for too long, but for turns, U-turns and overtaking that ends along a lane again."""
    along = smallest < TURN_RAD
    for first, stop in list_runs(smallest > np.pi / 2, driven.seconds, AGAINST_S):
        before, after = driven.window(first, stop, AROUND_S)
        turned = np.ptp(np.unwrap(driven.boxes[before:after, 4])) >= TURN_RAD
        settled = along[stop:].sum() >= SETTLED_S * FRAME_HZ and along[:first].any()
        if not (turned or settled or driven.is_at(first, stop, PlaceKind.JUNCTION, PlaceKind.CAR_PARK)):
            return driven.failure(DiscardReason.AGAINST_TRAFFIC, first, "seconds", driven.span(first, stop), AGAINST_S)
    return None


def _find_turn_across_road(driven: DrivenStretch, smallest: Floats, largest: Floats) -> VerificationFailure | None:
    """Across the whole width of a road, where there is no junction, and no U-turn that ends along a lane."""
    across = (smallest > TURN_RAD) & (largest < np.pi - TURN_RAD) & (driven.speed >= STANDING_M_S)
    for first, stop in list_runs(across, driven.seconds, 0.0):
        before, after = driven.window(first, stop, AROUND_S)
        if np.ptp(np.unwrap(driven.boxes[before:after, 4])) >= TURN_BACK_RAD:
            continue
        crossed = float(np.hypot(*(driven.boxes[stop - 1, :2] - driven.boxes[first, :2])))
        width = _measure_road_width(driven, (first + stop) // 2)
        junction = driven.is_at(first, stop, PlaceKind.JUNCTION, PlaceKind.CAR_PARK, PlaceKind.ROUNDABOUT)
        if width <= WIDEST_M and crossed >= WHOLE_WIDTH * width and not junction:
            return driven.failure(
                DiscardReason.ACROSS_ROAD, first, "share of the road's width", crossed / width, WHOLE_WIDTH
            )
    return None


def _measure_road_width(driven: DrivenStretch, at: int) -> float:
    """Metres of road along the vehicle's heading through its centre."""
    x, y, yaw = driven.boxes[at, [0, 1, 4]]
    reach = WIDEST_M * np.array([np.cos(yaw), np.sin(yaw)])
    line = shapely.LineString([(x - reach[0], y - reach[1]), (x + reach[0], y + reach[1])])
    pieces = shapely.get_parts(shapely.intersection(line, driven.scene.road_map.drivable_area))
    return max((piece.length for piece in pieces if piece.distance(shapely.Point(x, y)) < 1e-6), default=np.inf)


def _find_pressing(driven: DrivenStretch, others: OtherUsers) -> VerificationFailure | None:
    length, width = driven.boxes[0, 2:4]
    room = others.ahead - 0.5 * (length + others.size[:, :1])
    overlap = np.abs(others.aside) < 0.5 * (width + others.size[:, 1:])
    close = overlap & (room >= -1.0) & (room < PRESSING_HEADWAY_S * driven.speed) & np.isfinite(others.gap)
    close &= (driven.speed >= PRESSING_M_S) & (others.turn < TURN_RAD)
    return driven.lasting(DiscardReason.PRESSING, close, others, PRESSING_S)


def _find_riding_beside(driven: DrivenStretch, others: OtherUsers) -> VerificationFailure | None:
    length = 0.5 * (driven.boxes[0, 2] + others.size[:, :1])
    beside = (np.abs(others.ahead) < length) & (others.gap <= BESIDE_M) & (others.turn < TURN_RAD)
    beside &= (driven.speed >= MOVING_M_S) & (others.speed >= MOVING_M_S)
    return driven.lasting(DiscardReason.RIDING_BESIDE, beside, others, BESIDE_S)


def _find_sticking(driven: DrivenStretch, others: OtherUsers) -> VerificationFailure | None:
    near = (others.gap <= STICKING_M) & (driven.speed >= MOVING_M_S) & (others.speed >= MOVING_M_S)
    return driven.lasting(DiscardReason.STICKING, near, others, STICKING_S)


def _find_circling(driven: DrivenStretch) -> VerificationFailure | None:
    turned = float(np.ptp(np.unwrap(driven.boxes[:, 4])))
    if turned <= CIRCLING_RAD:
        return None
    return driven.failure(DiscardReason.CIRCLING, 0, "degrees", np.rad2deg(turned), np.rad2deg(CIRCLING_RAD))


def _find_off_road(driven: DrivenStretch) -> VerificationFailure | None:
    """Its centre off the road after having been on it, as who comes from a driveway has not; car parks are no fault."""
    centers = shapely.points(driven.boxes[:, :2])
    area = driven.scene.road_map.drivable_area
    shapely.prepare(area)
    off = ~shapely.dwithin(area, centers, OFF_ROAD_M)
    for park in driven.scene.road_map.carparks.values() if off.any() else ():
        off &= ~shapely.intersects(park, centers)
    off[: int(np.argmin(off)) if not off.all() else len(off)] = False
    for first, stop in list_runs(off, driven.seconds, OFF_ROAD_S):
        return driven.failure(DiscardReason.OFF_ROAD, first, "seconds", driven.span(first, stop), OFF_ROAD_S)
    return None


def _find_head_on(driven: DrivenStretch) -> VerificationFailure | None:
    resting = driven.speed < STANDING_M_S
    if not resting.any():
        return None
    way, first, last = get_ego_path(driven.scene), int(driven.frames[0]), int(driven.frames[-1])
    station, offset, turn = way.places(driven.boxes[:, [0, 1, 4]], first, last)
    facing = resting & (np.abs(turn) > HEAD_ON_RAD) & (np.abs(offset) <= HEAD_ON_M)
    facing &= station > way.station[driven.frames]
    for first, stop in list_runs(facing, driven.seconds, HEAD_ON_S):
        return driven.failure(DiscardReason.HEAD_ON, first, "seconds", driven.span(first, stop), HEAD_ON_S)
    return None


def _find_weaving(driven: DrivenStretch) -> VerificationFailure | None:
    """Lateral accelerations beyond 1 m/s^2 to alternating sides, more than three changes in 4 s, as splines show it."""
    keyframes = driven.scene.keyframes
    at = np.flatnonzero(np.isin(driven.frames, keyframes))
    for stretch in find_stretches(np.ones(len(at), np.bool_), driven.boxes[at, :2]):
        times = driven.seconds[at[stretch]]
        samples = np.arange(times[0], times[-1] + 1e-6, SAMPLE_S)
        across = fit_splines(times, driven.boxes[at[stretch]], samples).values["acceleration_across"]
        beyond = np.flatnonzero(np.abs(across) > WEAVING_M_S2)
        changes = samples[beyond[1:][np.diff(np.sign(across[beyond])) != 0]]
        for index in range(len(changes) - WEAVING_SIGNS):
            if changes[index + WEAVING_SIGNS] - changes[index] <= WEAVING_S:
                frame = int(np.searchsorted(driven.seconds, changes[index]))
                return driven.failure(DiscardReason.WEAVING, frame, "changes of side", WEAVING_SIGNS + 1, WEAVING_SIGNS)
    return None


def _compute_speed(centers: Floats, seconds: Floats) -> Floats:
    """(F,) m/s over a quarter of a second to both sides: recorded tracks have corners at key frames."""
    frames = np.arange(len(centers))
    first, last = (np.clip(frames + reach, 0, len(frames) - 1) for reach in (-SPEED_FRAMES, SPEED_FRAMES))
    moved = np.hypot(*(centers[last] - centers[first]).T)
    return np.asarray(moved / np.maximum(seconds[last] - seconds[first], 1e-9))


def _bridge_seams(turns: Floats) -> Floats:
    """The same where no lane is below for at most half a second: lanes do not always touch."""
    at = np.arange(len(turns))
    last = np.maximum.accumulate(np.where(np.isnan(turns), -1, at))
    known = (last >= 0) & (at - last <= FRAMES_PER_KEYFRAME)
    return np.where(known, turns[last], np.nan)


def list_runs(holds: Bools, seconds: Floats, longer_than: float) -> Iterator[tuple[int, int]]:
    """First and stop of each run of (F,) flags that lasts longer than so many seconds."""
    edges = np.flatnonzero(np.diff(holds.astype(np.int8), prepend=0, append=0)).reshape(-1, 2)
    for first, stop in edges.tolist():
        if seconds[stop - 1] - seconds[first] > longer_than or not longer_than:
            yield first, stop
