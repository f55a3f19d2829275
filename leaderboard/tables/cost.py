"""What planners cost: latency and memory, by the machine that they ran on."""

from collections.abc import Sequence
from typing import Final

from benchmark.records.planner_cost import COLD_SAMPLES, CostSummary, summary_of
from benchmark.records.run import RunRecord
from benchmark.report.cells import UNDEFINED, Origin, Shown, named_record
from benchmark.report.table import Table, table_of
from leaderboard.tables.pages import COST
from leaderboard.tables.rows import in_table_order, notes_of_marks, row_name

_MS: Final = 1000.0
_NOTE: Final = (
    f"Latency: from asking to the plan, reading images included, by the clock; the first {COLD_SAMPLES} samples of "
    "each scene are left out. Memory: greatest resident memory of the process that plans, the harness included (of "
    "planners of other packages their own process); GPU: greatest memory allocated there. Of this machine and of what "
    "else ran on it: no part of a record, and different each time."
)
_SHARED_NOTE: Final = "Several processes planned side by side; latencies are longer than alone."


def cost_table(data_name: str, records: Sequence[RunRecord]) -> Table | None:
    """Latency and memory of every planner on every split.

    Args:
        data_name: Name of the data set.
        records: At most one for each planner and split.

    Returns:
        The table, or ``None`` where nothing was noted.
    """
    known = [(record, summary_of(record.cost)) for record in in_table_order(records) if record.cost is not None]
    if not known:
        return None
    shared = [_SHARED_NOTE] if any(cost.workers > 1 for _, cost in known) else []
    return table_of(
        COST,
        f"{data_name}: what planners cost",
        ("planner", "split", "device", "median, ms", "p95, ms", "memory, MB", "GPU, MB", "processes"),
        [_row(record, cost) for record, cost in known],
        notes=(*notes_of_marks([record for record, _ in known]), _NOTE, *shared),
        text_columns=3,
    )


def _row(record: RunRecord, cost: CostSummary) -> tuple[str | Shown, ...]:
    origin, of = (
        Origin(record=named_record(record.content_id, record.planner, record.run.split)),
        "samples after the first of their scenes",
    )
    scenes = 0 if record.cost is None else len(record.cost.scenes)
    return (
        row_name(record, ""),
        record.run.split,
        "; ".join(cost.devices),
        origin.cell(cost.median_s, "ms", cost.samples, of, scale=_MS).shown(2),
        origin.cell(cost.p95_s, "ms", cost.samples, of, scale=_MS).shown(2),
        origin.cell(cost.peak_memory_mb, "MB", scenes, "scenes").shown(0),
        origin.cell(cost.peak_device_mb, "MB", scenes, "scenes").shown(0) if cost.peak_device_mb else UNDEFINED,
        origin.count(cost.workers, "processes").shown(),
    )
