"""Where a run lies on disk, and what may be left there when it is done."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from urllib.parse import unquote

from benchmark.errors import InputError
from benchmark.machine.storage import content_key, file_name, read_json, write_json, writing_to
from benchmark.records.run_schema import AS_PUBLISHED, PlannerFacts

TIMING_FILE = "timing.json"


def run_directory(out: Path, data_name: str, split: str, planner: PlannerFacts, part: Sequence[str] = ()) -> Path:
    """Directory of a run.

    One planner on one split of one data set has one directory, so that a repeated run replaces its record. Another
    checkpoint or seed, what is done as published, and a part of the scenes are told apart by a short hash.

    Args:
        out: Folder of run directories.
        data_name: Name of the data set.
        split: Name of the split.
        planner: Identity of the planner.
        part: Scenes, if not the whole split runs.

    Returns:
        ``<out>/<data>/<split>/<planner>``.
    """
    special = {
        "checkpoint": planner.settings.get("checkpoint_sha256"),
        "seed": planner.seed,
        "part": list(part),
    }
    if AS_PUBLISHED in planner.settings:
        special[AS_PUBLISHED] = planner.settings[AS_PUBLISHED]
    suffix = f"-{content_key(special)[:8]}" if any(special.values()) else ""
    return out / file_name(data_name) / file_name(split) / (file_name(planner.name) + suffix)


def tidy(directory: Path, planned: Mapping[Path, float | None]) -> None:
    """Remove what an interrupted or earlier run left, and note how long the planner took.

    Args:
        directory: Run directory.
        planned: Row files of this run, with the planning time where they were planned now; known times of the others
            stay.
    """
    with writing_to(directory):
        for path in (*directory.glob(".*.part"), *(directory / "rows").iterdir()):
            if path not in planned:
                path.unlink()
    known: dict[str, float] = {}
    timing = directory / TIMING_FILE
    if timing.exists():
        try:
            known = dict(read_json(timing)["planning_s"])
        except (InputError, KeyError, TypeError, ValueError):
            # Times are a convenience; a damaged file of them is written anew.
            known = {}
    now = {unquote(path.stem): seconds for path, seconds in planned.items() if seconds is not None}
    write_json(timing, {"planning_s": {**known, **now}})
