"""The page of measured results, and that anything it rests on makes it stale."""

import json
from pathlib import Path
from typing import Any

import pytest

from benchmark.cli.demo import stale_demo
from benchmark.machine.storage import read_json
from benchmark.records.run import RunRecord
from leaderboard.results import NUMBERS, PAGE, find_stale_results, write_results
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.records.hand_made_records import CLEAN, HIT, hand_made
from tests.leaderboard.made_up import study

MADE_FROM: dict[str, Any] = {"weights": {"uniad-mini": "a"}, "town": "mini-1", "protocols": {"exact": 1}}
RESULTS = Path(__file__).resolve().parents[2] / "docs" / "results"


@pytest.fixture
def records() -> list[RunRecord]:
    worse = {"s1": [HIT, CLEAN], "s2": [CLEAN, CLEAN]}
    better = {"s1": [CLEAN, CLEAN], "s2": [CLEAN, HIT]}
    calm = {"s1": [CLEAN, CLEAN], "s2": [CLEAN, CLEAN]}
    return [
        hand_made(name, scenes, split=split)
        for name, driven in (("one", worse), ("two", better))
        for split, scenes in (("val", calm), ("val-r", calm), ("adv", driven))
    ]


def written(records: list[RunRecord], folder: Path) -> dict[str, bytes]:
    files = write_results("d", records, [study()], MADE_FROM, folder)
    return {path.name: path.read_bytes() for path in files}


def test_the_page_has_all_that_is_measured_and_the_same_bytes_twice(records: list[RunRecord], tmp_path: Path) -> None:
    first = written(records, tmp_path / "a")
    assert first == written(list(reversed(records)), tmp_path / "b") and set(first) == {PAGE, NUMBERS}
    page = first[PAGE].decode()
    for said in ("Collision", "Transfer", "ablation of the search with p", "not for ranking"):
        assert said.lower() in page.lower()
    names = [table["name"] for table in read_json(tmp_path / "a" / NUMBERS)["tables"]]
    assert len(set(names)) == len(names) >= 4
    assert find_stale_results(tmp_path / "a", MADE_FROM) == []


def test_anything_that_has_changed_is_named(records: list[RunRecord], tmp_path: Path) -> None:
    written(records, tmp_path)
    for name in MADE_FROM:
        assert find_stale_results(tmp_path, MADE_FROM | {name: "other"}) == [
            f"{name} has changed since {tmp_path / NUMBERS} was written"
        ]
        without = {key: value for key, value in MADE_FROM.items() if key != name}
        assert len(find_stale_results(tmp_path, without)) == 1


def test_a_page_that_was_edited_or_lost_is_stale(records: list[RunRecord], tmp_path: Path) -> None:
    written(records, tmp_path)
    page = tmp_path / PAGE
    page.write_text(page.read_text() + "and more\n")
    assert find_stale_results(tmp_path, MADE_FROM) == [f"{page} does not match {tmp_path / NUMBERS}"]
    page.unlink()
    assert len(find_stale_results(tmp_path, MADE_FROM)) == 1
    (tmp_path / NUMBERS).write_text("{")
    assert find_stale_results(tmp_path, MADE_FROM) == [f"there are no results in {tmp_path}"]


def test_checking_without_full_is_wrong_use_and_nothing_there_is_stale(tmp_path: Path) -> None:
    wrong = run_here("demo", "--check")
    assert wrong.code == 2 and "--check applies only to demo --full" in wrong.err
    absent = run_here("demo", "--full", "--check", "--to", tmp_path, "--json")
    assert absent.code == 1 and json.loads(absent.out) == {"stale": [f"there are no results in {tmp_path}"]}


def test_the_results_in_the_documentation_are_current() -> None:
    assert stale_demo(RESULTS) == []
