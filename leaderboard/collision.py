"""Table 1 of the paper: collision rate over 1, 2 and 3 seconds, by planner and split, ours and the published ones."""

from collections.abc import Callable, Sequence

from benchmark.rates import HORIZONS
from benchmark.records import NATIVE, ProtocolSummary, RunRecord
from benchmark.scores import registered_version, source_of_scenes
from leaderboard.published import INCREASE, SOURCE, TABLE_1
from leaderboard.tables import UNDEFINED, Table, interval, metres, number, percent

SPLIT_ORDER = ("val", "val-r", "adv")
PRIVILEGED_MARK = "†"
PRIVILEGED_NOTE = f"{PRIVILEGED_MARK} sees what no car sees (boxes, map or the recorded future): a reference row."
STALE_MARK = "‡"
FEW_SCENES = 20
"""Below this many recorded scenes the intervals are clearly too narrow (docs/metrics.md has the measurement)."""
FEW_NOTE = f"Fewer than {FEW_SCENES} recorded scenes: the intervals are too narrow, take them as a hint."
RATES_NOTE = (
    "Brackets: 95 % bootstrap interval over recorded scenes; a dash where there are fewer than two or all of them "
    "agree. Increase: (adv − val) / val of the averages, as the paper computes it; beside it the same over val-r."
)
BEFORE_MASK = "collision_before_mask"


def collision_table(data_name: str, protocol: str, records: Sequence[RunRecord]) -> Table:
    """Collision rates and L2 of our runs under one protocol.

    Args:
        data_name: Name of the data set, for the title.
        protocol: Protocol of every number in the table.
        records: Runs on this data set; those without the protocol are named below the table.

    Returns:
        One row per planner and split: rates with the 95 % scene-bootstrap interval of their average, what the
        protocol's exclusion of recorded collisions removed (where it has one), the paper's increases of the averages,
        L2, and what was counted.
    """
    runs = [record for record in in_table_order(records) if protocol in record.summary.protocols]
    versions = sorted({record.summary.protocols[protocol].version for record in runs})
    return _table(
        f"collision-{protocol}",
        f"{data_name}: collision rate (%) and L2 (m), protocol {protocol} "
        f"(version {', '.join(str(version) for version in versions)})",
        in_table_order(records),
        lambda record: protocol,
        notes=(RATES_NOTE,),
    )


def native_table(data_name: str, records: Sequence[RunRecord]) -> Table:
    """The paper's Table 1: every planner under the protocol of its own repository.

    Args:
        data_name: Name of the data set, for the title.
        records: Runs on this data set.

    Returns:
        One row per planner and split that says whose protocol it is; planners without one of their own come after the
        others, under ``exact``.
    """
    ordered = sorted(in_table_order(records), key=lambda record: record.run.planner.native_protocol is None)
    without = any(record.run.planner.native_protocol is None for record in records)
    said = " The last rows, under exact, are planners without a repository of their own." if without else ""
    return _table(
        "collision-native",
        f"{data_name}: collision rate (%) and L2 (m), each planner under its own protocol",
        ordered,
        lambda record: record.native_protocol,
        notes=(
            "As in the paper, each row quotes the protocol of the planner's own repository: rows of different "
            f"protocols are not comparable.{said}",
            RATES_NOTE,
        ),
        names_protocol=True,
    )


def published_table() -> Table:
    """The paper's Table 1 as printed, with the protocol behind each row."""
    rows = []
    for rate in TABLE_1:
        increase = INCREASE[rate.model] if rate.data_set == "Adv-nuSc" else UNDEFINED
        rows.append((rate.model, rate.data_set, rate.protocol, *rate.percent, increase))
    return Table(
        name="published",
        title="Published numbers, not ours: collision rate (%)",
        columns=("planner", "data set", "protocol", "col. 1s", "col. 2s", "col. 3s", "col. avg", "increase"),
        rows=tuple(rows),
        notes=(
            f"Source: {SOURCE}.",
            "Each row quotes the protocol of the model's own repository; rows of different protocols are not "
            "comparable with each other, nor with our tables unless the protocol is the same.",
        ),
        text_columns=3,
    )


def in_table_order(records: Sequence[RunRecord]) -> list[RunRecord]:
    """Records by planner (privileged ones last), then split."""

    def place(record: RunRecord) -> tuple[bool, str, int, str]:
        split = record.run.split
        known = SPLIT_ORDER.index(split) if split in SPLIT_ORDER else len(SPLIT_ORDER)
        return record.run.planner.privileged, record.planner, known, split

    return sorted(records, key=place)


def marked(planner: str, *, privileged: bool) -> str:
    """The planner's name; a mark tells that it saw what no car sees."""
    return f"{planner} {PRIVILEGED_MARK}" if privileged else planner


def row_name(record: RunRecord, judge: str) -> str:
    """The planner's name with its marks: privileged, and judged by an earlier version of the protocol."""
    name = marked(record.planner, privileged=record.run.planner.privileged)
    return f"{name} {STALE_MARK}" if judge in record.stale_protocols else name


def stale_notes(record: RunRecord, protocols: Sequence[str]) -> list[str]:
    """One sentence for each of the protocols that judged a run in another version than the present one."""
    return [
        f"{STALE_MARK} {record.planner} on {record.run.split}: judged by version {record.run.protocols[name]} of "
        f"protocol {name}, now {registered_version(name)}; run challenger-bench rescore."
        for name in protocols
        if name in record.stale_protocols
    ]


