"""Admissible plans of an adversary: no contact but with the ego, and a safe end, with others predicted by policy."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Self

import numpy as np

from benchmark.closed_loop.adversary import Handover
from benchmark.closed_loop.agent_policy import AgentPolicy, TrafficSnapshot
from benchmark.closed_loop.plan_tracking import INSTANT_US, INSTANTS, SUBSTEP_US
from benchmark.dynamics.bicycle import DriverLimits
from benchmark.geometry import Bools, Floats, boxes_overlap, wrap_angle
from benchmark.interactions.tracks import ContinuousTracks, Integers
from benchmark.scene import Scene

AIR_M: Final = 0.1
"""Between bodies, on every side: what is driven is looked at every 0.05 s alone."""
AHEAD_FRAMES: Final = 60
"""How far others who answer are expected, and how much of a plan is kept for them: 5 s."""
GENTLE_M_S2: Final = 2.5
BRAKING_M_S2: Final = (GENTLE_M_S2, DriverLimits().braking_m_s2, 8.0)
"""How it brakes where no candidate is allowed: gently, as hard as a driver does, as hard as tyres do."""
LATER_FRAMES: Final = 6
"""A plan may end with brakes at once, or any number of half seconds later."""
_CHUNK: Final = 10
"""Instants that bodies are bounded over: 0.5 s."""


@dataclass(frozen=True, slots=True)
class SurroundingTracks:
    """All others than an adversary and the ego, every 0.05 s from a planning frame to the scene's last.

    `frame_seconds` are (K + 1,) of the frames that can be planned, from 0; `seconds` (R,) instants at which the drive
    places others, and frames. `boxes` are (R, N, 5), `reach` (N,) half of the diagonals; no centre is below `low` or
    above `high`, (C, N, 2), within a run of instants (infinite where absent). `size` is the adversary's with the air
    around it.
    """

    frame_seconds: Floats
    seconds: Floats
    boxes: Floats
    present: Bools
    reach: Floats
    low: Floats
    high: Floats
    size: Floats

    @classmethod
    def of(cls, scene: Scene, agent: int, frame: int, clock_us: int) -> Self:
        """Surroundings of an adversary in a scene of all others' futures; ``clock_us`` is any time of its clock."""
        now_us = int(scene.timestamps_us[frame])
        frames = (scene.timestamps_us[frame:] - now_us) / 1e6
        clock = np.arange((clock_us - now_us) % INSTANT_US, scene.timestamps_us[-1] - now_us + 1, INSTANT_US) / 1e6
        seconds = np.unique(np.concatenate([clock, frames]))
        seconds = seconds[seconds > 0.0]
        boxes, present = ContinuousTracks.of_scene(scene).agents_at(
            np.minimum(seconds + float(scene.seconds[frame]), float(scene.seconds[-1]))
        )
        present[agent] = False
        boxes, present = np.ascontiguousarray(boxes.transpose(1, 0, 2)), np.ascontiguousarray(present.T)
        begins = np.arange(0, len(seconds), _CHUNK)
        is_present, centre = present[..., None], boxes[..., :2]
        low = np.minimum.reduceat(np.where(is_present, centre, np.inf), begins, axis=0)
        high = np.maximum.reduceat(np.where(is_present, centre, -np.inf), begins, axis=0)
        reach = 0.5 * np.hypot(*scene.agents.size[:, :2].T)
        size = scene.agents.size[agent, :2] + 2.0 * AIR_M
        return cls(frames, seconds, boxes, present, reach, low, high, size)

    def compute_clear_seconds(self, poses: Floats, first: int = 0) -> float:
        """Seconds to the last instant before a motion touches another, looked at from ``first`` on; infinite if never.

        ``poses`` are (F, 3) of the box centre from the planning frame on.
        """
        known = self.frame_seconds[: len(poses)]
        count = int(np.searchsorted(self.seconds, known[-1] + 1e-9, side="right"))
        begin = int(np.searchsorted(self.seconds, known[first] + 1e-9, side="right")) // _CHUNK * _CHUNK
        if begin >= count:
            return np.inf
        seconds = self.seconds[begin:count]
        own = np.empty((len(seconds), 5))
        own[:, 0], own[:, 1], own[:, 4] = (
            np.interp(seconds, known, column)
            for column in (poses[: len(known), 0], poses[: len(known), 1], np.unwrap(poses[: len(known), 2]))
        )
        own[:, 2:4] = self.size
        row, other = self._near(own, begin)
        hit = boxes_overlap(own[row - begin], self.boxes[row, other])
        if not hit.any():
            return np.inf
        touched = int(row[hit].min())
        return float(self.seconds[touched - 1]) if touched else 0.0

    def _near(self, own: Floats, begin: int) -> tuple[Integers, Integers]:
        """Instants and indices of who may be touched by (I, 5) boxes, at the instants from one on."""
        begins = np.arange(0, len(own), _CHUNK)
        reach = self.reach + 0.5 * float(np.hypot(*self.size)) + 1e-6
        chunks = slice(begin // _CHUNK, begin // _CHUNK + len(begins))
        lowest = np.minimum.reduceat(own[:, :2], begins, axis=0)[:, None] - reach[:, None]
        highest = np.maximum.reduceat(own[:, :2], begins, axis=0)[:, None] + reach[:, None]
        may = ((self.low[chunks] <= highest) & (self.high[chunks] >= lowest)).all(axis=-1)
        chunk, other = np.nonzero(may)
        row = (chunk[:, None] * _CHUNK + np.arange(_CHUNK)).ravel()
        other = np.repeat(other, _CHUNK)
        inside = row < len(own)
        row, other = row[inside], other[inside]
        away = self.boxes[row + begin, other, :2] - own[row, :2]
        near = self.present[row + begin, other] & ((away**2).sum(axis=1) <= reach[other] ** 2)
        return row[near] + begin, other[near]

    def generate_endings(self, poses: Floats, executed: int) -> Iterator[Floats]:
        """Ways, (K + 1, 3), in which a motion may go on to the last frame once its ``executed`` frames are driven.

        It goes on as known, then at its speed; or it brakes on its own path, at once or any number of half seconds
        later, and stands; gentle braking comes first. ``poses`` are (F, 3) of the box centre from the planning frame
        on.
        """
        for first, braking in self._list_endings(poses, executed):
            yield brake_on_path(poses, first, self.frame_seconds, braking)

    def _list_endings(self, poses: Floats, executed: int) -> list[tuple[int, float]]:
        """From which frame on each ending brakes, and how hard."""
        count = len(self.frame_seconds)
        end = min(len(poses), count) - 1
        first = min(executed, end)
        later = range(first, end + 1, LATER_FRAMES) if first < count - 1 else ()
        return [(end, 0.0), *((frame, braking) for braking in BRAKING_M_S2 for frame in later)]

    def ending(self, poses: Floats, executed: int) -> Floats | None:
        """The first of them that never touches another; ``None`` if there is none."""
        last = min(executed, len(self.frame_seconds) - 1)
        if self.compute_clear_seconds(poses[: last + 1]) < np.inf:
            return None
        kinds = self._list_endings(poses, executed)
        # Most go on at their speed; of those that cannot, all brakes are looked at together.
        for some in (kinds[:1], kinds[1:]):
            motions = brake_on_paths(poses, some, self.frame_seconds)
            clear = self.find_clear(motions, last)
            if clear.any():
                return np.asarray(motions[int(np.argmax(clear))])
        return None

    def find_clear(self, motions: Floats, first: int) -> Bools:
        """(E,) whether (E, K + 1, 3) motions to the last frame touch nobody from a frame on."""
        known = self.frame_seconds
        count = int(np.searchsorted(self.seconds, known[-1] + 1e-9, side="right"))
        begin = int(np.searchsorted(self.seconds, known[first] + 1e-9, side="right")) // _CHUNK * _CHUNK
        clear = np.ones(len(motions), np.bool_)
        if begin >= count or not len(motions):
            return clear
        columns = np.stack([motions[..., 0], motions[..., 1], np.unwrap(motions[..., 2], axis=1)])
        placed = _interpolate_rows(self.seconds[begin:count], known, columns)
        begins = np.arange(0, count - begin, _CHUNK)
        reach = self.reach + 0.5 * float(np.hypot(*self.size)) + 1e-6
        chunks = slice(begin // _CHUNK, begin // _CHUNK + len(begins))
        may = np.ones((len(motions), len(begins), len(reach)), np.bool_)
        for axis in range(2):
            lowest = np.minimum.reduceat(placed[axis], begins, axis=1)[..., None] - reach
            highest = np.maximum.reduceat(placed[axis], begins, axis=1)[..., None] + reach
            may &= (self.low[chunks, :, axis] <= highest) & (self.high[chunks, :, axis] >= lowest)
        motion, chunk, other = np.nonzero(may)
        row = (chunk[:, None] * _CHUNK + np.arange(_CHUNK)).ravel()
        motion, other = np.repeat(motion, _CHUNK), np.repeat(other, _CHUNK)
        inside = row < count - begin
        motion, row, other = motion[inside], row[inside], other[inside]
        away = self.boxes[row + begin, other, :2] - placed[:2, motion, row].T
        near = self.present[row + begin, other] & ((away**2).sum(axis=1) <= reach[other] ** 2)
        motion, row, other = motion[near], row[near], other[near]
        own = np.empty((len(row), 5))
        own[:, [0, 1, 4]], own[:, 2:4] = placed[:, motion, row].T, self.size
        clear[motion[boxes_overlap(own, self.boxes[row + begin, other])]] = False
        return clear

    def find_longest(self, motions: Iterable[Floats]) -> Floats:
        """The first of some motions that last longest before they touch another."""
        return max(motions, key=self.compute_clear_seconds)


def brake_on_path(poses: Floats, first: int, seconds: Floats, braking_m_s2: float) -> Floats:
    """(K, 3) poses of a motion that is braked on its own path from some frame on; 0 m/s^2 keeps its speed.

    ``seconds`` are (K,) of the frames; those beyond the F are reached on the last heading.
    """
    count = len(seconds)
    path = poses[: min(len(poses), count)]
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    station = np.concatenate([[0.0], np.cumsum(steps)])
    before = max(first - 1, 0)
    after = min(before + 1, len(path) - 1)
    span = float(seconds[after] - seconds[before]) if after > before else 1.0
    speed = float(station[after] - station[before]) / span
    time = seconds[first:] - seconds[first]
    if braking_m_s2 > 0.0:
        time = np.minimum(time, speed / braking_m_s2)
    goal = station[min(first, len(path) - 1)] + speed * time - 0.5 * braking_m_s2 * time**2
    yaw = np.unwrap(path[:, 2])
    beyond = np.maximum(goal - station[-1], 0.0)
    ahead = np.array([np.cos(path[-1, 2]), np.sin(path[-1, 2])])
    # While it stood, two stations coincide and the path between them has no length; none is needed.
    place = np.column_stack([np.interp(goal, station, path[:, axis]) for axis in range(2)]) + beyond[:, None] * ahead
    turned = wrap_angle(np.interp(goal, station, yaw))
    return np.concatenate([path[:first], np.column_stack([place, turned])])


def brake_on_paths(poses: Floats, kinds: Sequence[tuple[int, float]], seconds: Floats) -> Floats:
    """(E, K, 3) `brake_on_path` of one motion in E ways, frame and m/s^2, the same to the last bit."""
    count = len(seconds)
    path = poses[: min(len(poses), count)]
    steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
    station = np.concatenate([[0.0], np.cumsum(steps)])
    goals = []
    for first, braking in kinds:
        before = max(first - 1, 0)
        after = min(before + 1, len(path) - 1)
        span = float(seconds[after] - seconds[before]) if after > before else 1.0
        speed = float(station[after] - station[before]) / span
        time = seconds[first:] - seconds[first]
        if braking > 0.0:
            time = np.minimum(time, speed / braking)
        goals.append(station[min(first, len(path) - 1)] + speed * time - 0.5 * braking * time**2)
    goal = np.concatenate([np.zeros(0), *goals])
    beyond = np.maximum(goal - station[-1], 0.0)
    ahead = np.array([np.cos(path[-1, 2]), np.sin(path[-1, 2])])
    place = np.column_stack([np.interp(goal, station, path[:, axis]) for axis in range(2)]) + beyond[:, None] * ahead
    later = np.column_stack([place, wrap_angle(np.interp(goal, station, np.unwrap(path[:, 2])))])
    motions = np.empty((len(kinds), count, 3))
    at = 0
    for row, (first, _) in enumerate(kinds):
        motions[row, :first], motions[row, first:] = path[:first], later[at : at + count - first]
        at += count - first
    return motions


def _interpolate_rows(wanted: Floats, known: Floats, rows: Floats) -> Floats:
    """(..., I) `numpy.interp` of (..., K) rows that share their (K,) known places, the same to the last bit."""
    at = np.clip(np.searchsorted(known, wanted, side="right") - 1, 0, len(known) - 1)
    after = np.minimum(at + 1, len(known) - 1)
    here = rows[..., at]
    width = np.where(after > at, known[after] - known[at], 1.0)
    between = (rows[..., after] - here) / width * (wanted - known[at]) + here
    return np.asarray(np.where((known[at] == wanted) | (after == at), here, between))


def order_candidates(scores: Floats, most: int) -> Iterator[tuple[int, int]]:
    """Round and index of at most ``most`` finite (R, B) scores: lowest first, and as many from all over the rest."""
    flat = scores.ravel()
    order: Integers = np.argsort(flat, kind="stable")
    order = order[np.isfinite(flat[order])]
    # The best candidates are alike: an obstacle to one of them stops the others, too.
    spread = np.unique(np.linspace(0, max(len(order) - 1, 0), most - most // 2).astype(np.int64))
    for place in order[np.union1d(np.arange(min(most // 2, len(order))), spread[: len(order)])].tolist():
        yield divmod(place, scores.shape[1])


@dataclass(frozen=True, slots=True)
class ExpectedAgents:
    """All others, who answer adversary and ego; ``own`` are the adversary's (F, 3) poses from the hand-over on."""

    policy: AgentPolicy[Any]
    memory: Any
    handover: Handover
    own: Floats


def predict_others(scene: Scene, others: ExpectedAgents, moment: TrafficSnapshot, frame: int) -> Scene:
    """The scene with the expected ego and all others where they will be; later, its tracks are held."""
    times = scene.timestamps_us
    last = min(frame + AHEAD_FRAMES, len(times) - 1)
    steps = -(-int(times[last] - moment.time_us) // SUBSTEP_US)
    rows, boxes, present = _simulate_others(others, moment, scene, steps)
    agents = scene.agents
    position, yaw, valid = agents.position.copy(), agents.yaw.copy(), agents.valid.copy()
    later = np.flatnonzero(times >= moment.time_us)
    seconds, frame_seconds = (
        (rows - rows[0]) / 1e6,
        np.clip((times[later] - rows[0]) / 1e6, 0.0, (rows[-1] - rows[0]) / 1e6),
    )
    place = np.clip(np.searchsorted(seconds, frame_seconds, side="right") - 1, 0, len(rows) - 2)
    share = ((frame_seconds - seconds[place]) / (seconds[place + 1] - seconds[place]))[:, None]
    for agent in range(len(agents)):
        first, second = boxes[place, agent], boxes[place + 1, agent]
        position[agent, later, :2] = first[:, :2] + share * (second[:, :2] - first[:, :2])
        yaw[agent, later] = first[:, 4] + share[:, 0] * wrap_angle(second[:, 4] - first[:, 4])
        # A road user present at one end of a step may be in the way during all of it.
        valid[agent, later] = present[place, agent] | present[place + 1, agent]
    adversary = others.handover.agent
    position[adversary], yaw[adversary], valid[adversary] = (
        agents.position[adversary],
        agents.yaw[adversary],
        agents.valid[adversary],
    )
    return replace(scene, agents=replace(agents, position=position, yaw=yaw, valid=valid))


def _simulate_others(
    others: ExpectedAgents, moment: TrafficSnapshot, scene: Scene, steps: int
) -> tuple[Floats, Floats, Floats]:
    """(R,) microseconds, (R, N, 5) boxes and (R, N) presence of all, beginning now."""
    times, boxes, present = [moment.time_us], [moment.boxes], [moment.present]
    ego = scene.ego.boxes
    frames = (scene.timestamps_us - moment.time_us) / 1e6
    yaw = np.unwrap(ego[:, 4])
    memory = others.memory
    for step in range(max(steps, 1)):
        memory, moved = others.policy.act(memory, moment, 0)
        moved = others.handover.moved(moved, others.own, moment.time_us)
        now_us = moment.time_us + SUBSTEP_US
        at = (step + 1) * SUBSTEP_US / 1e6
        box = np.array(
            [
                np.interp(at, frames, ego[:, 0]),
                np.interp(at, frames, ego[:, 1]),
                *ego[0, 2:4],
                np.interp(at, frames, yaw),
            ]
        )
        speed = float(np.hypot(*(box[:2] - moment.ego[:2]))) / (SUBSTEP_US / 1e6)
        moment = TrafficSnapshot(now_us, box, speed, moved.boxes[-1], moved.present[-1], moved.velocity)
        times += [now_us - SUBSTEP_US + (row + 1) * SUBSTEP_US // INSTANTS for row in range(INSTANTS)]
        boxes += [*moved.boxes]
        present += [*moved.present]
    return np.array(times), np.stack(boxes), np.stack(present)
