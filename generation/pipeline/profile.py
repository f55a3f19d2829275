"""Where the time goes: the paper's runtime table, from notes that workers leave beside their results.

Seconds are those of a processor, so that they do not depend on how many workers there were.
"""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Final

from pydantic import BaseModel, ConfigDict, ValidationError

from benchmark.machine.storage import read_kept_json
from benchmark.published import RUNTIME_S
from benchmark.records.statistics import Runtime
from benchmark.report.table import Table, table_of
from benchmark.report.words import counted

STAGES: Final = ("sampling", "physics", "scoring", "rendering", "other")


class _Note(BaseModel):
    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)

    seconds: dict[str, float]


class RuntimeTable(Runtime):
    """Processor seconds of a build, for people."""

    def table(self) -> Table:
        """The same for a terminal, the paper's beside it."""
        rows = [(stage, self.total_s[stage], self.each_s(stage), RUNTIME_S.get(stage)) for stage in STAGES]
        ours = sum(self.each_s(stage) or 0.0 for stage in STAGES)
        rows.append(("all", sum(self.total_s.values()), ours, sum(RUNTIME_S.values())))
        return table_of(
            "runtime",
            f"processor seconds of {counted(self.attempts, 'attempt')} and {counted(self.scenes, 'scene')}",
            ("stage", "total", "each", "paper"),
            [(name, *("-" if each is None else f"{each:.2f}" for each in seconds)) for name, *seconds in rows],
            notes=(
                "each: one attempt, rendering one scene; paper: quoted, seconds by the clock for one scene on two Xeon "
                "8457C and four L20, rendered by MagicDriveDiT.",
            ),
        )


def runtime_table(attempts: Iterable[Path], scenes: Iterable[Path]) -> RuntimeTable:
    """Table of the time that notes of attempts and of rendered scenes add up to.

    Damaged and absent notes are not counted.
    """
    of_attempts, of_scenes = _notes(attempts), _notes(scenes)
    total = dict.fromkeys(STAGES, 0.0)
    for note in (*of_attempts, *of_scenes):
        for stage, seconds in note.seconds.items():
            total[stage if stage in total else "other"] += seconds
    return RuntimeTable(attempts=len(of_attempts), scenes=len(of_scenes), total_s=total)


def kept_runtime(state: Path, timings: Path) -> RuntimeTable | None:
    """Table of the time that a build took, as far as it is known.

    It has all attempts that were timed there, and the scenes that are written now; ``None`` if there are none;
    neither folder need exist.
    """
    attempts = sorted((timings / "attempts").glob("*.timing.json"))
    written = sorted((state / "fragments").glob("*.json"))
    found = runtime_table(attempts, [timings / "rendering" / f"{path.stem}.timing.json" for path in written])
    return found if found.attempts or found.scenes else None


def mean_seconds(notes: Sequence[Path]) -> float | None:
    """Mean over notes of all stages together, ``None`` where there is no note."""
    found = _notes(notes)
    return sum(sum(note.seconds.values()) for note in found) / len(found) if found else None


def _notes(paths: Iterable[Path]) -> list[_Note]:
    found = []
    for path in paths:
        try:
            found.append(_Note.model_validate(read_kept_json(path)))
        except ValidationError:
            # Times are a convenience; a damaged or absent note says nothing.
            continue
    return found
