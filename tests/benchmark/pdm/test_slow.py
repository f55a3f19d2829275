"""The fast kernels against the slow version on made-up samples."""

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmark.geometry import wrap_angle
from benchmark.pdm.definition import HEADING
from benchmark.pdm.plan_motion import compute_disagreement, score_extended_comfort, track_plans
from benchmark.pdm.scoring import ScoredMotions, score_against_references, score_motions
from tests.benchmark.pdm.cases import Case, crossing
from tests.benchmark.pdm.slow_pdm import (
    SlowVerdict,
    slow_agreement,
    slow_differences,
    slow_progress,
    slow_score,
    slow_verdict,
)

SEEDS = range(3)


def judged_fast(case: Case) -> tuple[ScoredMotions, NDArray[np.int64]]:
    """All plans of all samples at once, sample after sample."""
    samples, plans = case.plans.shape[:2]
    of = np.repeat(np.arange(samples), plans)
    states = track_plans(case.plans.reshape(-1, 6, 3), case.now[of])
    return score_motions(states, of, case.build_context), of


Both = dict[int, tuple[Case, ScoredMotions, list[SlowVerdict]]]


@pytest.fixture(scope="module")
def both() -> Both:
    found: Both = {}
    for seed in SEEDS:
        case = crossing(seed, samples=2)
        slow = [slow_verdict(plan, case.slow(sample)) for sample, plans in enumerate(case.plans) for plan in plans]
        found[seed] = case, judged_fast(case)[0], slow
    return found


@pytest.mark.parametrize("seed", SEEDS)
def test_motions_and_verdicts_are_those_of_the_slow_version(seed: int, both: Both) -> None:
    _, fast, slow = both[seed]
    difference = fast.states - np.array([each.states for each in slow])
    difference[..., HEADING] = wrap_angle(difference[..., HEADING])
    assert np.abs(difference).max() < 1e-6
    for name in ("nc", "dac", "ddc", "ttc", "lk", "hc"):
        assert getattr(fast.scores, name).tolist() == [getattr(each, name) for each in slow], name
    assert fast.collisions.step.tolist() == [each.collision_step for each in slow]
    assert fast.near_misses.step.tolist() == [each.ttc_step for each in slow]
    assert fast.course.progress_m == pytest.approx([each.progress_m for each in slow], abs=1e-6)


def test_the_made_up_samples_decide_everything_both_ways(both: Both) -> None:
    found = [each for _, _, slow in both.values() for each in slow]
    for name, values in {"nc": {0.0, 0.5, 1.0}, "ddc": {0.0, 0.5, 1.0}}.items():
        assert {getattr(each, name) for each in found} == values
    for name in ("dac", "ttc", "lk", "hc"):
        assert {getattr(each, name) for each in found} == {0.0, 1.0}, name


@pytest.mark.parametrize("seed", SEEDS)
def test_progress_agreement_and_totals_are_those_of_the_slow_version(seed: int, both: Both) -> None:
    case, fast, slow = both[seed]
    plans = case.plans.shape[1]
    # The first plan of each sample stands for its recorded future.
    reference = np.repeat(np.arange(0, len(slow), plans), plans)
    scores = score_against_references(fast, fast.course.progress_m[reference], fast.scores.multiplier[reference])
    progress = [slow_progress(each, slow[place]) for each, place in zip(slow, reference)]
    assert scores.ep == pytest.approx(progress, abs=1e-6)
    # One sample's plans for the plans of the next: any two motions will do.
    earlier, later = fast.states[:plans], fast.states[plans : 2 * plans]
    ec = score_extended_comfort(compute_disagreement(earlier, later, 5))
    assert ec.tolist() == [slow_agreement(slow_differences(a, b, 5)) for a, b in zip(earlier, later)]
    expected = [slow_score(slow[plans + row], progress[plans + row], ec[row]) for row in range(plans)]
    assert scores.score(np.tile(ec, len(case.now)))[plans : 2 * plans] == pytest.approx(expected, abs=1e-6)
    without = [slow_score(each, ep, None) for each, ep in zip(slow, progress)]
    assert scores.score_without_ec == pytest.approx(without, abs=1e-6)


def test_a_sample_is_judged_alike_alone_and_among_others() -> None:
    case = crossing(3)
    together, of = judged_fast(case)
    around = case.build_context
    some = of == 2
    alone = score_motions(together.states[some], of[some], around)
    for name in ("nc", "dac", "ddc", "ttc", "lk", "hc"):
        assert getattr(alone.scores, name).tolist() == getattr(together.scores, name)[some].tolist()
    assert np.array_equal(alone.extremes, together.extremes[some])


def test_no_plans_have_no_verdicts() -> None:
    case = crossing(0)
    none = score_motions(track_plans(np.zeros((0, 6, 3)), np.zeros((0, 11))), np.zeros(0, np.int64), case.build_context)
    assert none.scores.nc.shape == (0,) and len(none.collisions.events) == 0
