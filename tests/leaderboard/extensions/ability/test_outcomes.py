"""Cells from records: what is safe, what failed, what is missing, and which records belong together."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import SceneFacts
from leaderboard.extensions.ability.fit import find_fits, summarise_posterior, write_fit
from leaderboard.extensions.ability.outcomes import GatheredOutcomes, choose_gathered, gather_outcomes
from leaderboard.frame.results import read_results
from leaderboard.site.scene_index import build_scene_index
from tests.benchmark.metrics.made_attacks import attacked, told
from tests.benchmark.records.test_drives import contact, failed, row, written
from tests.leaderboard.extensions.ability.made_fits import given_posterior

SOURCES = {"A-1": "A", "A-2": "A", "B-1": "B", "C-1": "C"}


def ran(planner: str, scenes: dict[str, str]) -> RunRecord:
    return told(attacked(planner, scenes, dict.fromkeys(scenes, True), sources=SOURCES))


def gather(records: list[RunRecord], kind: str = "contact") -> GatheredOutcomes:
    (found,) = gather_outcomes(records, [], "score" if kind == "score" else "contact", "open")
    return found


def test_a_scene_is_failed_by_one_sample_at_fault_and_a_failed_sample_is_no_hole() -> None:
    records = [ran("p", {"A-1": "f...", "A-2": "rF..", "B-1": "!..."}), ran("q", {"A-1": "....", "C-1": "ff.."})]
    matrix = gather(records).matrix
    assert matrix.planners == ("p", "q") and matrix.scenes == ("A-1", "A-2", "B-1", "C-1")
    assert matrix.recordings == ("A", "A", "B", "C") and matrix.shares_recordings and matrix.missing == 3
    assert np.array_equal(matrix.values, [[0, 1, 0, np.nan], [1, np.nan, np.nan, 0]], equal_nan=True)
    scores = gather(records, "score").matrix
    assert np.array_equal(scores.values, [[0.75, 1, 0.75, np.nan], [1, np.nan, np.nan, 0.5]], equal_nan=True)
    assert [part.tolist() for part in matrix.passed] == [[1, 1, 0, 0], [2, 1, 1, 1]]


def test_parts_of_a_split_are_put_together_and_the_larger_record_counts_twice_run_scenes() -> None:
    small, large = ran("p", {"A-1": "f..."}), ran("p", {"A-1": "....", "B-1": "...."})
    other = ran("p", {"C-1": "f..."})
    for order in ([small, large, other], [other, large, small]):
        found = gather(order)
        assert found.planners["p"].values == {"A-1": 1.0, "B-1": 1.0, "C-1": 0.0} and len(found.records) == 3


def test_other_content_is_refused_and_records_that_cannot_tell_are_left_out() -> None:
    first, second = ran("p", {"A-1": "...."}), ran("q", {"A-1": "...."})
    data = second.run.data.model_copy(update={"fingerprint": "0" * 64})
    changed = replace(second, run=second.run.model_copy(update={"data": data}))
    with pytest.raises(InputError, match="different content"):
        gather([first, changed])
    old = attacked("q", {"A-1": "f"}, {"A-1": True})
    assert gather_outcomes([old], [], "contact", "open") == []
    with pytest.raises(InputError, match=r"no records of split val of d .* split adv of d, contact, open loop"):
        choose_gathered([gather([first])], "d", "val")


def test_drives_are_safe_unless_the_adversary_is_hit_at_fault_or_the_planner_failed(tmp_path: Path) -> None:
    hit, other = {**contact(), "adversary": True}, {**contact(), "adversary": False}
    names = ["scene-1", "scene-2", "scene-3", "scene-4"]
    facts = {name: SceneFacts(source=name, manoeuvre=None, adversaries=1) for name in names}
    rows = [
        *(row(names[0], run, end="contact", contact=hit) if run else row(names[0], run) for run in (0, 1)),
        row(names[1], end="contact", contact=other),
        failed(names[2]),
        row(names[3], unlabelled=True),
    ]
    record = written(tmp_path / "a", *rows, scenes=names, scene_facts=facts)
    (found,) = gather_outcomes([], [record], "contact", "closed")
    assert found.planners["made"].values == {"scene-1": 0.0, "scene-2": 1.0, "scene-3": 0.0}
    (scores,) = gather_outcomes([], [record], "score", "closed")
    assert scores.planners["made"].values["scene-3"] == 0.0 and set(scores.planners["made"].values) == set(names[:3])
    assert "closed loop" in found.measured.words and gather_outcomes([], [record], "contact", "open") == []


def test_a_fit_knows_whether_its_records_are_the_present_ones_and_pages_of_scenes_show_it(tmp_path: Path) -> None:
    scenes = {"A-1": "f...", "B-1": "....", "C-1": "...."}
    records = [ran(name, scenes) for name in ("fair", "good", "mini", "stop")]
    found = gather(records)
    write_fit(tmp_path, summarise_posterior(given_posterior(found), found))
    (stored,) = find_fits(tmp_path, records, [])
    assert stored.current and not find_fits(tmp_path, records[1:], [])[0].current
    results = read_results(records, abilities=[stored])
    pages = build_scene_index(results.runs, results.sheets, (), frozenset(), results.abilities)
    facts = {scene["scene"]: dict(scene["page"]["facts"]) for scene in pages}
    ((words,),) = facts["A-1"]["ability scale, contact, open loop"]
    assert words.endswith("(4 of 4 planners fail)")
