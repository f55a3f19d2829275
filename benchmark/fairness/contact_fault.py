"""Whose fault a contact on a map is: roads and handedness of the place, and ``fault@1`` as records hold it."""

from typing import Final

import numpy as np

from benchmark.fairness.fault_definition import WINDOW_S, ContactTracks, FaultAttribution, RoadUser
from benchmark.fairness.fault_roads import FaultRoads, find_handedness
from benchmark.fairness.fault_rules import attribute_fault, rule_on_contact
from benchmark.geometry import Floats
from benchmark.interactions.tracks import STEP_S, ContinuousTracks
from benchmark.machine.identity_cache import IdentityCache
from benchmark.records.fault import UNTIMED_REASONS, StoredFault
from benchmark.road_map import Handedness, RoadMap
from benchmark.scene import Scene

_DECIMALS: Final = 3
_STEPS: Final = round(WINDOW_S / STEP_S)


def _read_place(road_map: RoadMap, driving_side: Handedness | None) -> tuple[FaultRoads, Handedness]:
    roads = FaultRoads.of(road_map)
    return roads, find_handedness(road_map.location, roads, driving_side)


_load_place: Final = IdentityCache[RoadMap, tuple[FaultRoads, Handedness]](_read_place, kept=4)


def load_roads(scene: Scene) -> FaultRoads:
    """The roads of a scene as attribution sees them."""
    return _load_place(scene.road_map, scene.driving_side)[0]


def judge_contact(scene: Scene, tracks: ContactTracks) -> FaultAttribution:
    """Whose fault a contact is on the map of a scene, which may be empty; `attribute_fault` says what tracks are."""
    return attribute_fault(tracks, *_load_place(scene.road_map, scene.driving_side))


def attribute_contact(scene: Scene, tracks: ContactTracks) -> StoredFault:
    """`judge_contact` as records hold it: of who alone is to blame, when it came into the other's way."""
    ruling, *users = rule_on_contact(tracks, *_load_place(scene.road_map, scene.driving_side))
    times: tuple[float | None, float | None] = (None, None)
    if len(ruling.blamed) == 1 and ruling.reason not in UNTIMED_REASONS:
        facts = users[min(ruling.blamed)].facts()
        times = facts.entry_s, facts.time_left_s
    return StoredFault(
        verdict=ruling.verdict,
        reason=ruling.reason,
        **{
            name: None if value is None or not np.isfinite(value) else round(value, _DECIMALS)
            for name, value in zip(("entry_s", "time_left_s"), times, strict=True)
        },
    )


def make_contact_grid(contact_s: float, first_s: float) -> Floats:
    """(N,) seconds every 0.1 s up to a contact, 5 s at most, from the time on at which both are known."""
    count = min(_STEPS, int(np.floor((contact_s - first_s) / STEP_S + 1e-6)))
    return contact_s - STEP_S * np.arange(count, -1, -1)


def trace_recorded_contact(tracks: ContinuousTracks, agent: int, contact_s: float) -> ContactTracks:
    """The ego of a recording and an agent every 0.1 s up to their contact, while the agent was there, 5 s at most."""
    frames = np.flatnonzero(tracks.seconds <= contact_s)
    absent = frames[~tracks.valid[agent, frames]]
    first = int(absent[-1]) + 1 if len(absent) else 0
    grid = make_contact_grid(contact_s, min(float(tracks.seconds[min(first, frames[-1])]), contact_s))
    boxes = tracks.ego_at(grid), tracks.only([agent]).agents_at(grid)[0][0]
    categories = "vehicle.car", tracks.categories[agent]
    ego, other = (
        RoadUser.resampled(category, (float(box[-1, 2]), float(box[-1, 3])), grid, box[:, [0, 1, 4]], grid)
        for category, box in zip(categories, boxes, strict=True)
    )
    return ContactTracks(grid, ego, other)
