"""The spread over seeds: runs that differ in the seed alone, and nothing else."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmark.records.planner_versions import label_versions
from benchmark.records.run import RunRecord
from benchmark.report.cells import UNDEFINED
from benchmark.report.table import Table
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.contents import build_data_set_tables
from leaderboard.tables.statistics import seed_spread_table
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, hand_made
from tests.leaderboard.csv_rows import csv_rows


def run(seed: int, flags: Sequence[str | None], *, name: str = "noisy", split: str = "adv", **facts: Any) -> RunRecord:
    scenes = {f"scene-{index}": [flag] for index, flag in enumerate(flags)}
    whole = facts.pop("scenes_in_split", None)
    made = hand_made(name, scenes, split=split, native=facts.pop("native", None), scenes_in_split=whole)
    planner = made.run.planner.model_copy(update={"seed": seed, **facts})
    return replace(made, run=made.run.model_copy(update={"planner": planner}))


RUNS = [run(0, [HIT, CLEAN, CLEAN, CLEAN]), run(1, [HIT, HIT, CLEAN, CLEAN]), run(2, [HIT, HIT, HIT, HIT])]


def rows_of(table: Table | None) -> list[dict[str, str]]:
    assert table is not None
    return csv_rows(table.csv())


def test_mean_ends_and_deviation_are_those_of_the_rates() -> None:
    (row,) = rows_of(seed_spread_table(DataSetRuns("d", label_versions(RUNS)), "exact"))
    rates = [25.0, 50.0, 100.0]
    assert (row["planner"], row["split"], row["protocol"], row["seeds"]) == ("noisy", "adv", "exact", "3")
    assert float(row["mean"]) == round(np.mean(rates), 3)
    assert (float(row["lowest"]), float(row["highest"])) == (25.0, 100.0)
    assert float(row["deviation"]) == round(float(np.std(rates, ddof=1)), 3)


def test_order_does_not_matter_and_a_single_seed_has_no_spread() -> None:
    def table(*runs: RunRecord) -> Table | None:
        return seed_spread_table(DataSetRuns("d", runs), "exact")

    assert table(*RUNS[::-1]) == table(*RUNS)
    assert table() is table(RUNS[0]) is table(RUNS[0], run(0, [HIT] * 4)) is None


def test_other_weights_settings_splits_and_planners_are_not_another_seed() -> None:
    changes: list[dict[str, Any]] = [
        {"weights_sha256": "0" * 64}, {"settings": {"gap": 1}}, {"split": "val"}, {"name": "another"}
    ]  # fmt: skip
    others = [run(1, [HIT] * 4, **each) for each in changes]
    for other in others:
        assert seed_spread_table(DataSetRuns("d", [RUNS[0], other]), "exact") is None
    whole = DataSetRuns("d", [*RUNS, *others, run(3, [CLEAN] * 4, split="val")])
    assert len(rows_of(seed_spread_table(whole, "exact"))) == 2


def test_runs_that_are_not_whole_are_named_and_left_out() -> None:
    partial = [run(3, [HIT, FAILED, HIT, HIT]), run(4, [HIT], scenes_in_split=4)]
    table = seed_spread_table(DataSetRuns("d", label_versions([RUNS[0], *partial])), "exact")
    (row,) = rows_of(table)
    assert row["seeds"] == "1" and row["deviation"] == "" and row["mean"] == "25.000"
    assert table is not None and sum(note.startswith("Left out: noisy (seed ") for note in table.notes) == 2
    other = seed_spread_table(DataSetRuns("d", RUNS), "vad")
    assert other is not None and other.rows[0][3:5] == ("0", UNDEFINED)
    assert all("was not judged by protocol 'vad'" in note for note in other.notes[1:])


def test_the_tables_of_a_data_set_have_it_where_there_are_seeds() -> None:
    names = [table.name for table in build_data_set_tables(DataSetRuns("d", label_versions(RUNS))).tables]
    assert names.index("seeds-exact") == names.index("collision-exact") + 1
    assert "seeds-exact" not in [table.name for table in build_data_set_tables(DataSetRuns("d", RUNS[:1])).tables]
    own = [run(seed, [HIT, CLEAN], native="exact") for seed in (0, 1)]
    (row,) = rows_of(seed_spread_table(DataSetRuns("d", own), "native"))
    assert (row["protocol"], row["deviation"]) == ("exact", "0.000")
