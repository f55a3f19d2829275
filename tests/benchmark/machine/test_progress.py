"""Progress says what is true: counts of what the user counts, time left from work done, with a clock of our own."""

import io
import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from benchmark.machine.progress import CountedUnits, ProgressReporter, format_duration, track_progress

ROOT = Path(__file__).resolve().parents[3]


@pytest.fixture(autouse=True)
def _terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")


@dataclass
class Clock:
    """A clock that somebody turns."""

    seconds: float = 100.0

    def __call__(self) -> float:
        return self.seconds


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def watched(
    watch: ProgressReporter, clock: Clock, each_s: float, units: int, count: CountedUnits | None = None
) -> Iterator[str]:
    """Units of work, with what was told by the end of each."""

    def work() -> Iterator[int]:
        for unit in range(units):
            clock.seconds += each_s
            yield unit

    stream = watch.stream
    assert isinstance(stream, io.StringIO)
    for _ in track_progress(work(), total=units, label="rendering", count=count, watch=watch):
        before = len(stream.getvalue())
        watch.tick()
        yield plain(stream.getvalue()[before:])


def plain(told: str) -> str:
    """The last line of what a terminal was told, without colours and the bar."""
    line = re.sub(r"\x1b\[[\d;?]*\w", "", told).split("\r")[-1]
    return re.sub(r" +[━╸╺]+ +", ": ", line).rstrip("\n")


def test_a_terminal_has_one_bar_with_the_time_left_from_work_done() -> None:
    clock, stream = Clock(), Terminal()
    lines = list(watched(ProgressReporter(stream, clock, beat=False), clock, 10.0, 3))
    assert [line.strip() for line in lines] == [
        "rendering: 1 of 3 scenes, 0:10, about 0:20 left",
        "rendering: 2 of 3 scenes, 0:20, about 0:10 left",
        "rendering: 3 of 3 scenes, 0:30",
    ]
    assert "━" in stream.getvalue() and stream.getvalue().endswith("\x1b[2K"), "the line is gone"


def test_a_line_fits_and_says_how_far_the_work_is_however_long_its_label(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmark.machine.progress.find_terminal_width", lambda: 70)
    clock, stream = Clock(), Terminal()
    watch = ProgressReporter(stream, clock, beat=False)
    with watch.work("a label that takes more room than there is, " * 3, 3, CountedUnits()) as work:
        clock.seconds += 10.0
        work.add("scene")
        watch.tick()
        told = plain(stream.getvalue())
    assert told.endswith(": 1 of 3 scenes, 0:10, about 0:20 left") and told.startswith("a label") and len(told) < 60


def test_a_terminal_without_a_cursor_has_no_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "dumb")
    clock, stream = Clock(), Terminal()
    list(watched(ProgressReporter(stream, clock, beat=False), clock, 50.0, 2))
    assert stream.getvalue() == "rendering: 2 of 2 scenes, 1:40\n"


def test_short_work_says_nothing() -> None:
    clock, stream = Clock(), Terminal()
    assert list(watched(ProgressReporter(stream, clock, beat=False), clock, 0.4, 4)) == [""] * 4
    assert stream.getvalue() == ""


def test_without_a_terminal_there_is_a_line_a_minute_over_all_work() -> None:
    clock, stream = Clock(), io.StringIO()
    watch = ProgressReporter(stream, clock, beat=False)
    for _ in range(3):
        list(watched(watch, clock, 25.0, 4))
    assert stream.getvalue().splitlines() == [
        "rendering: 3 of 4 scenes, 1:15, about 0:25 left",
        "rendering: 2 of 4 scenes, 0:50, about 0:50 left",
        "rendering: 1 of 4 scenes, 0:25, about 1:15 left",
        "rendering: 4 of 4 scenes, 1:40",
    ]


def test_what_was_there_before_makes_nothing_look_quicker() -> None:
    clock, stream = Clock(), Terminal()
    count = CountedUnits("vehicle", before=2, total=6, kept=lambda unit: unit < 2)
    lines = [line.strip() for line in watched(ProgressReporter(stream, clock, beat=False), clock, 10.0, 4, count)]
    assert lines == [
        "rendering: 3 of 6 vehicles, 0:10",
        "rendering: 4 of 6 vehicles, 0:20",
        "rendering: 5 of 6 vehicles, 0:30, about 0:30 left",
        "rendering: 6 of 6 vehicles, 0:40",
    ]


def test_the_parts_of_a_unit_stand_in_brackets_and_count_for_the_time_left() -> None:
    clock, stream = Clock(), Terminal()
    watch = ProgressReporter(stream, clock, beat=False)
    with watch.work("planning", 3, CountedUnits()) as scenes:
        lines = [line.strip() for line in watched(watch, clock, 10.0, 4, CountedUnits("sample"))]
        scenes.add("a scene")
        watch.tick()
        told = plain(stream.getvalue())
    assert lines == [
        "planning: 0 of 3 scenes (1 of 4 samples), 0:10, about 1:50 left",
        "planning: 0 of 3 scenes (2 of 4 samples), 0:20, about 1:40 left",
        "planning: 0 of 3 scenes (3 of 4 samples), 0:30, about 1:30 left",
        "planning: 0 of 3 scenes (4 of 4 samples), 0:40, about 1:20 left",
    ]
    assert told == "planning: 1 of 3 scenes, 0:40, about 1:20 left"


def test_durations() -> None:
    assert [format_duration(seconds) for seconds in (-1.0, 0.4, 41.0, 725.0, 3723.0)] == [
        *("0:00", "0:00", "0:41", "12:05", "1:02:03")
    ]


PROGRAM = """
import json
from benchmark.machine import progress
from benchmark.machine.workers import LocalProcesses
from tests.benchmark.machine import units_of_work
if __name__ == "__main__":
    progress.QUIET_S = 0.0
    progress.LINE_EVERY_S = 0.2
    progress._REDRAWN_EVERY_S = 0.05
    count = progress.CountedUnits("pause")
    results = LocalProcesses(2).map(units_of_work.pause, range(8), total=8, label="pausing", count=count)
    print(json.dumps(list(results)))
"""


def test_a_heart_beats_on_stderr_and_stdout_is_the_commands_own() -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    program = [sys.executable, "-c", PROGRAM]
    said = subprocess.run(program, cwd=ROOT, env=environment, capture_output=True, text=True, check=True)
    assert json.loads(said.stdout) == list(range(8))
    lines = said.stderr.splitlines()
    assert len(lines) >= 3 and all(re.match(r"pausing: \d of 8 pauses, \d+:\d\d", line) for line in lines)
    done = [int(line.split()[1]) for line in lines]
    assert done == sorted(done)
