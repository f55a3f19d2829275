"""What planners cost: latency and memory, by the machine that they ran on."""

from collections.abc import Sequence
from typing import Final

from benchmark.records.drives import DriveRecord
from benchmark.records.planner_cost import COLD_SAMPLES, PlannerCost, summary_of
from benchmark.records.run import RunRecord
from benchmark.report.cells import UNDEFINED, Origin, Shown, named_record
from benchmark.report.table import Table, table_of
from leaderboard.tables.drives import origin_of_drives, planner_cell
from leaderboard.tables.pages import COST
from leaderboard.tables.rows import in_table_order, mark_notes, notes_of_marks, row_name
from leaderboard.tables.worlds import worlds

_MS: Final = 1000.0
_HEADS: Final = ("device", "median, ms", "p95, ms", "memory, MB", "GPU, MB", "processes")
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
    known = [(record, record.cost) for record in in_table_order(records) if record.cost is not None]
    if not known:
        return None
    rows = []
    for record, cost in known:
        origin = Origin(record=named_record(record.content_id, record.planner, record.run.split))
        rows.append((row_name(record, ""), record.run.split, *_cells(origin, cost, "scenes")))
    return table_of(
        COST,
        f"{data_name}: what planners cost",
        ("planner", "split", *_HEADS),
        rows,
        notes=(*notes_of_marks([record for record, _ in known]), _NOTE, *_shared([cost for _, cost in known])),
        text_columns=3,
    )


def drive_cost_table(data_name: str, records: Sequence[DriveRecord]) -> Table | None:
    """Latency and memory of every planner while it drove.

    Args:
        data_name: Name of the data set.
        records: Of drives through it.

    Returns:
        The table, or ``None`` where nothing was noted.

    Raises:
        InputError: As of `leaderboard.tables.worlds.worlds`.
    """
    known = [
        (record, name, record.cost)
        for world in worlds(records)
        for record, name in zip(world.records, world.planners, strict=True)
        if record.cost is not None
    ]
    if not known:
        return None
    rows = []
    for record, name, cost in known:
        facts = record.facts
        where = f"{facts.split}, {facts.measured.world}, sensor {facts.measured.sensor}"
        rows.append((planner_cell(record, name), where, *_cells(origin_of_drives(record, name), cost, "drives")))
    planners = [record.facts.planner for record, _, _ in known]
    marks = mark_notes(
        privileged=any(each.privileged for each in planners), miniature=any(each.miniature for each in planners)
    )
    return table_of(
        f"drive-{COST}",
        f"{data_name}: what planners cost while they drive",
        ("planner", "driven", *_HEADS),
        rows,
        notes=(*marks, _NOTE, *_shared([cost for _, _, cost in known])),
        text_columns=3,
    )


def _shared(costs: Sequence[PlannerCost]) -> list[str]:
    return [_SHARED_NOTE] if any(summary_of(cost).workers > 1 for cost in costs) else []


def _cells(origin: Origin, cost: PlannerCost, pieces: str) -> tuple[str | Shown, ...]:
    """Cells of `_HEADS`; pieces are what memory was looked at for."""
    said, of, count = summary_of(cost), f"samples after the first of their {pieces}", len(cost.scenes)
    return (
        "; ".join(said.devices),
        origin.cell(said.median_s, "ms", said.samples, of, scale=_MS).shown(2),
        origin.cell(said.p95_s, "ms", said.samples, of, scale=_MS).shown(2),
        origin.cell(said.peak_memory_mb, "MB", count, pieces).shown(0),
        origin.cell(said.peak_device_mb, "MB", count, pieces).shown(0) if said.peak_device_mb else UNDEFINED,
        origin.count(said.workers, "processes").shown(),
    )
