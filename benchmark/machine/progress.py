"""How far lasting work is, told on stderr: a bar with the time left on a terminal, a line a minute where there is none.

What is counted is what the user counts (scenes, vehicles, samples), and the time left follows from what was made since
the work began: what an earlier command had finished counts as done and makes nothing look quicker than it is. The
outermost work has the line; how far the work is that its present unit consists of stands in brackets.
"""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, TextIO, TypeVar

from benchmark.report.terminal import find_terminal_width
from benchmark.report.words import pluralise

if TYPE_CHECKING:
    from rich.progress import Progress

Result = TypeVar("Result")

QUIET_S: Final = 2.0
"""Shorter work is not worth a line."""
LINE_EVERY_S: Final = 60.0
"""Where there is no terminal; over all work of a command together."""
_REDRAWN_EVERY_S: Final = 0.5
_BAR_COLUMNS: Final = 12


def _one(_: Any) -> int:
    return 1


def _none(_: Any) -> bool:
    return False


@dataclass(frozen=True, slots=True)
class CountedUnits:
    """Things that are counted of some work.

    Attributes:
        noun: In the singular.
        before: How many were finished before the work began, by an earlier command.
        total: ``before`` and one for each unit of work by default.
        each: How many a result stands for.
        kept: Whether a result was there before and only had to be found.
    """

    noun: str = "scene"
    before: int = 0
    total: int | None = None
    each: Callable[[Any], int] = _one
    kept: Callable[[Any], bool] = _none


class WorkProgress:
    """Progress of one piece of work; ``begun_s`` is on the clock of its watch."""

    def __init__(self, label: str, units: int, count: CountedUnits, begun_s: float) -> None:
        self.label, self.noun, self.begun_s = label, count.noun, begun_s
        self.total = count.before + units if count.total is None else count.total
        self._count = count
        self._done = count.before
        self._made = 0
        self._lock = threading.Lock()

    def add(self, result: Any) -> None:
        """A unit is finished; may be called from any thread."""
        amount, is_cached = self._count.each(result), self._count.kept(result)
        with self._lock:
            self._done += amount
            self._made += 0 if is_cached else amount

    def sentence(self, now_s: float, unit: "WorkProgress | None" = None) -> str:
        """How far it is: for example ``rendering: 3 of 10 scenes (9 of 40 frames), 0:30, about 1:04 left``.

        Without the time left before anything was made. ``now_s`` is on the clock of its watch; ``unit`` is the work
        that one of its units consists of, if that is under way.
        """
        return f"{self.label}: {self.state(now_s, unit)}"

    def state(self, now_s: float, unit: "WorkProgress | None" = None) -> str:
        """The `sentence` without what is done."""
        with self._lock:
            done, fresh = self._done, float(self._made)
        gone_s, left, within = now_s - self.begun_s, float(self.total - done), ""
        if unit is not None and left > 0:
            share = unit.share()
            fresh, left = fresh + share, left - share
            within = f" ({unit.counts()})"
        text = f"{self.counts()}{within}, {format_duration(gone_s)}"
        return f"{text}, about {format_duration(gone_s * left / fresh)} left" if fresh and left > 0 else text

    def counts(self) -> str:
        """How many there are of how many."""
        return f"{self._done:,} of {pluralise(self.total, self.noun)}"

    def share(self) -> float:
        """Which part of it is done, 0..1."""
        return self._done / self.total if self.total else 1.0


