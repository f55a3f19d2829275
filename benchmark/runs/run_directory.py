"""Where a run lies on disk."""

from collections.abc import Sequence
from pathlib import Path

from benchmark.machine.storage import content_key, sanitise_file_name
from benchmark.records.run_schema import AS_PUBLISHED, PlannerFacts


def run_directory(out: Path, data_name: str, split: str, planner: PlannerFacts, part: Sequence[str] = ()) -> Path:
    """Directory of a run, ``<out>/<data>/<split>/<planner>``.

    One planner on one split of one data set has one directory, so that a repeated run replaces its record. Another
    checkpoint or seed, what is done as published, and a part of the scenes are told apart by a short hash.
    """
    special = {
        "checkpoint": planner.settings.get("checkpoint_sha256"),
        "seed": planner.seed,
        "part": list(part),
    }
    if AS_PUBLISHED in planner.settings:
        special[AS_PUBLISHED] = planner.settings[AS_PUBLISHED]
    suffix = f"-{content_key(special)[:8]}" if any(special.values()) else ""
    return out / sanitise_file_name(data_name) / sanitise_file_name(split) / (sanitise_file_name(planner.name) + suffix)
