"""What planners cost: noted beside records, of whom, and what counts of it."""

import json
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate, plan_shard
from benchmark.machine.metering import Meter, peak_memory_mb
from benchmark.records.planner_cost import PlannerCost, SceneCost, cost_path, note_cost, read_cost, summarise_cost
from benchmark.records.record_costs import with_cost
from benchmark.records.run import RunRecord, load_record
from benchmark.runs.planner_facts import build_planner_facts
from benchmark.runs.units import Shard
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.contents import build_data_set_tables
from leaderboard.tables.runtime import cost_table
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.planners import Factory, Failing, Straight
from tests.leaderboard.csv_rows import csv_rows

ROOT = Path(__file__).resolve().parents[3]


def scene(latency_s: Sequence[float | None], memory_mb: float | None = 100.0) -> SceneCost:
    known = {"peak_memory_mb": memory_mb, "peak_device_mb": None, "device": "accelerator"}
    return SceneCost.model_validate({"planning_s": 1.0, "latency_s": list(latency_s), **known})


def timed(tmp_path: Path, planner: Straight) -> RunRecord:
    """A run, read with what was noted of its cost."""
    settings = EvalSettings(protocols=("exact",), timings=tmp_path / "timings")
    record = evaluate(town_of_two(), "val", planner, tmp_path / "runs", settings)
    return with_cost(load_record(record.directory), [tmp_path / "runs"], lambda _: tmp_path / "timings")


def test_the_first_samples_of_each_scene_and_failures_do_not_count() -> None:
    cost = PlannerCost(
        planner="", scenes={"b": scene([9.0, 9.0, 3.0, None, 4.0]), "a": scene([9.0, 9.0, 1.0, 2.0], 200)}
    )
    assert cost.warm_s() == [1.0, 2.0, 3.0, 4.0]
    summary = summarise_cost(cost)
    assert (summary.samples, summary.median_s, summary.peak_memory_mb) == (4, 2.5, 200.0)
    assert summary.p95_s == pytest.approx(np.percentile([1, 2, 3, 4], 95))
    assert summarise_cost(PlannerCost(planner="", scenes={"a": scene([9.0])})).median_s is None


def test_an_evaluation_notes_each_sample_and_the_record_stays_the_same(tmp_path: Path) -> None:
    slow = timed(tmp_path / "slow", Straight(0.02))
    again = evaluate(town_of_two(), "val", Straight(), tmp_path / "plain", EvalSettings(protocols=("exact",)))
    files = ["run.json", "samples.jsonl", "summary.json"]
    assert all((slow.directory / name).read_bytes() == (again.directory / name).read_bytes() for name in files)
    assert slow.cost is not None and set(slow.cost.scenes) == set(slow.run.scenes)
    for name, cost in slow.cost.scenes.items():
        assert len(cost.latency_s) == len(slow.rows_of(name))
        assert all(latency is not None and latency >= 0.02 for latency in cost.latency_s)
        assert cost.planning_s >= 0.02 * len(cost.latency_s)
        assert cost.peak_memory_mb is None or cost.peak_memory_mb > 10.0


def test_samples_on_which_the_planner_failed_have_no_latency(tmp_path: Path) -> None:
    cost = timed(tmp_path, Failing(index=3)).cost
    assert cost is not None
    assert all([at for at, value in enumerate(each.latency_s) if value is None] == [3] for each in cost.scenes.values())


def test_plans_that_were_kept_keep_their_cost_and_another_version_begins_anew(tmp_path: Path) -> None:
    path, facts = tmp_path / "x.timing.json", build_planner_facts(Straight())
    note_cost(path, facts, {"a": scene([1.0]), "b": scene([2.0])})
    note_cost(path, facts, {"a": None, "b": scene([3.0])})
    found = read_cost(path)
    assert found is not None and [found.scenes[name].latency_s for name in "ab"] == [[1.0], [3.0]]
    note_cost(path, facts.model_copy(update={"seed": 5}), {"a": None, "b": scene([4.0])})
    found = read_cost(path)
    assert found is not None and list(found.scenes) == ["b"]


