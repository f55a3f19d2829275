"""What commands suggest next runs as it is printed, and is not suggested once it is done."""

import shlex
from pathlib import Path

import pytest

from benchmark.report.words import format_options
from tests.benchmark.cli.in_process import Done, run_here
from tests.benchmark.cli.small_path import SEARCH, SMALL, done
from tests.benchmark.edited_roots import small_town


def steps(run: Done) -> list[list[str]]:
    """Words of the commands that come next, without the program's name."""
    lines = run.err.splitlines()
    starts = ("next: challenger-bench ", "      challenger-bench ")
    return [shlex.split(line[len(starts[0]) :].partition("   # ")[0]) for line in lines if line.startswith(starts)]


def test_options_are_quoted_and_left_out_where_there_is_nothing() -> None:
    given = format_options(data="my data", tables=None, out=Path("a"), model=["x", "y;z"], records=())
    assert given == " --data 'my data' --out a --model x --model 'y;z'"


@pytest.fixture
def town(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A town in a folder whose name needs quotes, beside which commands run."""
    monkeypatch.chdir(tmp_path)
    return small_town(tmp_path / "my data" / "town", 1, images=True)


def test_steps_after_an_evaluation_run_as_printed(town: Path) -> None:
    command = ("eval", "--data", town, "--model", "idm", "--out", "my results", "--workers", "1")
    suggested = steps(done(run_here(*command)))
    assert [step[0] for step in suggested] == ["sheets", "leaderboard"]
    for step in suggested:
        done(run_here(*step))
    assert "next:" not in done(run_here(*command)).err
    (film, *_) = steps(done(run_here(*suggested[0])))
    assert film[0] == "film"
    done(run_here(*film, "--until", "0.2"))
    assert "next:" not in done(run_here(*suggested[0])).err
    assert "next:" in done(run_here(*command, "--model", "stop")).err, "the leaderboard lacks a planner"


def test_steps_after_a_search_and_a_drive_run_as_printed(town: Path) -> None:
    on = ("--data", town, "--out", "my results", "--workers", "1")
    command = ("generate", *on, *SMALL, *SEARCH)
    suggested = steps(done(run_here(*command)))
    assert [step[:2] for step in suggested] == [["data", "show"], ["eval", "--model"]]
    for step in suggested:
        done(run_here(*step))
    assert sorted(path.parents[1].name for path in Path("my results/runs").rglob("run.json")) == ["adv", "val"]
    assert "next:" not in done(run_here(*command)).err
    (evaluate,) = steps(done(run_here("drive", *on, "--model", "idm", "--model", "stop", "--no-baselines")))
    assert evaluate[:5] == ["eval", "--split", "adv", "--model", "stop"], "idm was evaluated before"
    done(run_here(*evaluate))
    (check,) = steps(done(run_here("leaderboard", "--no-site", "--out", "my results", "--to", "my tables")))
    assert check[-1] == "--check" and done(run_here(*check)).out.startswith("my tables is current")


def test_a_run_that_failed_everywhere_says_where_to_look_and_suggests_nothing(town: Path) -> None:
    Path("failing.py").write_text(
        "class Fails:\n    name = 'fails'\n    def reset(self, scene): ...\n"
        "    def plan(self, observation): raise ValueError('no')\n"
    )
    run = run_here("eval", "--data", town, "--model", "failing:Fails", "--out", "out", "--workers", "1")
    (tracebacks,) = Path("out").rglob("failures.txt")
    assert run.code == 1 and "next:" not in run.err and "--allow-partial" not in run.err
    assert f"(the first: ValueError: no; all tracebacks: {tracebacks})" in run.err
    assert "failing.py" in tracebacks.read_text()
