"""The table of speed: both sides in turns, what is past its limits, what cannot run here, and names that are none."""

import json
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import pytest

from bench.speed import __main__ as command
from bench.speed.case import Case, format_line, format_seconds, measure
from bench.speed.cases import CASES

MADE_UP = Case(
    "made-up/one",
    "Nothing.",
    lambda quick, folder: [(quick, folder.name)],
    lambda state: (4, state),
    "thing",
    other=("slow version", lambda _: (1, "slow")),
    same=lambda state, ours, other: ours is state and other == "slow",
    more=lambda state, _: f"from {state}",
)


def clock(*spent: float) -> Callable[[], float]:
    """Each side takes the next of these seconds."""

    def ticks() -> Iterator[float]:
        now = 0.0
        for seconds in spent:
            yield now
            now += seconds
            yield now

    return ticks().__next__


def test_the_least_of_each_side_counts(tmp_path: Path) -> None:
    figures = measure(MADE_UP, tmp_path, repeat=2, clock=clock(2.0, 5.0, 1.0, 9.0))
    assert (figures["ours_s"], figures["other_s"], figures["ratio"]) == (0.25, 5.0, 20.0) and figures["wrong"] == []
    assert figures["more"] == "from [(False, '0')]" and json.loads(json.dumps(figures)) == figures
    assert format_line(figures).startswith(f"{MADE_UP.name:<32} 250 ms per thing; slow version 5 s: 20 times; from ")
    assert [format_seconds(seconds) for seconds in (90.0, 1.5e-3, 2e-6)] == ["90 s", "1.5 ms", "2 us"]


@pytest.mark.parametrize(
    ("strict", "says"),
    [
        (replace(MADE_UP, most_s=0.2), "too slow: at most 200 ms per thing are meant"),
        (replace(MADE_UP, least_ratio=30.0), "too slow: 30.00 times as fast is meant"),
        (replace(MADE_UP, most_mb=1.0), "too large: at most 1 MB are meant"),
        (replace(MADE_UP, same=lambda *_: False), "slow version: comes to something else"),
    ],
)
def test_what_is_past_its_limit_or_comes_to_something_else_is_said(tmp_path: Path, strict: Case, says: str) -> None:
    assert measure(strict, tmp_path, repeat=1, clock=clock(1.0, 5.0))["wrong"] == [says]
    (again := tmp_path / "quick").mkdir()
    quick = measure(strict, again, quick=True, repeat=1, clock=clock(1.0, 5.0))
    assert bool(quick["wrong"]) == ("something else" in says)


def test_names_choose_and_what_is_run_on_request_is_run_by_name_only(capsys: pytest.CaptureFixture[str]) -> None:
    two = (MADE_UP, replace(MADE_UP, name="made-up/two", on_request=True))
    for names, chosen in (([], 1), (["made-up"], 2), (["made-up/two"], 1)):
        assert command.main([*names, "--list"], two) == 0
        assert len(capsys.readouterr().out.splitlines()) == chosen
    assert len({case.name for case in CASES}) == len(CASES)


def test_a_case_is_measured_in_a_process_of_its_own(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["door/recording", "--quick", "--repeat", "1", "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["name"] == "door/recording" and figures["ratio"] > 0 and figures["wrong"] == []
