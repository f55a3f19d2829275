"""Verdicts in files, evaluations and leaderboards: what stands, what is refused; bad files change nothing."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from adapters.registry import planner_factory
from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.statistics import list_scenes, statistics
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.metrics.transfer import transfer
from benchmark.records.review import NOT_REVIEWED, REVIEW_FILE, read_review
from benchmark.records.run import load_record
from benchmark.records.run_schema import ReviewFacts
from benchmark.runs.rescoring import rescore
from benchmark.untrusted.verdicts import read_verdicts
from leaderboard.build import build_leaderboard_tables
from leaderboard.frame.rows import review_notes
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.review.small_roots import NAMES, say, three_scenes
from tests.benchmark.records.hand_made_records import CLEAN, HIT, hand_made


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return three_scenes(tmp_path_factory.mktemp("whole") / "root").root


@pytest.fixture
def data(whole: Path, tmp_path: Path) -> DataSet:
    return open_data(Path(shutil.copytree(whole, tmp_path / "root")))


def test_without_a_verdict_nothing_is_rejected_and_it_says_so(data: DataSet) -> None:
    review = data.review("val")
    assert review.facts is None and review.rejected == {} and review.waiting == NAMES
    assert review.sentence() == NOT_REVIEWED
    assert data.scene_names("val") == NAMES


def test_rejected_scenes_are_in_no_split_and_counted(data: DataSet) -> None:
    say(data.root, scene_9902="leaves the road", scene_9903="accepted")
    opened = open_data(data.root)
    assert opened.scene_names("val") == list_scenes(data.root, "val") == ("scene-9901", "scene-9903")
    assert opened.scene_names(None) == list_scenes(data.root) == NAMES
    facts = opened.review("val").facts
    assert facts is not None and (facts.accepted, facts.rejected, facts.not_reviewed) == (1, 1, 1)
    assert opened.review("val").sentence().startswith("1 scene rejected by hand, 1 accepted, 1 not reviewed (review ")
    assert statistics(data.root, split="val").counts.scenes == 2
    assert statistics(data.root).counts.scenes == 3
    # The data are what they were.
    assert opened.fingerprint() == data.fingerprint()


def test_the_hash_is_of_verdicts_and_not_of_words(data: DataSet) -> None:
    def content() -> str:
        facts = open_data(data.root).review("val").facts
        assert facts is not None
        return facts.content

    say(data.root, scene_9902="leaves the road")
    first = content()
    say(data.root, scene_9902="leaves the rode, look at 3 s")
    assert content() == first
    say(data.root, scene_9903="accepted")
    second = content()
    say(data.root, scene_9902="accepted")
    assert len({first, second, content()}) == 3


def test_a_verdict_on_other_content_does_not_stand(data: DataSet) -> None:
    say(data.root, scene_9902="leaves the road")
    path = data.root / REVIEW_FILE
    path.write_text(path.read_text().replace(read_review(data.root)["scene-9902"].token, "0" * 32))
    review = open_data(data.root).review("val")
    assert (review.facts, review.outdated, review.rejected) == (None, ("scene-9902",), {})
    assert review.sentence() == "not reviewed; 1 older verdict on other content"


def test_roots_side_by_side_may_have_verdicts_each_and_together(whole: Path, tmp_path: Path) -> None:
    for folder in ("v0", "v1"):
        shutil.copytree(whole, tmp_path / folder)
    say(tmp_path / "v0", scene_9901="leaves the road")
    outer = {"v0/scene-9902": "x", "v1/scene-9901": "y"}
    said = json.dumps({name: {"verdict": "rejected", "reason": why} for name, why in outer.items()})
    (tmp_path / "said.json").write_text(said)
    assert run_here("data", "review", tmp_path, "--verdicts", tmp_path / "said.json").code == 0
    kept = ("v0/scene-9903", "v1/scene-9902", "v1/scene-9903")
    opened = open_data(tmp_path)
    assert opened.scene_names("val") == list_scenes(tmp_path, "val") == kept
    assert opened.review("val").rejected == {"v0/scene-9901": "leaves the road", **outer}
    assert statistics(tmp_path, split="val").counts.scenes == 3


@pytest.mark.path
@pytest.mark.parametrize("name", ["said.csv", "said.json"])
def test_a_file_of_verdicts_is_recorded_whole_and_printed(data: DataSet, tmp_path: Path, name: str) -> None:
    rows = {"scene-9901": ("accept", ""), "scene-9903": ("Rejected", "two cars, one place")}
    if name.endswith("csv"):
        text = "scene,verdict,reason\n" + "".join(f'{key},{said},"{why}"\n' for key, (said, why) in rows.items())
    else:
        text = json.dumps({key: {"verdict": said, "reason": why} for key, (said, why) in rows.items()})
    (tmp_path / name).write_text(text)
    done = run_here("data", "review", data.root, "--verdicts", tmp_path / name)
    assert done.code == 0, done.err
    assert "rejected: scene-9903: two cars, one place" in done.out and "2 verdicts recorded" in done.err
    listed = json.loads(run_here("data", "review", data.root, "--list", "--json").out)
    assert listed["review"]["rejected"] == 1 and listed["verdicts"]["scene-9901"]["verdict"] == "accepted"
    # What the command wrote is a file of verdicts itself.
    again = read_verdicts(data.root / REVIEW_FILE)
    assert set(again) == set(rows) and again["scene-9903"]["verdict"] == "rejected"


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("v.csv", "scene,verdict\nscene-9901,rejected\n", "a rejected scene needs a reason"),
        ("v.csv", "scene,verdict\nscene-9901,perhaps\n", "accepted or rejected"),
        ("v.csv", "scene,verdict\nscene-9999,accepted\n", "names scene-9999, which is not a scene of"),
        ("v.csv", "name,verdict\nscene-9901,accepted\n", "must have the columns scene, verdict"),
        ("v.csv", "scene,verdict\nscene-9901,accepted\nscene-9901,accepted\n", "names a scene twice"),
        ("v.csv", "scene,verdict\nscene-9901,accepted,more,and,more,and more\n", "must have the columns"),
        ("v.csv", 'scene,verdict\n"scene-9901,accepted\n', "not a CSV file"),
        ("v.csv", "scene,verdict\n\udcff", "not a CSV file"),
        ("v.csv", f"scene,verdict,reason\nscene-9901,rejected,{'x' * 501}\n", "at most 500"),
        ("v.csv", f"scene,verdict,reason\nscene-9901,rejected,{'x' * 70_000}\n", "a line longer than"),
        ("v.json", '{"scene-9901": "rejected"}', "an object of verdicts"),
        ("v.json", '{"scene-9901": {"verdict": "rejected", "reason": "a\\u0007b"}}', "printable"),
        ("v.json", '{"scene-9901": {"verdict": "accepted", "mood": "good"}}', "mood"),
        ("v.json", '{"format": "challenger-bench review"}', "an object of verdicts"),
        ("v.json", "[" * 100, "not valid JSON"),
        ("v.txt", "", "must end in .csv or .json"),
    ],
)
def test_bad_files_of_verdicts_are_one_sentence_and_change_nothing(
    data: DataSet, tmp_path: Path, name: str, text: str, says: str
) -> None:
    path = tmp_path / name
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    sentence = refusal("data", "review", data.root, "--verdicts", path)
    assert says in sentence and "\n" not in sentence
    assert not (data.root / REVIEW_FILE).exists()


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("{", "not valid JSON"),
        ("[]", "not a valid review"),
        ('{"format": "challenger-bench review", "schema": 2, "verdicts": {}}', "upgrade"),
        ('{"format": "challenger-bench review", "schema": 1, "verdicts": {"a": {}}}', "verdicts.a"),
    ],
)
def test_a_damaged_review_stops_whoever_reads_the_split(data: DataSet, text: str, says: str) -> None:
    (data.root / REVIEW_FILE).write_text(text)
    for read in (open_data, lambda root: list_scenes(root, "val")):
        with pytest.raises(InputError, match=says) as raised:
            read(data.root)
        assert REVIEW_FILE in str(raised.value) and "\n" not in str(raised.value)


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