def judges(protocol: str) -> str:
    """Who judges, as titles say it."""
    return "each planner under its own protocol" if protocol == NATIVE else f"protocol {protocol}"


def increase_over(baseline: float | None, rate: float | None) -> float | None:
    """The paper's "× increase": (rate - baseline) / baseline, ``None`` where the baseline is zero or unknown."""
    if baseline is None or rate is None or baseline == 0:
        return None
    return (rate - baseline) / baseline


def times(value: float | None) -> str:
    """An increase as the paper prints it, or a dash."""
    return UNDEFINED if value is None else f"{number(value, 1)}×"


def recordings(record: RunRecord) -> int:
    """How many recorded scenes a run's scenes come from: what its intervals rest on."""
    return len(set(source_of_scenes(record).values()))


def completeness_notes(records: Sequence[RunRecord]) -> list[str]:
    """What has to be said of runs that are not whole.

    Args:
        records: Runs.

    Returns:
        One sentence for each run with failed samples and each run of a part of its split.
    """
    notes = []
    for record in records:
        who = f"{record.planner} on {record.run.split}"
        if not record.complete:
            summary = record.summary
            notes.append(
                f"{who}: {summary.failed} samples failed. The rates cover {100 * summary.coverage:.1f} % of "
                f"{summary.samples} samples."
            )
        if not record.covers_split:
            notes.append(f"{who}: {len(record.run.scenes)} of {record.run.scenes_in_split} scenes of the split.")
    return notes


def _table(
    name: str,
    title: str,
    records: Sequence[RunRecord],
    judge_of: Callable[[RunRecord], str],
    *,
    notes: Sequence[str],
    names_protocol: bool = False,
) -> Table:
    """Rows of all records that have their judge's verdicts, in the order given."""
    runs = [record for record in records if judge_of(record) in record.summary.protocols]
    run_of = {(run.planner, run.run.split): run for run in runs}
    has_mask = any(BEFORE_MASK in run.summary.protocols[judge_of(run)].columns for run in runs)
    rows = []
    for run in runs:
        judge = judge_of(run)
        baselines = [run_of.get((run.planner, split)) for split in ("val", "val-r")]
        increases = [_increase(run, baseline, judge_of) for baseline in baselines]
        name_cells = (row_name(run, judge), run.run.split, *((judge,) if names_protocol else ()))
        rows.append((*name_cells, *_numbers(run, run.summary.protocols[judge], increases, has_mask=has_mask)))
    return Table(
        name=name,
        title=title,
        columns=(
            *("planner", "split", *(("protocol",) if names_protocol else ())),
            *(f"col. {horizon}" for horizon in HORIZONS),
            "95 % of avg",
            *(("avg before mask", "steps masked") if has_mask else ()),
            *("increase", "over val-r"),
            *(f"L2 {horizon}" for horizon in HORIZONS),
            *("samples", "scenes", "scenes failed", "coverage"),
        ),
        rows=tuple(rows),
        notes=(*notes, *_notes(records, judge_of, has_mask=has_mask)),
        text_columns=3 if names_protocol else 2,
    )


def _increase(record: RunRecord, baseline: RunRecord | None, judge_of: Callable[[RunRecord], str]) -> float | None:
    """From a baseline to an adversarial run; ``None`` where they are not of whole splits, or judged differently."""
    if record.run.split != "adv" or baseline is None or judge_of(baseline) != judge_of(record):
        return None
    first, second = (run.summary.protocols[judge_of(run)] for run in (baseline, record))
    if not (baseline.covers_split and record.covers_split) or first.version != second.version:
        return None
    return increase_over(*(summary.columns["collision"]["avg"].value for summary in (first, second)))


def _numbers(
    record: RunRecord, summary: ProtocolSummary, increases: Sequence[float | None], *, has_mask: bool
) -> tuple[str, ...]:
    collision, l2 = summary.columns["collision"], summary.columns["l2"]
    average = collision["avg"]
    return (
        *(percent(collision[horizon].value) for horizon in HORIZONS),
        interval(average.low, average.high, scale=100.0),
        *(_mask_cells(summary) if has_mask else ()),
        *(times(increase) for increase in increases),
        *(metres(l2[horizon].value) for horizon in HORIZONS),
        str(summary.counted),
        str(len(record.run.scenes)),
        f"{summary.scenes_failed}/{summary.scenes_decided}",
        f"{100 * record.summary.coverage:.1f}",
    )


def _mask_cells(summary: ProtocolSummary) -> tuple[str, str]:
    if BEFORE_MASK not in summary.columns:
        return UNDEFINED, UNDEFINED
    removed = summary.mask_removed_steps
    return percent(summary.columns[BEFORE_MASK]["avg"].value), UNDEFINED if removed is None else str(removed)


def _notes(records: Sequence[RunRecord], judge_of: Callable[[RunRecord], str], *, has_mask: bool) -> list[str]:
    notes = []
    if has_mask:
        notes.append(
            "Mask: steps at which the recorded ego collides too, under the same protocol, do not count. Before it: the "
            "average without that exclusion; masked: how many colliding steps it removed."
        )
    if any(record.run.planner.privileged for record in records):
        notes.append(PRIVILEGED_NOTE)
    if any(recordings(record) < FEW_SCENES for record in records):
        notes.append(FEW_NOTE)
    for record in records:
        judge, who = judge_of(record), f"{record.planner} on {record.run.split}"
        if judge not in record.summary.protocols:
            notes.append(f"{who}: no verdicts under protocol {judge}; run challenger-bench rescore.")
        notes += stale_notes(record, (judge,))
    return [*notes, *completeness_notes(records)]
