"""Whether a careful human would survive a candidate: all candidates of a batch at once, along the ego's way.

In open loop an adversary never touches the recorded ego, and that keeps it fair. In closed loop the ego may do
anything, and only somebody who may be hit is ever in anybody's way. So the search asks what a careful and competent
human would do in the ego's place (`benchmark.drivers`, on the path alone: two seconds to contact, 0.75 s of reaction,
braking that rises to 0.774 g), and whether that driver is hit: by the candidate, or by who drives behind and does not
brake.
"""

from dataclasses import dataclass
from typing import Final, Self

import numpy as np

from benchmark.constants import FRAME_HZ
from benchmark.drivers.rules import CAREFUL_TIME_S, HARDEST_BRAKING, REACTION_S
from benchmark.dynamics.bicycle import SimulatedMotion
from benchmark.geometry import Bools, Floats
from benchmark.scene import Scene
from generation.search.ego_way import EgoWay

EVERY_FRAMES: Final = 2
LOOK_FRAMES: Final = 36
_RISE_M_S3: Final = 12.65
_AIR_ALONG_M: Final = 1.0
_AIR_ASIDE_M: Final = 0.4
_ASIDE_M_S: Final = 0.25
"""What is nearer than this, in the ego's way and beside it, is as good as touched: where the ego will be is not known,
and less so the farther ahead."""


@dataclass(frozen=True, slots=True)
class CarefulAhead:
    """A careful human in the ego's place, and who is behind it.

    Attributes:
        way: The ego's way.
        frame: The planning frame.
        station: Of the ego's centre, metres.
        speed: m/s.
        behind: (S,) highest station of anybody's front behind the ego in its strip; minus infinity where nobody is.
        steps: (S,) frames after the planning frame.
    """

    way: EgoWay
    frame: int
    station: float
    speed: float
    behind: Floats
    steps: tuple[int, ...]

    @classmethod
    def of(cls, scene: Scene, agent: int, frame: int, speed: float) -> Self:
        """The careful human of a planning frame.

        Args:
            scene: With the ego as it is expected to drive on.
            agent: The adversary.
            frame: The planning frame.
            speed: Of the ego there, m/s.
        """
        last = min(frame + LOOK_FRAMES, len(scene.timestamps_us) - 1)
        steps = tuple(range(EVERY_FRAMES, last - frame + 1, EVERY_FRAMES)) or (last - frame,)
        way = EgoWay.of(scene)
        at = [frame + step for step in steps]
        station = float(way.station[frame])
        return cls(way, frame, station, speed, _behind(scene, agent, way, frame, at), steps)

    def hit(self, motion: SimulatedMotion, size: Floats) -> Bools:
        """(B,) whether the careful human is hit, or would surely be soon after.

        Args:
            motion: Of B candidates.
            size: (2,) length and width of the adversary.
        """
        center = np.where(motion.finite[:, None, None], motion.center[:, [0, *self.steps]], 0.0)
        rear, front, beside = self._placed(center, size)
        count, half = len(center), 0.5 * self.way.length_m
        dt = EVERY_FRAMES / FRAME_HZ
        station, speed = np.full(count, self.station), np.full(count, self.speed)
        waiting, braking = np.full(count, REACTION_S), np.zeros(count)
        hit = np.zeros(count, np.bool_)
        for step in range(len(self.steps)):
            gap = rear[:, step] - station - half
            closing = speed - (rear[:, step + 1] - rear[:, step]) / dt
            ahead = front[:, step] > station
            way = beside[:, step] <= 0.0
            unsafe = way & ahead & ((gap <= 0.0) | ((closing > 0.0) & (gap <= CAREFUL_TIME_S * closing)))
            ready = unsafe & (waiting <= 0.0)
            waiting = np.where(unsafe, waiting - dt, waiting)
            braking = np.where(ready, np.minimum(braking + _RISE_M_S3 * dt, HARDEST_BRAKING), braking)
            after = np.maximum(speed - np.where(ready, braking, 0.0) * dt, 0.0)
            station, speed = station + 0.5 * dt * (speed + after), after
            over = (rear[:, step + 1] < station + half + _AIR_ALONG_M) & (front[:, step + 1] > station - half)
            hit |= over & (beside[:, step + 1] <= _AIR_ASIDE_M + _ASIDE_M_S * (step + 1) * dt)
            # Who comes from behind hits whoever has braked, not who would have been hit in any case.
            hit |= (self.behind[step] > station - half) & (waiting < REACTION_S)
        gap = rear[:, -1] - station - half
        closing = np.maximum(speed - (rear[:, -1] - rear[:, -2]) / dt, 0.0)
        needed = closing * np.maximum(waiting, 0.0) + closing**2 / (2.0 * HARDEST_BRAKING)
        return np.asarray(hit | ((beside[:, -1] <= 0.0) & (gap > -half) & (gap < needed)))

    def _placed(self, center: Floats, size: Floats) -> tuple[Floats, Floats, Floats]:
        """(B, S) lowest and highest stations of candidates, and metres from the ego's strip."""
        station, offset, turn = self.way.places(center, self.frame, self.frame + self.steps[-1])
        cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
        along, across = 0.5 * (cos * size[0] + sin * size[1]), 0.5 * (sin * size[0] + cos * size[1])
        return station - along, station + along, np.abs(offset) - across - 0.5 * self.way.width_m


def _behind(scene: Scene, agent: int, way: EgoWay, frame: int, at: list[int]) -> Floats:
    """(S,) see `CarefulAhead`."""
    agents = scene.agents
    others = np.flatnonzero(agents.valid[:, frame])
    others = others[others != agent]
    if not len(others):
        return np.full(len(at), -np.inf)
    frames = [frame, *at]
    grid = np.ix_(others, frames)
    poses = np.concatenate([agents.position[grid][..., :2], agents.yaw[grid][..., None]], axis=-1)
    station, offset, turn = way.places(poses, frames[0], frames[-1])
    size = agents.size[others]
    cos, sin = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    along = 0.5 * (cos * size[:, :1] + sin * size[:, 1:2])
    beside = np.abs(offset) - 0.5 * (sin * size[:, :1] + cos * size[:, 1:2]) - 0.5 * way.width_m
    start = way.station[frame] - 0.5 * way.length_m
    follows = (station[:, :1] + along[:, :1] < start) & (beside <= 0.0) & agents.valid[grid]
    return np.asarray(np.where(follows, station + along, -np.inf).max(axis=0)[1:])
