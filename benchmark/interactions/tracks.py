"""Recorded tracks in continuous time: where all agents are between the frames, and how fast.

``docs/severity.md``, "Time and poses". Positions are linear between frames, headings take the shortest arc; velocities
look at the past only, so that a driver who reacts to them knows nothing of the future.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final, Self

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Bools, Floats, boxes_overlap, wrap_angle
from benchmark.scene import Scene

STEP_S: Final = 0.1
"""Time between the instants at which drivers decide and encounters are sampled."""
SUB_STEPS: Final = 5
"""Instants of each step at which contact is looked for."""
_WHOLE: Final = 1e-9
"""Fractions this near to a frame are that frame."""
_MEMORY_S: Final = 0.2
_SHORTEST_MEMORY_S: Final = 0.05
_FORESIGHT_S: Final = 0.1
_SHORTEST_S: Final = 1e-6
HIDING_EXCEPTIONS: Final = ("vehicle.motorcycle", "vehicle.bicycle")
"""Vehicles that no other can hide behind."""

Integers = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class ContinuousTracks:
    """One ego, (F, 5), and N agents, (N, F, 5), over F frames at rising seconds.

    Where an agent is not there, by (N, F) ``valid``, its boxes are any finite values.
    """

    seconds: Floats
    ego: Floats
    agents: Floats
    valid: Bools
    categories: tuple[str, ...]
    _runs: tuple[Floats, Floats] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_runs", _find_run_limits(self.seconds, self.valid))

    @classmethod
    def of_scene(cls, scene: Scene) -> Self:
        """The tracks of a scene: its ego (real body) and all its objects."""
        agents = scene.agents
        return cls(scene.seconds, scene.ego.boxes, agents.boxes, agents.valid, agents.categories)

    def __len__(self) -> int:
        return len(self.categories)

    def only(self, agents: Sequence[int] | Integers | Bools) -> Self:
        """The same with some of the agents, by indices or an (N,) mask, in the order given."""
        rows = np.arange(len(self))[np.asarray(agents)]
        names = tuple(self.categories[row] for row in rows.tolist())
        return type(self)(self.seconds, self.ego, self.agents[rows], self.valid[rows], names)

    @property
    def hides(self) -> Bools:
        """(N,) who can hide a car: vehicles with four wheels or more, and trailers."""
        names = self.categories
        return np.array([name.startswith("vehicle.") and name not in HIDING_EXCEPTIONS for name in names], np.bool_)

    def grid(self, start: float | None = None) -> Floats:
        """Instants every 0.1 s from a start, the first frame by default, to the last frame at most."""
        start = float(self.seconds[0]) if start is None else start
        count = int(np.floor((self.seconds[-1] - start) / STEP_S + _WHOLE)) + 1
        return start + STEP_S * np.arange(count)

    def ego_at(self, times: Floats) -> Floats:
        """(..., 5) boxes of the ego at any times of the recording, seconds."""
        frame, fraction = locate_frames(self.seconds, times)
        return _interpolate_boxes(self.ego[frame], self.ego[frame + 1], fraction)

    def agents_at(self, times: Floats) -> tuple[Floats, Bools]:
        """(N, T, 5) boxes and (N, T) presence of all agents at any times of the recording, seconds.

        One is there if it is at both frames around the time, or at the one frame it is.
        """
        frame, fraction = locate_frames(self.seconds, times)
        boxes = _interpolate_boxes(self.agents[:, frame], self.agents[:, frame + 1], fraction)
        return boxes, self.present_at(times)

    def present_at(self, times: Floats) -> Bools:
        """(N, T) who is there at (T,) times; the second answer of `agents_at`."""
        frame, fraction = locate_frames(self.seconds, times)
        return np.asarray((self.valid[:, frame] | (fraction == 1.0)) & (self.valid[:, frame + 1] | (fraction == 0.0)))

    def touching_at(self, time: float) -> Bools:
        """(N,) who overlaps the recorded ego at a time: such agents never count."""
        boxes, present = self.agents_at(np.array([time]))
        return np.asarray(present[:, 0] & boxes_overlap(self.ego_at(np.array([time])), boxes[:, 0]))

    def velocities_at(self, times: Floats, agents: Integers | None = None) -> Floats:
        """(N, T, 2) m/s from the last 0.2 s of each agent's run of valid frames, meant only for when it is there.

        Where the run has lasted less than 0.05 s it is the next 0.1 s, and zero where there is no time at all.
        """
        rows = np.arange(len(self)) if agents is None else agents
        frame, fraction = locate_frames(self.seconds, times)
        at = np.where(fraction == 1.0, frame + 1, frame)
        run_start, run_end = (times_of[rows][:, at] for times_of in self._runs)
        times = np.broadcast_to(times, run_start.shape)
        earlier = np.maximum(times - _MEMORY_S, run_start)
        forward = times - earlier < _SHORTEST_MEMORY_S
        first = np.where(forward, times, earlier)
        last = np.where(forward, np.minimum(times + _FORESIGHT_S, run_end), times)
        span = last - first
        moved = self._interpolate_centres(rows, last) - self._interpolate_centres(rows, first)
        lasting = span >= _SHORTEST_S
        return np.asarray(np.where(lasting[..., None], moved / np.where(lasting, span, 1.0)[..., None], 0.0))

    def ego_velocities_at(self, times: Floats) -> Floats:
        """(T, 2) velocities of the ego at (T,) times by the same rule."""
        there = np.ones((1, len(self.seconds)), np.bool_)
        return np.asarray(type(self)(self.seconds, self.ego, self.ego[None], there, ("",)).velocities_at(times)[0])

    def run_limits_at(self, times: Floats) -> tuple[Floats, Floats]:
        """(N, T) when each agent's run of valid frames around each of (T,) times starts, and when it ends."""
        frame, fraction = locate_frames(self.seconds, times)
        at = np.where(fraction == 1.0, frame + 1, frame)
        return self._runs[0][:, at], self._runs[1][:, at]

    def centres_at(self, times: Floats) -> Floats:
        """(N, T, 2) centres at (N, T) times of each agent's own."""
        return self._interpolate_centres(np.arange(len(self)), times)

    def _interpolate_centres(self, rows: Integers, times: Floats) -> Floats:
        frame, fraction = locate_frames(self.seconds, times)
        first, second = self.agents[rows[:, None], frame, :2], self.agents[rows[:, None], frame + 1, :2]
        return np.asarray(first + fraction[..., None] * (second - first))


