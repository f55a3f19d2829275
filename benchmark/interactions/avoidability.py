"""Time to last chance: until when one of 25 sampled manoeuvres still avoids the contact that a base track ends in.

``docs/severity.md``, "Time to last chance". The base is a recorded or driven ego, or the ego at constant speed. Agents
replay their tracks. Manoeuvres brake so hard, and swerve so far, from a moment on: a lower bound of what could be done.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_WHEELBASE_M
from benchmark.geometry import Bools, Floats, box_corners, boxes_overlap, wrap_angle
from benchmark.interactions.contacts import KINDS, NOT_AT_FAULT_KINDS, classify_contacts, is_agent_category
from benchmark.interactions.driver_outcomes import CollisionChecker, EgoCollision
from benchmark.interactions.driver_simulation import DrivingSituation, ReferenceDriver, simulate_drivers
from benchmark.interactions.ego_path import EgoPath
from benchmark.interactions.reaction import HARDEST_BRAKING, Driver
from benchmark.interactions.tracks import STEP_S as GRID_S
from benchmark.interactions.tracks import ContinuousTracks, Integers

BRAKING: Final = (0.0, 2.0, 4.0, 6.0, HARDEST_BRAKING)
OFFSETS_M: Final = (0.0, 1.75, -1.75, 3.5, -3.5)
MANOEUVRES: Final = tuple((braking, offset) for braking in BRAKING for offset in OFFSETS_M)
"""Index ``5 i + j`` is the i-th braking with the j-th offset."""
STEP_S: Final = 0.05
LONGEST_STEPS: Final = 120
_BUILD_UP: Final = 12.65 * STEP_S
_LARGEST_STEERING_RAD: Final = 0.6
_STEERING_STEP_RAD: Final = 0.03
_LOOK_TIME_S: Final = 0.8
_SHORTEST_LOOK_M: Final = 4.0
_BACK_M, _AHEAD_M = 2.0, 20.0
"""How far the rear axle's station may move in a step."""
STATE_COLUMNS: Final = 5
X, Y, HEADING, SPEED, STEERING = range(STATE_COLUMNS)
"""Columns of a state: rear axle, heading, speed, steering angle."""


@dataclass(frozen=True, slots=True)
class ManoeuvreStarts:
    """O moments at which manoeuvres start: (O, 3) box centre and heading of the ego, and its metres along the path."""

    pose: Floats
    speed: Floats
    station: Floats


def simulate_manoeuvres(path: EgoPath, starts: ManoeuvreStarts, steps: int) -> Floats:
    """(O, 25, steps + 1, 5) states, the start included, of all manoeuvres from all moments, as if the ego were alone.

    Steps are of 0.05 s.
    """
    shape = (len(starts.speed), len(MANOEUVRES))
    braking = np.broadcast_to([value for value, _ in MANOEUVRES], shape).ravel()
    offset = np.broadcast_to([value for _, value in MANOEUVRES], shape).ravel()
    x, y, heading, speed, steering, station = (
        np.broadcast_to(column[:, None], shape).ravel() for column in _read_start(path, starts)
    )
    states = np.empty((len(braking), steps + 1, STATE_COLUMNS))
    states[:, 0] = np.column_stack([x, y, heading, speed, steering])
    built_up = np.zeros(len(braking))
    for step in range(1, steps + 1):
        built_up = np.minimum(braking, built_up + _BUILD_UP)
        position = np.column_stack([x, y])
        station, _ = path.project(position, station - _BACK_M, station + _AHEAD_M)
        wanted = _compute_steering(path, position, heading, speed, station, offset)
        left = np.sqrt(np.maximum(HARDEST_BRAKING**2 - built_up**2, 0.0))
        largest = np.minimum(_LARGEST_STEERING_RAD, np.arctan(left * EGO_WHEELBASE_M / np.maximum(speed, 0.1) ** 2))
        change = np.clip(np.clip(wanted, -largest, largest) - steering, -_STEERING_STEP_RAD, _STEERING_STEP_RAD)
        steering = np.clip(steering + change, -largest, largest)
        speed = np.maximum(speed - STEP_S * built_up, 0.0)
        turned = heading + STEP_S * speed * np.tan(steering) / EGO_WHEELBASE_M
        x = x + STEP_S * speed * np.cos(0.5 * (heading + turned))
        y = y + STEP_S * speed * np.sin(0.5 * (heading + turned))
        heading = turned
        states[:, step] = np.column_stack([x, y, heading, speed, steering])
    return states.reshape(*shape, steps + 1, STATE_COLUMNS)


def compute_boxes(states: Floats, size: Floats) -> Floats:
    """(..., 5) rectangles of (..., 5) states, for a car of (2,) length and width."""
    heading = states[..., HEADING]
    ahead = EGO_CENTER_FROM_REAR_AXLE_M * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    sizes = np.broadcast_to(size, (*heading.shape, 2))
    return np.concatenate([states[..., :2] + ahead, sizes, heading[..., None]], axis=-1)


