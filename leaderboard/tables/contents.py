"""Tables in reading order, the instability of consecutive plans, and the spread of rates over seeds of the search."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from benchmark.errors import InputError
from benchmark.machine.extension import call_extension, call_installed, list_offers
from benchmark.metrics.attacks import has_adversaries, has_severity
from benchmark.metrics.consistency import INSTANTS, MEAN, Consistency, measure_consistency
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.rates import HORIZONS, SceneSums
from benchmark.metrics.scores import find_protocol_version, map_scenes_to_sources, score_record
from benchmark.metrics.search_seeds import combine_seeds, format_seeds
from benchmark.records.ablation import AblationReport
from benchmark.records.drives import DriveRecord
from benchmark.records.driving import PDM
from benchmark.records.run import RunRecord, resolve_protocol
from benchmark.records.scene_pages import ScenePages
from benchmark.records.seed_splits import parse_seed
from benchmark.report.cells import PERCENT, AnyRate, ValueSource, join_record_names
from benchmark.report.table import Table
from leaderboard.frame.rows import name_cell, name_judge, run_notes
from leaderboard.frame.runs import DataSetRuns, RunRow, name_judges, row_notes
from leaderboard.frame.specification import (
    SplitTables,
    Values,
    estimate_columns,
    group_by_data_set,
    group_columns,
    interval_columns,
    merge_by_data_set,
    number_columns,
    tabulate,
    text_columns,
)
from leaderboard.tables.ablation import ablation_tables
from leaderboard.tables.attacks import attack_tables
from leaderboard.tables.collision import collision_table
from leaderboard.tables.comparisons import planner_table, split_table
from leaderboard.tables.diagnosis import diagnosis_tables
from leaderboard.tables.disagreement import disagreement_tables
from leaderboard.tables.drives import drive_tables, loop_tables
from leaderboard.tables.driving import driving_tables
from leaderboard.tables.effect import effect_table
from leaderboard.tables.further_columns import further_table
from leaderboard.tables.longer_plans import longer_table
from leaderboard.tables.pressure import pressure_tables
from leaderboard.tables.runtime import cost_table, drive_cost_table, runtime_tables
from leaderboard.tables.scenario_assessment import assessment_tables
from leaderboard.tables.slices import DIAGNOSIS, build_slice_tables
from leaderboard.tables.statistics import manoeuvre_tables, seed_spread_table, statistics_tables
from leaderboard.tables.transfer import transfer_tables

_AVERAGE = HORIZONS.index("avg")
_RULE = (
    "Splits adv-seed-N: the same recordings, searched with seed N (generate --seeds). The row of all: the mean "
    "of the rates. Over scenes: 95 % bootstrap interval over recorded scenes, of all seeds with everything that they "
    "made of a recording; it includes the chance of the search, once for each recording and seed. "
    "Deviation: of the rates of the seeds around their mean (n − 1); over seeds: 95 % interval of that mean (Student) "
    "on these recordings, the spread from repeating the search (docs/metrics.md)."
)


def drawn_seeds_table(frame: DataSetRuns, protocol: str) -> Table | None:
    """Average collision rate of each planner on the splits ``adv-seed-N``, a row a seed and one for all.

    ``None`` where no planner ran on two. ``native`` is the planner's own protocol; runs that do not belong to the
    others are named below.
    """
    rows: list[Values] = []
    notes, shown_runs = [_RULE], []
    for runs in _group_by_planner(frame.runs):
        comparable, refused = _select_comparable(runs, protocol)
        if len(comparable) < 2:
            continue
        notes += refused
        rows += _rows(comparable, protocol)
        shown_runs += list(comparable.values())
    if not rows:
        return None
    columns = [
        *text_columns("planner", "protocol", "seed"),
        *group_columns("counted", number_columns("scenes", "recordings")),
        *group_columns(
            f"average collision rate in %, {name_judges(protocol)}",
            estimate_columns("avg", digits=2, beside="over scenes"),
            number_columns("deviation", digits=2),
            interval_columns({"over seeds": "over seeds"}),
        ),
    ]
    return tabulate(
        f"drawn-seeds-{protocol}",
        f"{frame.data_name}: average collision rate (%) over seeds of the search, {name_judge(protocol)}",
        columns,
        rows,
        (*notes, *run_notes(shown_runs, ())),
    )


def _group_by_planner(records: Sequence[RunRecord]) -> list[dict[int, RunRecord]]:
    """Runs on splits of seeds, by planner and then by seed."""
    runs_by_planner: dict[str, dict[int, RunRecord]] = {}
    for record in records:
        seed = parse_seed(record.run.split)
        if seed is not None:
            runs_by_planner.setdefault(record.planner, {})[seed] = record
    return [dict(sorted(runs.items())) for runs in runs_by_planner.values()]


def _select_comparable(runs: dict[int, RunRecord], protocol: str) -> tuple[dict[int, RunRecord], list[str]]:
    """Runs that differ in the seed of the search alone, and why the others do not count."""
    comparable: dict[int, RunRecord] = {}
    refused = []
    for seed, run in runs.items():
        reason = _explain_refusal(seed, run, next(iter(comparable.values()), None), protocol)
        if reason is None:
            comparable[seed] = run
        else:
            refused.append(f"Left out: {run.planner} on {run.run.split}: {reason}.")
    return comparable, refused


def _explain_refusal(seed: int, run: RunRecord, first: RunRecord | None, protocol: str) -> str | None:
    generated = run.run.generated
    if generated is None or generated.seed != seed:
        return "its data set does not record this seed of the search"
    if not (run.covers_split and run.complete):
        return "it has no plan for some samples of the split"
    if first is not None and first.run.generated is not None and first.run.generated.search != generated.search:
        return f"its search differs from that of {first.run.split} in more than the seed"
    weights = None if first is None else first.run.planner
    if weights is not None and weights != run.run.planner:
        return f"the planner has other weights, settings, code or seed than on {first.run.split if first else ''}"
    try:
        score_record(run, protocol=protocol)
    except InputError as refusal:
        return str(refusal)
    return None


def _rows(runs: dict[int, RunRecord], protocol: str) -> list[Values]:
    """A row a seed, and one of all, which alone has a deviation and an interval over seeds."""
    spread = combine_seeds({seed: _compute_sums(run, protocol) for seed, run in runs.items()})
    first = next(iter(runs.values()))
    judge = resolve_protocol(first, protocol)
    identity: Values = {"planner": name_cell(first.planner, first.run.planner), "protocol": judge}

    def row(seed: str, of: Sequence[RunRecord], recordings: int, rate: AnyRate) -> Values:
        origin = ValueSource(judge, join_record_names(*of))
        scenes = origin.count(sum(len(run.run.scenes) for run in of), "scenes")
        counted = {"scenes": scenes, "recordings": origin.count(recordings, "recorded scenes")}
        return {**identity, "seed": seed, **counted, "avg": origin.percent(rate)}

    of_each = [
        (seed_rate, run, len(set(map_scenes_to_sources(run).values())))
        for seed_rate, run in zip(spread.seeds, runs.values())
    ]
    rows = [row(str(seed_rate.seed), [run], recordings, seed_rate.rate) for seed_rate, run, recordings in of_each]
    origin, count = ValueSource(judge, join_record_names(*runs.values())), len(spread.seeds)
    of_seeds = f"seeds {format_seeds(list(runs))}"
    every = {
        **row("all", list(runs.values()), spread.recordings, spread.mean),
        "deviation": origin.cell(spread.deviation, PERCENT, count, of_seeds, scale=100.0),
        "over seeds": origin.cell(
            spread.mean.value, PERCENT, count, "seeds", low=spread.low, high=spread.high, scale=100.0
        ),
    }
    return [*rows, every]


def _compute_sums(run: RunRecord, protocol: str) -> SceneSums:
    """Sums that each recording adds to the average rate."""
    scene_sums = score_record(run, protocol=protocol).sums(map_scenes_to_sources(run))
    column = slice(_AVERAGE, _AVERAGE + 1)
    return SceneSums(scene_sums.names, scene_sums.numerators[:, column], scene_sums.denominators[:, column])


_AFTER = {instant: f"after {instant}" for instant in INSTANTS}
_COLUMNS = [
    *text_columns("planner", "split"),
    *group_columns("distance in m", estimate_columns(MEAN, digits=2), number_columns(*_AFTER.values(), digits=2)),
    *group_columns("counted", number_columns("pairs")),
]
_NOTE = (
    "Two plans half a second apart, without the recorded motion between them: distance at the same instants, by "
    "seconds after the later one. Brackets: 95 % bootstrap interval over recorded scenes. 0: one fixed path is "
    "followed. Justified changes of a plan are not distinguished from dithering."
)


def consistency_table(frame: DataSetRuns) -> Table | None:
    """Distances between consecutive plans; ``None`` where no two consecutive samples have plans."""
    rows = [row for row in frame.rows("", measure_consistency) if row.found.pairs]
    if not rows:
        return None
    title = f"{frame.data_name}: disagreement of consecutive plans on the same instants (m)"
    without = [(row.describe_run, row.found.without) for row in rows if row.found.without]
    sentences = [f"{run_name}: {count} pairs are left out because a plan is missing." for run_name, count in without]
    brief = ("planner", "split", MEAN, f"95 % of {MEAN}", "pairs")
    return tabulate(
        "consistency", title, _COLUMNS, map(_values, rows), (_NOTE, *row_notes(rows, sentences)), brief=brief
    )


def _values(row: RunRow[Consistency]) -> Values:
    consistency, origin = row.found, row.origin
    return {
        "planner": row.planner,
        "split": row.split,
        **{_AFTER.get(at, at): origin.amount(rate, "m", "pairs") for at, rate in consistency.distances.items()},
        "pairs": origin.count(consistency.pairs, "pairs", consistency.pairs + consistency.without),
    }


OptionalTables = Table | None | Iterable[Table]
FIRST_TABLES: Final[tuple[Callable[[DataSetRuns], OptionalTables], ...]] = (effect_table,)
JUDGE_TABLES: Final[tuple[Callable[[DataSetRuns, str], OptionalTables], ...]] = (
    collision_table,
    further_table,
    seed_spread_table,
    drawn_seeds_table,
    split_table,
)
"""Under a protocol, or ``native``."""
SPLIT_TABLES: Final[tuple[Callable[[DataSetRuns, str, str], OptionalTables], ...]] = (planner_table, transfer_tables)
"""Under a protocol on a split."""
LAST_TABLES: Final[tuple[Callable[[DataSetRuns], OptionalTables], ...]] = (
    attack_tables,
    assessment_tables,
    longer_table,
    consistency_table,
    diagnosis_tables,
    disagreement_tables,
    driving_tables,
    cost_table,
)
GENERATION_TABLES: Final[tuple[SplitTables, ...]] = (
    statistics_tables,
    manoeuvre_tables,
    runtime_tables,
)
"""Made from scene sheets."""


@dataclass(frozen=True, slots=True)
class DataSetTables:
    """Tables of one data set, in reading order.

    `front` are under ``exact`` and the planners' own protocols, then diagnosis, disagreement and driving scores;
    `slices` the same judges by place, light, manoeuvre, speed and command; `others` by protocol, the collision table
    first.
    """

    frame: DataSetRuns = field(compare=False, repr=False)
    front: tuple[Table, ...]
    slices: tuple[Table, ...]
    others: dict[str, tuple[Table, ...]]

    @property
    def tables(self) -> tuple[Table, ...]:
        """All of them."""
        return (*self.front, *self.slices, *(table for tables in self.others.values() for table in tables))


def build_data_set_tables(frame: DataSetRuns) -> DataSetTables:
    """Every table that the records of one data set allow: at most one for each planner and split."""
    front = (
        *(frame.once(make) for make in FIRST_TABLES),
        *_build_judge_tables(frame, frame.judges),
        *(make(frame) for make in LAST_TABLES),
        *(call_extension("table", name, frame) for name in list_offers("table")),
    )
    others = {}
    for name in sorted(frame.protocols - {EXACT}):
        # Verdicts of one protocol at a time are in memory.
        frame.forget_verdicts()
        others[name] = (*_flatten(_build_judge_tables(frame, [name])), *_build_slice_tables(frame, name))
    frame.forget_verdicts()
    return DataSetTables(frame, _flatten(front), _build_slice_tables(frame, *frame.judges, PDM, DIAGNOSIS), others)


def _build_judge_tables(frame: DataSetRuns, judges: Sequence[str]) -> Iterable[OptionalTables]:
    yield from (frame.once(make, judge) for make in JUDGE_TABLES for judge in judges)
    yield from (make(frame, judge, split) for split in frame.splits for make in SPLIT_TABLES for judge in judges)


def _flatten(table_groups: Iterable[OptionalTables]) -> tuple[Table, ...]:
    """Tables, one after the other."""
    parts = ([part] if isinstance(part, Table) else part or () for part in table_groups)
    return tuple(table for part in parts for table in part)


def _build_slice_tables(frame: DataSetRuns, *asked: str) -> tuple[Table, ...]:
    """Tables by slice that have rows; what old records lack is said once, in the notes."""
    return tuple(table for table in build_slice_tables(frame, asked) if table.rows)


def closed_loop_tables(data_name: str, drives: Sequence[DriveRecord], runs: Sequence[RunRecord]) -> tuple[Table, ...]:
    """Every table of drives through one data set, beside open loop where the planners ran there too."""
    table_groups = (
        drive_tables(drives),
        *call_installed("drive table", drives),
        loop_tables(drives, runs),
        pressure_tables(drives),
        drive_cost_table(data_name, drives),
    )
    return _flatten(table_groups)


def generation_tables(sheets: ScenePages, ablations: Sequence[AblationReport]) -> dict[str, tuple[Table, ...]]:
    """Statistics, manoeuvres, search, runtime, ablation: tables of no run record, by data set in the order of names."""
    return merge_by_data_set(
        [*(group_by_data_set(sheets, make) for make in GENERATION_TABLES), ablation_tables(ablations)]
    )


def missing_notes(frame: DataSetRuns) -> list[str]:
    """Sentences on what old records do not say."""
    notes = []
    for record in frame.runs:
        run_name = f"{record.planner} on {record.run.split}"
        if record.missing_protocols:
            notes.append(
                f"{run_name}: not scored by {', '.join(record.missing_protocols)}; run challenger-bench rescore."
            )
        if absent := sorted(name for name in record.run.protocols if find_protocol_version(name) is None):
            notes.append(
                f"{run_name}: judged by protocol {', '.join(absent)}, of an extension that is not installed here; its "
                "numbers are shown as recorded, without what is counted anew."
            )
        if any(None in record.columns.values(field) for field in ("place", "speed_m_s")):
            notes.append(
                f"{run_name}: the record does not say where its samples are, in what light and how fast, so that it is "
                "in no table by place, light or speed; run challenger-bench rescore."
            )
        if has_adversaries(record) and not has_severity(record):
            notes.append(
                f"{run_name}: the record does not say how severe its plans are, so that it is in no table of attack "
                "success or severity; run challenger-bench rescore."
            )
        if record.run.split == "adv" and not record.run.scene_facts:
            notes.append(
                f"{run_name}: the record does not say which recordings its scenes come from, so that intervals take "
                "scenes of one recording as independent; run challenger-bench rescore."
            )
    return notes
