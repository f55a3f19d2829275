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


def test_a_fresh_state_is_made_for_each_turn(tmp_path: Path) -> None:
    figures = measure(replace(MADE_UP, fresh=True), tmp_path, quick=True, repeat=2, clock=clock(*[1.0] * 4))
    assert figures["more"] == "from [(True, '1')]"


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


def test_what_is_needed_and_is_not_here_skips_a_case(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main([], (replace(MADE_UP, needs=("no_such_package",)),)) == 0
    assert capsys.readouterr().out.split(maxsplit=1)[1] == "skipped: it needs the package no_such_package\n"


def test_an_unknown_name_is_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    assert command.main(["made-up", "none"], (MADE_UP,)) == 2
    assert "there is no case 'none'" in capsys.readouterr().err


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


def test_another_tree_is_measured_in_turns(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    figures = {"name": MADE_UP.name, "unit": "thing", "peak_mb": 1, "wrong": []}
    here = iter([{"ours_s": 3.0, "digest": "a"}, {"ours_s": 2.0, "digest": "a"}])

    def found(tree: Path, _case: Case, _given: object) -> dict[str, object]:
        return figures | (next(here) if tree == command.ROOT else {"ours_s": 5.0, "digest": "b"})

    monkeypatch.setattr(command, "measure_in_tree", found)
    assert command.main(["--against", "elsewhere"], (MADE_UP,)) == 1
    shown = capsys.readouterr().out
    assert "in the other tree 5 s: 2.50 times" in shown and "the other tree comes to something else" in shown