def _read_start(path: EgoPath, starts: ManoeuvreStarts) -> tuple[Floats, ...]:
    heading = starts.pose[:, 2]
    x = starts.pose[:, 0] - EGO_CENTER_FROM_REAR_AXLE_M * np.cos(heading)
    y = starts.pose[:, 1] - EGO_CENTER_FROM_REAR_AXLE_M * np.sin(heading)
    turn = wrap_angle(path.heading(starts.station + 1.0) - path.heading(starts.station - 1.0))
    steering = np.clip(np.arctan(EGO_WHEELBASE_M * turn / 2), -_LARGEST_STEERING_RAD, _LARGEST_STEERING_RAD)
    return x, y, heading, starts.speed, steering, starts.station - EGO_CENTER_FROM_REAR_AXLE_M


def _compute_steering(
    path: EgoPath, position: Floats, heading: Floats, speed: Floats, station: Floats, offset: Floats
) -> Floats:
    """Pure pursuit of a point ahead on the shifted path."""
    aim = station + np.maximum(_SHORTEST_LOOK_M, _LOOK_TIME_S * speed)
    tangent = path.tangent(aim)
    normal = np.column_stack([-tangent[:, 1], tangent[:, 0]])
    target = path.position(aim) + offset[:, None] * normal - position
    cos, sin = np.cos(heading), np.sin(heading)
    ahead, left = target[:, 0] * cos + target[:, 1] * sin, target[:, 1] * cos - target[:, 0] * sin
    return np.asarray(np.arctan(2 * EGO_WHEELBASE_M * left / (ahead**2 + left**2)))


REACTION_S: Final = 0.75
OFF_ROAD_M: Final = 0.3
"""A corner further off the drivable area than this ends a manoeuvre."""


@dataclass(frozen=True, slots=True)
class ManoeuvreTrial:
    """Manoeuvres from one moment, as if nothing had been hit: (25, S + 1, 5) states.

    ``failed`` is (25,), the step of the contact or of leaving the road, -1 for success.
    """

    time: float
    states: Floats
    failed: Integers

    @property
    def succeeds(self) -> Bools:
        """(25,) verdicts."""
        return self.failed < 0

    @property
    def first(self) -> int:
        """Index of the first manoeuvre that succeeds, -1 for none."""
        return int(np.argmax(self.succeeds)) if self.succeeds.any() else -1


@dataclass(frozen=True, slots=True)
class LastAvoidableTime:
    """Last moment at which a contact could be avoided; ``contact`` is the base's, ``None`` if it is not threatened.

    ``time``, seconds, is ``None`` if there is no contact, it is not the ego's to avoid, or nothing avoids it from the
    start on. ``evaluated`` has the first manoeuvre that succeeds, by the tenth of a second that was looked at.
    """

    contact: EgoCollision | None
    time: float | None
    evaluated: dict[int, int]

    @property
    def unsolvable(self) -> bool:
        """Whether nothing avoids the contact even from the start."""
        return self.evaluated.get(0) == -1


