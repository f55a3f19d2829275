"""Where the time of generation goes, ours beside the paper's: from scene sheets."""

from typing import Final

from benchmark.published import RUNTIME_MACHINE, RUNTIME_S, RUNTIME_SOURCE
from benchmark.records.scenes import Sheets, SplitSheet
from benchmark.records.statistics import RENDERING, Runtime
from benchmark.report.cells import PERCENT, Shown
from benchmark.report.table import Table, table_of
from benchmark.report.words import counted, titled
from leaderboard.tables.published import published_seconds
from leaderboard.tables.statistics import by_data_set, origin_of

ALL: Final = "all"


def runtime_tables(sheets: Sheets) -> dict[str, tuple[Table, ...]]:
    """Processor seconds of each stage of generation.

    Args:
        sheets: Sheets of any splits; those whose generation was not timed have no table.

    Returns:
        Tables by name of the data set.
    """
    return by_data_set(
        sheets,
        lambda name, splits: [_table(name, split, split.runtime) for split in splits if split.runtime is not None],
    )


def _table(data_name: str, split: SplitSheet, runtime: Runtime) -> Table:
    stages = [*RUNTIME_S, *sorted(set(runtime.total_s) - set(RUNTIME_S))]
    return table_of(
        f"runtime-{split.split}",
        f"{titled(data_name, split.split)}: processor seconds of generation",
        ("stage", "total, s", "each, s", "% of total", "paper, s"),
        [_row(split, runtime, stage) for stage in (*stages, ALL)],
        notes=(
            f"Here: seconds of one processor core over {counted(runtime.attempts, 'attempt')} and "
            f"{counted(runtime.scenes, 'rendered scene')}, whatever the machine; each: one attempt, rendering: one "
            "scene.",
            f"Paper: seconds by the clock for one scene of about 240 frames and six cameras on {RUNTIME_MACHINE}. The "
            "two columns have different units of work and do not compare.",
        ),
        groups=(("", 1), ("here, processor seconds", 3), ("paper, seconds by the clock", 1)),
        sources=(RUNTIME_SOURCE,),
    )


def _row(split: SplitSheet, runtime: Runtime, stage: str) -> tuple[str | Shown, ...]:
    origin, every = origin_of(split), sum(runtime.total_s.values())
    total = every if stage == ALL else runtime.total_s.get(stage, 0.0)
    count, of = (runtime.scenes, "scenes") if stage == RENDERING else (runtime.attempts, "attempts")
    return (
        stage,
        origin.cell(total, "s", count, of).shown(2),
        origin.cell(_each(runtime, stage), "s", count, of).shown(2),
        origin.cell(total / every if every else None, PERCENT, count, of, scale=100.0).shown(1),
        published_seconds(stage),
    )


def _each(runtime: Runtime, stage: str) -> float | None:
    """Seconds of one unit of a stage; of all stages, one attempt and one rendered scene together."""
    if stage == ALL:
        each = [_each(runtime, name) for name in runtime.total_s]
        return sum(seconds or 0.0 for seconds in each) if runtime.attempts or runtime.scenes else None
    return runtime.each_s(stage)
