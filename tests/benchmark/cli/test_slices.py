"""``leaderboard slices`` and ``eval --by``: what is printed, as tables and as JSON, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import typer

from benchmark.cli.app import app
from benchmark.cli.eval_options import EvalOptions
from benchmark.cli.evaluate import _show_runs
from benchmark.evaluation import evaluate
from benchmark.metrics.slices import KINDS
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.planners import Straight


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out") / "runs"
    evaluate(town_of_two(slow_leader=True), "val", Straight(), folder)
    return folder


def printed(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    command = ["leaderboard", "slices", *map(str, arguments)]
    typer.main.get_command(app).main(command, prog_name="challenger-bench", standalone_mode=False)
    return capsys.readouterr().out


def test_all_kinds_are_printed_unless_some_are_asked_for(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    every = printed(capsys, "--records", runs)
    assert [kind for kind in KINDS if f" by {kind}, protocol exact" in every] == ["place", "light", "speed", "command"]
    by_speed = printed(capsys, "--records", runs, "--by", "speed", "--protocol", "pdm", "--protocol", "diagnosis")
    assert "5 to 10 m/s" in by_speed and "driving scores (%) by speed" in by_speed
    assert "causes of collisions" in by_speed and "by place" not in by_speed and "protocol vad" not in by_speed
    assert max(map(len, by_speed.splitlines())) <= 80


def test_machines_get_tables_with_the_facts_behind_them(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (table,) = json.loads(printed(capsys, "--records", runs, "--by", "place", "--protocol", "vad", "--json"))
    assert table["name"] == "slices-place-vad" and [row[2] for row in table["rows"]] == ["straight"]
    assert table["cells"][0][3]["protocol"] == "vad"


def test_eval_prints_them_behind_its_tables_and_in_its_json(runs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    record = evaluate(town_of_two(slow_leader=True), "val", Straight(), runs)
    by_place = EvalOptions(by=("place",))
    assert _show_runs("fake", [record], None, runs, by_place)
    text = capsys.readouterr().out
    assert text.index("protocol exact (version") < text.index("by place, protocol exact")
    assert _show_runs("fake", [record], None, runs, replace(by_place, json_output=True))
    said = json.loads(capsys.readouterr().out)
    assert said["slices"][0]["name"] == "slices-place-exact" and said["runs"][0]["status"] == "complete"
    assert _show_runs("fake", [record], None, runs, EvalOptions(json_output=True))
    assert json.loads(capsys.readouterr().out)[0]["status"] == "complete"


def test_what_is_not_there_is_said(runs: Path) -> None:
    assert "no matching run records" in refusal("leaderboard", "slices", "--records", runs, "--split", "adv")
    assert "fake (val: straight)" in refusal("leaderboard", "slices", "--records", runs, "--data", "other")
    assert "unknown protocol 'nonsense'" in refusal(
        "leaderboard", "slices", "--records", runs, "--protocol", "nonsense"
    )
    assert "--by" in refusal("leaderboard", "slices", "--records", runs, "--by", "nonsense")