class BaselineEgo:
    """Ego whose first contact is to be avoided, as it is (``RECORDED``) or at the speed of the start (``CONSTANT``).

    Manoeuvres may go anywhere if ``drivable`` is ``None``.
    """

    def __init__(
        self,
        situation: DrivingSituation,
        driver: Driver = Driver.RECORDED,
        drivable: shapely.MultiPolygon | None = None,
        surroundings: CollisionChecker | None = None,
    ) -> None:
        if driver not in (Driver.RECORDED, Driver.CONSTANT):
            raise ValueError(f"{driver} cannot be a base; drive it and pass its track as the ego of the scene")
        self.situation, self.driver = situation, driver
        self.drivable = None if drivable is None else drivable.buffer(OFF_ROAD_M)
        if self.drivable is not None:
            shapely.prepare(self.drivable)
        (motion,) = simulate_drivers(situation, [ReferenceDriver(driver)])
        self.contact = (surroundings or CollisionChecker.of(situation)).find_outcome(motion).contact

    def try_from(self, time: float) -> ManoeuvreTrial:
        """Try all manoeuvres from one moment inside the recording, seconds."""
        tracks, path = self.situation.tracks, self.situation.path
        steps = min(LONGEST_STEPS, max(0, int(np.floor((tracks.seconds[-1] - time) / STEP_S + 1e-9))))
        at = np.array([time])
        start = self._boxes(at)
        states = simulate_manoeuvres(
            path, ManoeuvreStarts(start[:, [0, 1, 4]], self._speed(at), self._station(at)), steps
        )[0]
        times = time + STEP_S * np.arange(1, steps + 1)
        failed = self._find_first_contacts(states[:, 1:], times, start)
        if self.drivable is not None and steps:
            corners = box_corners(compute_boxes(states[:, 1:], path.size))
            inside = shapely.contains_xy(self.drivable, corners[..., 0], corners[..., 1]).all(axis=-1)
            failed = np.minimum(failed, np.where(inside, steps + 1, np.arange(1, steps + 1)).min(axis=1))
        return ManoeuvreTrial(time, states, np.where(failed > steps, -1, failed))

    def last_chance(self) -> LastAvoidableTime:
        """Search the last moment from which a manoeuvre succeeds, by bisection over tenths of a second.

        It is exact if what succeeds late succeeds earlier too.
        """
        contact, start = self.contact, float(self.situation.times[0])
        if contact is None or KINDS.index(contact.kind) in NOT_AT_FAULT_KINDS:
            return LastAvoidableTime(contact, None, {})
        evaluated = {0: self.try_from(start).first}
        if evaluated[0] < 0:
            return LastAvoidableTime(contact, None, evaluated)
        low, high = 0, int(np.ceil((contact.time - start) / GRID_S - 1e-9))
        while high - low > 1:
            middle = (low + high) // 2
            evaluated[middle] = self.try_from(start + GRID_S * middle).first
            low, high = (middle, high) if evaluated[middle] >= 0 else (low, middle)
        return LastAvoidableTime(contact, start + GRID_S * low, evaluated)

    def is_avoidable_after(self, first_visible: float | None) -> bool:
        """Whether a manoeuvre succeeds once a driver has had time to react to the adversary (``None``: never visible).

        The verdict at the first tenth of a second that is 0.75 s later; true where the base is not threatened or not to
        blame, false where it is over by then.
        """
        contact = self.contact
        if contact is None or KINDS.index(contact.kind) in NOT_AT_FAULT_KINDS:
            return True
        if first_visible is None:
            return False
        times = self.situation.times
        later = times[times >= first_visible + REACTION_S - 1e-9]
        return bool(len(later)) and later[0] < contact.time and self.try_from(float(later[0])).first >= 0

    def _station(self, times: Floats) -> Floats:
        situation = self.situation
        if self.driver is Driver.RECORDED:
            return situation.path.recorded_station(times)
        return np.asarray(situation.station[0] + situation.speed[0] * (times - situation.times[0]))

    def _speed(self, times: Floats) -> Floats:
        if self.driver is Driver.RECORDED:
            return self.situation.path.recorded_speed(times)
        return np.full(times.shape, self.situation.speed[0])

    def _boxes(self, times: Floats) -> Floats:
        if self.driver is Driver.RECORDED:
            return self.situation.tracks.ego_at(times)
        return self.situation.path.boxes(self._station(times))

    def _find_first_contacts(self, states: Floats, times: Floats, start: Floats) -> Integers:
        """(25,) first step, counted from 1, of a contact that is the ego's to avoid; S + 1 for none.

        An agent that runs into the ego from behind, or into a standing one, counts no more afterwards: so what matters
        of each agent is its first contact.
        """
        steps = len(times)
        failed = np.full(len(states), steps + 1)
        tracks = self._select_counted_agents(states, times, start) if steps else None
        if tracks is None or not len(tracks):
            return failed
        boxes, present = tracks.agents_at(times)
        ego = compute_boxes(states, self.situation.path.size)
        offset = boxes[None, ..., :2] - ego[:, None, :, :2]
        reach = 0.5 * (np.hypot(boxes[..., 2], boxes[..., 3]) + np.hypot(*self.situation.path.size)) + 1e-6
        near = present & (offset[..., 0] ** 2 + offset[..., 1] ** 2 <= reach**2)
        row, agent, step = np.nonzero(near)
        touching = np.zeros(near.shape, np.bool_)
        touching[row, agent, step] = boxes_overlap(ego[row, step], boxes[agent, step])
        row, agent = np.nonzero(touching.any(axis=-1))
        step = np.argmax(touching[row, agent], axis=-1)
        speed = np.hypot(*np.moveaxis(tracks.velocities_at(times), -1, 0))[agent, step]
        agents = np.array([is_agent_category(name) for name in tracks.categories], np.bool_)[agent]
        kind = classify_contacts(ego[row, step], states[row, step, SPEED], boxes[agent, step], speed, agents)
        counts = ~np.isin(kind, NOT_AT_FAULT_KINDS)
        np.minimum.at(failed, row[counts], step[counts] + 1)
        return failed

    def _select_counted_agents(self, states: Floats, times: Floats, start: Floats) -> ContinuousTracks:
        """Agents that a manoeuvre could touch; not those that overlap the ego at its start or that of the scene."""
        tracks = self.situation.tracks
        first = np.searchsorted(tracks.seconds, times[0] - STEP_S, side="right") - 1
        frames = slice(max(int(first), 0), None)
        reach = 0.5 * (np.hypot(*np.moveaxis(tracks.agents[:, frames, 2:4], -1, 0)).max(axis=1))
        reach += np.hypot(*self.situation.path.size) + 1e-3
        low, high = (limit(states[..., :2], axis=(0, 1)) for limit in (np.min, np.max))
        centre, there = tracks.agents[:, frames, :2], tracks.valid[:, frames, None]
        their_low = np.where(there, centre, np.inf).min(axis=1) - reach[:, None]
        their_high = np.where(there, centre, -np.inf).max(axis=1) + reach[:, None]
        meets = ((their_low <= high) & (low <= their_high)).all(axis=-1)
        boxes, present = tracks.agents_at(times[:1] - STEP_S)
        overlapping = present[:, 0] & boxes_overlap(start, boxes[:, 0])
        return tracks.only(meets & ~overlapping & ~self.situation.ignored)