def test_costs_of_another_version_belong_to_nobody_here(tmp_path: Path) -> None:
    record = timed(tmp_path, Straight())
    path = cost_path(tmp_path / "timings", tmp_path / "runs", record.directory)
    note_cost(path, record.run.planner.model_copy(update={"seed": 5}), {"scene": scene([1.0])})
    bare = replace(record, cost=None)
    assert with_cost(bare, [tmp_path / "runs"], lambda _: tmp_path / "timings").cost is None


@pytest.mark.parametrize("broken", ["{", "[]", '{"schema": 1, "planner": "", "scenes": {"a": {"planning_s": -1}}}'])
def test_a_damaged_note_is_named_and_written_anew(tmp_path: Path, broken: str) -> None:
    path = tmp_path / "x.timing.json"
    path.write_text(broken)
    with pytest.raises(InputError, match=r"x\.timing\.json"):
        read_cost(path)
    note_cost(path, build_planner_facts(Straight()), {"a": scene([1.0])})
    assert json.loads(path.read_text())["scenes"]["a"]["latency_s"] == [1.0]


def test_notes_of_the_format_before_say_nothing_of_latency(tmp_path: Path) -> None:
    path = tmp_path / "x.timing.json"
    path.write_text('{"planning_s": {"a": 1.5}}')
    assert read_cost(path) is None


def test_the_table_has_a_row_for_whom_it_is_known_of(tmp_path: Path) -> None:
    record = timed(tmp_path, Straight(0.01))
    table = cost_table(DataSetRuns("town", [record]))
    assert table is not None
    (row,) = csv_rows(table.csv())
    assert float(row["median, ms"]) >= 10.0 and float(row["p95, ms"]) >= float(row["median, ms"])
    assert cost_table(DataSetRuns("town", [replace(record, cost=None)])) is None
    names = [each.name for each in build_data_set_tables(DataSetRuns("town", [record])).front]
    without = [each.name for each in build_data_set_tables(DataSetRuns("town", [replace(record, cost=None)])).front]
    assert set(names) - set(without) == {"cost"}


def test_a_meter_times_calls_that_return_and_those_that_raise() -> None:
    meter = Meter()
    with meter.call():
        time.sleep(0.01)
    with pytest.raises(ValueError), meter.call():
        raise ValueError
    first, second = meter.latency_s
    assert first is not None and first >= 0.01 and second is None


HOLDING = """
import numpy as np
from benchmark.machine.metering import Meter, peak_memory_mb
Meter()
before = peak_memory_mb()
held = np.ones(40_000_000)
during = peak_memory_mb()
del held
Meter()
print(before, during, peak_memory_mb())
"""


def test_the_peak_of_memory_begins_again_with_each_meter() -> None:
    if peak_memory_mb() is None:
        pytest.skip("the system does not tell")
    # In a process of its own: another test may have asked this one to keep the memory that it frees.
    said = subprocess.run([sys.executable, "-c", HOLDING], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    before, during, after = map(float, said.split())
    assert during > before + 200.0 and after < during - 200.0
    assert peak_memory_mb(2**22 + 1) is None


def test_what_shards_took_is_put_together(tmp_path: Path) -> None:
    runs, timings = tmp_path / "runs", tmp_path / "timings"
    planners = [(Factory(), EvalSettings(protocols=("exact",), timings=timings))]
    for number in (1, 2):
        plan_shard(town_of_two(), "val", planners, runs, Shard(number, 2))
    record = evaluate(town_of_two(), "val", *planners[0][:1], runs, planners[0][1])
    known = with_cost(load_record(record.directory), [runs], lambda _: timings)
    assert known.cost is not None and set(known.cost.scenes) == set(town_of_two().scene_names("val"))
    assert summarise_cost(known.cost).median_s is not None
    assert known == load_record(record.directory)
    assert [path.name for path in timings.rglob("*.json")] == [f"{record.directory.name}.timing.json"]
