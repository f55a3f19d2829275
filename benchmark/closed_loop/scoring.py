"""The main path of scoring: a scene and a drive in, contact, fault, nuPlan's terms and HD-Score out.

No planner, no engine. HUGSIM's HD-Score has terms of our own, so that the number is not HUGSIM's; nuPlan's terms go
without what nuScenes lacks; fault during an episode is told by the same rules as in later scoring.
"""

import math
from collections import ChainMap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
import shapely

from benchmark.closed_loop.episodes import Episode
from benchmark.closed_loop.fault_attribution import is_lane_ambiguous, load_scored_road, trace_contact
from benchmark.closed_loop.nuplan import DrivenPart
from benchmark.closed_loop.route import Route, build_driven_scene, hold_last_frame
from benchmark.closed_loop.simulation_state import SUBSTEPS, CollisionEvent
from benchmark.constants import PLAN_STEPS
from benchmark.fairness.contact_fault import attribute_contact
from benchmark.geometry import Bools, Floats, box_corners
from benchmark.interactions.contacts import (
    AHEAD_RAD,
    BEHIND_RAD,
    KINDS,
    ContactPairs,
    compute_bearing,
    compute_delta_v,
    is_agent_category,
    is_at_fault,
    mass_kg,
)
from benchmark.machine.extension import call_installed
from benchmark.pdm.collision_scores import STANDING_M_S
from benchmark.pdm.definition import SPEED, STATE_COLUMNS
from benchmark.pdm.plan_motion import check_comfort, compute_comfort_series, compute_extremes
from benchmark.pdm.plan_scoring import score_scene_plans
from benchmark.pdm.road_polygons import (
    RoadPolygons,
    RoadPositions,
    compute_footprints,
    locate_on_road,
)
from benchmark.pdm.scoring import measure_along_route, score_direction_compliance
from benchmark.planning import Plan
from benchmark.records.drive_schema import HdScore, NuplanTerms, ScoredContact
from benchmark.records.fault import StoredFault
from benchmark.scene import Scene

LACKS: Final = ("SL (speed limits)", "traffic lights", "route blocks (the route is the recorded path)")
"""Parts of nuPlan's closed-loop score that are not implemented."""
OFF_ROAD_M: Final = 0.3
"""A corner this far outside the drivable area is off the road."""
LEAST_PROGRESS: Final = 0.2
"""Below this share of the recorded way the score is 0 (MP)."""
SHORTEST_M: Final = 2.0
"""Progress is never compared over less."""
TTC_S: Final = 0.95
LONGEST_TTC_S: Final = 3.0
_COMFORT_INSTANTS: Final = 15
"""The longest window of the smoothing filters; a shorter drive has no comfort."""
_WEIGHTS: Final = (5.0, 5.0, 2.0)


@dataclass(frozen=True, slots=True)
class RouteProgress:
    """Progress along the route from the first driven instant to the last scored one, metres.

    ``recorded_m`` is the recorded ego's in the same time, ``whole_m`` to the last keyframe of the recording, or of
    the window.
    """

    metres: float
    recorded_m: float
    whole_m: float

    @property
    def share(self) -> float | None:
        """Of the recorded way to its end, 0 to 1; ``None`` where the recorded car hardly moves."""
        return float(np.clip(self.metres / self.whole_m, 0.0, 1.0)) if self.whole_m > SHORTEST_M else None

    @property
    def relative_to_recorded(self) -> float:
        """NuPlan's P."""
        if self.metres < -SHORTEST_M:
            return 0.0
        return min(1.0, max(self.metres, SHORTEST_M) / max(self.recorded_m, SHORTEST_M))


