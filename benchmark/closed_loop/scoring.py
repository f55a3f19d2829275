"""The main path of scoring: a scene and a drive in, everything that is said of it out; no planner, no engine."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.closed_loop.blame import scored_road, unsure_of_its_lane
from benchmark.closed_loop.driven_part import DrivenPart
from benchmark.closed_loop.driving import Drive
from benchmark.closed_loop.hd_score import hd_score
from benchmark.closed_loop.nuplan import Progress, comfort, nuplan_terms, places_on
from benchmark.closed_loop.riding import Touch
from benchmark.closed_loop.route import Route
from benchmark.closed_loop.scored_contact import scored_contact
from benchmark.records.drive_schema import HdScore, NuplanTerms, ScoredContact
from benchmark.scene import Scene

VERSION: Final = 1
"""Raised whenever a score of an unchanged drive would change."""


@dataclass(frozen=True, slots=True)
class DriveScores:
    """Scores of one drive.

    Attributes:
        contact: The contact that ended it.
        comfortable: Whether the whole drive is within nuPlan's bounds; ``None`` of less than 1.5 s.
        nuplan: nuPlan's terms; ``None`` where the map has no road or no lanes, and of NeuroNCAP's engine.
        hd: HD-Score; ``None`` likewise.
        passed: Contacts before that did not end it.
    """

    contact: ScoredContact | None
    progress: Progress
    comfortable: float | None
    nuplan: NuplanTerms | None
    hd: HdScore | None
    passed: tuple[ScoredContact, ...] = ()


def score_drive(scene: Scene, drive: Drive) -> DriveScores:
    """Score a drive that did not fail, in the recorded scene with its map.

    NeuroNCAP's own scores are in the drive, and a drive that has them has no score of another formula.
    """
    part, route = DrivenPart.of(scene, drive), Route.of(scene)
    line, road = scored_road(scene)
    where = places_on(road, part)
    known = bool(road.drivable and road.lanes)
    unsure = unsure_of_its_lane(road, where)[0]
    pursuer = None if drive.adversary is None else drive.adversary.agent

    def scored_touch(touch: Touch) -> ScoredContact:
        at = min(int(np.searchsorted(part.times_us, touch.time_us)), len(unsure) - 1)
        start_us = int(part.times_us[0])
        return scored_contact(scene, touch, start_us, unsure=bool(unsure[at]), adversary=pursuer)

    contact = None if drive.touch is None else scored_touch(drive.touch)
    progress = progress_of(route, part)
    scored = known and drive.neuroncap is None
    return DriveScores(
        contact=contact,
        progress=progress,
        comfortable=comfort(part.states),
        nuplan=nuplan_terms(part, road, where, line, progress, contact) if scored else None,
        hd=hd_score(scene, route, drive) if scored else None,
        passed=tuple(scored_touch(touch) for touch in drive.passed),
    )


def progress_of(route: Route, part: DrivenPart) -> Progress:
    """How far along the route a drive came."""
    station = route.place(part.states[0]).station
    near = station
    for state in part.states[1::5]:
        near = route.place(state, near).station
    end = route.place(part.states[-1], near).station
    first, last = (route.seconds_of(int(part.times_us[at])) for at in (0, -1))
    recorded = route.recorded_station(last) - route.recorded_station(first)
    whole = route.recorded_station(float(route.step_seconds[-1])) - route.recorded_station(first)
    return Progress(end - station, recorded, whole)
