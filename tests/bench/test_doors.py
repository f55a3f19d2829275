"""Absurd options and odd planners: a small sample is answered, and ways to fall are seen."""

from pathlib import Path

import pytest

from bench.attacking.campaign import run_campaign
from bench.attacking.children import Ended
from bench.attacking.doors import ABSURD, BASES, Doors, commands_of, door_verdict, option_tries, planner_tries
from bench.attacking.planners import ODD_PLANNERS
from bench.attacking.verdicts import FALLEN, Verdict
from benchmark.cli.app import app

ENDED = Ended(2, "", "error: --limit must be at least 1, got 0\n", 1.0, 1.0, 20.0, 1 << 28)
LEFT_OUT = {"data build", "data export scenarionet", "demo", "reproduce", "serve", "train judge"}
LEFT_OUT |= {"weights anchors", "weights fetch", "weights list"}


@pytest.fixture(scope="module")
def doors(tmp_path_factory: pytest.TempPathFactory) -> Doors:
    return Doors(tmp_path_factory.mktemp("doors"), 0)


def test_a_sample_of_absurd_options_is_answered(doors: Doors) -> None:
    numbers = [number for number, tried in enumerate(doors.tries) if tried.kind.startswith("options")][:40]
    results = list(run_campaign(doors, numbers))
    assert [each for each in results if each.verdict in FALLEN] == []
    assert sum(each.code == 2 for each in results) > 25
    assert not [path for path in doors.folder.iterdir() if path.name.startswith("door-")]


def test_a_good_planner_of_others_runs_and_a_failing_one_is_a_partial_run(doors: Doors) -> None:
    places = {(tried.name, tried.arguments[0]): number for number, tried in enumerate(doors.tries)}
    codes = [doors.run(places[name, "eval"]).code for name in ("a good one", "plans nothing", "cannot be imported")]
    assert codes == [0, 1, 2]


def test_what_is_attacked_and_what_is_left_out_are_commands() -> None:
    import typer

    commands = {name for name, _ in commands_of(typer.main.get_command(app)) if name}
    assert commands >= {*BASES} | LEFT_OUT and not {*BASES} & LEFT_OUT
    tries = option_tries()
    assert {tried.command for tried in tries} == {*BASES} - {"models"}
    assert len({tried.arguments for tried in tries}) == len(tries) > 100 * len(ABSURD)
    assert len(planner_tries()) == 2 * len(ODD_PLANNERS)


@pytest.mark.parametrize(
    ("ended", "found"),
    [
        (ENDED, Verdict.ANSWERED),
        (Ended(0, "", "", 1.0, 1.0, 20.0, 0), Verdict.OTHER_INPUT),
        (Ended(1, "", "3 of 4 samples failed\n", 1.0, 1.0, 20.0, 0), Verdict.ANSWERED),
        (Ended(1, "", "", 1.0, 1.0, 20.0, 0), Verdict.UNCLEAR),
        (Ended(2, "", "error: a\nb\n", 1.0, 1.0, 20.0, 0), Verdict.UNCLEAR),
        (Ended(3, "", "error: a\n", 1.0, 1.0, 20.0, 0), Verdict.UNCLEAR),
        (Ended(-11, "", "", 1.0, 1.0, 20.0, 0), Verdict.DEATH),
        (Ended(2, "", "error: a\n", 1.0, 30.0, 20.0, 0), Verdict.HANG),
        (Ended(2, "", "error: a\n", 1.0, 1.0, 20.0, 3 << 30), Verdict.MEMORY),
        (Ended(1, "", "Traceback (most recent call last)\n", 1.0, 1.0, 20.0, 0), Verdict.TRACEBACK),
    ],
)
def test_every_way_to_fall_is_seen(ended: Ended, found: Verdict, tmp_path: Path) -> None:
    assert door_verdict(ended, tmp_path / "out") == found


def test_a_refusal_that_wrote_something_is_seen(tmp_path: Path) -> None:
    (tmp_path / "half").touch()
    assert door_verdict(ENDED, tmp_path) == Verdict.WROTE
