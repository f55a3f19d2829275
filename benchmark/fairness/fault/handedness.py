"""The side of the road that traffic keeps to: as given, from the directions of lanes, or from the place."""

from typing import Final

import numpy as np

from benchmark.fairness.fault.definition import ONCOMING_RAD, angle_between
from benchmark.fairness.fault.roads import FaultRoads
from benchmark.road_map import Handedness

BESIDE_M: Final = 15.0
"""Centre lines of oncoming lanes of one road are at most so far apart."""


def find_handedness(location: str, roads: FaultRoads | None, given: Handedness | None = None) -> Handedness:
    """As given, else by its lanes, else by the name of the place; right where nothing tells.

    Lanes come before names: maps that are no city's go by the names of cities, since official code opens no others.
    """
    known = given or (None if roads is None else derive_handedness(roads))
    return known or Handedness.of_location(location) or Handedness.RIGHT


def derive_handedness(roads: FaultRoads) -> Handedness | None:
    """By the side on which lanes have the nearest oncoming lane; ``None`` where as many say left as right."""
    votes = 0
    for lane in np.flatnonzero(~roads.is_junction).tolist():
        middle = roads.lines[lane][len(roads.lines[lane]) // 2][None]
        heading = roads.headings[roads.first[lane] + (len(roads.lines[lane]) - 1) // 2]
        places = roads.locate(middle, roads.near(middle, BESIDE_M))
        oncoming = angle_between(places.heading[0], heading) >= ONCOMING_RAD
        apart = np.where(oncoming & ~places.beyond[0] & ~roads.is_junction[places.lanes], places.distance[0], np.inf)
        nearest = int(apart.argmin())
        if apart[nearest] <= BESIDE_M:
            votes += int(np.sign(places.offset[0, nearest]))
    return None if votes == 0 else Handedness.RIGHT if votes > 0 else Handedness.LEFT