def locate_frames(seconds: Floats, times: Floats) -> tuple[Integers, Floats]:
    """The earlier frame beside each time, at most F - 2, and the fraction to the next; outside, the nearest end."""
    times = np.asarray(times, np.float64)
    if len(seconds) < 2:
        raise ValueError("tracks need at least two frames")
    frame = np.clip(np.searchsorted(seconds, times, side="right") - 1, 0, len(seconds) - 2)
    fraction = np.clip((times - seconds[frame]) / (seconds[frame + 1] - seconds[frame]), 0.0, 1.0)
    fraction = np.where(fraction < _WHOLE, 0.0, np.where(fraction > 1.0 - _WHOLE, 1.0, fraction))
    return frame, fraction


def _interpolate_boxes(first: Floats, second: Floats, fraction: Floats) -> Floats:
    step = second - first
    step[..., 4] = wrap_angle(step[..., 4])
    return np.asarray(first + np.asarray(fraction)[..., None] * step)


def _find_run_limits(seconds: Floats, valid: Bools) -> tuple[Floats, Floats]:
    """(N, F) times at which the run of valid frames that each frame is in starts and ends."""
    valid = np.asarray(valid, np.bool_)
    limits = []
    for mask, times in ((valid, seconds), (valid[:, ::-1], seconds[::-1])):
        frames = np.arange(len(seconds))
        before = np.concatenate([np.zeros((len(mask), 1), np.bool_), mask[:, :-1]], axis=1)
        starts = np.where(mask & ~before, frames, 0)
        limits.append(times[np.maximum.accumulate(starts, axis=1)])
    return limits[0], limits[1][:, ::-1]
