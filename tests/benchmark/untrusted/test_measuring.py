"""Wrong readings are found in few samples, too few are not testable, and no bad planner is suspected for that."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from adapters.models import baselines
from adapters.registry import planner_factory
from benchmark.datasets.roots import DataSet, open_data
from benchmark.evaluation import EvalSettings, evaluate_together
from benchmark.geometry import Floats
from benchmark.records.run import RunRecord
from benchmark.untrusted.plan_plausibility import (
    ASIDE_M,
    FEWEST,
    FEWEST_STANDING,
    MOVED_M,
    NOT_TESTABLE,
    ComparedPlans,
    measure_plausibility,
)
from tests.benchmark.edited_roots import small_town
from tests.benchmark.untrusted.misread import AHEAD_M, FRAMES, MISREAD

BLIND = tuple(baselines())
SCENES = 3


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    """Some scenes of mini, without pictures."""
    return open_data(small_town(tmp_path_factory.mktemp("town") / "root", SCENES), name="mini")


@pytest.fixture(scope="module")
def futures(town: DataSet) -> Floats:
    """(N, 6, 2) recorded futures of the samples whose recording goes on for 3 s."""
    truths = [truth for name in town.scene_names("val") for truth in town.truth(name)]
    return np.array([truth.ego_future[:, :2] for truth in truths if truth.complete])


def moving(futures: Floats) -> Floats:
    return np.asarray(futures[np.linalg.norm(futures[:, -1], axis=1) > MOVED_M])


def turning(futures: Floats) -> Floats:
    return np.asarray(futures[np.abs(futures[:, -1, 0]) >= ASIDE_M])


def noise(count: int, seed: int, sigma_m: float = 2.0) -> Floats:
    """(N, 6, 2) of that much at 3 s, growing from the car."""
    at_3_s = np.random.default_rng(seed).normal(0.0, sigma_m, (count, 1, 2))
    return np.asarray(at_3_s * np.arange(1, 7)[:, None] / 6)


def standing(count: int) -> Floats:
    return np.zeros((count, 6, 2))


@pytest.mark.parametrize("wrong", MISREAD)
def test_every_wrong_reading_is_found_wherever_few_samples_are_taken(wrong: str, futures: Floats) -> None:
    change, says = MISREAD[wrong]
    pool, fewest = (turning(futures), 10) if wrong == "mirrored" else (moving(futures), 20)
    assert len(pool) > 2 * fewest
    for first in range(0, len(pool) - fewest + 1, 9):
        recorded = pool[first : first + fewest]
        found = measure_plausibility(ComparedPlans(change(recorded), recorded)).misreading
        assert found is not None and says in found.sentence, (first, found)
        assert found.frame == FRAMES.get(wrong)
        assert "\n" not in found.sentence and not found.sentence.endswith(".")


def test_another_point_of_the_car_is_found_in_five_samples_that_stand() -> None:
    recorded = standing(FEWEST_STANDING)
    found = measure_plausibility(ComparedPlans(recorded + [0.0, AHEAD_M], recorded)).misreading
    assert found is not None and found.category == "origin" and "begin 0.94 m away" in found.sentence
    wherever = np.random.default_rng(0).normal(0.0, 2.0, (40, 1, 2)) + standing(40)
    assert measure_plausibility(ComparedPlans(wherever, standing(40))).misreading is None


@pytest.mark.parametrize("wrong", MISREAD)
def test_fewer_samples_are_not_testable_and_never_said_to_fit(wrong: str, futures: Floats) -> None:
    pool = turning(futures) if wrong == "mirrored" else moving(futures)
    few = pool[: FEWEST - 1]
    found = measure_plausibility(ComparedPlans(MISREAD[wrong][0](few), few))
    assert found.misreading is None
    assert all(said.startswith(NOT_TESTABLE) for said in found.measured.values())
    recorded = standing(FEWEST_STANDING - 1)
    found = measure_plausibility(ComparedPlans(recorded + [0.0, AHEAD_M], recorded))
    assert found.misreading is None and found.measured["origin"].startswith(NOT_TESTABLE)
    assert all(
        said.startswith(NOT_TESTABLE) for said in measure_plausibility(ComparedPlans.joined([])).measured.values()
    )


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 60), sigma_m=st.floats(0.0, 2.0))
def test_no_plan_with_two_metres_of_noise_is_suspected(futures: Floats, seed: int, count: int, sigma_m: float) -> None:
    recorded = futures[np.random.default_rng(seed).integers(len(futures), size=count)]
    for disturbance in (
        noise(count, seed, sigma_m),
        np.random.default_rng(seed).normal(0.0, sigma_m, recorded.shape),
        noise(1, seed, sigma_m) + 0.0 * recorded,
    ):
        found = measure_plausibility(ComparedPlans(recorded + disturbance, recorded)).misreading
        assert found is None, found


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), wrong=st.sampled_from([name for name in MISREAD if name != "mirrored"]))
def test_wrong_readings_of_noisy_plans_are_found_all_the_same(futures: Floats, seed: int, wrong: str) -> None:
    change, says = MISREAD[wrong]
    recorded = moving(futures)[np.random.default_rng(seed).integers(len(moving(futures)), size=20)]
    found = measure_plausibility(ComparedPlans(change(recorded + noise(20, seed)), recorded)).misreading
    assert found is not None and says in found.sentence, found


@pytest.fixture(scope="module")
def records(town: DataSet, tmp_path_factory: pytest.TempPathFactory) -> dict[str, RunRecord]:
    """Every planner of ours that needs no pictures."""
    planners = [(planner_factory(name), EvalSettings(("exact",))) for name in BLIND]
    return dict(zip(BLIND, evaluate_together(town, "val", planners, tmp_path_factory.mktemp("runs")), strict=True))


@pytest.mark.parametrize("name", BLIND)
def test_no_planner_of_ours_is_suspected_in_whatever_part_of_its_run(
    records: dict[str, RunRecord], name: str, tmp_path: Path
) -> None:
    assert records[name].run.caveats == []
    columns = records[name].columns
    compared = ComparedPlans.of(columns.in_lidar, columns.recorded)
    assert len(compared.plan) > 60
    for fewest in (FEWEST, 20):
        for first in range(0, len(compared.plan) - fewest + 1, 5):
            part = slice(first, first + fewest)
            found = measure_plausibility(ComparedPlans(compared.plan[part], compared.recorded[part])).misreading
            assert found is None, (first, found)


def test_plans_too_large_for_squares_are_measured_without_a_warning(futures: Floats) -> None:
    recorded = moving(futures)[:20]
    found = measure_plausibility(ComparedPlans(np.full_like(recorded, 1e300), recorded)).misreading
    assert found is not None and "\n" not in found.sentence
