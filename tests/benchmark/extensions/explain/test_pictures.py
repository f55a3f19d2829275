"""Pictures show what the protocol compares, the same bytes each time, one for each cause; the command draws them."""

import hashlib
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import InputError
from benchmark.evaluation import evaluate
from benchmark.extensions.explain.clearest_cases import DisagreementCase, build_case, find_clearest_cases
from benchmark.extensions.explain.pictures import WORDS, draw_case, explain
from benchmark.extensions.explain.views import build_raster_view
from benchmark.geometry import Floats
from benchmark.metrics.disagreement import CAUSES, find_contacts_before_mask
from benchmark.protocols import PROTOCOLS
from benchmark.records.run import RunRecord
from benchmark.truth import SampleTruth
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.cli.small_path import done, judged_town, small_town
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.metrics.test_disagreement import STRAIGHT, Object, random_samples, truth, turning
from tests.benchmark.planners import Failing, Straight


@pytest.mark.parametrize(
    ("name", "examples"),
    [
        *((name, 12) for name in ("uniad", "vad", "stp3", "opendrivevla")),
        *((name, 4) for name in ("bev-planner", "omnidrive")),
    ],
)
def test_cells_that_are_drawn_meet_exactly_where_the_protocol_reports_it(name: str, examples: int) -> None:
    @settings(max_examples=examples, deadline=None)
    @given(seed=st.integers(0, 2**32 - 1))
    def drawn(seed: int) -> None:
        truths, plans = random_samples(seed, 3, 8)
        plans *= np.random.default_rng(seed).choice([1.0, 3.5])
        found = find_contacts_before_mask(PROTOCOLS[name].evaluate(truths, plans))
        for sample, plan, contacts in zip(truths, plans, found):
            for step in range(6):
                view = build_raster_view(PROTOCOLS[name], sample, plan, step)
                assert view is not None
                assert (view.occupied & view.ego).any() == contacts[step]

    drawn()


def test_cells_lie_where_the_objects_are() -> None:
    # The recorded ego drives straight on: where it goes aside, ST-P3 shifts what it draws.
    sample = truth(Object([10.0, 20.0], size=(4.0, 2.0)), recorded=STRAIGHT)
    for name in ("uniad", "vad", "stp3", "bev-planner", "omnidrive", "opendrivevla"):
        view = build_raster_view(PROTOCOLS[name], sample, STRAIGHT, 0)
        assert view is not None
        rows, columns = np.nonzero(view.occupied)
        middle = np.array([columns.mean(), rows.mean()]) * view.cell_m + view.first_cell_m
        assert np.abs(middle - [10.0, 20.0]).max() < 0.3, name
    assert build_raster_view(PROTOCOLS["sparsedrive"], sample, STRAIGHT, 0) is None


SHOWN = (
    (truth(Object([0.0, 12.5], "human.pedestrian.adult", size=(0.7, 0.7))), STRAIGHT, "uniad"),
    (truth(Object([11.0, 8.0], size=(1.5, 1.0))), turning(1.0), "vad"),
    (truth(Object([-2.15, 12.5])), STRAIGHT, "uniad"),
    (truth(Object([0.0, 12.5], size=(3.0, 1.9)), recorded=STRAIGHT), STRAIGHT, "sparsedrive"),
    (truth(Object([0.0, 12.5], size=(3.0, 1.9)), recorded=STRAIGHT), STRAIGHT, "vad-23"),
    (truth(Object([0.0, 5.5], size=(0.4, 0.4))), STRAIGHT * 2.5, "uniad"),
    (truth(Object([0.0, 5.5], size=(0.4, 0.4))), STRAIGHT * 2.5, "sparsedrive"),
    (truth(Object(np.column_stack([np.zeros(7), 36.0 - 4.0 * np.arange(7)]))), STRAIGHT, "vad"),
    (truth(Object([0.0, 12.5], "human.pedestrian.adult", size=(0.7, 0.7))), STRAIGHT, "bev-planner"),
    (replace(truth(Object([0.0, 12.5], "movable_object.barrier", size=(0.7, 0.7))), index=2), STRAIGHT, "stp3"),
)


