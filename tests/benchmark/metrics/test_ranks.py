"""Ranks with intervals and letters against a slow bootstrap, and what must never be ranked."""

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from benchmark.metrics.ranks import (
    assign_letters,
    average_drives_by_scene,
    find_shared_scenes,
    rank_planners,
    sum_faults_by_scene,
)
from benchmark.metrics.rates import RESAMPLES
from benchmark.records.run import RunRecord
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.drives import drive_tables
from leaderboard.tables.effect import effect_table
from leaderboard.tables.ranks import RANK
from tests.benchmark.metrics.made_attacks import attacked, told
from tests.benchmark.records.test_drives import failed, row, written


def slow_ranks(values: Floats, recordings: list[str], lower: bool) -> tuple[Any, Any, Any]:
    """Ends of the intervals of ranks and of means, drawn recording by recording; (P, N) values of single scenes."""
    names = sorted(set(recordings))
    rng = np.random.default_rng(content_seed("scene bootstrap", names, 0))
    drawn = rng.multinomial(len(names), np.full(len(names), 1 / len(names)), size=RESAMPLES)
    best, worst, means = [], [], []
    own = {name: np.mean([v for v, r in zip(values.T, recordings) if r == name], axis=0) for name in names}
    for counts in drawn:
        mean = sum(count * own[name] for count, name in zip(counts, names)) / len(names)
        ahead = [sum((b < a) if lower else (b > a) for b in mean) for a in mean]
        level = [sum(b == a for b in mean) for a in mean]
        best.append(np.array(ahead) + 1)
        worst.append(np.array(ahead) + level)
        means.append(mean)
    low = np.percentile(best, 2.5, axis=0, method="inverted_cdf")
    high = np.percentile(worst, 97.5, axis=0, method="inverted_cdf")
    return low, high, np.percentile(means, (2.5, 97.5), axis=0)


@settings(max_examples=8, deadline=None)
@given(st.integers(0, 2**32), st.integers(2, 5), st.booleans())
def test_ranks_are_those_of_a_slow_bootstrap(seed: int, planners: int, lower: bool) -> None:
    rng = np.random.default_rng(seed)
    recordings = ["a", "a", "a", "b", "c", "d", "d"]
    # Whole eighths: sums are exact in any order.
    values = rng.integers(0, 9, (planners, len(recordings))) / 8.0 * 3.0
    scenes = [f"s{number}" for number in range(len(recordings))]
    totals = [{scene: (float(value), 1.0) for scene, value in zip(scenes, own)} for own in values]
    found = rank_planners(totals, dict(zip(scenes, recordings)), lower_is_better=lower)
    assert found is not None
    low, high, means = slow_ranks(values, recordings, lower)
    if any(len(set(column)) < planners for column in values.T):
        # Where planners tie in a resample, the last bits may decide otherwise in the slow sum.
        near = [
            abs(rank.best - best) <= 1 and abs(rank.worst - worst) <= 1 for rank, best, worst in zip(found, low, high)
        ]
        assert all(near)
    else:
        assert [rank.best for rank in found] == low.tolist() and [rank.worst for rank in found] == high.tolist()
    assert np.allclose([(rank.low, rank.high) for rank in found], means.T)


def test_equals_share_places_and_one_recording_ranks_nobody() -> None:
    totals = [{"a": (1.0, 2.0), "b": (0.0, 2.0)}] * 3
    found = rank_planners(totals, {"a": "A", "b": "B"}, lower_is_better=True)
    assert found is not None and {(rank.best, rank.worst, rank.letters) for rank in found} == {(1, 3, "a")}
    assert rank_planners(totals, {"a": "A", "b": "A"}, lower_is_better=True) is None
    assert rank_planners([], {}, lower_is_better=True) is None
    assert find_shared_scenes([*totals, {"b": (0.0, 1.0), "c": (0.0, 1.0)}]) == ["b"]


def test_who_is_always_better_is_told_apart_in_both_directions() -> None:
    scenes = [f"s{number}" for number in range(6)]
    totals = [dict.fromkeys(scenes, (value, 1.0)) for value in (3.0, 1.0, 2.0)]
    for lower, places in ((True, [3, 1, 2]), (False, [1, 3, 2])):
        found = rank_planners(totals, dict(zip(scenes, scenes)), lower_is_better=lower)
        assert found is not None and [(rank.best, rank.worst) for rank in found] == [(at, at) for at in places]
        assert [rank.letters for rank in found] == ["abc"[at - 1] for at in places]


@settings(max_examples=60, deadline=None)
@given(st.integers(2, 7), st.integers(0, 2**32), st.floats(0.0, 1.0))
def test_letters_are_shared_exactly_by_those_that_are_not_told_apart(count: int, seed: int, share: float) -> None:
    rng = np.random.default_rng(seed)
    better = np.triu(rng.random((count, count)) < share, 1)
    letters = [set(own) for own in assign_letters(better, range(count))]
    assert all(letters)
    for one, other in combinations(range(count), 2):
        assert bool(letters[one] & letters[other]) != bool(better[one, other])


def ran(planner: str, scenes: dict[str, str], *, miniature: bool = False) -> RunRecord:
    record = told(attacked(planner, scenes, dict.fromkeys(scenes, True)))
    facts = record.run.planner.model_copy(update={"miniature": miniature})
    return replace(record, run=record.run.model_copy(update={"planner": facts}))


def test_a_failed_sample_is_the_worst_and_bystanders_and_the_innocent_count_nothing() -> None:
    totals = sum_faults_by_scene(ran("p", {"A": "f.r", "B": "F..", "C": "!.."}))
    assert totals == {"A": (1.0, 3.0), "B": (0.0, 3.0), "C": (1.0, 3.0)}


def test_the_main_table_ranks_candidates_and_miniatures_apart_and_references_not() -> None:
    clean, hit = dict.fromkeys("ABCDEF", "...."), dict.fromkeys("ABCDEF", "ff..")
    part = {name: hit[name] for name in "ABCDE"}
    runs = [ran("good", clean), ran("bad", part), ran("stop", hit)]
    runs += [ran("small", clean, miniature=True), ran("tiny", hit, miniature=True)]
    table = effect_table(DataSetRuns("d", runs))
    assert table is not None and table.columns[-1] == RANK
    shown = {cells[0]: cells[-1] for cells in table.rows}
    assert shown["good"].startswith("1 a") and shown["bad"].startswith("2 b") and shown["stop"].startswith("–")
    assert shown["small §"].startswith("1 a §") and shown["tiny §"].startswith("2 b §")
    notes = " ".join(table.notes)
    assert "Ranks of 2 planners: over 5 scenes of 5 recordings" in notes and "2 miniatures: over 6 scenes" in notes
    assert table.brief is not None and len(table.columns) - 1 in table.brief.columns


def test_drives_are_ranked_by_their_score_and_a_failed_one_is_a_zero(tmp_path: Path) -> None:
    names = [f"scene-{number}" for number in range(1, 7)]
    one = written(tmp_path / "a", *map(row, names), scenes=names)
    other = written(tmp_path / "b", *map(failed, names), scenes=names, planner={"name": "other", "privileged": False})
    assert set(average_drives_by_scene(other).values()) == {(0.0, 1.0)}
    (table,) = drive_tables([one, other])
    shown = {cells[0]: cells[-1] for cells in table.rows}
    assert table.columns[-1] == RANK and shown["made"].startswith("1 a") and shown["other"].startswith("2 b")
