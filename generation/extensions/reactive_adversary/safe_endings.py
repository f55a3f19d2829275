"""Admissible plans of an adversary: no contact but with the ego, and a safe end, with others predicted by policy."""

from collections.abc import Callable, Iterable, Iterator, Sequence
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
from generation.extensions.reactive_adversary.braking import InstantsBetween, brake_on_path, brake_on_paths

AIR_M: Final = 0.1
"""Between bodies, on every side: what is driven is looked at every 0.05 s alone."""
AHEAD_FRAMES: Final = 60
"""How far others who answer are expected, and how much of a plan is kept for them: 5 s."""
GENTLE_M_S2: Final = 2.5
BRAKING_M_S2: Final = (GENTLE_M_S2, DriverLimits().braking_m_s2, 8.0)
"""How it brakes where no candidate is allowed: gently, as hard as a driver does, as hard as tyres do."""
LATER_FRAMES: Final = 6
"""A plan may end with brakes at once, or any number of half seconds later."""
SOON_FRAMES: Final = (24, 42, 66)
"""Within 2, 3.5 and 5.5 s most endings that touch another do."""
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
        others = _select_later(scene, agent, frame)
        boxes, present = others.agents_at(np.minimum(seconds + float(scene.seconds[frame]), float(scene.seconds[-1])))
        boxes, present = np.ascontiguousarray(boxes.transpose(1, 0, 2)), np.ascontiguousarray(present.T)
        low, high = _bound(boxes, present)
        reach = 0.5 * np.hypot(*others.agents[:, 0, 2:4].T)
        size = scene.agents.size[agent, :2] + 2.0 * AIR_M
        return cls(frames, seconds, boxes, present, reach, low, high, size)

    def extend(self, boxes: Floats) -> Self:
        """With one more, who is always there, at (R, 5) boxes."""
        present = np.ones((len(boxes), 1), np.bool_)
        low, high = _bound(boxes[:, None], present)
        return replace(
            self,
            boxes=np.concatenate([self.boxes, boxes[:, None]], axis=1),
            present=np.concatenate([self.present, present], axis=1),
            reach=np.append(self.reach, 0.5 * np.hypot(*boxes[0, 2:4])),
            low=np.concatenate([self.low, low], axis=1),
            high=np.concatenate([self.high, high], axis=1),
        )

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
        for first, braking in self._list_endings(len(poses), executed):
            yield brake_on_path(poses, first, self.frame_seconds, braking)

    def _list_endings(self, length: int, executed: int) -> list[tuple[int, float]]:
        """From which frame on each ending of so many poses brakes, and how hard."""
        count = len(self.frame_seconds)
        end = min(length, count) - 1
        first = min(executed, end)
        later = range(first, end + 1, LATER_FRAMES) if first < count - 1 else ()
        return [(end, 0.0), *((frame, braking) for braking in BRAKING_M_S2 for frame in later)]

    def ending(self, poses: Floats, executed: int) -> Floats | None:
        """The first of them that never touches another; ``None`` if there is none."""
        found = self.find_ending(poses[None], executed)
        return None if found is None else found[1]

    def find_ending(
        self, motions: Floats, executed: int, are_allowed: Callable[[Floats], Bools] | None = None
    ) -> tuple[int, Floats] | None:
        """Index of the first of (N, F, 3) motions that has an `ending`, and that ending; looked at together.

        ``are_allowed`` says which of (3, P, K) x, y, yaw are, of any motions from now on; with it brakes are tried at
        once, or where the motion ends.
        """
        last = min(executed, len(self.frame_seconds) - 1)
        done = motions[:, : last + 1].transpose(2, 0, 1)
        kept = np.flatnonzero(self.find_clear(done, 0))
        kinds = self._list_endings(motions.shape[1], executed)
        kinds = kinds if are_allowed is None else [kind for kind in kinds if kind[0] in (last, kinds[0][0])]
        goes_on = self._find_clear_endings(motions[kept], kinds[:1], last, are_allowed)[:, 0]
        # One that can go on at its speed needs no brakes, and none after it is asked.
        before = int(np.argmax(goes_on)) if goes_on.any() else len(kept)
        brakes = self._find_clear_endings(motions[kept[:before]], kinds[1:], last, are_allowed)
        if brakes.any():
            row = int(np.argmax(brakes.any(axis=1)))
            chosen, (first, braking) = int(kept[row]), kinds[1 + int(np.argmax(brakes[row]))]
        elif before < len(kept):
            chosen, (first, braking) = int(kept[before]), kinds[0]
        else:
            return None
        return chosen, brake_on_path(motions[chosen], first, self.frame_seconds, braking)

    def _find_clear_endings(
        self,
        motions: Floats,
        kinds: Sequence[tuple[int, float]],
        last: int,
        are_allowed: Callable[[Floats], Bools] | None,
    ) -> Bools:
        """(N, E) which endings of (N, F, 3) motions touch nobody from the frame ``last`` on."""
        clear = np.ones((len(motions), len(kinds)), np.bool_)
        count = len(self.frame_seconds)
        # Most contacts are soon, and what touches one needs no look at what comes later.
        for ends in ([min(last + ahead, count) for ahead in SOON_FRAMES], [count]):
            row, kind = np.nonzero(clear)
            if len(row):
                columns = brake_on_paths(motions, row, [kinds[each] for each in kind], self.frame_seconds, ends[-1])
                alive = np.arange(len(row))
                for end in ends:
                    alive = alive[self.find_clear(columns[:, alive, :end], last)]
                    last = end - 1
                if are_allowed is not None:
                    alive = alive[are_allowed(columns[:, alive])]
                clear[:] = False
                clear[row[alive], kind[alive]] = True
            if ends[-1] == count:
                break
        return clear

    def find_clear(self, columns: Floats, first: int) -> Bools:
        """(P,) whether motions touch nobody from a frame on; (3, P, K) x, y, yaw of the first frames."""
        known = self.frame_seconds[: columns.shape[2]]
        count = int(np.searchsorted(self.seconds, known[-1] + 1e-9, side="right"))
        begin = int(np.searchsorted(self.seconds, known[first] + 1e-9, side="right")) // _CHUNK * _CHUNK
        clear = np.ones(columns.shape[1], np.bool_)
        if begin >= count or not len(clear):
            return clear
        motion, chunk, other = self._find_near_chunks(columns[:2], known, begin, count)
        if not len(motion):
            return clear
        # All instants of each motion that is near anybody: faster than those that matter, one by one.
        rows = slice(begin + int(chunk.min()) * _CHUNK, min(begin + (int(chunk.max()) + 1) * _CHUNK, count))
        between = InstantsBetween.of(known, self.seconds[rows])
        moving, place = np.unique(motion, return_inverse=True)
        own_x, own_y = between.at(columns[:2, moving])
        row = (chunk[:, None] * _CHUNK + np.arange(begin, begin + _CHUNK)).ravel()
        place, other = np.repeat(place, _CHUNK), np.repeat(other, _CHUNK)
        there = (row < count) & self.present[np.minimum(row, count - 1), other]
        place, row, other = place[there], row[there], other[there]
        x, y = own_x[place, row - rows.start], own_y[place, row - rows.start]
        theirs = self.boxes[row, other]
        near = (theirs[:, 0] - x) ** 2 + (theirs[:, 1] - y) ** 2 <= (self._reach_of_both**2)[other]
        place, row = place[near], row[near]
        turning, where = np.unique(place, return_inverse=True)
        own = np.empty((len(row), 5))
        own[:, 0], own[:, 1], own[:, 2:4] = x[near], y[near], self.size
        own[:, 4] = between.at(np.unwrap(columns[2, moving[turning]], axis=1))[where, row - rows.start]
        clear[moving[place[boxes_overlap(own, theirs[near])]]] = False
        return clear

    def _find_near_chunks(
        self, places: Floats, known: Floats, begin: int, count: int
    ) -> tuple[Integers, Integers, Integers]:
        """Motion, run of instants after ``begin``, and other, of all that may touch; (2, P, K) ``places`` of frames."""
        starts = np.arange(begin, count, _CHUNK)
        ends = np.minimum(starts + _CHUNK, count) - 1
        frame = np.maximum(np.searchsorted(known, self.seconds[starts], side="right") - 1, 0)
        after = np.minimum(np.searchsorted(known, self.seconds[ends]), len(known) - 1) + 1
        bounds = np.column_stack([frame, after]).ravel()
        padded = np.concatenate([places, places[..., -1:]], axis=2)
        low, high = (bound.reduceat(padded, bounds, axis=2)[..., ::2] for bound in (np.minimum, np.maximum))
        chunks, reach = slice(begin // _CHUNK, begin // _CHUNK + len(starts)), self._reach_of_both
        their_low, their_high = self.low[chunks] - reach[:, None], self.high[chunks] + reach[:, None]
        lowest, highest = low.min(axis=1).T[:, None], high.max(axis=1).T[:, None]
        # Most others are far from all motions.
        chunk, other = np.nonzero(((their_low <= highest) & (their_high >= lowest)).all(axis=-1))
        may = np.ones((places.shape[1], len(chunk)), np.bool_)
        for axis in range(2):
            may &= low[axis][:, chunk] <= their_high[chunk, other, axis]
            may &= high[axis][:, chunk] >= their_low[chunk, other, axis]
        motion, pair = np.nonzero(may)
        return motion, chunk[pair], other[pair]

    @property
    def _reach_of_both(self) -> Floats:
        """(N,) distance of centres within which bodies may touch, metres."""
        return np.asarray(self.reach + 0.5 * float(np.hypot(*self.size)) + 1e-6)

    def find_longest(self, motions: Iterable[Floats]) -> Floats:
        """The first of some motions that last longest before they touch another."""
        return max(motions, key=self.compute_clear_seconds)


def _select_later(scene: Scene, agent: int, frame: int) -> ContinuousTracks:
    """Tracks from a frame on, or a little before it, of all but one agent who are there then."""
    agents, rest = scene.agents, slice(max(frame - 1, 0), None)
    there = agents.valid[:, rest].any(axis=1)
    there[agent] = False
    rows = np.flatnonzero(there)
    size = np.broadcast_to(agents.size[rows, None, :2], (len(rows), len(scene.seconds[rest]), 2))
    boxes = np.concatenate([agents.position[rows, rest, :2], size, agents.yaw[rows, rest, None]], axis=-1)
    names = tuple(agents.categories[row] for row in rows.tolist())
    return ContinuousTracks(scene.seconds[rest], scene.ego.boxes[rest], boxes, agents.valid[rows, rest], names)


def _bound(boxes: Floats, present: Bools) -> tuple[Floats, Floats]:
    """(C, N, 2) lowest and highest centres of (R, N, 5) boxes within runs of instants."""
    begins = np.arange(0, len(boxes), _CHUNK)
    low = np.minimum.reduceat(np.where(present[..., None], boxes[..., :2], np.inf), begins, axis=0)
    return low, np.maximum.reduceat(np.where(present[..., None], boxes[..., :2], -np.inf), begins, axis=0)


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