def compute_nuplan_terms(
    part: DrivenPart,
    road: RoadPolygons,
    where: RoadPositions,
    route: Floats,
    progress: RouteProgress,
    contact: ScoredContact | None,
) -> NuplanTerms:
    """Terms of nuPlan of the scored part of a drive, along a (M, 2) route, up to the contact that ended it.

    ``contact`` is the first that is the ego's fault by nuPlan's rule, else any other.
    """
    outside = measure_outside_m(part, road)
    off = np.flatnonzero(outside >= OFF_ROAD_M)
    wrong = measure_along_route(part.states[None], route, where.oncoming, where.center_in_intersection).wrong_way_m
    least = float(compute_ttc(part, where).min())
    is_at_fault = contact is not None and contact.at_fault
    share = progress.relative_to_recorded
    nc, dac, mp = compute_no_collision(contact), 0.0 if len(off) else 1.0, float(share >= LEAST_PROGRESS)
    ddc = float(score_direction_compliance(wrong)[0])
    p, ttc, c = share, float(least > TTC_S and not is_at_fault), compute_comfort(part.states)
    return NuplanTerms(
        score=nuplan_score((nc, dac, mp, ddc), (p, ttc, c)),
        nc=nc,
        dac=dac,
        mp=mp,
        ddc=ddc,
        p=p,
        ttc=ttc,
        c=c,
        off_road_s=float((part.times_us[off[0]] - part.times_us[0]) * 1e-6) if len(off) else None,
        least_ttc_s=float(least) if np.isfinite(least) else None,
    )


def nuplan_score(multipliers: Sequence[float], parts: tuple[float, float, float | None]) -> float:
    """The product of the weighted mean of P, TTC and C, which counts as 1 where it is ``None``, and of multipliers."""
    known = [1.0 if part is None else part for part in parts]
    mean = sum(weight * part for weight, part in zip(_WEIGHTS, known, strict=True)) / sum(_WEIGHTS)
    return math.prod(multipliers) * mean


def compute_no_collision(contact: ScoredContact | None) -> float:
    """NC of a drive, given its first contact that is the ego's fault by nuPlan's rule; else any other or none."""
    if contact is None or not contact.at_fault:
        return 1.0
    return 0.0 if is_agent_category(contact.category) else 0.5


def compute_comfort(states: Floats) -> float | None:
    """1 where all six series of (F, 11) states stay inside their bounds, else 0; ``None`` of fewer than 15 instants."""
    if len(states) < _COMFORT_INSTANTS:
        return None
    series = compute_comfort_series(states[None], np.zeros((1, 0, STATE_COLUMNS)))
    return float(check_comfort(compute_extremes(series)).all())


def measure_outside_m(part: DrivenPart, road: RoadPolygons) -> Floats:
    """(F,) how far the corner that is farthest outside the drivable area is outside it, metres; 0 inside."""
    corners = box_corners(compute_footprints(part.states))
    surface = shapely.union_all(road.drivable)
    shapely.prepare(surface)
    points = shapely.points(corners)
    away = np.zeros(corners.shape[:-1])
    beyond = ~shapely.covers(surface, points)
    away[beyond] = shapely.distance(surface, points[beyond])
    return np.asarray(away.max(axis=-1))


def compute_ttc(part: DrivenPart, where: RoadPositions) -> Floats:
    """(F,) time to collision at each instant, infinite above 2.9 s.

    Both go on as they are; any object ahead counts, and where the ego is in several lanes, off the road or in an
    intersection any that is not behind. An object touched at an instant can no longer be hit.
    """
    boxes, speed = compute_footprints(part.states), part.states[:, SPEED]
    agents = np.array([is_agent_category(category) for category in part.scene.agents.categories], np.bool_)
    agent_rows, instants = np.nonzero(_find_near(part, boxes, speed))
    least = np.full(len(speed), np.inf)
    if not len(agent_rows):
        return least
    pairs = ContactPairs(
        boxes[instants],
        speed[instants],
        part.boxes[agent_rows, instants],
        part.velocity[agent_rows, instants],
        agents[agent_rows],
    )
    angle = compute_bearing(pairs.ego, pairs.other)
    unsure = (where.multiple_lanes | where.non_drivable | where.axle_in_intersection)[0, instants]
    counts = ((angle < AHEAD_RAD) | (unsure & (angle <= BEHIND_RAD))) & (pairs.gap > 0.0)
    np.minimum.at(least, instants, np.where(counts, pairs.time_to_contact_nuplan, np.inf))
    return least


