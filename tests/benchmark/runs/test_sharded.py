"""Shards of an evaluation, and then the same evaluation, are the run that was never cut."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmark.evaluation import EvalSettings, evaluate, plan_shard
from benchmark.runs.units import Shard
from tests.benchmark.planners import Failing, Remembering
from tests.benchmark.runs.test_together import Made
from tests.benchmark.test_evaluation import contents, town_of_six

SETTINGS = EvalSettings(protocols=("exact", "uniad"))
KINDS = (Remembering, Failing)


def planned(out: Path, number: int, of: int, settings: EvalSettings = SETTINGS) -> None:
    plan_shard(town_of_six(), "val", [(Made(kind), settings) for kind in KINDS], out, Shard(number, of))


def evaluated(out: Path, settings: EvalSettings = SETTINGS) -> dict[str, bytes]:
    for kind in KINDS:
        evaluate(town_of_six(), "val", Made(kind), out, settings)
    return contents(out)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    return evaluated(tmp_path_factory.mktemp("whole"))


@pytest.mark.parametrize("of", [4, 8])
def test_shards_become_the_bytes_of_a_run_that_was_never_cut(tmp_path: Path, whole: dict[str, bytes], of: int) -> None:
    written: list[set[str]] = []
    for number in reversed(range(1, of + 1)):
        before = set(contents(tmp_path))
        planned(tmp_path, number, of)
        written.append(set(contents(tmp_path)) - before)
    assert sum(map(len, written)) == len(contents(tmp_path)) == len(KINDS) * 6
    kept = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("rows/*")}
    assert evaluated(tmp_path) == whole
    assert kept and all(path.stat().st_mtime_ns == at for path, at in kept.items())


def test_what_no_shard_made_or_is_damaged_is_made_by_the_run(tmp_path: Path, whole: dict[str, bytes]) -> None:
    planned(tmp_path, 2, 3)
    planned(tmp_path, 1, 2, EvalSettings(protocols=("exact",), seed=5))
    rows = sorted((tmp_path / "fake" / "val" / "failing" / "rows").iterdir())
    rows[1].write_text(rows[1].read_text()[:-5])
    assert evaluated(tmp_path) == whole


def test_a_part_of_the_scenes_can_be_cut_too(tmp_path: Path) -> None:
    some = EvalSettings(protocols=("exact",), limit=3)
    for number in (1, 2):
        planned(tmp_path / "cut", number, 2, some)
    assert evaluated(tmp_path / "cut", some) == evaluated(tmp_path / "whole", some)


@given(st.integers(1, 50), st.integers(0, 200))
def test_every_scene_is_in_one_shard_and_shards_differ_by_one(of: int, count: int) -> None:
    parts = [Shard(number, of).part(range(count)) for number in range(1, of + 1)]
    assert sorted(scene for part in parts for scene in part) == list(range(count))
    assert max(map(len, parts)) - min(map(len, parts)) <= 1
