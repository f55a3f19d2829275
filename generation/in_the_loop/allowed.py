"""What an adversary may drive: nobody but the ego is ever touched, and from where a plan ends there is a way on."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from benchmark.closed_loop.following import INSTANT_US
from benchmark.dynamics.bicycle import DriverLimits
from benchmark.encounters.tracks import Integers, Tracks
from benchmark.geometry import Bools, Floats, boxes_overlap, wrap_angle
from benchmark.scene import Scene

AIR_M: Final = 0.1
"""Between bodies, on every side: what is driven is looked at every 0.05 s alone."""
AHEAD_FRAMES: Final = 60
"""How far is looked: 5 s. Candidates are known for 3 s of them, as far as scores look; who brakes, to the end."""
BRAKING_M_S2: Final = (2.5, DriverLimits().braking_m_s2, 8.0)
"""How it brakes where no candidate is allowed: gently, as hard as a driver does, as hard as tyres do."""


@dataclass(frozen=True, slots=True)
class Surrounded:
    """Everybody but an adversary and the ego, every 0.05 s from a planning frame on.

    Attributes:
        frame_seconds: (K + 1,) of the frames that can be planned, since the planning frame; the first is 0.
        seconds: (R,) instants after it, to the last frame.
        boxes: (R, N, 5) of everybody.
        present: (R, N) who is there.
        reach: (N,) half of the diagonals.
        size: (2,) length and width of the adversary, with the air around it.
    """

    frame_seconds: Floats
    seconds: Floats
    boxes: Floats
    present: Bools
    reach: Floats
    size: Floats

    @classmethod
    def of(cls, scene: Scene, agent: int, frame: int) -> Self:
        """Those of a scene, as far as scores look or the scene lasts."""
        last = min(frame + AHEAD_FRAMES, len(scene.timestamps_us) - 1)
        times = (scene.timestamps_us - scene.timestamps_us[frame]) / 1e6
        frames = times[frame : last + 1]
        count = int(np.floor(frames[-1] / (INSTANT_US / 1e6) + 1e-9))
        seconds = np.unique(np.concatenate([INSTANT_US / 1e6 * np.arange(1, count + 1), frames[1:]]))
        boxes, present = Tracks.of_scene(scene).agents_at(seconds + float(scene.seconds[frame]))
        present[agent] = False
        reach = 0.5 * np.hypot(*scene.agents.size[:, :2].T)
        size = scene.agents.size[agent, :2] + 2.0 * AIR_M
        return cls(
            frames,
            seconds,
            np.ascontiguousarray(boxes.transpose(1, 0, 2)),
            np.ascontiguousarray(present.T),
            reach,
            size,
        )

    def clear_for(self, poses: Floats) -> float:
        """How long a motion touches nobody.

        Args:
            poses: (F, 3) of the box centre at the planning frame and at those after it.

        Returns:
            Seconds to the last instant before it touches somebody; infinite where it never does.
        """
        known = self.frame_seconds[: len(poses)]
        rows = self.seconds <= known[-1] + 1e-9
        own = np.empty((int(rows.sum()), 5))
        own[:, 0], own[:, 1], own[:, 4] = (
            np.interp(self.seconds[rows], known, column)
            for column in (poses[: len(known), 0], poses[: len(known), 1], np.unwrap(poses[: len(known), 2]))
        )
        own[:, 2:4] = self.size
        offset = self.boxes[: len(own), :, :2] - own[:, None, :2]
        reach = self.reach + 0.5 * float(np.hypot(*self.size)) + 1e-6
        near = self.present[: len(own)] & (offset[..., 0] ** 2 + offset[..., 1] ** 2 <= reach**2)
        row, other = np.nonzero(near)
        hit = boxes_overlap(own[row], self.boxes[row, other])
        if not hit.any():
            return np.inf
        first = int(row[np.argmax(hit)])
        return float(self.seconds[first - 1]) if first else 0.0

    def way_on(self, poses: Floats, executed: int) -> float:
        """How long nobody is touched if the first frames of a motion are driven and the best is made of what follows.

        Args:
            poses: (F, 3) of the box centre at the planning frame and at those after it.
            executed: How many of them are driven.

        Returns:
            Seconds; infinite where the motion may be driven: it touches nobody in these frames, and as far as is looked
            it does not either if it goes on as it ends, or if it brakes after them.
        """
        last = min(executed, len(self.frame_seconds) - 1)
        lasting = 0.0
        end = min(len(poses), len(self.frame_seconds)) - 1
        for first, braking in ((end, 0.0), *((last, braking) for braking in BRAKING_M_S2[:2])):
            lasting = max(lasting, self.clear_for(braked(poses, first, self.frame_seconds, braking)))
            if lasting == np.inf or lasting < self.frame_seconds[last]:
                break
        return lasting


def braked(poses: Floats, first: int, seconds: Floats, braking_m_s2: float) -> Floats:
    """A motion that is driven to some frame and then braked on its own path.

    Args:
        poses: (F, 3) of the box centre, one a frame.
        first: Frame of them from which it brakes.
        seconds: (K,) of the frames; those beyond the F are reached on the last heading.
        braking_m_s2: Deceleration; 0 goes on at the speed that it has.

    Returns:
        (K, 3) poses.
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
    # Where it stood on its path there is no way between two stations, and none is asked for.
    place = np.column_stack([np.interp(goal, station, path[:, axis]) for axis in range(2)]) + beyond[:, None] * ahead
    turned = wrap_angle(np.interp(goal, station, yaw))
    return np.concatenate([path[:first], np.column_stack([place, turned])])


def in_order(scores: Floats, most: int) -> Iterator[tuple[int, int]]:
    """Round and index of the best candidates, the best first, and of as many from all over the rest.

    Args:
        scores: (R, B), lower is better; infinite ones are left out.
        most: How many at most.

    Yields:
        Their places.
    """
    flat = scores.ravel()
    order: Integers = np.argsort(flat, kind="stable")
    order = order[np.isfinite(flat[order])]
    # The best are all alike: what stops one of them stops the others.
    spread = np.unique(np.linspace(0, max(len(order) - 1, 0), most - most // 2).astype(np.int64))
    for place in order[np.union1d(np.arange(min(most // 2, len(order))), spread[: len(order)])].tolist():
        yield divmod(place, scores.shape[1])