def _find_near(part: DrivenPart, boxes: Floats, speed: Floats) -> Bools:
    """(N, F) who could touch the ego within 3 s."""
    reach = 0.5 * (np.hypot(boxes[:, 2], boxes[:, 3]) + np.hypot(part.boxes[..., 2], part.boxes[..., 3]))
    closing = LONGEST_TTC_S * (np.abs(speed) + np.hypot(part.velocity[..., 0], part.velocity[..., 1]))
    offset = part.boxes[..., :2] - boxes[:, :2]
    near = np.hypot(offset[..., 0], offset[..., 1]) <= reach + closing
    return np.asarray(part.present & near & (speed >= STANDING_M_S))


def locate_segment(road: RoadPolygons, part: DrivenPart) -> RoadPositions:
    """Where the ego is on the road, (1, F) each."""
    return locate_on_road(road, part.states[None])


NOT_HUGSIM: Final = "HD-Score's formula with our terms; not comparable to HUGSIM's"
COMPLETE_AT: Final = 0.9
"""Of the recorded poses, from which on the route is complete."""


def compute_hd_score(scene: Scene, route: Route, drive: Episode) -> HdScore | None:
    """Score a drive that did not fail; ``None`` where the map has no road or no lanes."""
    driven = hold_last_frame(build_driven_scene(scene, route, drive.motion), PLAN_STEPS)
    first = int(np.searchsorted(scene.timestamps_us[scene.keyframes], drive.motion.times_us[0]))
    plans: list[Plan | None] = [None] * len(driven.keyframes)
    for tick in range(drive.primed - 1, len(drive.plans)):
        plans[first + tick] = drive.plans[tick]
    judged = [verdict for verdict in score_scene_plans(driven, plans) if verdict is not None]
    if not judged:
        return None
    terms = [
        scores.nc * scores.dac * (5 * scores.ttc + 2 * (1.0 if scores.hc is None else scores.hc)) / 7
        for scores in judged
    ]
    mean, completed = float(np.mean(terms)), compute_completed_share(scene, drive, first)
    return HdScore(score=mean * completed, plans=mean, completed=completed)


def compute_completed_share(scene: Scene, drive: Episode, first: int) -> float:
    """The farthest recorded pose that the ego came nearest to, among those from the first driven instant on.

    ``first`` is the keyframe of the first planning instant.
    """
    start, end = first + drive.primed - 1, None if drive.window is None else drive.window.end + 1
    recorded = scene.ego.pose[scene.keyframes[start:end], :2]
    driven = drive.motion.ego[drive.motion.ticks[drive.primed - 1 :], :2]
    nearest = np.hypot(*(driven[:, None] - recorded[None]).transpose(2, 0, 1)).argmin(axis=1)
    return float(min(1.0, (nearest.max() + 1) / (COMPLETE_AT * len(recorded))))


def score_collision(
    scene: Scene,
    touch: CollisionEvent,
    start_us: int,
    *,
    unsure: bool,
    adversaries: Collection[str] = (),
    fault: StoredFault | None = None,
) -> ScoredContact:
    """A contact in numbers; ``start_us`` is the first driven instant.

    ``unsure`` is an ego in several lanes or off the drivable area, which by nuPlan's rule makes a lateral contact its
    fault; ``adversaries`` are those of this drive alone.
    """
    pair = touch.pair
    kind = KINDS[int(pair.kinds[0])]
    impact = pair.impact_speed
    own, others = compute_delta_v(impact, np.array([mass_kg(touch.category)]))
    return ScoredContact(
        seconds=(touch.time_us - start_us) * 1e-6,
        agent=touch.uuid,
        category=touch.category,
        adversary=touch.uuid in scene.adversaries or touch.uuid in adversaries,
        kind=kind.value,
        at_fault=is_at_fault(kind, unsure),
        impact_speed=float(impact[0]),
        delta_v_ego=float(own[0]),
        delta_v_other=float(others[0]),
        fault=fault,
    )


