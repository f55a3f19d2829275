"""Which tables and figures the records of one data set give."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from benchmark.errors import InputError
from benchmark.metrics.attacks import has_adversaries, says_severity
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.scores import require_current
from benchmark.metrics.transfer import TransferMatrix
from benchmark.records.ablation import AblationReport
from benchmark.records.driving import PDM
from benchmark.records.run import NATIVE, RunRecord, protocol_of
from benchmark.records.scenes import Sheets
from benchmark.report.table import Table
from leaderboard.tables.ablation import ablation_tables
from leaderboard.tables.attacks import attack_tables
from leaderboard.tables.collision import collision_table, native_table
from leaderboard.tables.comparisons import Verdicts, planner_table, split_table
from leaderboard.tables.consistency import consistency_table
from leaderboard.tables.cost import cost_table
from leaderboard.tables.diagnosis import diagnosis_tables
from leaderboard.tables.disagreement import disagreement_table
from leaderboard.tables.drawn_seeds import drawn_seeds_table
from leaderboard.tables.driving import driving_table
from leaderboard.tables.effect import effect_table
from leaderboard.tables.further_columns import further_table
from leaderboard.tables.judgements import judgement_tables
from leaderboard.tables.longer_plans import longer_table
from leaderboard.tables.manoeuvres import manoeuvre_tables
from leaderboard.tables.rows import in_table_order, part_of_split, splits_of
from leaderboard.tables.runtime import runtime_tables
from leaderboard.tables.seeds import seed_spread_table
from leaderboard.tables.slices import DIAGNOSIS, slice_tables
from leaderboard.tables.statistics import statistics_tables
from leaderboard.tables.transfer import both_matrices, lift_table, transfer_table


@dataclass(frozen=True, slots=True)
class DataSetTables:
    """Tables of one data set, in the order in which they are read.

    Attributes:
        data_name: Name of the data set.
        front: Under ``exact`` and under the planners' own protocols, then diagnosis, disagreement and driving scores.
        slices: By place, light, manoeuvre, speed and command: the same judges as ``front``.
        others: Under each other protocol; the collision table comes first.
        matrices: Transfer matrices that get a picture of shares, by the name of their table.
        lifts: Those that get one of lift and φ, by the name of that table.
        records: What they are made from.
        notes: Sentences on what records lack.
    """

    data_name: str
    front: tuple[Table, ...]
    slices: tuple[Table, ...]
    others: dict[str, tuple[Table, ...]]
    matrices: dict[str, TransferMatrix]
    lifts: dict[str, TransferMatrix]
    records: tuple[RunRecord, ...]
    notes: tuple[str, ...]

    @property
    def tables(self) -> tuple[Table, ...]:
        """All of them."""
        return (*self.front, *self.slices, *(table for tables in self.others.values() for table in tables))


def data_set_tables(data_name: str, records: Sequence[RunRecord], against: Sequence[RunRecord] = ()) -> DataSetTables:
    """Every table that the records of one data set allow.

    Args:
        data_name: Its name.
        records: At most one for each planner and split.
        against: Records of other data sets, which may have the unchanged recordings of its adversarial scenes.

    Returns:
        The tables.
    """
    protocols = {name for record in records for name in record.summary.protocols}
    splits, verdicts = splits_of(records), Verdicts()
    front: list[Table | None] = [effect_table(data_name, records, against)]
    matrices: dict[str, TransferMatrix] = {}
    lifts: dict[str, TransferMatrix] = {}
    names = [name for name in (EXACT, NATIVE) if name in protocols or (name == NATIVE and _has_native(records))]
    front += [
        native_table(data_name, records) if name == NATIVE else collision_table(data_name, name, records)
        for name in names
    ]
    front += [seed_spread_table(data_name, name, records) for name in names]
    front += [drawn_seeds_table(data_name, name, records) for name in names]
    front += [split_table(data_name, name, records, verdicts) for name in names]
    for split in splits:
        front += [planner_table(data_name, split, name, records, verdicts) for name in names if name != NATIVE]
        for name in names:
            found, of_transfer = _transfer_tables(data_name, split, name, records)
            front += of_transfer
            matrices |= zip([table.name for table in of_transfer[::2]], found)
            if found and name == EXACT:
                # Where it is known who is an adversary, contacts with bystanders say nothing of attacks.
                lifts[of_transfer[-1].name] = found[-1]
    front += [*attack_tables(data_name, records), *judgement_tables(data_name, records)]
    front += [longer_table(data_name, records), consistency_table(data_name, records)]
    if EXACT in protocols:
        front += diagnosis_tables(data_name, records)
        disagreements = (disagreement_table(data_name, split, records) for split in splits)
        front += [table for table in disagreements if table.rows]
    if any(record.summary.driving is not None for record in records):
        front.append(driving_table(data_name, records))
    front.append(cost_table(data_name, records))
    # Verdicts of one protocol at a time are in memory.
    others = {name: _tables_under(data_name, name, splits, records) for name in sorted(protocols - {EXACT})}
    tables = tuple(table for table in front if table is not None)
    slices = _slices(data_name, records, (*names, PDM, DIAGNOSIS))
    return DataSetTables(data_name, tables, slices, others, matrices, lifts, tuple(records), _missing(records))


def generation_tables(sheets: Sheets, ablations: Sequence[AblationReport]) -> dict[str, tuple[Table, ...]]:
    """Every table that is not made from run records: statistics, manoeuvres, search, runtime, ablation.

    Args:
        sheets: Scene sheets.
        ablations: Ablation studies.

    Returns:
        Tables by name of the data set, in the order of the names.

    Raises:
        InputError: If a sheet is damaged.
    """
    parts = (statistics_tables(sheets), manoeuvre_tables(sheets), runtime_tables(sheets), ablation_tables(ablations))
    names = sorted({name for part in parts for name in part})
    return {name: tuple(table for part in parts for table in part.get(name, ())) for name in names}


def _tables_under(
    data_name: str, protocol: str, splits: Sequence[str], records: Sequence[RunRecord]
) -> tuple[Table, ...]:
    verdicts = Verdicts()
    tables = [
        collision_table(data_name, protocol, records),
        further_table(data_name, protocol, records),
        seed_spread_table(data_name, protocol, records),
        drawn_seeds_table(data_name, protocol, records),
        split_table(data_name, protocol, records, verdicts),
    ]
    for split in splits:
        tables.append(planner_table(data_name, split, protocol, records, verdicts))
        tables += _transfer_tables(data_name, split, protocol, records)[1]
    return (*(table for table in tables if table is not None), *_slices(data_name, records, (protocol,)))


def _slices(data_name: str, records: Sequence[RunRecord], asked: Sequence[str]) -> tuple[Table, ...]:
    """Tables by slice that have rows; what old records lack is said once, in the notes."""
    return tuple(table for table in slice_tables(data_name, records, asked) if table.rows)


def _transfer_tables(
    data_name: str, split: str, protocol: str, records: Sequence[RunRecord]
) -> tuple[list[TransferMatrix], list[Table]]:
    """Matrices of the planners that ran on the whole split, of each a table of shares and one of lift and φ.

    The tables say who is left out.
    """
    kept, refused = [], []
    for record in in_table_order(records):
        if record.run.split != split:
            continue
        if not record.covers_split:
            ran = part_of_split(len(record.run.scenes), record.run.scenes_in_split)
            refused.append(f"Left out: {record.planner} ran on {ran}.")
            continue
        try:
            require_current(record, protocol_of(record, protocol))
        except InputError as refusal:
            refused.append(f"Left out: {refusal}.")
            continue
        kept.append(record)
    if len(kept) < 2:
        return [], []
    matrices = both_matrices(kept, protocol)
    tables = [make(data_name, each) for each in matrices for make in (transfer_table, lift_table)]
    return matrices, [replace(table, notes=(*table.notes, *refused)) for table in tables]


def _missing(records: Sequence[RunRecord]) -> tuple[str, ...]:
    """What old records do not say."""
    notes = []
    for record in in_table_order(records):
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
    return tuple(notes)


def _has_native(records: Sequence[RunRecord]) -> bool:
    return any(record.run.planner.native_protocol is not None for record in records)
