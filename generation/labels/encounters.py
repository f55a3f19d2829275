"""A vehicle and the ego in the frame of the ego's driven path: who is where, and how long until they meet."""

from dataclasses import dataclass

import numpy as np

from benchmark.geometry import Bools, Floats, box_gap
from generation.labels.path_frame import PathFrame, Placement

MOVING_M_S = 1.0
"""Below this speed a body stands."""


@dataclass(frozen=True, slots=True)
class Encounter:
    """A vehicle and the ego, frame by frame, in the frame of the ego's path.

    Attributes:
        seconds: (F,) since the scene's first frame.
        present: (F,) whether the vehicle is there.
        ego: The ego's body.
        other: The vehicle's body.
        ego_speed: (F,) m/s.
        speed: (F,) m/s, of the vehicle.
        along: (F,) the part of ``speed`` along the path.
        gap: (F,) between the bodies, metres.
        half_width: Half the width of the strip that the ego sweeps.
    """

    seconds: Floats
    present: Bools
    ego: Placement
    other: Placement
    ego_speed: Floats
    speed: Floats
    along: Floats
    gap: Floats
    half_width: float

    @property
    def frame_s(self) -> float:
        """Mean time between frames."""
        return float(np.ptp(self.seconds)) / max(len(self.seconds) - 1, 1)

    @property
    def inside(self) -> Bools:
        """(F,) whether the vehicle's body reaches into the strip that the ego sweeps."""
        return self.within(0.0)

    def within(self, margin_m: float) -> Bools:
        """(F,) whether it reaches into the strip with a margin on both sides."""
        half = self.half_width + margin_m
        return np.asarray((self.other.right < half) & (self.other.left > -half) & self.present)

    @property
    def ahead(self) -> Bools:
        """(F,) whether its centre is ahead of the ego's."""
        return np.asarray(self.other.station > self.ego.station)

    @property
    def abreast(self) -> Bools:
        """(F,) whether the bodies overlap along the path."""
        return np.asarray((self.other.front > self.ego.rear) & (self.other.rear < self.ego.front) & self.present)

    @property
    def reach_s(self) -> Floats:
        """(F,) time until the ego's front is where the vehicle's rear is now, by the recording.

        After its end the ego goes on as fast as at the end: for ever, if it stands.
        """
        front = np.maximum.accumulate(self.ego.front)
        at = np.searchsorted(front, self.other.rear)
        later = self.seconds[np.minimum(at, len(front) - 1)]
        missing = np.maximum(self.other.rear - front[-1], 0.0)
        later = later + missing / max(float(self.ego_speed[-1]), 1e-9)
        return np.asarray(np.maximum(later - self.seconds, 0.0))

    @property
    def room(self) -> Floats:
        """(F,) metres of path between the ego's front and the vehicle's rear, 0 where they overlap."""
        return np.maximum(self.other.rear - self.ego.front, 0.0)

    @property
    def meet_s(self) -> Floats:
        """(F,) time until the ego reaches the vehicle: `reach_s`, or sooner where the vehicle comes towards it."""
        closing = np.maximum(self.ego_speed - self.along, 1e-9)
        return np.minimum(self.reach_s, self.room / closing)

    @property
    def pursuit_s(self) -> Floats:
        """(F,) time that the vehicle needs at its speed to where the ego's rear is now; infinite if it stands."""
        room = np.maximum(self.ego.rear - self.other.front, 0.0)
        return np.where(self.along > MOVING_M_S, room / np.maximum(self.along, MOVING_M_S), np.inf)

    @property
    def side_gap(self) -> Floats:
        """(F,) distance from the ego's strip to the vehicle, 0 where it reaches in."""
        return np.maximum(np.maximum(self.other.right, -self.other.left) - self.half_width, 0.0)

    @property
    def acceleration(self) -> Floats:
        """(F,) change of the speed along the path over the second around each frame, m/s^2."""
        if len(self.seconds) < 2:
            return np.zeros(len(self.seconds))
        before, after = (
            np.interp(self.seconds + step, self.seconds, np.arange(len(self.seconds))) for step in (-0.5, 0.5)
        )
        frames = np.arange(len(self.seconds))
        span = np.interp(after, frames, self.seconds) - np.interp(before, frames, self.seconds)
        return np.asarray((np.interp(after, frames, self.along) - np.interp(before, frames, self.along)) / span)


def encounter(ego: Floats, other: Floats, seconds: Floats, present: Bools, start: int) -> Encounter:
    """Bring two tracks of (T, 5) boxes at (T,) times into the frame of the ego's path, from frame ``start`` on."""
    path, frames = PathFrame.of(ego), slice(start, None)
    placed = Placement.of(path, other[frames], frames)
    ego_velocity, velocity = (_velocity(track[frames], seconds[frames]) for track in (ego, other))
    heading = other[frames, 4] - placed.turn
    return Encounter(
        seconds=seconds[frames],
        present=present[frames],
        ego=Placement.of(path, ego[frames], frames),
        other=placed,
        ego_speed=np.hypot(ego_velocity[:, 0], ego_velocity[:, 1]),
        speed=np.hypot(velocity[:, 0], velocity[:, 1]),
        along=velocity[:, 0] * np.cos(heading) + velocity[:, 1] * np.sin(heading),
        gap=np.where(present[frames], box_gap(other[frames], ego[frames]), np.inf),
        half_width=0.5 * float(ego[0, 3]),
    )


def _velocity(boxes: Floats, seconds: Floats) -> Floats:
    """(F, 2) m/s; a single frame stands."""
    if len(boxes) < 2:
        return np.zeros((len(boxes), 2))
    return np.asarray(np.gradient(boxes[:, :2], seconds, axis=0))
