"""Golden files of the PDM sub-scores (plain arrays, plans), and verdicts on them, none of which may differ."""

from itertools import pairwise
from typing import Final

import numpy as np
from shapely.geometry import Polygon

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.pdm.definition import (
    CENTER_AHEAD_M,
    COMFORT_CENTER_AHEAD_M,
    LENGTH_M,
    STATE_COLUMNS,
    STATES,
    WHEELBASE_M,
    WIDTH_M,
)
from benchmark.pdm.plan_motion import build_history_rows, check_comfort, compute_disagreement, score_extended_comfort
from benchmark.pdm.road_polygons import RoadPolygons, SurfaceKind
from benchmark.pdm.scoring import (
    ScoredMotions,
    ScoringContext,
    measure_offsets,
    remove_touching_objects,
    score_against_references,
    score_motions,
    score_recorded_motions,
)
from benchmark.pdm.totals import FILTERED, SubScores
from benchmark.pdm.traffic import KeyFrameObjects, interpolate_traffic
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays

VEHICLE: Final = (LENGTH_M, WIDTH_M, CENTER_AHEAD_M, WHEELBASE_M, WHEELBASE_M, COMFORT_CENTER_AHEAD_M)
"""Length, width, centre ahead, wheelbase of tracker and bicycle, centre ahead inside the comfort terms."""
RECORDED: Final = "recorded"
AGENT_TYPES: Final = 3
"""Types of objects below this move by themselves."""


class PdmGoldenScene:
    """Scene with S samples and P plans for each: (S, P, 6, 3) poses in the frame of the rear axle, (S, 11) car states.

    `history` (S, 4, 8) begins states at -1.5, -1, -0.5 and 0 s; `recorded` is the plan of the recorded future, the
    reference of EP and of the filter. Samples with the same `pair` (S,) are consecutive; `route` is an (M, 2) polyline.
    """

    def __init__(self, stored: GoldenArrays) -> None:
        self.stored = stored
        self.plans = stored.floats("plans", None, None, PLAN_STEPS, 3)
        self.samples, self.count = self.plans.shape[:2]
        vehicle = tuple(stored.floats("vehicle", len(VEHICLE)).tolist())
        if vehicle != VEHICLE:
            raise ValueError(f"it assumes the vehicle {vehicle}; this program uses {VEHICLE}")
        self.now = stored.floats("ego_initial_state", self.samples, STATE_COLUMNS)
        self.history = stored.floats("history_keyframes", self.samples, 4, 8)
        self.recorded = stored.texts("plan_names", self.count).index(RECORDED)
        self.pair = stored.integers("pair", self.samples)
        self.route = stored.floats("centerline", None, 2)
        self.key_frames = self._key_frames()
        self.with_area = stored.verdicts("uses_drivable_area", self.samples)
        self._surfaces = self._read_surfaces()

    def road(self, sample: int) -> RoadPolygons:
        """Surfaces of a sample; some do without the drivable area."""
        area = bool(self.with_area[sample])
        return RoadPolygons.of(
            [surface for surface in self._surfaces if area or surface[0] is not SurfaceKind.DRIVABLE_AREA]
        )

    def by_plan(self, name: str, *shape: int) -> Floats:
        """An official array, (S, P, ...)."""
        return self.stored.floats(name, self.samples, self.count, *shape)

    def flags_by_plan(self, name: str, *shape: int) -> Bools:
        """Official verdicts, (S, P, ...)."""
        return self.stored.verdicts(name, self.samples, self.count, *shape)

    def _key_frames(self) -> KeyFrameObjects:
        stored, frames = self.stored, PLAN_STEPS + 1
        offsets = stored.integers("obj_offset", self.samples + 1)
        count = int(offsets[-1])
        return KeyFrameObjects(
            offsets=offsets,
            box=stored.floats("obj_key_box", count, frames, 3),
            size=stored.floats("obj_size", count, 2),
            annotated=stored.verdicts("obj_key_valid", count, frames),
            velocity=stored.floats("obj_key_velocity", count, frames, 2),
            is_agent=stored.integers("obj_type", count) < AGENT_TYPES,
            number=np.arange(count),
        )

    def _read_surfaces(self) -> list[tuple[SurfaceKind, Polygon, bool]]:
        stored = self.stored
        names, layers = stored.texts("layer_names"), stored.integers("poly_layer", None)
        routed = stored.verdicts("poly_on_route", len(layers))
        points, offsets = stored.floats("ring_xy", None, 2), stored.integers("ring_offset", None)
        owner = stored.integers("ring_poly", len(offsets) - 1)
        is_hole = stored.verdicts("ring_is_hole", len(offsets) - 1)
        rings = [points[start:stop] for start, stop in pairwise(offsets.tolist())]
        shells = {int(owner[ring]): rings[ring] for ring in np.flatnonzero(~is_hole)}
        holes: dict[int, list[Floats]] = {}
        for ring in np.flatnonzero(is_hole):
            holes.setdefault(int(owner[ring]), []).append(rings[ring])
        return [
            (SurfaceKind(names[layer]), Polygon(shells[number], holes.get(number, [])), bool(on_route))
            for number, (layer, on_route) in enumerate(zip(layers.tolist(), routed))
        ]


