"""Which tables there are, and in which order they are read."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from benchmark.metrics.attacks import has_adversaries, says_severity
from benchmark.metrics.disagreement import EXACT
from benchmark.records.ablation import AblationReport
from benchmark.records.drives import DriveRecord
from benchmark.records.driving import PDM
from benchmark.records.run import RunRecord
from benchmark.records.scenes import Sheets
from benchmark.report.table import Table
from leaderboard.frame.runs import Frame
from leaderboard.frame.sheets import OfSplits, by_data_set, by_name
from leaderboard.tables.ablation import ablation_tables
from leaderboard.tables.attacks import attack_tables
from leaderboard.tables.collision import collision_table
from leaderboard.tables.comparisons import planner_table, split_table
from leaderboard.tables.consistency import consistency_table
from leaderboard.tables.cost import cost_table, drive_cost_table
from leaderboard.tables.diagnosis import diagnosis_tables
from leaderboard.tables.disagreement import disagreement_tables
from leaderboard.tables.drawn_seeds import drawn_seeds_table
from leaderboard.tables.drives import drive_tables
from leaderboard.tables.driving import driving_tables
from leaderboard.tables.effect import effect_table
from leaderboard.tables.further_columns import further_table
from leaderboard.tables.judgements import judgement_tables
from leaderboard.tables.longer_plans import longer_table
from leaderboard.tables.loops import loop_tables
from leaderboard.tables.pressure import pressure_tables
from leaderboard.tables.runtime import runtime_tables
from leaderboard.tables.seeds import seed_spread_table
from leaderboard.tables.slices import DIAGNOSIS, slices_of
from leaderboard.tables.statistics import manoeuvre_tables, statistics_tables
from leaderboard.tables.transfer import transfer_tables

Made = Table | None | Iterable[Table]
FIRST: Final[tuple[Callable[[Frame], Made], ...]] = (effect_table,)
UNDER: Final[tuple[Callable[[Frame, str], Made], ...]] = (
    collision_table,
    further_table,
    seed_spread_table,
    drawn_seeds_table,
    split_table,
)
"""Under a protocol, or ``native``."""
ON: Final[tuple[Callable[[Frame, str, str], Made], ...]] = (planner_table, transfer_tables)
"""Under a protocol on a split."""
LAST: Final[tuple[Callable[[Frame], Made], ...]] = (
    attack_tables,
    judgement_tables,
    longer_table,
    consistency_table,
    diagnosis_tables,
    disagreement_tables,
    driving_tables,
    cost_table,
)
OF_GENERATION: Final[tuple[OfSplits, ...]] = (
    statistics_tables,
    manoeuvre_tables,
    runtime_tables,
)
"""Made from scene sheets."""


@dataclass(frozen=True, slots=True)
class DataSetTables:
    """Tables of one data set, in the order in which they are read.

    Attributes:
        front: Under ``exact`` and under the planners' own protocols, then diagnosis, disagreement and driving scores.
        slices: By place, light, manoeuvre, speed and command: the same judges as ``front``.
        others: Under each other protocol; the collision table comes first.
    """

    frame: Frame = field(compare=False, repr=False)
    front: tuple[Table, ...]
    slices: tuple[Table, ...]
    others: dict[str, tuple[Table, ...]]

    @property
    def tables(self) -> tuple[Table, ...]:
        """All of them."""
        return (*self.front, *self.slices, *(table for tables in self.others.values() for table in tables))


def data_set_tables(frame: Frame) -> DataSetTables:
    """Every table that the records of one data set allow: at most one for each planner and split."""
    front = (
        *(frame.once(make) for make in FIRST),
        *_under(frame, frame.judges),
        *(make(frame) for make in LAST),
    )
    others = {}
    for name in sorted(frame.protocols - {EXACT}):
        # Verdicts of one protocol at a time are in memory.
        frame.forget_verdicts()
        others[name] = (*_flat(_under(frame, [name])), *_slices(frame, name))
    frame.forget_verdicts()
    return DataSetTables(frame, _flat(front), _slices(frame, *frame.judges, PDM, DIAGNOSIS), others)


def _under(frame: Frame, judges: Sequence[str]) -> Iterable[Made]:
    yield from (frame.once(make, judge) for make in UNDER for judge in judges)
    yield from (make(frame, judge, split) for split in frame.splits for make in ON for judge in judges)


def _flat(made: Iterable[Made]) -> tuple[Table, ...]:
    """Tables, one after the other."""
    parts = ([part] if isinstance(part, Table) else part or () for part in made)
    return tuple(table for part in parts for table in part)


def _slices(frame: Frame, *asked: str) -> tuple[Table, ...]:
    """Tables by slice that have rows; what old records lack is said once, in the notes."""
    return tuple(table for table in slices_of(frame, asked) if table.rows)


def closed_loop_tables(data_name: str, drives: Sequence[DriveRecord], runs: Sequence[RunRecord]) -> tuple[Table, ...]:
    """Every table of drives through one data set, beside open loop where the planners ran there too."""
    made = drive_tables(drives), loop_tables(drives, runs), pressure_tables(drives), drive_cost_table(data_name, drives)
    return _flat(made)


def generation_tables(sheets: Sheets, ablations: Sequence[AblationReport]) -> dict[str, tuple[Table, ...]]:
    """Statistics, manoeuvres, search, runtime, ablation: tables of no run record, by data set in the order of names."""
    return by_name([*(by_data_set(sheets, make) for make in OF_GENERATION), ablation_tables(ablations)])


def missing_notes(frame: Frame) -> list[str]:
    """Sentences on what old records do not say."""
    notes = []
    for record in frame.runs:
        who = f"{record.planner} on {record.run.split}"
        if record.missing_protocols:
            notes.append(f"{who}: not judged by {', '.join(record.missing_protocols)}; run challenger-bench rescore.")
        if any(None in record.columns.values(field) for field in ("place", "speed_m_s")):
            notes.append(
                f"{who}: the record does not say where its samples are, in what light and how fast, so that it is in "
                "no table by place, light or speed; run challenger-bench rescore."
            )
        if has_adversaries(record) and not says_severity(record):
            notes.append(
                f"{who}: the record does not say how severe its plans are, so that it is in no table of attack success "
                "or severity; run challenger-bench rescore."
            )
        if record.run.split == "adv" and not record.run.scene_facts:
            notes.append(
                f"{who}: the record does not say which recordings its scenes come from, so that intervals take scenes "
                "of one recording for independent; run challenger-bench rescore."
            )
    return notes
