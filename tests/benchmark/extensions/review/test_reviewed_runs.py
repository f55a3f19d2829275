"""Evaluations and leaderboards of reviewed splits: rejected scenes are not judged, and records name the verdicts."""

from dataclasses import replace
from pathlib import Path

import pytest

from adapters.registry import planner_factory
from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.metrics.transfer import transfer
from benchmark.records.run import load_record
from benchmark.records.run_schema import ReviewFacts
from benchmark.runs.rescoring import rescore
from leaderboard.build import build_leaderboard_tables
from leaderboard.frame.rows import review_notes
from tests.benchmark.extensions.review.small_roots import say, three_scenes
from tests.benchmark.records.hand_made_records import CLEAN, HIT, hand_made


@pytest.fixture
def data(tmp_path: Path) -> DataSet:
    return three_scenes(tmp_path / "root")


def test_an_evaluation_leaves_rejected_scenes_out_and_its_record_names_the_review(
    data: DataSet, tmp_path: Path
) -> None:
    factory = planner_factory("constant-velocity")
    before = evaluate(data, "val", factory, tmp_path / "runs")
    assert before.run.review is None and len(before.run.scenes) == 3
    say(data.root, scene_9902="leaves the road")
    reviewed = open_data(data.root)
    after = evaluate(reviewed, "val", factory, tmp_path / "runs")
    assert after.run.scenes == ["scene-9901", "scene-9903"] and after.covers_split
    assert after.run.review == reviewed.review("val").facts
    assert after.directory == before.directory and after.content_id != before.content_id
    assert load_record(after.directory).run.review == after.run.review
    assert review_notes([after]) == [f"val: {reviewed.review('val').sentence()}."]
    # Another verdict, even one that moves no number, makes the record one of other verdicts.
    say(data.root, scene_9901="accepted")
    with pytest.raises(InputError, match="other verdicts of inspectors"):
        rescore(after.directory, open_data(data.root))
    again = evaluate(open_data(data.root), "val", factory, tmp_path / "runs")
    assert again.summary == after.summary and again.content_id != after.content_id


def test_a_rejected_scene_asked_for_by_name_is_refused_with_the_reason(data: DataSet) -> None:
    say(data.root, scene_9902="leaves the road")
    with pytest.raises(InputError, match=r"scene-9902 was rejected by hand \(leaves the road\)"):
        EvalSettings(scenes=("scene-9902",)).chosen(open_data(data.root), "val")
    say(data.root, scene_9901="x", scene_9903="x")
    with pytest.raises(InputError, match="inspectors rejected all 3"):
        EvalSettings().chosen(open_data(data.root), "val")


def test_records_under_different_verdicts_never_stand_in_one_table() -> None:
    first, second = (hand_made(name, {"s0": [HIT], "s1": [CLEAN]}) for name in ("p", "q"))
    facts = ReviewFacts(content="a" * 64, accepted=1, rejected=1, not_reviewed=1)
    reviewed = replace(second, run=second.run.model_copy(update={"review": facts}))
    with pytest.raises(InputError, match=r"different verdicts of inspectors .*not reviewed and review aaaaaaaaaaaa"):
        build_leaderboard_tables([first, reviewed])
    with pytest.raises(InputError, match="other verdicts of inspectors"):
        transfer([first, reviewed])
    both = [replace(one, run=one.run.model_copy(update={"review": facts})) for one in (first, second)]
    table = build_leaderboard_tables(both)[0].front[0]
    assert "adv: 1 scene rejected by hand, 1 accepted, 1 not reviewed (review aaaaaaaaaaaa)." in table.notes
    assert "adv: not reviewed by hand." in build_leaderboard_tables([first, second])[0].front[0].notes
