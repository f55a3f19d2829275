"""What planners cost: latency and memory, by the machine that they ran on."""

from collections.abc import Sequence
from typing import Final

from benchmark.records.drives import DriveRecord
from benchmark.records.planner_cost import COLD_SAMPLES, PlannerCost, summary_of
from benchmark.records.run import RunRecord
from benchmark.report.cells import Cell, Origin
from benchmark.report.table import Table
from leaderboard.frame.drives import worlds
from leaderboard.frame.rows import marks_of, notes_of_marks
from leaderboard.frame.runs import Frame
from leaderboard.frame.specification import Value, Values, numbers, tabulate, texts
from leaderboard.page.files import COST

_MS: Final = 1000.0
_NOTE: Final = (
    f"Latency: from asking to the plan, reading images included, by the clock; the first {COLD_SAMPLES} samples of "
    "each scene are left out. Memory: greatest resident memory of the process that plans, the harness included (of "
    "planners of other packages their own process); GPU: greatest memory allocated there. Of this machine and of what "
    "else ran on it: no part of a record, and different each time."
)
_SHARED_NOTE: Final = "Several processes planned side by side; latencies are longer than alone."


def cost_table(frame: Frame) -> Table | None:
    """Latency and memory of every planner on every split; ``None`` where nothing was noted."""
    rows = frame.rows("", _cost)
    shown = [row.names | _values(row.origin, row.found, "scenes") for row in rows]
    marks = notes_of_marks(row.record for row in rows)
    return _table(COST, f"{frame.data_name}: what planners cost", "split", shown, marks)


def drive_cost_table(data_name: str, records: Sequence[DriveRecord]) -> Table | None:
    """Latency and memory of every planner while it drove; ``None`` where nothing was noted."""
    shown: list[Values] = []
    planners = []
    for row in (row for world in worlds(records) for row in world.rows):
        facts, cost = row.record.facts, row.record.cost
        if cost is not None:
            where = f"{facts.split}, {facts.measured.world}, sensor {facts.measured.sensor}"
            shown.append({"planner": row.planner, "driven": where, **_values(row.origin, cost, "drives")})
            planners.append(facts.planner)
    title = f"{data_name}: what planners cost while they drive"
    return _table(f"drive-{COST}", title, "driven", shown, marks_of(planners))


def _cost(record: RunRecord) -> PlannerCost | None:
    return record.cost


def _table(name: str, title: str, where: str, rows: Sequence[Values], marks: Sequence[str]) -> Table | None:
    if not rows:
        return None
    columns = [
        *texts("planner", where, "device"),
        *numbers("median, ms", "p95, ms", digits=2),
        *numbers("memory, MB", "GPU, MB", "processes"),
    ]
    several = any(isinstance(cell := row["processes"], Cell) and (cell.value or 0) > 1 for row in rows)
    return tabulate(name, title, columns, rows, (*marks, _NOTE, *([_SHARED_NOTE] if several else [])))


def _values(origin: Origin, cost: PlannerCost, pieces: str) -> dict[str, Value]:
    """Cost of a planner; pieces are those for which memory was looked at."""
    said, of, count = summary_of(cost), f"samples after the first of their {pieces}", len(cost.scenes)
    return {
        "device": "; ".join(said.devices),
        "median, ms": origin.cell(said.median_s, "ms", said.samples, of, scale=_MS),
        "p95, ms": origin.cell(said.p95_s, "ms", said.samples, of, scale=_MS),
        "memory, MB": origin.cell(said.peak_memory_mb, "MB", count, pieces),
        "GPU, MB": origin.cell(said.peak_device_mb, "MB", count, pieces) if said.peak_device_mb else None,
        "processes": origin.count(said.workers, "processes"),
    }
