"""Agents that replay their recorded or generated tracks without reacting to the ego."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from benchmark.closed_loop.agent_policy import AgentMotion, TrafficSnapshot
from benchmark.closed_loop.plan_tracking import INSTANT_US, INSTANTS
from benchmark.geometry import Bools, Floats
from benchmark.interactions.tracks import ContinuousTracks

_END_S = 1e-9


@dataclass(frozen=True, slots=True)
class TrackReplay:
    """Tracks of N agents in R rows every 0.05 s: (R, N, 5) boxes, (R, N) presence, none after the end of the tracks.

    ``velocity`` is (R, N, 2), m/s, of the past alone.
    """

    start_us: int
    boxes: Floats
    present: Bools
    velocity: Floats
    name: str = "replay"
    draws: bool = False

    @classmethod
    def of(cls, tracks: ContinuousTracks, first_us: int, start_us: int, end_us: int) -> Self:
        """Tracks from the start to the end of a drive; ``first_us`` is the time of their second 0."""
        rows = -(-(end_us - start_us) // INSTANT_US) + 1
        times = (start_us - first_us) / 1e6 + INSTANT_US / 1e6 * np.arange(rows)
        boxes, present = tracks.agents_at(times)
        # Tracks hold their last state; an agent whose track has ended is absent.
        inside = (times >= tracks.seconds[0] - _END_S) & (times <= tracks.seconds[-1] + _END_S)
        velocity = tracks.velocities_at(np.clip(times, tracks.seconds[0], tracks.seconds[-1]))
        return cls(
            start_us,
            np.ascontiguousarray(boxes.transpose(1, 0, 2)),
            np.ascontiguousarray(present.T) & inside[:, None],
            np.ascontiguousarray(velocity.transpose(1, 0, 2)),
        )

    def init(self, time_us: int, key: int) -> tuple[None, AgentMotion]:
        """All agents at a time of the drive."""
        return None, self._rows(time_us, time_us)

    def act(self, memory: None, moment: TrafficSnapshot, key: int) -> tuple[None, AgentMotion]:
        """The next 0.1 s."""
        return None, self._rows(moment.time_us + INSTANT_US, moment.time_us + INSTANTS * INSTANT_US)

    def _rows(self, *times_us: int) -> AgentMotion:
        """Two rows; after the last one no agent is there."""
        last = len(self.boxes) - 1
        wanted_rows = [(time - self.start_us) // INSTANT_US for time in times_us]
        if wanted_rows[-1] <= last and wanted_rows[-1] == wanted_rows[0] + 1:
            rows = slice(wanted_rows[0], wanted_rows[0] + INSTANTS)
            return AgentMotion(self.boxes[rows], self.present[rows], self.velocity[wanted_rows[-1]])
        clipped_rows = [min(row, last) for row in wanted_rows]
        after_end = np.array(wanted_rows) > last
        return AgentMotion(
            self.boxes[clipped_rows], self.present[clipped_rows] & ~after_end[:, None], self.velocity[clipped_rows[-1]]
        )