@pytest.mark.parametrize(
    ("sample", "plan", "protocol"),
    [pytest.param(*SHOWN[0], marks=pytest.mark.path), pytest.param(*SHOWN[1], marks=pytest.mark.path), *SHOWN[2:]],
)
def test_a_picture_is_a_png_and_the_same_each_time(sample: SampleTruth, plan: Floats, protocol: str) -> None:
    case = build_case("somebody", protocol, sample, plan)
    assert case is not None
    picture = draw_case(case)
    image = cv2.imdecode(np.frombuffer(picture, np.uint8), cv2.IMREAD_COLOR)
    assert image.shape == (560, 900, 3)
    assert hashlib.sha256(picture).digest() == hashlib.sha256(draw_case(case)).digest()


def test_there_is_no_case_where_all_agree_or_the_sample_does_not_count() -> None:
    assert build_case("somebody", "uniad", truth(Object([0.0, 12.5])), STRAIGHT) is None
    adult = Object([0.0, 12.5], "human.pedestrian.adult", size=(0.7, 0.7))
    assert build_case("somebody", "uniad", truth(adult, valid=5), STRAIGHT) is None


def test_the_step_shown_is_the_one_with_most_overlap() -> None:
    adult = Object([0.0, 12.9], "human.pedestrian.adult", size=(0.7, 0.7))
    crossing = Object([0.0, 18.55], "human.pedestrian.adult", size=(0.7, 0.7))
    case = build_case("somebody", "uniad", truth(adult, crossing), STRAIGHT)
    assert case is not None and case.step == 2


def test_a_latched_flag_is_shown_where_it_was_raised() -> None:
    beside = truth(Object([-2.15, 12.5]))
    latched = PROTOCOLS["safemvdrive"].evaluate([beside], STRAIGHT[None])
    raised = latched.step("at_step")[0]
    assert raised.any() and latched.collision[0, -1] and not raised[-1]
    case = build_case("somebody", "safemvdrive", beside, STRAIGHT)
    assert case is not None and case.cause == "false alarm: raster" and raised[case.step]


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[FakeData, list[RunRecord]]:
    data = town_of_two(slow_leader=True)
    out = tmp_path_factory.mktemp("runs")
    return data, [evaluate(data, "val", planner, out) for planner in (Straight(), Failing())]


def causes_of(records: Sequence[RunRecord]) -> set[tuple[str, str]]:
    return {cause for record in records for row in record.rows for cause in row.disagreements.items()}


def test_one_picture_for_each_cause_and_protocol(runs: tuple[FakeData, list[RunRecord]], tmp_path: Path) -> None:
    data, records = runs
    pictures = explain(records, data, tmp_path)
    assert {(picture.case.protocol, picture.case.cause) for picture in pictures} == causes_of(records)
    assert pictures and sorted(tmp_path.iterdir()) == sorted(picture.path for picture in pictures)
    for picture in pictures:
        assert picture.case.protocol in picture.sentence and picture.case.planner in picture.sentence
    assert set(WORDS) == set(CAUSES)
    # Without runs nothing is written; a folder that cannot be is the user's to fix.
    assert explain([], data, tmp_path / "none") == [] and not (tmp_path / "none").exists()
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="file"):
        explain(records, data, tmp_path / "file")


def test_the_clearest_case_does_not_depend_on_the_order_of_records(runs: tuple[FakeData, list[RunRecord]]) -> None:
    data, records = runs

    def key(case: DisagreementCase) -> tuple[str, str, str, str, int]:
        return case.planner, case.protocol, case.cause, case.truth.sample_token, case.step

    assert [key(case) for case in find_clearest_cases(records, data)] == [
        key(case) for case in find_clearest_cases(records[::-1], data)
    ]


def test_explaining_protocols_prints_a_table_and_draws_cases(tmp_path: Path) -> None:
    town, out = small_town(tmp_path / "small"), tmp_path / "out"
    judged_town(town, out)
    common = ("--model", "constant-velocity", "--data", town, "--split", "adv", "--out", out)
    run = done(run_here("eval", *common, "--explain-protocols", "--protocol", "vad", "--protocol", "exact"))
    pictures = list((out / "explained").rglob("*.png"))
    assert pictures
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)
    assert all(text in run.out for text in ("misses", "protocol vad", "protocol exact"))
    unknown = run_here("eval", *common, "--protocol", "guess")
    assert (unknown.code, unknown.err.count("\n")) == (2, 1)
