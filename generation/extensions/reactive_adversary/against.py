"""A planning frame in closed loop: as in open loop, but that it is fair by what a careful human survives."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from benchmark.dynamics.bicycle import SimulatedMotion
from benchmark.geometry import Floats
from benchmark.road_map import DrivableRaster
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.careful import careful_ahead
from generation.search.planning import Planning
from generation.search.scoring import Surroundings, Terms, surroundings

HIT_WEIGHT: Final = 20.0
"""Of a candidate that a careful human does not survive: more than any threat is worth."""
MET_WEIGHT: Final = 5.0
"""Of one that a careful human survives and that an ego that does not react runs into."""

FOLLOW_WEIGHT: Final = 1.0
FOLLOW_MOST_M: Final = 20.0
"""A metre that is missing to stop behind the ego, and how many count."""


@dataclass(frozen=True, slots=True)
class PlanningAgainst(Planning):
    """Planning frames of an adversary that the ego may run into."""

    def around(self, frames: tuple[int, ...], raster: DrivableRaster) -> Surroundings:
        """All but the ego: what it survives is asked of a careful human in its place."""
        found = surroundings(self.scene, self.agent, frames, raster)
        present = found.present.copy()
        present[:, -1] = False
        return replace(found, present=present)

    def rated(self, frame: int, offsets: tuple[int, ...], track: Floats) -> Callable[[SimulatedMotion], Terms]:
        """As in open loop, and what is not survivable costs."""
        rate = Planning.rated(self, frame, offsets, track)
        careful = careful_ahead(self.scene, self.agent, frame, ego_speed(self.scene, frame))
        size = self.scene.agents.size[self.agent, :2]

        def rated(motion: SimulatedMotion) -> Terms:
            terms = rate(motion)
            placed = careful.placed(motion, size)
            hit = careful.hits(placed)
            follows = FOLLOW_WEIGHT * np.minimum(careful.lacking(placed), FOLLOW_MOST_M)
            more = HIT_WEIGHT * hit - MET_WEIGHT * (careful.met(placed) & ~hit) + follows
            return replace(terms, further=more if terms.further is None else terms.further + more)

        return rated


def ego_speed(scene: Scene, frame: int) -> float:
    """Speed of the ego at a frame, m/s, of its places around it."""
    first, last = max(frame - 2, 0), min(frame + 1, len(scene.timestamps_us) - 1)
    way = np.hypot(*(scene.ego.position[last, :2] - scene.ego.position[first, :2]))
    return float(way) / max(float(scene.seconds[last] - scene.seconds[first]), 1e-9)