@dataclass(slots=True)
class ProgressReporter:
    """Watch that tells how far work is, on stderr at the time of each line by default.

    ``clock`` gives seconds from any beginning. With ``beat`` a thread ticks; else the caller has to call `tick`.
    """

    stream: TextIO | None = None
    clock: Callable[[], float] = time.monotonic
    beat: bool = True
    _works: list[WorkProgress] = field(default_factory=list)
    _lock: threading.RLock = field(default_factory=threading.RLock)
    _line_s: float | None = None
    _bar: "Progress | None" = None
    _silent: bool = False

    def silence(self) -> None:
        """Say nothing any more: in a worker, whose command tells."""
        self._silent = True

    @contextlib.contextmanager
    def work(self, label: str, units: int, count: CountedUnits) -> Iterator[WorkProgress]:
        """Watch a piece of work, of which finished units are to be told."""
        now_s = self.clock()
        self._line_s = now_s if self._line_s is None else self._line_s
        work, over = WorkProgress(label, units, count, now_s), threading.Event()
        self._works.append(work)
        beats = self.beat and not self._silent and len(self._works) == 1
        if beats:
            threading.Thread(target=self._tick_until, args=(over,), daemon=True).start()
        try:
            yield work
        finally:
            over.set()
            with self._lock:
                self._works.remove(work)
                self._clear()

    def tick(self) -> None:
        """Tell what there is to tell now."""
        with self._lock:
            if self._silent or not self._works:
                return
            stream, now_s, work = self.stream or sys.stderr, self.clock(), self._works[0]
            unit = self._works[-1] if self._works[-1].noun != work.noun else None
            if now_s - work.begun_s < QUIET_S:
                return
            if stream.isatty() and (bar := self._bar or self._new_bar(stream, work)) is not None:
                state, inner = work.state(now_s, unit), 0.0 if unit is None else unit.share()
                # The state is shown in full; the label is cut to the remaining width.
                room = max(bar.console.width - _BAR_COLUMNS - len(state) - 2, 0)
                label = work.label if len(work.label) <= room else f"{work.label[: room - 3]}..." if room > 3 else ""
                done = work.share() * work.total + inner
                bar.update(bar.task_ids[0], description=label, completed=done, state=state)
                bar.refresh()
            elif self._line_s is not None and now_s - self._line_s >= LINE_EVERY_S:
                self._line_s = now_s
                stream.write(f"{work.sentence(now_s, unit)}\n")
                stream.flush()

    def _tick_until(self, over: threading.Event) -> None:
        while not over.wait(_REDRAWN_EVERY_S):
            # A closed stream needs no progress.
            with contextlib.suppress(OSError, ValueError):
                self.tick()

    def _new_bar(self, stream: TextIO, work: WorkProgress) -> "Progress | None":
        """Begin a bar; none on a terminal that cannot move its cursor."""
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        console = Console(file=stream, width=find_terminal_width() - 1, highlight=False)
        if console.is_dumb_terminal:
            return None
        label, state = TextColumn("{task.description}", markup=False), TextColumn("{task.fields[state]}", markup=False)
        quiet: dict[str, Any] = {"auto_refresh": False, "redirect_stdout": False, "redirect_stderr": False}
        columns = (label, BarColumn(_BAR_COLUMNS), state)
        self._bar = Progress(*columns, console=console, transient=True, **quiet)
        self._bar.add_task("", total=work.total, state="")
        self._bar.start()
        return self._bar

    def _clear(self) -> None:
        bar, self._bar = self._bar, None
        if bar is not None:
            with contextlib.suppress(OSError, ValueError):
                bar.stop()


PROGRESS_REPORTER: Final = ProgressReporter()
"""The one of this process."""


def track_progress(
    results: Iterable[Result],
    *,
    total: int,
    label: str,
    count: CountedUnits | None = None,
    watch: ProgressReporter = PROGRESS_REPORTER,
) -> Iterator[Result]:
    """Pass results through and tell how far the work is; scenes are counted by default."""
    with watch.work(label, total, count or CountedUnits()) as work:
        for result in results:
            work.add(result)
            yield result


def format_duration(seconds: float) -> str:
    """A duration as minutes and seconds, or hours, minutes and seconds: ``0:41``, ``12:05``, ``1:02:03``."""
    minutes, rest = divmod(round(max(seconds, 0.0)), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