APART: Final = 5
"""States between the two samples of a pair."""
VERDICTS: Final = ("nc", "dac", "ddc", "ttc", "lk", "hc")


class ModeComparison:
    """Comparison of the verdicts on motions of one kind, ``lqr`` or ``direct``."""

    def __init__(self, comparison: Comparison, scene: PdmGoldenScene, mode: str) -> None:
        self.comparison, self.scene, self.mode = comparison, scene, mode

    def compare(self, states: Floats) -> list[SubScores]:
        """Sub-scores, EP by the reference, of each sample after comparison of all (S, P, 31, 11) motions."""
        scene, sub_scores = self.scene, []
        differences, ec = compute_pair_comfort(scene, states)
        self.comparison.numbers("EC differences", differences, scene.by_plan(f"{self.mode}_ec_rms", 4))
        self.comparison.same("EC", ec, scene.by_plan(f"{self.mode}_ec"))
        for sample in range(scene.samples):
            plans = score_motions(states[sample], np.zeros(scene.count, np.int64), build_surroundings(scene, sample))
            self._compare_events(sample, plans)
            self._compare_sub_scores(sample, plans)
            sub_scores.append(self._compare_totals(sample, plans, ec[sample]))
        return sub_scores

    def _official(self, sample: int, name: str, *shape: int) -> Floats:
        return np.asarray(self.scene.by_plan(f"{self.mode}_{name}", *shape)[sample])

    def _compare_events(self, sample: int, plans: ScoredMotions) -> None:
        """Areas at every state, and every contact with what was made of it."""
        where, flags, same = plans.where, self.scene.flags_by_plan, self.comparison.same
        areas = np.stack([where.multiple_lanes, where.non_drivable, where.oncoming], axis=-1)
        same("areas", areas, flags(f"{self.mode}_areas", STATES, 3)[sample])
        crossing = np.stack([where.center_in_intersection, where.axle_in_intersection], axis=-1)
        same("in intersection", crossing, flags(f"{self.mode}_in_intersection", STATES, 2)[sample])
        for name, events in (("nc", plans.collisions.events), ("ttc", plans.near_misses.events)):
            official = self.scene.stored.integers(f"{self.mode}_{name}_events", None, events.shape[1] + 1)
            theirs = official[official[:, 0] == sample, 1:]
            other = set(map(tuple, events.tolist())) ^ set(map(tuple, theirs.tolist()))
            wrong = np.arange(max(len(events), len(theirs), 1)) < len(other)
            self.comparison.verdicts(f"{name.upper()} events", wrong)

    def _compare_sub_scores(self, sample: int, plans: ScoredMotions) -> None:
        same, numbers, course = self.comparison.same, self.comparison.numbers, plans.course
        for name in VERDICTS:
            same(name.upper(), getattr(plans.scores, name), self._official(sample, name))
        steps = self.scene.stored.integers
        shape = (self.scene.samples, self.scene.count)
        same("collision step", plans.collisions.step, steps(f"{self.mode}_collision_step", *shape)[sample])
        same("TTC step", plans.near_misses.step, steps(f"{self.mode}_ttc_step", *shape)[sample])
        checks = self.scene.flags_by_plan(f"{self.mode}_hc_checks", 6)[sample]
        same("HC tests", check_comfort(plans.extremes), checks)
        numbers("HC extremes", plans.extremes, self._official(sample, "hc_extremes", 6, 2))
        numbers("progress (m)", course.progress_m, self._official(sample, "progress_m"))
        numbers("wrong way (m)", course.wrong_way_m, self._official(sample, "ddc_max_m"))
        apart = measure_offsets(plans.states, self.scene.route)
        numbers("distance from route (m)", apart, self._official(sample, "lk_offset_m", STATES))

    def _compare_totals(self, sample: int, plans: ScoredMotions, ec: Floats) -> SubScores:
        shape, recorded = self.scene.count, self.scene.recorded
        progress_m = np.repeat(plans.course.progress_m[recorded], shape)
        multiplier = np.repeat(plans.scores.multiplier[recorded], shape)
        scores = score_against_references(plans, progress_m, multiplier)
        ours = {
            "reference progress (m)": (progress_m, "reference_progress_m"),
            "reference multiplier": (multiplier, "reference_multiplier"),
            "EP": (scores.ep, "ep"),
            "EP alone": (plans.scores.ep, "ep_alone"),
            "multiplier": (scores.multiplier, "multiplier"),
            "score without EC": (scores.score_without_ec, "score_without_ec"),
            "score without EC, alone": (plans.scores.score_without_ec, "score_without_ec_alone"),
            "score": (scores.score(ec), "score"),
        }
        for name, (values, array) in ours.items():
            self.comparison.numbers(name, values, self._official(sample, array))
        return scores


