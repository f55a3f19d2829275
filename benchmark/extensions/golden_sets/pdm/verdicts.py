"""Verdicts and scores of given motions against those of the official code; no verdict may differ."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.extensions.golden_sets.pdm.golden_set import GoldenScene
from benchmark.geometry import Floats
from benchmark.pdm.comfort import comfort_checks, disagreement, extended_comfort, history_rows
from benchmark.pdm.definition import STATES
from benchmark.pdm.route import offsets
from benchmark.pdm.scoring import Judged, Surroundings, beside, human_scores, judged, log_replay
from benchmark.pdm.totals import FILTERED, SubScores
from benchmark.pdm.traffic import KeyFrames, at_states
from benchmark.verification.checks import Comparison

APART: Final = 5
"""States between the two samples of a pair."""
TOLERANCE, EXTREMES_TOLERANCE = 1e-8, 2e-8
VERDICTS: Final = ("nc", "dac", "ddc", "ttc", "lk", "hc")


class ModeComparison:
    """Compares what is said of motions of one kind.

    Attributes:
        comparison: Gathers the errors.
        scene: The golden scene.
        mode: ``lqr`` or ``direct``: whose official answers.
        label: What the checks are called by.
    """

    def __init__(self, comparison: Comparison, scene: GoldenScene, mode: str, label: str) -> None:
        self.comparison, self.scene, self.mode, self.label = comparison, scene, mode, label

    def compare(self, states: Floats) -> list[SubScores]:
        """Compare all plans of all samples.

        Args:
            states: (S, P, 31, 11) the motions.

        Returns:
            The sub-scores of each sample's plans, EP by the reference.
        """
        scene, found = self.scene, []
        differences, ec = comfort_of_pairs(scene, states)
        self._numbers("EC differences", differences, scene.by_plan(f"{self.mode}_ec_rms", 4))
        self._verdicts("EC", ec, scene.by_plan(f"{self.mode}_ec"))
        for sample in range(scene.samples):
            plans = judged(states[sample], np.zeros(scene.count, np.int64), surroundings(scene, sample))
            self._events(sample, plans)
            self._sub_scores(sample, plans)
            found.append(self._totals(sample, plans, ec[sample]))
        return found

    def _official(self, sample: int, name: str, *shape: int) -> Floats:
        return np.asarray(self.scene.by_plan(f"{self.mode}_{name}", *shape)[sample])

    def _numbers(self, name: str, ours: Floats, theirs: Floats, tolerance: float = TOLERANCE) -> None:
        self.comparison.numbers(f"{self.label}: {name}", ours, theirs, tolerance, where=self.scene.name)

    def _verdicts(self, name: str, ours: NDArray[np.generic], theirs: NDArray[np.generic]) -> None:
        self.comparison.verdicts(f"{self.label}: {name}", np.asarray(ours != theirs), where=self.scene.name)

    def _events(self, sample: int, plans: Judged) -> None:
        """Areas at every state, and every contact with what was made of it."""
        where, flags = plans.where, self.scene.flags_by_plan
        areas = np.stack([where.multiple_lanes, where.non_drivable, where.oncoming], axis=-1)
        self._verdicts("areas", areas, flags(f"{self.mode}_areas", STATES, 3)[sample])
        crossing = np.stack([where.center_in_intersection, where.axle_in_intersection], axis=-1)
        self._verdicts("in intersection", crossing, flags(f"{self.mode}_in_intersection", STATES, 2)[sample])
        for name, events in (("nc", plans.collisions.events), ("ttc", plans.near_misses.events)):
            official = self.scene.stored.integers(f"{self.mode}_{name}_events", None, events.shape[1] + 1)
            theirs = official[official[:, 0] == sample, 1:]
            same = set(map(tuple, events.tolist())) ^ set(map(tuple, theirs.tolist()))
            wrong = np.arange(max(len(events), len(theirs), 1)) < len(same)
            self.comparison.verdicts(f"{self.label}: {name.upper()} events", wrong, where=self.scene.name)

    def _sub_scores(self, sample: int, plans: Judged) -> None:
        for name in VERDICTS:
            self._verdicts(name.upper(), getattr(plans.scores, name), self._official(sample, name))
        steps = self.scene.stored.integers
        shape = (self.scene.samples, self.scene.count)
        self._verdicts("collision step", plans.collisions.step, steps(f"{self.mode}_collision_step", *shape)[sample])
        self._verdicts("TTC step", plans.near_misses.step, steps(f"{self.mode}_ttc_step", *shape)[sample])
        checks = self.scene.flags_by_plan(f"{self.mode}_hc_checks", 6)[sample]
        self._verdicts("HC tests", comfort_checks(plans.extremes), checks)
        extremes = self._official(sample, "hc_extremes", 6, 2)
        self._numbers("HC extremes", plans.extremes, extremes, EXTREMES_TOLERANCE)
        course = plans.course
        self._numbers("progress (m)", course.progress_m, self._official(sample, "progress_m"))
        self._numbers("wrong way (m)", course.wrong_way_m, self._official(sample, "ddc_max_m"))
        apart = offsets(plans.states, self.scene.route)
        self._numbers("distance from route (m)", apart, self._official(sample, "lk_offset_m", STATES))

    def _totals(self, sample: int, plans: Judged, ec: Floats) -> SubScores:
        shape, recorded = self.scene.count, self.scene.recorded
        progress_m = np.repeat(plans.course.progress_m[recorded], shape)
        multiplier = np.repeat(plans.scores.multiplier[recorded], shape)
        self._numbers("reference progress (m)", progress_m, self._official(sample, "reference_progress_m"))
        self._numbers("reference multiplier", multiplier, self._official(sample, "reference_multiplier"))
        scores = beside(plans, progress_m, multiplier)
        self._numbers("EP", scores.ep, self._official(sample, "ep"))
        self._numbers("EP alone", plans.scores.ep, self._official(sample, "ep_alone"))
        self._numbers("multiplier", scores.multiplier, self._official(sample, "multiplier"))
        self._numbers("score without EC", scores.score_without_ec, self._official(sample, "score_without_ec"))
        alone = self._official(sample, "score_without_ec_alone")
        self._numbers("score without EC, alone", plans.scores.score_without_ec, alone)
        self._numbers("score", scores.score(ec), self._official(sample, "score"))
        return scores


def compare_filter(comparison: Comparison, scene: GoldenScene, states: Floats, scores: list[SubScores]) -> None:
    """Compare the scores in which what the recorded driver fails is forgiven.

    Args:
        comparison: Gathers the errors.
        scene: The golden scene.
        states: (S, P, 31, 11) tracked motions.
        scores: The sub-scores of each sample's plans.
    """
    ec = comfort_of_pairs(scene, states)[1]
    for sample, ours in enumerate(scores):
        recorded = states[sample, scene.recorded][None]
        human = human_scores(judged(recorded, np.zeros(1, np.int64), surroundings(scene, sample)))
        for name in FILTERED:
            official = scene.stored.floats(f"human_{name}", scene.samples)[sample]
            comparison.verdicts("recorded driver", getattr(human, name) != official, where=scene.name)
        filtered = ours.forgiving(human.zeros())
        columns = {f"filtered {name}": getattr(filtered, name) for name in FILTERED}
        columns |= {"filtered multiplier": filtered.multiplier, "filtered score": filtered.score(ec[sample])}
        for name, values in columns.items():
            official = scene.by_plan(name.replace(" ", "_"))[sample]
            comparison.numbers(name, values, official, TOLERANCE, where=scene.name)


def comfort_of_pairs(scene: GoldenScene, states: Floats) -> tuple[Floats, Floats]:
    """Differences (S, P, 4) and EC (S, P) of consecutive samples, the same for both."""
    differences = np.zeros((scene.samples, scene.count, 4))
    for number in np.unique(scene.pair):
        earlier, later = np.flatnonzero(scene.pair == number)
        differences[[earlier, later]] = disagreement(states[earlier], states[later], APART)
    return differences, extended_comfort(differences)


def surroundings(scene: GoldenScene, sample: int) -> Surroundings:
    """What the plans of one sample are judged by.

    Args:
        scene: The golden scene.
        sample: Which of its samples.

    Returns:
        One sample's surroundings.
    """
    frames = scene.key_frames
    start, stop = int(frames.offsets[sample]), int(frames.offsets[sample + 1])
    some = slice(start, stop)
    of_sample = KeyFrames(
        np.array([0, stop - start]),
        frames.box[some],
        frames.size[some],
        frames.annotated[some],
        frames.velocity[some],
        frames.is_agent[some],
        frames.number[some],
    )
    now = scene.now[sample][None]
    return Surroundings(
        now=now,
        history=history_rows(scene.history[sample][None]),
        has_history=np.ones(1, np.bool_),
        traffic=log_replay(at_states(of_sample), now),
        road=scene.road(sample),
        route=scene.route,
    )
