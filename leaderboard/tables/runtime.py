"""Runtime of generation beside the paper's, from scene sheets, and latency and memory of planners by machine."""

from collections.abc import Sequence
from typing import Final

from benchmark.published import RUNTIME_MACHINE, RUNTIME_S, RUNTIME_SOURCE
from benchmark.records.drives import DriveRecord
from benchmark.records.planner_cost import COLD_SAMPLES, PlannerCost, summarise_cost
from benchmark.records.run import RunRecord
from benchmark.records.scene_pages import SplitPage
from benchmark.records.statistics import RENDERING, BuildRuntime
from benchmark.report.cells import PERCENT, CellSource, ValueSource
from benchmark.report.table import Table
from benchmark.report.words import format_title, pluralise
from leaderboard.frame.drives import group_comparable_drives
from leaderboard.frame.rows import list_planner_marks, list_run_marks
from leaderboard.frame.runs import DataSetRuns
from leaderboard.frame.specification import (
    Value,
    Values,
    find_origin,
    group_columns,
    number_columns,
    tabulate,
    text_columns,
)
from leaderboard.page.sections import COST
from leaderboard.tables.published import quote_seconds

_MS: Final = 1000.0
_NOTE: Final = (
    f"Latency: wall-clock time from request to plan, including reading images; the first {COLD_SAMPLES} samples of "
    "each scene are left out. Memory: peak resident memory of the planning process, including the harness (planners "
    "of other packages have their own process); GPU: peak memory allocated there. The numbers depend on the machine "
    "and its load: they are not part of a record, and vary from run to run."
)
_SHARED_NOTE: Final = "Several processes planned side by side; latencies are longer than in a single process."


def cost_table(frame: DataSetRuns) -> Table | None:
    """Latency and memory of every planner on every split; ``None`` where nothing was noted."""
    rows = frame.rows("", _find_cost)
    cost_rows = [row.names | _cost_values(row.origin, row.found, "scenes") for row in rows]
    marks = list_run_marks(row.record for row in rows)
    return _cost_table(COST, f"{frame.data_name}: cost of planners", "split", cost_rows, marks)


def drive_cost_table(data_name: str, records: Sequence[DriveRecord]) -> Table | None:
    """Latency and memory of every planner while it drove; ``None`` where nothing was noted."""
    cost_rows: list[Values] = []
    planners = []
    for row in (row for world in group_comparable_drives(records) for row in world.rows):
        facts, cost = row.record.facts, row.record.cost
        if cost is not None:
            where = f"{facts.split}, {facts.measured.world}, sensor {facts.measured.sensor}"
            cost_rows.append({"planner": row.planner, "driven": where, **_cost_values(row.origin, cost, "drives")})
            planners.append(facts.planner)
    title = f"{data_name}: cost of planners in closed loop"
    return _cost_table(f"drive-{COST}", title, "driven", cost_rows, list_planner_marks(planners))


def _find_cost(record: RunRecord) -> PlannerCost | None:
    return record.cost


def _cost_table(name: str, title: str, where: str, rows: Sequence[Values], marks: Sequence[str]) -> Table | None:
    if not rows:
        return None
    columns = [
        *text_columns("planner", where, "device"),
        *number_columns("median, ms", "p95, ms", digits=2),
        *number_columns("memory, MB", "GPU, MB", "processes"),
    ]
    several = any(isinstance(cell := row["processes"], CellSource) and (cell.value or 0) > 1 for row in rows)
    return tabulate(name, title, columns, rows, (*marks, _NOTE, *([_SHARED_NOTE] if several else [])))


def _cost_values(origin: ValueSource, cost: PlannerCost, pieces: str) -> dict[str, Value]:
    """Cost of a planner; `pieces` are those with memory figures."""
    said, of, count = summarise_cost(cost), f"samples after the first of their {pieces}", len(cost.scenes)
    return {
        "device": "; ".join(said.devices),
        "median, ms": origin.cell(said.median_s, "ms", said.samples, of, scale=_MS),
        "p95, ms": origin.cell(said.p95_s, "ms", said.samples, of, scale=_MS),
        "memory, MB": origin.cell(said.peak_memory_mb, "MB", count, pieces),
        "GPU, MB": origin.cell(said.peak_device_mb, "MB", count, pieces) if said.peak_device_mb else None,
        "processes": origin.count(said.workers, "processes"),
    }


ALL: Final = "all"
_COLUMNS: Final = [
    *text_columns("stage"),
    *group_columns(
        "here, processor seconds",
        number_columns("total, s", "each, s", digits=2),
        number_columns("% of total", digits=1),
    ),
    *group_columns("paper, seconds by the clock", number_columns("paper, s")),
]


def runtime_tables(data_name: str, splits: Sequence[SplitPage]) -> list[Table]:
    """Processor seconds of each stage of generation, of each split that was timed."""
    return [_table(data_name, split, split.runtime) for split in splits if split.runtime is not None]


def list_stages(runtime: BuildRuntime) -> list[str]:
    """The paper's stages, then all others."""
    return [*RUNTIME_S, *sorted(set(runtime.total_s) - set(RUNTIME_S))]


def count_units(runtime: BuildRuntime, stage: str) -> tuple[int, str]:
    """Number of attempts, or of rendering scenes, that the seconds of a stage are counted over."""
    return (runtime.scenes, "scenes") if stage == RENDERING else (runtime.attempts, "attempts")


def _table(data_name: str, split: SplitPage, runtime: BuildRuntime) -> Table:
    return tabulate(
        f"runtime-{split.split}",
        f"{format_title(data_name, split.split)}: processor seconds of generation",
        _COLUMNS,
        [_values(split, runtime, stage) for stage in (*list_stages(runtime), ALL)],
        (
            f"Here: seconds of one processor core over {pluralise(runtime.attempts, 'attempt')} and "
            f"{pluralise(runtime.scenes, 'rendered scene')}, on any machine; each: one attempt, rendering: one scene.",
            f"Paper: wall-clock seconds for one scene of about 240 frames and six cameras on {RUNTIME_MACHINE}. The "
            "two columns have different units of work and are not comparable.",
        ),
        sources=(RUNTIME_SOURCE,),
    )


def _values(split: SplitPage, runtime: BuildRuntime, stage: str) -> Values:
    origin, every = find_origin(split), sum(runtime.total_s.values())
    total = every if stage == ALL else runtime.total_s.get(stage, 0.0)
    count, of = count_units(runtime, stage)
    return {
        "stage": stage,
        "total, s": origin.cell(total, "s", count, of),
        "each, s": origin.cell(_seconds_per_unit(runtime, stage), "s", count, of),
        "% of total": origin.cell(total / every if every else None, PERCENT, count, of, scale=100.0),
        "paper, s": quote_seconds(stage),
    }


def _seconds_per_unit(runtime: BuildRuntime, stage: str) -> float | None:
    """Seconds of one unit of a stage; of all stages, one attempt and one rendered scene together."""
    if stage == ALL:
        stage_seconds = [_seconds_per_unit(runtime, name) for name in runtime.total_s]
        return sum(seconds or 0.0 for seconds in stage_seconds) if runtime.attempts or runtime.scenes else None
    return runtime.each_s(stage)
