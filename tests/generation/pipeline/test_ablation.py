"""The four rows of the ablation study."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.records.ablation import VARIANTS, AblationReport, read_ablation
from benchmark.records.run import find_records
from generation.pipeline.ablation import estimate_ablation, run_ablation
from generation.pipeline.surrogate import PlannerUnderTest
from tests.generation.labels.recorded_roads import BUSY, QUICK, contents, recorded, write_source
from tests.generation.search.drivers import Drivers, RaisingDriver

FAST = PlannerUnderTest(Drivers(speed=10.0), images=False)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    root = tmp_path_factory.mktemp("recorded")
    return write_source(root, recorded("scene-9901", BUSY[:4]), recorded("scene-9902", BUSY[:1], seconds=9.0))


@pytest.fixture(scope="module")
def study(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, AblationReport]:
    out = tmp_path_factory.mktemp("study")
    return out, run_ablation(source, FAST, replace(QUICK, out=out, limit=2))


def test_counts_add_up_and_every_row_tries_the_same_vehicles(
    source: DataSet, study: tuple[Path, AblationReport]
) -> None:
    out, report = study
    assert [row.name for row in report.rows] == [variant.name for variant in VARIANTS]
    tried = []
    complete = {name: sum(truth.complete for truth in source.truth(name)) for name in report.scenes}
    for row in report.rows:
        attempts = [json.loads(line) for line in (out / row.name / "attempts.jsonl").read_text().splitlines()]
        assert row.attempted == len(attempts) == row.kept + sum(row.discarded.values())
        assert row.samples_attempted == sum(complete[attempt["scene"]] for attempt in attempts)
        assert row.samples_kept == sum(complete[attempt["scene"]] for attempt in attempts if attempt["kept"])
        assert row.colliding_samples <= row.samples_kept <= row.samples_attempted
        assert row.rate_attempted.value == row.colliding_samples / row.samples_attempted
        assert row.rate_kept.denominator == row.samples_kept
        tried.append([(attempt["scene"], attempt["agent"]) for attempt in attempts])
    assert tried[0] and all(agents == tried[0] for agents in tried)
    full, *others = report.rows
    assert full.full_minus is None
    for row in others:
        assert row.full_minus is not None and row.full_minus.recordings == 2
        fewer = (full.colliding_samples - row.colliding_samples) / row.samples_attempted
        assert row.full_minus.value == pytest.approx(fewer)


def test_contacts_with_bystanders_do_not_count(
    source: DataSet, study: tuple[Path, AblationReport], tmp_path: Path
) -> None:
    # The builds are there already.
    shutil.copytree(study[0], tmp_path, dirs_exist_ok=True)
    faster = PlannerUnderTest(Drivers(speed=25.0), images=False)
    report = run_ablation(source, faster, replace(QUICK, out=tmp_path, limit=2))
    (record,) = (
        each for each in find_records(tmp_path / "runs" / "full") if each.run.planner.settings["speed"] == 25.0
    )
    outcomes = [row.outcomes["exact"] for row in record.rows]
    touched = [outcome.facts["hit_adversary"] for outcome in outcomes if outcome.counted]
    assert touched.count(True) and touched.count(False)
    assert report.rows[0].colliding_samples == touched.count(True)


def test_the_search_is_what_makes_scenes_hard(study: tuple[Path, AblationReport]) -> None:
    full, *others = study[1].rows
    assert full.rate_attempted.value is not None
    assert all((row.rate_attempted.value or 0.0) <= full.rate_attempted.value for row in others)
    assert full.rate_attempted.value > 0.0


def test_the_record_reads_back_and_resumes(source: DataSet, study: tuple[Path, AblationReport]) -> None:
    out, report = study
    assert read_ablation(out / "ablation.json") == report
    before = contents(out)
    (out / "ablation.json").unlink()
    next((out / "full" / ".challenger" / "attempts").iterdir()).unlink()
    assert run_ablation(source, FAST, replace(QUICK, out=out, limit=2)) == report
    assert contents(out) == before


def test_the_table_has_counts_intervals_and_the_papers_numbers(study: tuple[Path, AblationReport]) -> None:
    lines = study[1].table().plain(wide=True, width=200).splitlines()
    for line, variant, row in zip(lines[2:6], VARIANTS, study[1].rows, strict=True):
        assert line.startswith(variant.label)
        assert line.endswith(variant.published)
        assert f"{row.colliding_samples} of {row.samples_kept}" in line


def test_an_estimate_writes_nothing(source: DataSet, tmp_path: Path) -> None:
    lines = estimate_ablation(source, FAST, replace(QUICK, out=tmp_path / "study")).splitlines()
    assert len(lines) == 4
    assert all("would build adv from 2 scenes" in line for line in lines)
    assert not (tmp_path / "study").exists()


def test_a_planner_that_raises_has_no_row(source: DataSet, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="raising raised on"):
        run_ablation(
            source, PlannerUnderTest(Drivers(RaisingDriver), images=False), replace(QUICK, out=tmp_path, limit=1)
        )
    assert not (tmp_path / "ablation.json").exists()


def test_nothing_survives_in_any_row(source: DataSet, tmp_path: Path) -> None:
    hyper = replace(QUICK.hyper, close_gap_m=0.0)
    report = run_ablation(source, FAST, replace(QUICK, out=tmp_path, limit=1, hyper=hyper))
    for row in report.rows:
        assert row.kept == 0
        assert row.rate_attempted.value == 0.0
        assert row.rate_kept.value is None
        assert row.mean_gap_m is None
    assert "-" in report.table().plain()


@pytest.mark.parametrize("text", ["", "[]", "{}", '{"schema": 99}'])
def test_a_damaged_record_is_a_sentence(tmp_path: Path, text: str) -> None:
    (tmp_path / "ablation.json").write_text(text)
    with pytest.raises(InputError, match=r"ablation\.json"):
        read_ablation(tmp_path / "ablation.json")
