"""What a planner raised, as text to read: beside a record, not part of it."""

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from benchmark.machine.storage import write_bytes, writing_to
from benchmark.records.row_schema import SampleRow
from benchmark.records.rows import Rows

FAILURES_FILE: Final = "failures.txt"


def write_failures(directory: Path, rows: Sequence[SampleRow]) -> None:
    """Write every traceback below the scene and the sample that it is of; remove the file where there is none."""
    path = directory / FAILURES_FILE
    # Of a compressed record the scenes without a failure are not unpacked.
    some = rows.of_failed_scenes() if isinstance(rows, Rows) else rows
    failed = [row for row in some if row.error is not None]
    if not failed:
        with writing_to(path):
            path.unlink(missing_ok=True)
        return
    parts = [
        f"{row.scene}, sample {row.index} ({row.sample_token})\n\n{(row.error or '').rstrip()}\n" for row in failed
    ]
    head = f"{len(failed)} of {len(rows)} samples failed\n\n"
    write_bytes(path, (head + "\n".join(parts)).encode(errors="backslashreplace"))


def first_failure(rows: Sequence[SampleRow]) -> str | None:
    """The last line of the first traceback, which says what was raised; ``None`` if nothing was."""
    error = next((row.error for row in rows if row.error is not None), None)
    if error is None:
        return None
    # A message may have many lines; the one that names the exception is the last that is not indented.
    lines = [line for line in error.rstrip().splitlines() if line.strip()]
    raised = [line for line in lines[_last_frame(lines) + 1 :] if not line.startswith(" ")]
    return (raised or lines or ["nothing was said"])[0].strip()


def _last_frame(lines: Sequence[str]) -> int:
    return max((number for number, line in enumerate(lines) if line.startswith('  File "')), default=-1)
