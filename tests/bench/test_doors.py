"""Absurd options and odd planners: a small sample is answered, and ways to fall are seen."""

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.attacking.children import CommandOutcome
from bench.attacking.doors import (
    ABSURD,
    BASES,
    REQUESTS,
    DoorCampaign,
    commands_of,
    option_tries,
    planner_tries,
    server_tries,
)
from bench.attacking.planners import ODD_PLANNERS
from bench.attacking.servers import SLOW, odd_answers
from bench.attacking.verdicts import FINE, Verdict, door_verdict
from benchmark.cli.app import app
from benchmark.extensions.http import model

ENDED = CommandOutcome(2, "", "error: --limit must be at least 1, got 0\n", 1.0, 1.0, 20.0, 1 << 28)
LEFT_OUT = {"demo"}


@pytest.fixture(scope="module")
def doors(tmp_path_factory: pytest.TempPathFactory) -> Iterator[DoorCampaign]:
    with pytest.MonkeyPatch.context() as patch:
        # What it sets for its children shall not hold for the tests that follow.
        for name in ("RETURN_S", "ALIVE_S"):
            patch.setattr(model, name, getattr(model, name))
        made = DoorCampaign(tmp_path_factory.mktemp("doors"), 0)
        yield made
        if made.server is not None:
            made.server.end()


@pytest.mark.slow
def test_a_good_planner_of_others_runs_and_a_failing_one_is_a_partial_run(doors: DoorCampaign) -> None:
    places = {(tried.name, *tried.arguments[:1]): number for number, tried in enumerate(doors.tries)}
    codes = [doors.run(places[name, "eval"]).code for name in ("a good one", "plans nothing", "cannot be imported")]
    assert codes == [0, 1, 2]


@pytest.mark.slow
def test_who_would_serve_for_ever_is_interrupted(doors: DoorCampaign) -> None:
    serving = ("serve", "--seed is a number of 400 digits"), ("serve", "--seed is a billion")
    places = {(tried.command, tried.name): place for place, tried in enumerate(doors.tries)}
    refused, interrupted = (doors.run(places[each]).code for each in serving)
    # On a machine that is busy it is interrupted before it serves.
    assert refused == 2 and interrupted in (0, 130)


@pytest.mark.slow
def test_our_server_refuses_requests_that_are_none_and_a_server_that_died_is_seen(doors: DoorCampaign) -> None:
    numbers = [place for place, tried in enumerate(doors.tries) if tried.request is not None]
    assert len(numbers) == REQUESTS and numbers[-1] == len(doors.tries) - 1
    assert {doors.run(number).verdict for number in numbers[:12]} <= {Verdict.ANSWERED, Verdict.OTHER_INPUT}
    assert doors.server is not None
    os.kill(doors.server.process, signal.SIGKILL)
    os.waitid(os.P_PID, doors.server.process, os.WEXITED | os.WNOWAIT)
    assert doors.run(numbers[12]).verdict == Verdict.DEATH and doors.run(numbers[13]).verdict in FINE


def test_what_is_attacked_and_what_is_left_out_are_commands() -> None:
    import typer

    commands = {name for name, _ in commands_of(typer.main.get_command(app)) if name}
    assert commands >= {*BASES} | LEFT_OUT and not {*BASES} & LEFT_OUT
    tries = option_tries()
    assert {tried.command for tried in tries} == {*BASES}
    assert len({tried.arguments for tried in tries}) == len(tries) > 100 * len(ABSURD)
    assert len(planner_tries()) == 2 * len(ODD_PLANNERS)
    assert len(server_tries()) == 2 * len(odd_answers()) - 3 * len(SLOW)


@pytest.mark.parametrize(
    ("ended", "found"),
    [
        (ENDED, Verdict.ANSWERED),
        (CommandOutcome(0, "", "", 1.0, 1.0, 20.0, 0), Verdict.OTHER_INPUT),
        (CommandOutcome(1, "", "3 of 4 samples failed\n", 1.0, 1.0, 20.0, 0), Verdict.ANSWERED),
        (CommandOutcome(1, "", "", 1.0, 1.0, 20.0, 0), Verdict.UNCLEAR),
        (CommandOutcome(2, "", "error: a\nb\n", 1.0, 1.0, 20.0, 0), Verdict.UNCLEAR),
        (CommandOutcome(3, "", "error: a\n", 1.0, 1.0, 20.0, 0), Verdict.UNCLEAR),
        (CommandOutcome(-11, "", "", 1.0, 1.0, 20.0, 0), Verdict.DEATH),
        (CommandOutcome(2, "", "error: a\n", 1.0, 30.0, 20.0, 0), Verdict.HANG),
        (CommandOutcome(2, "", "error: a\n", 1.0, 1.0, 20.0, 3 << 30), Verdict.MEMORY),
        (CommandOutcome(1, "", "Traceback (most recent call last)\n", 1.0, 1.0, 20.0, 0), Verdict.TRACEBACK),
    ],
)
def test_every_way_to_fall_is_seen(ended: CommandOutcome, found: Verdict, tmp_path: Path) -> None:
    assert door_verdict(ended, tmp_path / "out") == found
