"""Shards that are merged are the run that was never cut; what is missing is named."""

import json
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.runs.sharded import merge_shards, plan_shard
from benchmark.runs.shards import Shard
from tests.benchmark.planners import Failing, Remembering
from tests.benchmark.runs.test_together import Made
from tests.benchmark.test_evaluation import contents, town_of_six

SETTINGS = EvalSettings(protocols=("exact", "uniad"))


def planned(out: Path, number: int, of: int, settings: EvalSettings = SETTINGS) -> None:
    kinds = [(Made(kind), settings) for kind in (Remembering, Failing)]
    plan_shard(town_of_six(), "val", kinds, out, Shard(number, of))


def merged(out: Path, name: str = "fake") -> list[str]:
    return [record.planner for record in merge_shards(out, lambda split: town_of_six(), name)]


@pytest.mark.parametrize("of", [1, 4, 8])
def test_merged_shards_are_the_bytes_of_a_run_that_was_never_cut(tmp_path: Path, of: int) -> None:
    written: list[set[str]] = []
    for number in reversed(range(1, of + 1)):
        before = set(contents(tmp_path / "cut"))
        planned(tmp_path / "cut", number, of)
        written.append(set(contents(tmp_path / "cut")) - before)
    assert sum(map(len, written)) == len(contents(tmp_path / "cut"))
    assert merged(tmp_path / "cut") == ["failing", "remembering"]
    for kind in (Remembering, Failing):
        evaluate(town_of_six(), "val", Made(kind), tmp_path / "whole", SETTINGS)
    assert contents(tmp_path / "cut") == contents(tmp_path / "whole")
    assert not list((tmp_path / "cut").rglob("shards"))
    with pytest.raises(InputError, match="no shards of runs on fake"):
        merged(tmp_path / "cut")


def test_a_part_of_the_scenes_can_be_cut_too(tmp_path: Path) -> None:
    some = EvalSettings(protocols=("exact",), limit=3)
    for number in (1, 2):
        plan_shard(town_of_six(), "val", [(Made(Failing), some)], tmp_path / "cut", Shard(number, 2))
    merged(tmp_path / "cut")
    evaluate(town_of_six(), "val", Made(Failing), tmp_path / "whole", some)
    assert contents(tmp_path / "cut") == contents(tmp_path / "whole")


def test_what_is_missing_or_does_not_go_together_is_named(tmp_path: Path) -> None:
    planned(tmp_path, 1, 3)
    with pytest.raises(InputError, match=r"shard 2/3, 3/3 is missing; run the same eval command with --shard 2/3"):
        merged(tmp_path)
    with pytest.raises(InputError, match="no shards of runs on other"):
        list(merge_shards(tmp_path, lambda split: town_of_six(), "other"))
    planned(tmp_path, 2, 3)
    planned(tmp_path, 3, 3, EvalSettings(protocols=("exact",)))
    with pytest.raises(InputError, match=r"shards 1/3 and 3/3 are not of one run \(protocols differs\)"):
        merged(tmp_path)
    planned(tmp_path, 3, 3)
    rows = sorted((tmp_path / "fake" / "val" / "failing" / "rows").iterdir())
    rows[1].write_text(rows[1].read_text()[:-5])
    with pytest.raises(InputError, match="missing or damaged, which shard 2/3 makes"):
        merged(tmp_path)
    planned(tmp_path, 2, 3)
    first = tmp_path / "fake" / "val" / "failing" / "shards" / "1-of-3" / "shard.json"
    first.write_text(json.dumps({**json.loads(first.read_text()), "seed": "no number"}))
    with pytest.raises(InputError, match=r"shard.json is not that of a shard: seed"):
        merged(tmp_path)
    planned(tmp_path, 1, 3)
    planned(tmp_path, 1, 2)
    with pytest.raises(InputError, match=r"in shards of 2 and of 3"):
        merged(tmp_path)


@pytest.mark.parametrize("text", ["", "3", "0/4", "5/4", "1/0", "-1/2", "1/2/3", "a/b", "1 / 2"])
def test_what_is_no_shard_is_a_sentence(text: str) -> None:
    with pytest.raises(InputError, match="--shard takes a number and how many"):
        Shard.named(text)


@given(st.integers(1, 50), st.integers(0, 200))
def test_every_scene_is_in_one_shard_and_shards_differ_by_one(of: int, count: int) -> None:
    parts = [Shard(number, of).part(range(count)) for number in range(1, of + 1)]
    assert sorted(scene for part in parts for scene in part) == list(range(count))
    assert max(map(len, parts)) - min(map(len, parts)) <= 1
