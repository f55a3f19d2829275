"""Runs on one data set in the order of tables, each with what is measured of it: one row of a table."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Generic, TypeVar

from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.scores import ScoredSamples, score_record
from benchmark.records.run import NATIVE, RunRecord, resolve_protocol
from benchmark.records.run_schema import ProtocolSummary
from benchmark.report.cells import AnyRate, CellSource, TableCell, ValueSource, make_value_source
from leaderboard.frame.rows import (
    add_caveat_mark,
    list_splits,
    name_cell,
    row_name,
    run_notes,
    sort_for_tables,
    stale_notes,
)
from leaderboard.frame.specification import Value

Measurement = TypeVar("Measurement")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class RunRow(Generic[Measurement]):
    """A run as a row of a table; cells name record and `judge`: the protocol or definition, empty without one."""

    record: RunRecord
    judge: str
    found: Measurement

    @property
    def planner(self) -> TableCell:
        """The planner's name with the marks of what it is."""
        return name_cell(self.record.planner, self.record.run.planner)

    @property
    def with_caveats(self) -> TableCell:
        """Name of the planner, marked where its numbers lacked something."""
        return add_caveat_mark(self.planner, self.record.run)

    @property
    def name(self) -> TableCell:
        """Name of the planner with all marks: reproduced by others, judged by an earlier version of the protocol."""
        return row_name(self.record, self.judge)

    @property
    def names(self) -> dict[str, Value]:
        """The two values that most tables of runs begin with."""
        return {"planner": self.name, "split": self.split}

    @property
    def split(self) -> str:
        """The split that it ran on."""
        return self.record.run.split

    @property
    def describe_run(self) -> str:
        """The run in sentences."""
        return f"{self.record.planner} on {self.split}"

    @property
    def origin(self) -> ValueSource:
        """Origin of its numbers."""
        return make_value_source(self.record, self.judge or None)

    def samples(self, count: int) -> CellSource:
        """Cell of a count of its samples."""
        return self.origin.count(count, "samples", self.record.summary.samples)

    def scenes(self, count: int) -> CellSource:
        """Cell of a count of the scenes that ran."""
        return self.origin.count(count, "scenes", len(self.record.run.scenes))

    def scenes_of_split(self) -> CellSource:
        """Cell of the number of scenes of its split that ran."""
        return self.origin.count(len(self.record.run.scenes), "scenes", self.record.run.scenes_in_split)

    def by_horizon(self, head: str, column: str, rates: Mapping[str, AnyRate]) -> dict[str, Value]:
        """Rates by horizon, which ``head`` names: L2 in metres, those of all other columns in per cent."""
        origin, metres = self.origin, column == "l2"
        return {
            head.format(horizon): origin.amount(rate, "m") if metres else origin.percent(rate)
            for horizon, rate in rates.items()
        }


class DataSetRuns:
    """The runs on one data set in the order of tables, and what was measured of them, each thing once.

    `given` are the records as they were given, `against` further ones to compare with, the newest last.
    """

    def __init__(self, data_name: str, records: Iterable[RunRecord], against: Iterable[RunRecord] = ()) -> None:
        self.data_name, self.given, self.against = data_name, tuple(records), tuple(against)
        self.runs = tuple(sort_for_tables(self.given))
        self._made: dict[Any, Any] = {}
        self._scored: dict[tuple[int, str], ScoredSamples] = {}

    @cached_property
    def splits(self) -> list[str]:
        """Splits that were run, in their order."""
        return list_splits(self.runs)

    @cached_property
    def protocols(self) -> set[str]:
        """Protocols that judged any run."""
        return {name for record in self.runs for name in record.summary.protocols}

    @property
    def has_native(self) -> bool:
        """Whether any planner has a native protocol."""
        return any(record.run.planner.native_protocol for record in self.runs)

    @cached_property
    def judges(self) -> list[str]:
        """Judges whose verdicts come first: ``exact``, and each planner's own protocol where one has it."""
        return [*((EXACT,) if EXACT in self.protocols else ()), *((NATIVE,) if self.has_native else ())]

    def once(self, make: Callable[..., Result], *of: str) -> Result:
        """Result of a function of the frame and some words, which is asked for once."""
        key = make, *of
        if key not in self._made:
            self._made[key] = make(self, *of)
        result: Result = self._made[key]
        return result

    def rows(self, judge: str, measure: Callable[[RunRecord], Measurement | None]) -> list[RunRow[Measurement]]:
        """A row, in the order of tables, for each run of which something is measured; `judge` as in `RunRow`."""
        measurements = [(record, measure(record)) for record in self.runs]
        return [RunRow(record, judge, measured) for record, measured in measurements if measured is not None]

    def scored(self, record: RunRecord, protocol: str) -> ScoredSamples:
        """Verdicts on one of the runs, read once."""
        key = id(record), resolve_protocol(record, protocol)
        if key not in self._scored:
            self._scored[key] = score_record(record, protocol=protocol)
        return self._scored[key]

    def forget_verdicts(self) -> None:
        """Keep no verdicts: those of all protocols would fill memory."""
        self._scored.clear()

    def judged(self, protocol: str) -> list[RunRow[ProtocolSummary]]:
        """A row for each run with verdicts of a protocol, or of its own one if ``native``."""
        return list_judged_rows(self.runs, protocol)


def list_judged_rows(records: Iterable[RunRecord], protocol: str) -> list[RunRow[ProtocolSummary]]:
    """`DataSetRuns.judged` of records in any order."""
    record_judges = [(record, resolve_protocol(record, protocol)) for record in records]
    return [
        RunRow(run, judge, run.summary.protocols[judge])
        for run, judge in record_judges
        if judge in run.summary.protocols
    ]


def choose_protocols(frame: DataSetRuns, asked: Sequence[str] | None) -> Sequence[str]:
    """Protocols that are asked for; unasked ``exact``, and ``native`` where a planner has one of its own."""
    return asked or ((EXACT, NATIVE) if frame.has_native else (EXACT,))


def row_notes(rows: Sequence[RunRow[Any]], told: Iterable[str] = ()) -> list[str]:
    """Notes on the runs behind rows, ``told`` and who was judged by an earlier version among it."""
    stale = [note for row in rows for note in stale_notes(row.record, (row.judge,))]
    return run_notes([row.record for row in rows], [*told, *stale])


def name_judges(protocol: str) -> str:
    """Judges whose verdicts are shown, as labels over columns name them."""
    return "own protocol" if protocol == NATIVE else protocol
