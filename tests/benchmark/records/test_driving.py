"""Driving scores in records: means, shares, totals and filtered ones from rows alone; old records get them."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.evaluation import EvalSettings, evaluate
from benchmark.pdm.definition import VERSION
from benchmark.pdm.totals import DrivenPlan
from benchmark.records.driving import COLUMNS, SUB_SCORES, read_sample_scores, summarise_driving_scores
from benchmark.records.row_schema import SampleRow
from benchmark.records.run import load_record, summarise_rows
from benchmark.runs.rescoring import rescore
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.planners import Failing, Straight
from tests.benchmark.records.test_run import GOLDEN, row

PERFECT: dict[str, Any] = {
    **dict.fromkeys(SUB_SCORES, 1.0),
    **{"forgiven": [], "progress_m": 20.0, "recorded_progress_m": 20.0, "collision_s": None, "ttc_s": None},
}


def driven(**changed: Any) -> DrivenPlan:
    return DrivenPlan(**{**PERFECT, **changed})


def sample(scene: str, index: int, **changed: Any) -> SampleRow:
    return row(scene, index).model_copy(update={"driving": driven(**changed)})


def column(rows: list[DrivenPlan], name: str) -> list[float | None]:
    values, known = read_sample_scores(rows)
    place = COLUMNS.index(name)
    return [float(value) if there else None for value, there in zip(values[:, place], known[:, place])]


def test_totals_are_the_weighted_means_times_the_multipliers() -> None:
    rows = [driven(), driven(nc=0.5, ep=0.8, lk=0.0), driven(dac=0.0), driven(ec=None), driven(hc=None, ec=0.0)]
    assert column(rows, "score") == pytest.approx([1.0, 0.5 * (4 + 5 + 2 + 2) / 16, 0.0, None, 14 / 16])
    assert column(rows, "score_without_ec") == pytest.approx([1.0, 0.5 * (4 + 5 + 2) / 14, 0.0, 1.0, 1.0])
    assert column(rows, "hc")[-1] is None and column(rows, "ec")[3] is None


def test_filtered_scores_forgive_what_the_recorded_driver_fails() -> None:
    rows = [driven(dac=0.0, lk=0.0, forgiven=["dac"]), driven(dac=0.0), driven(ddc=0.5, forgiven=["ddc", "ttc"])]
    assert column(rows, "filtered_dac") == [1.0, 0.0, 1.0]
    assert column(rows, "filtered_score") == pytest.approx([14 / 16, 0.0, 1.0])
    assert column(rows, "score") == pytest.approx([0.0, 0.0, 0.5])
    assert column(rows, "filtered_ddc") == [1.0, 1.0, 1.0] and "filtered_ec" not in COLUMNS


def test_a_summary_has_means_shares_counts_and_intervals_over_scenes() -> None:
    rows = [
        sample("a", 0, ec=None), sample("a", 1, nc=0.5), sample("b", 0, ec=None, nc=0.0), row("b", 1, counted=False),
    ]  # fmt: skip
    summary = summarise_driving_scores(rows, [each.scene for each in rows], seed=0)
    assert summary is not None and summary.version == VERSION
    assert (summary.counted, summary.incomplete) == (3, 1)
    nc = summary.columns["nc"]
    assert (nc["mean"].numerator, nc["mean"].denominator) == (1.5, 3) and nc["ones"].value == pytest.approx(1 / 3)
    assert nc["mean"].low == 0.0 and nc["mean"].high == 0.75
    assert summary.columns["score"]["mean"].denominator == 1 and summary.columns["score"]["mean"].low is None
    assert set(summary.columns) == set(COLUMNS)
    # Two scenes made from one recording are one.
    again = summarise_driving_scores(rows, ["a"] * 4, seed=0)
    assert again is not None and again.columns["nc"]["mean"].low is None


def test_no_driving_scores_are_no_summary() -> None:
    assert summarise_driving_scores([row("a", 0)], ["a"], seed=0) is None
    assert summarise_rows([row("a", 0)], {"exact": 1}, seed=0).driving is None


def test_eval_writes_them_and_they_read_back(tmp_path: Path) -> None:
    record = evaluate(town_of_two(slow_leader=True), "val", Failing(), tmp_path, EvalSettings(protocols=("exact",)))
    summary = record.summary.driving
    assert summary is not None and summary.counted == sum(each.driving is not None for each in record.rows) == 18
    assert all(each.driving is None for each in record.rows if each.status == "failed")
    assert load_record(record.directory) == record
    rates = [rate for pair in summary.columns.values() for rate in pair.values()]
    assert all(0.0 <= (rate.value or 0.0) <= 1.0 for rate in rates)


def test_records_of_earlier_schemas_get_them_by_rescoring(tmp_path: Path) -> None:
    data = town_of_two(slow_leader=True)
    directory = Path(shutil.copytree(GOLDEN / "schema-1", tmp_path / "old"))
    assert load_record(directory).summary.driving is None
    record = rescore(directory, data, protocols=("exact",))
    fresh = evaluate(data, "val", Failing(), tmp_path / "new", EvalSettings(protocols=("exact",)))
    assert record.summary.driving == fresh.summary.driving is not None
    assert [each.driving for each in record.rows] == [each.driving for each in fresh.rows]


def test_a_new_version_of_the_definition_is_rescored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = town_of_two()
    record = evaluate(data, "val", Straight(), tmp_path, EvalSettings(protocols=("exact",)))
    assert rescore(record.directory, data, protocols=("exact",)) == record
    monkeypatch.setattr("benchmark.records.driving.VERSION", VERSION + 1)
    again = rescore(record.directory, data, protocols=("exact",))
    assert again.summary.driving is not None and again.summary.driving.version == VERSION + 1


def test_without_a_map_there_are_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(FakeData, "has_map", lambda self, name: False)
    record = evaluate(town_of_two(), "val", Straight(), tmp_path, EvalSettings(protocols=("exact",)))
    assert record.summary.driving is None and all(each.driving is None for each in record.rows)


def test_scores_of_no_samples_have_every_column() -> None:
    values, known = read_sample_scores([])
    assert values.shape == known.shape == (0, len(COLUMNS)) and not np.isnan(values).any()
