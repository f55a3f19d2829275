"""A traffic session under way: the policy is stepped every 0.1 s from the hand-over on, against where the ego was told.

Who keeps to the log is told from the log, as it was sent; who is driven, from the policy. No call changes what an
earlier one was answered.
"""

import time
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from benchmark.closed_loop.adversary import AdversarialPolicy, AdversaryTrack
from benchmark.closed_loop.agent_policy import AgentMotion, AgentPolicy, TrafficSnapshot
from benchmark.closed_loop.plan_tracking import INSTANT_US, INSTANTS, SUBSTEP_US
from benchmark.extensions.alpasim.poses import SECOND_US, Poses
from benchmark.extensions.alpasim.traffic.session_log import LoggedTrack, SessionLog
from benchmark.extensions.alpasim.traffic.session_scene import MapFrame
from benchmark.geometry import Bools, Floats, boxes_overlap, poses_between, quaternion_from_yaw, yaw_of_quaternion
from benchmark.scene import Scene

_GENTLE_M_S2: Final = 2.5
"""How an adversary stops once no log goes on."""
_STILL_US: Final = 100_000


@dataclass(slots=True)
class SessionWorld:
    """One session: what has been told of the ego, and what everybody else did.

    ``everybody_answers`` is whether the policy drives others than the adversary. ``planned_s`` are the seconds of each
    step in which an adversary was planned; ``touched`` holds pairs of names that came to overlap, the ego's last.
    """

    log: SessionLog
    frame: MapFrame
    scene: Scene
    policy: AgentPolicy[Any]
    everybody_answers: bool = False
    planned_s: list[float] = field(default_factory=list)
    touched: dict[tuple[str, str], int] = field(default_factory=dict)
    ego_us: list[int] = field(default_factory=list)
    ego_poses: list[Floats] = field(default_factory=list)
    _memory: Any = None
    _clock_us: int = 0
    _moved: AgentMotion | None = None
    _boxes: list[Floats] = field(default_factory=list)
    _ignored: Bools | None = None

    def __post_init__(self) -> None:
        times = self.log.ego.poses.times_us
        position, yaw = self.log.ego.resample(times)
        self.ego_us = times.tolist()
        self.ego_poses = list(self.frame.to_map(np.column_stack([position[:, :2], yaw])))

    @property
    def adversary(self) -> AdversaryTrack | None:
        """Where the adversary was planned to go so far, if there is one."""
        started = self._moved is not None and isinstance(self.policy, AdversarialPolicy)
        return self.policy.adversary(self._memory) if started else None  # type: ignore[attr-defined]

    @property
    def told_us(self) -> int:
        """Time of the newest pose of the ego."""
        return self.ego_us[-1]

    @property
    def reached_us(self) -> int:
        """Time up to which everybody can be placed."""
        return min(self.told_us, max(self._clock_us, self.log.handover_us))

    def tell(self, poses: Poses) -> None:
        """New poses of the ego's box centre, later than all before."""
        planar = np.column_stack([poses.position[:, :2], yaw_of_quaternion(poses.rotation)])
        self.ego_us += poses.times_us.tolist()
        self.ego_poses += list(self.frame.to_map(planar))

    def advance(self, until_us: int) -> None:
        """Step to a time up to which the ego is known."""
        if until_us <= self.log.handover_us:
            return
        if self._moved is None:
            self._begin()
        while self._clock_us < until_us:
            self._step()

    def place(self, number: int, time_us: int) -> tuple[Floats, Floats] | None:
        """Position and quaternion of the box of a road user at a time that is reached; ``None`` where it is not."""
        track, adversary = self.log.others[number], self.adversary
        own = adversary is not None and adversary.agent == number
        driven = adversary is not None and own and time_us > int(self.scene.timestamps_us[adversary.start])
        if not (track.covers(time_us) or driven):
            return None
        if time_us <= self.log.handover_us or not (driven or (self.everybody_answers and not own)):
            return track.at(time_us)
        if driven and adversary is not None and time_us > int(self.scene.timestamps_us[-1]):
            return self._lift(track, self._stop(adversary, time_us), time_us)
        later = (time_us - self.log.handover_us) / INSTANT_US
        first = min(int(later), len(self._boxes) - 2)
        before, after = (self._boxes[at][number, [0, 1, 4]] for at in (first, first + 1))
        return self._lift(track, poses_between(before, after, np.array(later - first)), time_us)

    def _lift(self, track: LoggedTrack, pose: Floats, time_us: int) -> tuple[Floats, Floats]:
        x, y, yaw = self.frame.to_session(pose)
        return np.array([x, y, track.at(time_us)[0][2]]), quaternion_from_yaw(np.array(yaw))

    def _begin(self) -> None:
        self._clock_us = self.log.handover_us
        self._memory, self._moved = self.policy.init(self._clock_us, 0)
        self._boxes.append(self._moved.boxes[-1])
        ego, _ = self._see_ego(self._clock_us)
        self._ignored = self._find_overlaps(self._moved.boxes[-1], self._moved.present[-1], ego)

    def _step(self) -> None:
        self.note_contacts()
        assert self._moved is not None
        moved, (ego, speed) = self._moved, self._see_ego(self._clock_us)
        moment = TrafficSnapshot(self._clock_us, ego, speed, moved.boxes[-1], moved.present[-1], moved.velocity)
        begun, plans = time.perf_counter(), self._count_plans()
        self._memory, self._moved = self.policy.act(self._memory, moment, 0)
        if self._count_plans() > plans:
            self.planned_s.append(time.perf_counter() - begun)
        self._boxes += [*self._moved.boxes]
        self._clock_us += SUBSTEP_US

    def note_contacts(self) -> None:
        """Look for contacts in the last step, as far as the ego is known in it."""
        if self._moved is None or self._ignored is None or self._clock_us == self.log.handover_us:
            return
        names = (*self.scene.agents.ids, self.log.ego.uuid)
        for row in range(INSTANTS):
            at_us = self._clock_us + (row + 1 - INSTANTS) * INSTANT_US
            if at_us > self.told_us:
                continue
            found = self._find_overlaps(self._moved.boxes[row], self._moved.present[row], self._see_ego(at_us)[0])
            for first, second in np.argwhere(found & ~self._ignored).tolist():
                self.touched.setdefault((names[first], names[second]), at_us)

    def _see_ego(self, time_us: int) -> tuple[Floats, float]:
        """(5,) box of the ego at a time up to the newest pose, and its speed over the last 0.1 s, m/s."""
        now, before = self.ego_at(time_us), self.ego_at(max(time_us - _STILL_US, self.ego_us[0]))
        span = min(_STILL_US, time_us - self.ego_us[0]) / SECOND_US
        ahead = (now[:2] - before[:2]) @ [np.cos(now[2]), np.sin(now[2])]
        box = np.array([now[0], now[1], self.log.ego.size[0], self.log.ego.size[1], now[2]])
        return box, max(float(ahead) / span, 0.0) if span > 0.0 else 0.0

    def ego_at(self, time_us: int) -> Floats:
        """(3,) pose of the ego's box at a time up to the newest, in the frame of the map."""
        place = min(max(int(np.searchsorted(self.ego_us, time_us)), 1), len(self.ego_us) - 1)
        if len(self.ego_us) == 1 or self.ego_us[place] == time_us:
            return self.ego_poses[place if len(self.ego_us) > 1 else 0]
        first_us, last_us = self.ego_us[place - 1], self.ego_us[place]
        share = np.array((time_us - first_us) / (last_us - first_us))
        return poses_between(self.ego_poses[place - 1], self.ego_poses[place], share)

    def _stop(self, track: AdversaryTrack, time_us: int) -> Floats:
        """(3,) the adversary after the last log's end: it brakes on its heading and stands."""
        last = track.poses[-1]
        span = float(np.diff(self.scene.timestamps_us[-2:])[0]) / SECOND_US
        speed = float(np.hypot(*(last - track.poses[-min(2, len(track.poses))])[:2])) / span
        seconds = min((time_us - int(self.scene.timestamps_us[-1])) / SECOND_US, speed / _GENTLE_M_S2)
        travel = speed * seconds - 0.5 * _GENTLE_M_S2 * seconds**2
        return np.asarray(last + travel * np.array([np.cos(last[2]), np.sin(last[2]), 0.0]))

    def _count_plans(self) -> int:
        track = self.adversary
        return 0 if track is None else len(track.replanned)

    def _find_overlaps(self, boxes: Floats, present: Bools, ego: Floats) -> Bools:
        """(N + 1, N + 1) pairs of overlapping bodies that matter here: with the ego, the adversary or who answers."""
        everybody, there = np.concatenate([boxes, ego[None]]), np.append(present, True)
        driven = np.full(len(there), self.everybody_answers)
        driven[-1] = True
        adversary = self.adversary
        if adversary is not None:
            driven[adversary.agent] = True
        reach = 0.5 * np.hypot(everybody[:, 2], everybody[:, 3])
        apart = np.hypot(*(everybody[:, None, :2] - everybody[None, :, :2]).transpose(2, 0, 1))
        near = np.triu(apart <= reach[:, None] + reach, 1) & there[:, None] & there & (driven[:, None] | driven)
        first, second = np.nonzero(near)
        near[first, second] = boxes_overlap(everybody[first], everybody[second])
        return np.asarray(near)
