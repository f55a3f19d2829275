"""nuPlan's closed-loop terms for whole drives on nuScenes, without what nuScenes lacks.

Score = NC DAC MP DDC (5 P + 5 TTC + 2 C) / 12. Speed limits (SL, weight 4 of 16) are not in nuScenes' maps, and are
left out of sum and weights; the route is the recorded path instead of route blocks. The numbers are not nuPlan's, and
compare only with one another.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import shapely

from benchmark.closed_loop.driven_part import DrivenPart
from benchmark.geometry import Bools, Floats, box_corners
from benchmark.interactions.contacts import AHEAD_RAD, BEHIND_RAD, Pairs, bearing, is_agent
from benchmark.pdm.comfort import comfort_checks, comfort_series, extremes_of
from benchmark.pdm.contacts import STANDING_M_S
from benchmark.pdm.definition import SPEED, STATE_COLUMNS
from benchmark.pdm.road import Road, Whereabouts, footprints, whereabouts
from benchmark.pdm.route import course, direction_compliance
from benchmark.records.drive_schema import NuplanTerms, ScoredContact

LACKS: Final = ("SL (speed limits)", "traffic lights", "route blocks (the route is the recorded path)")
"""What of nuPlan's closed-loop score there is not."""
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
class Progress:
    """Progress along the route, metres.

    ``metres`` is from the first driven instant to the last scored one, ``recorded_m`` the recorded ego's in the
    same time, ``whole_m`` the recorded ego's to the last keyframe of the recording.
    """

    metres: float
    recorded_m: float
    whole_m: float

    @property
    def share(self) -> float | None:
        """Of the recorded way to its end, 0 to 1; ``None`` where the recorded car hardly moves."""
        return float(np.clip(self.metres / self.whole_m, 0.0, 1.0)) if self.whole_m > SHORTEST_M else None

    @property
    def beside_recorded(self) -> float:
        """NuPlan's P."""
        if self.metres < -SHORTEST_M:
            return 0.0
        return min(1.0, max(self.metres, SHORTEST_M) / max(self.recorded_m, SHORTEST_M))


def nuplan_terms(
    part: DrivenPart, road: Road, where: Whereabouts, route: Floats, progress: Progress, contact: ScoredContact | None
) -> NuplanTerms:
    """Terms of nuPlan of the scored part of a drive.

    ``route`` is a (M, 2) polyline; the contact is the one that ended the drive.
    """
    outside = outside_m(part, road)
    off = np.flatnonzero(outside >= OFF_ROAD_M)
    wrong = course(part.states[None], route, where.oncoming, where.center_in_intersection).wrong_way_m
    least = least_ttc(part, where)
    blamed = contact is not None and contact.at_fault
    share = progress.beside_recorded
    nc, dac, mp = no_collision(contact), 0.0 if len(off) else 1.0, float(share >= LEAST_PROGRESS)
    ddc = float(direction_compliance(wrong)[0])
    p, ttc, c = share, float(least > TTC_S and not blamed), comfort(part.states)
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


def no_collision(contact: ScoredContact | None) -> float:
    """NC of a drive that ends at a contact, if at all; contacts that did not end it do not count."""
    if contact is None or not contact.at_fault:
        return 1.0
    return 0.0 if is_agent(contact.category) else 0.5


def comfort(states: Floats) -> float | None:
    """1 where all six series of (F, 11) states stay inside their bounds, else 0.

    ``None`` of fewer than 15 instants.
    """
    if len(states) < _COMFORT_INSTANTS:
        return None
    series = comfort_series(states[None], np.zeros((1, 0, STATE_COLUMNS)))
    return float(comfort_checks(extremes_of(series)).all())


def outside_m(part: DrivenPart, road: Road) -> Floats:
    """(F,) how far the corner that is farthest outside the drivable area is outside it, metres; 0 inside."""
    corners = box_corners(footprints(part.states))
    surface = shapely.union_all(road.drivable)
    shapely.prepare(surface)
    points = shapely.points(corners)
    away = np.zeros(corners.shape[:-1])
    beyond = ~shapely.covers(surface, points)
    away[beyond] = shapely.distance(surface, points[beyond])
    return np.asarray(away.max(axis=-1))


def least_ttc(part: DrivenPart, where: Whereabouts) -> float:
    """The smallest time to collision of all instants, infinite above 2.9 s.

    Both go on as they are; any object ahead counts, and where the ego is in several lanes, off the road or in an
    intersection any that is not behind. An object touched at an instant can no longer be hit.
    """
    boxes, speed = footprints(part.states), part.states[:, SPEED]
    agents = np.array([is_agent(category) for category in part.scene.agents.categories], np.bool_)
    near = _near(part, boxes, speed)
    who, when = np.nonzero(near)
    if not len(who):
        return float("inf")
    pairs = Pairs(boxes[when], speed[when], part.boxes[who, when], part.velocity[who, when], agents[who])
    angle = bearing(pairs.ego, pairs.other)
    unsure = (where.multiple_lanes | where.non_drivable | where.axle_in_intersection)[0, when]
    counts = ((angle < AHEAD_RAD) | (unsure & (angle <= BEHIND_RAD))) & (pairs.gap > 0.0)
    return float(np.where(counts, pairs.time_to_contact_nuplan, np.inf).min())


def _near(part: DrivenPart, boxes: Floats, speed: Floats) -> Bools:
    """(N, F) who could touch the ego within 3 s."""
    reach = 0.5 * (np.hypot(boxes[:, 2], boxes[:, 3]) + np.hypot(part.boxes[..., 2], part.boxes[..., 3]))
    closing = LONGEST_TTC_S * (np.abs(speed) + np.hypot(part.velocity[..., 0], part.velocity[..., 1]))
    offset = part.boxes[..., :2] - boxes[:, :2]
    near = np.hypot(offset[..., 0], offset[..., 1]) <= reach + closing
    return np.asarray(part.present & near & (speed >= STANDING_M_S))


def places_on(road: Road, part: DrivenPart) -> Whereabouts:
    """Where the ego is on the road, (1, F) each."""
    return whereabouts(road, part.states[None])
