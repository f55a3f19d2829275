"""Whose fault a contact of a drive is: while the drive lasts, and when it is scored, by the same rules."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.closed_loop.simulation_state import SPEED, YAW, CollisionEvent, EpisodeMotion
from benchmark.closed_loop.world_state import compute_ego_boxes
from benchmark.fairness.contact_fault import attribute_contact, make_contact_grid
from benchmark.fairness.fault_definition import ContactTracks, RoadUser
from benchmark.geometry import Bools, Floats
from benchmark.interactions.contacts import KINDS, ContactKind, is_at_fault
from benchmark.machine.identity_cache import IdentityCache
from benchmark.pdm import definition as pdm
from benchmark.pdm.road_polygons import (
    RoadPolygons,
    RoadPositions,
    build_road_polygons,
    build_route,
    locate_on_road,
)
from benchmark.records.drive_schema import StopCondition
from benchmark.records.fault import blames_ego
from benchmark.scene import Scene

_POSE: Final = (0, 1, 4)
"""Columns of a box."""


def _read_recorded_road(scene: Scene) -> tuple[Floats, RoadPolygons]:
    line = build_route(scene.ego.pose)
    return line, build_road_polygons(scene.road_map, line)


load_scored_road: Final = IdentityCache[Scene, tuple[Floats, RoadPolygons]](_read_recorded_road, kept=4)
"""(M, 2) recorded route of a scene and the surfaces along it, which all drives of the scene are scored by."""


def is_lane_ambiguous(road: RoadPolygons, where: RoadPositions) -> Bools:
    """(B, T) whether the ego is in several lanes or off the drivable area; nowhere on a map without road or lanes."""
    return (where.multiple_lanes | where.non_drivable) & bool(road.drivable and road.lanes)


def trace_contact(motion: EpisodeMotion, touch: CollisionEvent) -> ContactTracks:
    """Ego and other of a contact every 0.1 s up to it, for as long as the other was there, 5 s at most."""
    before = int(np.searchsorted(motion.times_us, touch.time_us))
    absent = np.flatnonzero(~motion.present[touch.agent, :before])
    rows = slice(int(absent[-1]) + 1 if len(absent) else 0, before)
    times = np.append(motion.times_us[rows], touch.time_us) * 1e-6 - touch.time_us * 1e-6
    grid = make_contact_grid(0.0, float(times[0]))
    boxes = compute_ego_boxes(motion.ego[rows])
    other = np.column_stack([motion.position[touch.agent, rows, :2], motion.yaw[touch.agent, rows]])

    def user(category: str, poses: Floats, at_contact: Floats, speed: Floats | None = None) -> RoadUser:
        size = float(at_contact[2]), float(at_contact[3])
        return RoadUser.resampled(category, size, times, np.vstack([poses, at_contact[[*_POSE]]]), grid, speed)

    return ContactTracks(
        grid,
        user("vehicle.car", boxes[:, _POSE], touch.ego, np.append(motion.ego[rows, SPEED], touch.ego_speed)),
        user(touch.category, other, touch.other),
    )


@dataclass(frozen=True, slots=True)
class EpisodeFaultAttribution:
    """Judge of whether a contact is the ego's fault, from the recorded scene with its map. Picklable.

    ``until`` is what ends the drive: ``fault@1``, or ``fault@nuplan``, which older records call ``fault``.
    """

    scene: Scene
    until: StopCondition

    def __call__(self, contact: CollisionEvent, motion: EpisodeMotion) -> bool:
        """Whether the ego is at fault; the motion goes on to the end of the step of the contact."""
        if self.until == "fault@1":
            return blames_ego(attribute_contact(self.scene, trace_contact(motion, contact))) is True
        kind = KINDS[int(contact.pair.kinds[0])]
        return is_at_fault(kind, kind is ContactKind.LATERAL and self._is_lane_ambiguous(contact, motion))

    def _is_lane_ambiguous(self, contact: CollisionEvent, motion: EpisodeMotion) -> bool:
        """At the first instant that does not come before the contact."""
        _, road = load_scored_road(self.scene)
        state = np.zeros((1, 1, pdm.STATE_COLUMNS))
        at = min(int(np.searchsorted(motion.times_us, contact.time_us)), len(motion.times_us) - 1)
        state[0, 0, : pdm.HEADING + 1] = motion.ego[at, : YAW + 1]
        return bool(is_lane_ambiguous(road, locate_on_road(road, state))[0, 0])
