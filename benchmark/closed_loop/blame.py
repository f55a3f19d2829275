"""Whose fault a contact is while a drive goes on, by the rules that it is scored by afterwards."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.closed_loop.following import Ego
from benchmark.closed_loop.riding import Touch
from benchmark.geometry import Bools, Floats
from benchmark.interactions.contacts import KINDS, ContactKind, at_fault
from benchmark.machine.last_made import LastMade
from benchmark.pdm import definition as pdm
from benchmark.pdm.layers import road_of, route_of
from benchmark.pdm.road import Road, Whereabouts, whereabouts
from benchmark.scene import Scene


def _recorded_road(scene: Scene) -> tuple[Floats, Road]:
    line = route_of(scene.ego.pose)
    return line, road_of(scene.road_map, line)


scored_road: Final = LastMade[Scene, tuple[Floats, Road]](_recorded_road, kept=4)
"""(M, 2) recorded route of a scene and the surfaces along it, which all drives of the scene are scored by."""


def unsure_of_its_lane(road: Road, where: Whereabouts) -> Bools:
    """(B, T) whether the ego is in several lanes or off the drivable area; nowhere on a map without road or lanes."""
    return (where.multiple_lanes | where.non_drivable) & bool(road.drivable and road.lanes)


@dataclass(frozen=True, slots=True)
class Blame:
    """Judge of whether a contact is the ego's fault, from the recorded scene with its map. Picklable."""

    scene: Scene

    def __call__(self, contact: Touch, ego: Floats) -> bool:
        """Whether the ego is to blame.

        ``ego`` are (6,) values of `Ego` at the first end of a sub-step that does not come before the contact.
        """
        kind = KINDS[int(contact.pair.kinds[0])]
        return at_fault(kind, kind is ContactKind.LATERAL and self._unsure(Ego.of_row(ego)))

    def _unsure(self, ego: Ego) -> bool:
        _, road = scored_road(self.scene)
        state = np.zeros((1, 1, pdm.STATE_COLUMNS))
        state[0, 0, : pdm.HEADING + 1] = ego.pose
        return bool(unsure_of_its_lane(road, whereabouts(road, state))[0, 0])
