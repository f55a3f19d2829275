"""Table 1 of the paper: collision rate over 1, 2 and 3 seconds, by planner and split, ours and the published ones."""

from collections.abc import Sequence

from benchmark.rates import HORIZONS
from benchmark.records import ProtocolSummary, RunRecord
from leaderboard.published import INCREASE, SOURCE, TABLE_1
from leaderboard.tables import UNDEFINED, Table, metres, percent, percent_interval

SPLIT_ORDER = ("val", "val-r", "adv")
PRIVILEGED_MARK = "†"
PRIVILEGED_NOTE = f"{PRIVILEGED_MARK} sees what no car sees (boxes, map or the recorded future): a reference row."


def collision_table(data_name: str, protocol: str, records: Sequence[RunRecord]) -> Table:
    """Collision rates and L2 of our runs under one protocol.

    Args:
        data_name: Name of the data set, for the title.
        protocol: Protocol of every number in the table.
        records: Runs on this data set; those without the protocol are left out.

    Returns:
        One row per planner and split: rates with the 95 % scene-bootstrap interval of their average, the paper's
        increase (adv - val) / val of the averages, L2, and what was counted.
    """
    runs = [record for record in in_table_order(records) if protocol in record.summary.protocols]
    baseline = {
        record.planner: _average(record.summary.protocols[protocol]) for record in runs if record.run.split == "val"
    }
    rows = [_row(record, protocol, baseline.get(record.planner)) for record in runs]
    versions = sorted({record.summary.protocols[protocol].version for record in runs})
    return Table(
        name=f"collision-{protocol}",
        title=f"{data_name}: collision rate (%) and L2 (m), protocol {protocol} "
        f"(version {', '.join(str(version) for version in versions)})",
        columns=(
            "planner",
            "split",
            *(f"col. {horizon}" for horizon in HORIZONS),
            "95 % of avg",
            "increase",
            *(f"L2 {horizon}" for horizon in HORIZONS),
            "samples",
            "scenes",
            "scenes failed",
            "coverage",
        ),
        rows=tuple(rows),
        notes=_notes(runs),
        text_columns=2,
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


def increase_over(baseline: float | None, rate: float | None) -> float | None:
    """The paper's "× increase": (rate - baseline) / baseline, ``None`` where the baseline is zero or unknown."""
    if baseline is None or rate is None or baseline == 0:
        return None
    return (rate - baseline) / baseline


def _average(summary: ProtocolSummary) -> float | None:
    return summary.columns["collision"]["avg"].value


def _row(record: RunRecord, protocol: str, baseline: float | None) -> tuple[str, ...]:
    summary = record.summary.protocols[protocol]
    collision, l2 = summary.columns["collision"], summary.columns["l2"]
    average = collision["avg"]
    increase = increase_over(baseline, average.value) if record.run.split == "adv" else None
    interval = None if average.low is None or average.high is None else (average.low, average.high)
    return (
        marked(record.planner, privileged=record.run.planner.privileged),
        record.run.split,
        *(percent(collision[horizon].value) for horizon in HORIZONS),
        percent_interval(interval),
        UNDEFINED if increase is None else f"{increase:.1f}×",
        *(metres(l2[horizon].value) for horizon in HORIZONS),
        str(summary.counted),
        str(len(record.run.scenes)),
        f"{summary.scenes_failed}/{summary.scenes_decided}",
        f"{100 * record.summary.coverage:.1f}",
    )


def _notes(runs: Sequence[RunRecord]) -> tuple[str, ...]:
    notes = [
        "Brackets: 95 % bootstrap interval over scenes. Increase: (adv − val) / val of the averages, as the paper "
        "computes it."
    ]
    if any(record.run.planner.privileged for record in runs):
        notes.append(PRIVILEGED_NOTE)
    for record in runs:
        if not record.complete:
            notes.append(f"{record.planner} on {record.run.split}: {record.summary.failed} samples failed.")
        if not record.covers_split:
            notes.append(
                f"{record.planner} on {record.run.split}: {len(record.run.scenes)} of {record.run.scenes_in_split} "
                "scenes of the split."
            )
    return tuple(notes)
