"""Where the time of generation goes, ours beside the paper's: from scene sheets."""

from collections.abc import Sequence
from typing import Final

from benchmark.published import RUNTIME_MACHINE, RUNTIME_S, RUNTIME_SOURCE
from benchmark.records.scenes import SplitSheet
from benchmark.records.statistics import RENDERING, Runtime
from benchmark.report.cells import PERCENT
from benchmark.report.table import Table
from benchmark.report.words import counted, titled
from leaderboard.frame.sheets import origin_of
from leaderboard.frame.specification import Values, numbers, tabulate, texts, under
from leaderboard.tables.published import published_seconds

ALL: Final = "all"
_COLUMNS: Final = [
    *texts("stage"),
    *under("here, processor seconds", numbers("total, s", "each, s", digits=2), numbers("% of total", digits=1)),
    *under("paper, seconds by the clock", numbers("paper, s")),
]


def runtime_tables(data_name: str, splits: Sequence[SplitSheet]) -> list[Table]:
    """Processor seconds of each stage of generation, of each split that was timed."""
    return [_table(data_name, split, split.runtime) for split in splits if split.runtime is not None]


def stages_of(runtime: Runtime) -> list[str]:
    """The paper's stages, then all others."""
    return [*RUNTIME_S, *sorted(set(runtime.total_s) - set(RUNTIME_S))]


def counted_of(runtime: Runtime, stage: str) -> tuple[int, str]:
    """Number of attempts, or of rendering scenes, that the seconds of a stage are counted over."""
    return (runtime.scenes, "scenes") if stage == RENDERING else (runtime.attempts, "attempts")


def _table(data_name: str, split: SplitSheet, runtime: Runtime) -> Table:
    return tabulate(
        f"runtime-{split.split}",
        f"{titled(data_name, split.split)}: processor seconds of generation",
        _COLUMNS,
        [_values(split, runtime, stage) for stage in (*stages_of(runtime), ALL)],
        (
            f"Here: seconds of one processor core over {counted(runtime.attempts, 'attempt')} and "
            f"{counted(runtime.scenes, 'rendered scene')}, whatever the machine; each: one attempt, rendering: one "
            "scene.",
            f"Paper: seconds by the clock for one scene of about 240 frames and six cameras on {RUNTIME_MACHINE}. The "
            "two columns have different units of work and do not compare.",
        ),
        sources=(RUNTIME_SOURCE,),
    )


def _values(split: SplitSheet, runtime: Runtime, stage: str) -> Values:
    origin, every = origin_of(split), sum(runtime.total_s.values())
    total = every if stage == ALL else runtime.total_s.get(stage, 0.0)
    count, of = counted_of(runtime, stage)
    return {
        "stage": stage,
        "total, s": origin.cell(total, "s", count, of),
        "each, s": origin.cell(_each(runtime, stage), "s", count, of),
        "% of total": origin.cell(total / every if every else None, PERCENT, count, of, scale=100.0),
        "paper, s": published_seconds(stage),
    }


def _each(runtime: Runtime, stage: str) -> float | None:
    """Seconds of one unit of a stage; of all stages, one attempt and one rendered scene together."""
    if stage == ALL:
        each = [_each(runtime, name) for name in runtime.total_s]
        return sum(seconds or 0.0 for seconds in each) if runtime.attempts or runtime.scenes else None
    return runtime.each_s(stage)