def compare_filter(comparison: Comparison, scene: PdmGoldenScene, states: Floats, scores: list[SubScores]) -> None:
    """Compare the scores that forgive faults of the recorded driver; motions are (S, P, 31, 11), tracked."""
    ec = compute_pair_comfort(scene, states)[1]
    for sample, ours in enumerate(scores):
        recorded = states[sample, scene.recorded][None]
        human = score_recorded_motions(
            score_motions(recorded, np.zeros(1, np.int64), build_surroundings(scene, sample))
        )
        for name in FILTERED:
            official = scene.stored.floats(f"human_{name}", scene.samples)[sample]
            comparison.verdicts("recorded driver", getattr(human, name) != official)
        filtered = ours.forgive(human.zeros())
        columns = {f"filtered {name}": getattr(filtered, name) for name in FILTERED}
        columns |= {"filtered multiplier": filtered.multiplier, "filtered score": filtered.score(ec[sample])}
        for name, values in columns.items():
            comparison.numbers(name, values, scene.by_plan(name.replace(" ", "_"))[sample])


def compute_pair_comfort(scene: PdmGoldenScene, states: Floats) -> tuple[Floats, Floats]:
    """Differences (S, P, 4) and EC (S, P) of consecutive samples, the same for both."""
    differences = np.zeros((scene.samples, scene.count, 4))
    for number in np.unique(scene.pair):
        earlier, later = np.flatnonzero(scene.pair == number)
        differences[[earlier, later]] = compute_disagreement(states[earlier], states[later], APART)
    return differences, score_extended_comfort(differences)


def build_surroundings(scene: PdmGoldenScene, sample: int) -> ScoringContext:
    """Surroundings that the plans of one sample of a scene are judged by."""
    frames = scene.key_frames
    start, stop = int(frames.offsets[sample]), int(frames.offsets[sample + 1])
    some = slice(start, stop)
    of_sample = KeyFrameObjects(
        np.array([0, stop - start]),
        frames.box[some],
        frames.size[some],
        frames.annotated[some],
        frames.velocity[some],
        frames.is_agent[some],
        frames.number[some],
    )
    now = scene.now[sample][None]
    return ScoringContext(
        now=now,
        history=build_history_rows(scene.history[sample][None]),
        has_history=np.ones(1, np.bool_),
        traffic=remove_touching_objects(interpolate_traffic(of_sample), now),
        road=scene.road(sample),
        route=scene.route,
    )