VERSION: Final = 2
"""Raised whenever a score of an unchanged drive would change."""


@dataclass(frozen=True, slots=True)
class EpisodeScores:
    """Scores of one drive.

    ``comfortable`` says if all of it is within nuPlan's bounds, ``None`` of less than 1.5 s; ``nuplan`` and ``hd`` are
    ``None`` where the map has no road or no lanes, and of NeuroNCAP's engine. ``contact`` ended it, ``passed`` ones did
    not. ``ttc_s`` is the smallest time to collision of each half second driven in a window, infinite above 2.9 s.
    ``further`` are parts of scores of extensions, by score.
    """

    contact: ScoredContact | None
    progress: RouteProgress
    comfortable: float | None
    nuplan: NuplanTerms | None
    hd: HdScore | None
    passed: tuple[ScoredContact, ...] = ()
    ttc_s: tuple[float, ...] = ()
    further: Mapping[str, Mapping[str, float | None]] = field(default_factory=dict)


def score_episode(scene: Scene, drive: Episode) -> EpisodeScores:
    """Score a drive that did not fail, in the recorded scene with its map.

    A drive that has NeuroNCAP's own scores has no score of another formula.
    """
    part, route = DrivenPart.of(scene, drive), Route.of(scene)
    line, road = load_scored_road(scene)
    where = locate_segment(road, part)
    known = bool(road.drivable and road.lanes)
    unsure = is_lane_ambiguous(road, where)[0]
    pursuers = [] if drive.adversary is None else [scene.agents.ids[drive.adversary.agent]]
    pursuers += [] if drive.window is None else drive.window.adversaries

    def scored_touch(touch: CollisionEvent) -> ScoredContact:
        at = min(int(np.searchsorted(part.times_us, touch.time_us)), len(unsure) - 1)
        start_us = int(part.times_us[0])
        fault = attribute_contact(scene, trace_contact(drive.motion, touch))
        return score_collision(scene, touch, start_us, unsure=bool(unsure[at]), adversaries=pursuers, fault=fault)

    contact = None if drive.touch is None else scored_touch(drive.touch)
    passed = tuple(scored_touch(touch) for touch in drive.passed)
    by_nuplan = next((touch for touch in (*passed, contact) if touch is not None and touch.at_fault), contact)
    progress = measure_progress(route, part, None if drive.window is None else drive.window.end)
    scored = known and drive.neuroncap is None
    return EpisodeScores(
        contact=contact,
        progress=progress,
        comfortable=compute_comfort(part.states),
        nuplan=compute_nuplan_terms(part, road, where, line, progress, by_nuplan) if scored else None,
        hd=compute_hd_score(scene, route, drive) if scored else None,
        passed=passed,
        ttc_s=() if drive.window is None else _reduce_by_tick(compute_ttc(part, where)),
        further=dict(ChainMap(*call_installed("drive score", scene, drive))),
    )


def _reduce_by_tick(ttc: Floats) -> tuple[float, ...]:
    """The smallest of each half second, the last of which may be short."""
    return tuple(np.minimum.reduceat(ttc, np.arange(0, len(ttc), SUBSTEPS)).tolist())


def measure_progress(route: Route, part: DrivenPart, last_keyframe: int | None = None) -> RouteProgress:
    """How far along the route a drive came; ``last_keyframe`` is where its window ends, by default the recording's."""
    station = route.place(part.states[0]).station
    near = station
    for state in part.states[1::5]:
        near = route.place(state, near).station
    end = route.place(part.states[-1], near).station
    first, last = (route.seconds_of(int(part.times_us[at])) for at in (0, -1))
    recorded = route.recorded_station(last) - route.recorded_station(first)
    over = float(route.step_seconds[-1 if last_keyframe is None else last_keyframe])
    full_length = route.recorded_station(over) - route.recorded_station(first)
    return RouteProgress(end - station, recorded, full_length)
