"""The spread over seeds of the search, beside the interval over scenes."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmark.metrics.rates import SceneSums, compute_ratios_over_scenes
from benchmark.metrics.search_seeds import combine_seeds, student_975
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import GeneratedFacts
from benchmark.report.table import Table
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.contents import build_data_set_tables, drawn_seeds_table
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, hand_made
from tests.leaderboard.csv_rows import csv_rows


def run(seed: int, flags: dict[str, list[str | None]], *, says: int | None = None, **changes: Any) -> RunRecord:
    """A run on the split of a seed; scenes ``a-1`` are made from recording ``a``."""
    sources = {name: name.partition("-")[0] for name in flags}
    made = hand_made("p", flags, split=f"adv-seed-{seed}", sources=sources)
    generated = GeneratedFacts(seed=seed if says is None else says, search=changes.pop("search", "s"))
    planner = made.run.planner.model_copy(update=changes)
    return replace(made, run=made.run.model_copy(update={"generated": generated, "planner": planner}))


RUNS = [
    run(0, {"a-1": [HIT, CLEAN], "b-1": [CLEAN, CLEAN], "c-1": [CLEAN, CLEAN]}),
    run(1, {"a-2": [HIT, HIT], "a-3": [CLEAN, HIT], "b-1": [CLEAN, CLEAN]}),
    run(2, {"b-4": [HIT, CLEAN], "c-1": [CLEAN, CLEAN]}),
]


def rows_of(table: Table | None) -> list[dict[str, str]]:
    assert table is not None
    return csv_rows(table.csv())


def test_each_seed_has_its_rate_and_all_have_mean_deviation_and_both_intervals() -> None:
    rows = rows_of(drawn_seeds_table(DataSetRuns("d", RUNS), "exact"))
    rates = [100 / 6, 50.0, 25.0]
    assert [row["seed"] for row in rows] == ["0", "1", "2", "all"]
    assert [float(row["avg"]) for row in rows] == pytest.approx([*rates, np.mean(rates)], abs=0.005)
    assert [row["scenes"] for row in rows] == ["3", "3", "2", "8"] and [row["recordings"] for row in rows][-1] == "3"
    deviation = float(np.std(rates, ddof=1))
    assert float(rows[-1]["deviation"]) == pytest.approx(deviation, abs=0.005)
    half = 4.303 * deviation / 3**0.5
    assert rows[-1]["over seeds"] == f"[0.0, {np.mean(rates) + half:.1f}]", "a rate is never below zero"
    assert all(row["deviation"] == row["over seeds"] == "" for row in rows[:-1])


def test_the_interval_of_one_seed_is_that_of_its_split() -> None:
    flags: dict[str, list[str | None]] = {f"r{place}-1": [CLEAN if place % 3 else HIT] * 2 for place in range(12)}
    rows = rows_of(drawn_seeds_table(DataSetRuns("d", [run(0, flags), run(1, flags)]), "exact"))
    values = np.repeat([[float(each[0] == HIT)] for each in flags.values()], 2, axis=0)
    sources = [name.partition("-")[0] for name in flags for _ in range(2)]
    (rate,) = compute_ratios_over_scenes(values, np.ones_like(values), sources, seed=0)
    assert rate.low is not None and rate.high is not None
    expected = f"[{100 * rate.low:.1f}, {100 * rate.high:.1f}]"
    # Two seeds with the same scenes know no more than one.
    assert [row["over scenes"] for row in rows] == [expected] * 3
    assert (rows[-1]["deviation"], rows[-1]["over seeds"]) == ("0.00", "")


def test_runs_that_do_not_differ_in_the_seed_alone_are_left_out_and_named() -> None:
    flags: dict[str, list[str | None]] = {"a-1": [HIT], "b-1": [CLEAN]}
    others = {
        "that of": run(3, flags, search="t"),
        "does not record this seed": run(4, flags, says=5),
        "other weights, settings, code or seed": run(6, flags, weights_sha256="0" * 64),
        "no plan for some samples": run(7, {"a-1": [HIT, FAILED]}),
    }
    table = drawn_seeds_table(DataSetRuns("d", [*RUNS, *others.values()]), "exact")
    assert [row["seed"] for row in rows_of(table)] == ["0", "1", "2", "all"]
    assert table is not None
    for reason in others:
        assert sum(reason in note for note in table.notes) == 1, reason


def test_one_seed_has_no_table_and_the_leaderboard_has_it_from_two_on() -> None:
    assert drawn_seeds_table(DataSetRuns("d", RUNS[:1]), "exact") is None
    assert drawn_seeds_table(DataSetRuns("d", [hand_made("p", {"a": [HIT]}), RUNS[0]]), "exact") is None
    assert "drawn-seeds-exact" in [table.name for table in build_data_set_tables(DataSetRuns("d", RUNS)).front]


def test_student_points_fall_to_the_normal_one() -> None:
    points = [student_975(freedom) for freedom in range(1, 40)]
    assert points == sorted(points, reverse=True) and points[0] == 12.706 and points[-1] == 1.960


def test_a_seed_without_counted_samples_is_no_rate() -> None:
    whole = SceneSums(("a", "b"), np.array([[1.0], [0.0]]), np.array([[2.0], [2.0]]))
    nothing = SceneSums(("a",), np.zeros((1, 1)), np.zeros((1, 1)))
    found = combine_seeds({0: whole, 1: nothing})
    assert found.seeds[1].rate.value is None and found.mean.value == 0.25 and found.deviation is None
