"""One unit of driving: one scene and one run, driven and scored, here or in another process.

What came of it is kept under a content key, in a file of its own that is written last: finished units are read. A kept
drive that was scored by earlier definitions is driven again by its stored plans, without its planner.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmark.closed_loop.drives.asking import Reason
from benchmark.closed_loop.drives.driving import Stage, drive
from benchmark.closed_loop.drives.riding import RideMaker
from benchmark.closed_loop.drives.sensors import Sensor
from benchmark.closed_loop.scores.scoring import VERSION, score_drive
from benchmark.errors import InputError
from benchmark.machine.storage import content_key, content_seed, file_name, read_json, write_json
from benchmark.planning import Planner
from benchmark.records.drive_schema import DriveRow, Measured
from benchmark.records.run_schema import PlannerFacts
from benchmark.runs.beginning_again import begun_again
from benchmark.runs.code_identity import code_sha256
from benchmark.runs.drive_rows import row_of
from benchmark.runs.plan_rows import PlannerFactory, seed_everything
from benchmark.runs.redriving import can_of, driven_again
from benchmark.scene import Scene

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

FORMAT: Final = 1
"""Raised whenever the drives of an unchanged planner in an unchanged engine would change."""
KEPT: Final = "drives"
"""Folder of kept drives in a record's directory."""
_LOOP: Final = "benchmark.closed_loop.drives.driving:drive"


@dataclass(frozen=True, slots=True)
class Unit:
    """One scene, one of its scenarios if it has any, and one run."""

    scene: str
    run: int
    family: str = ""


@dataclass(frozen=True, slots=True)
class Job:
    """What every unit of work needs to know; picklable.

    Attributes:
        directory: The record's directory.
        fingerprint: Of the data set.
        planner: Identity of the planner.
        measured: What is measured.
        maker: The engine.
        sensor: What cameras see.
        timeout_s: How long a plan may take.
        fresh: Drive again even where drives are kept.
    """

    directory: Path
    fingerprint: str
    planner: PlannerFacts
    measured: Measured
    maker: RideMaker
    sensor: Sensor
    timeout_s: float
    fresh: bool

    def key(self, unit: Unit) -> str:
        """Content key of a unit. No score is part of it: kept drives are scored again."""
        who = self.planner.model_dump(mode="json", exclude={"native_protocol", "published_as", "miniature"})
        code = [code_sha256(type(self.maker)), code_sha256(type(self.sensor)), code_sha256(Stage, made_by=_LOOP)]
        what = self.measured.model_dump(mode="json")
        return content_key("drive", FORMAT, self.fingerprint, unit.scene, unit.family, unit.run, who, what, code)

    def path(self, unit: Unit) -> Path:
        """File of a unit; scene names may hold slashes."""
        name = "-".join([file_name(unit.scene), *([unit.family] if unit.family else []), str(unit.run)])
        return self.directory / KEPT / f"{name}.json"


@dataclass(frozen=True, slots=True)
class UnitResult:
    """What came of a unit.

    Attributes:
        unit: Which.
        row: Of the record.
        seconds: How long it took, or ``None`` where it was kept from before.
    """

    unit: Unit
    row: DriveRow
    seconds: float | None


def work_here(job: Job, data: "DataSet", planner: Planner, unit: Unit) -> UnitResult:
    """Drive a unit, or take the drive that is kept.

    Args:
        job: What is done.
        data: The data set.
        planner: The planner.
        unit: Which.

    Returns:
        The result.

    Raises:
        InputError: If the data is broken or the drive cannot be written.
    """
    key, path = job.key(unit), job.path(unit)
    kept = None if job.fresh else kept_drive(path, key)
    if kept is not None and kept[1] == VERSION:
        return UnitResult(unit, kept[0], None)
    scene = data.scene(unit.scene)
    if kept is not None:
        row = driven_again(job.maker, scene, data, kept[0])
        write_kept(path, key, row)
        return UnitResult(unit, row, None)
    started = time.perf_counter()
    seed_everything(content_seed(key))
    row = _driven(job, data, scene, unit, planner)
    if row.failure is None or row.failure.reason != Reason.TIMEOUT.value:
        # How long a plan takes is the machine's matter: the same command tries again.
        write_kept(path, key, row)
    return UnitResult(unit, row, time.perf_counter() - started)


_in_this_process: dict[str, tuple["DataSet", Planner]] = {}
"""Data set and planner of a worker process, opened once."""


def work_in_worker(job: Job, reopen: Callable[[], "DataSet"], factory: PlannerFactory, unit: Unit) -> UnitResult:
    """`work_here` in a worker process, which opens the data set and builds the planner the first time."""
    key = content_key(job.fingerprint, job.planner.model_dump(mode="json"))
    if key not in _in_this_process:
        _in_this_process[key] = (reopen(), factory())
    return work_here(job, *_in_this_process[key], unit)


def kept_drive(path: Path, key: str) -> tuple[DriveRow, int] | None:
    """A drive that is kept under its content key, and the version of its scores; ``None`` if there is none."""
    try:
        kept: Any = read_json(path)
        head, row = kept["head"], kept["row"]
        if head != _header(key, row, int(head["scoring"])):
            return None
        return DriveRow.model_validate(row), int(head["scoring"])
    except (InputError, ValueError, KeyError, TypeError):
        # What is absent or damaged is unfinished work: it is done again.
        return None


def write_kept(path: Path, key: str, row: DriveRow) -> None:
    """Keep a drive."""
    stored = row.model_dump(mode="json")
    write_json(path, {"head": _header(key, stored, VERSION), "row": stored}, indent=None)


def _header(key: str, row: Any, scoring: int) -> dict[str, Any]:
    return {"key": key, "scoring": scoring, "content": content_key(row)}


def _driven(job: Job, data: "DataSet", scene: Scene, unit: Unit, planner: Planner) -> DriveRow:
    stage = Stage(scene, can_of(data, scene.name), unit.run, job.maker, job.sensor, job.timeout_s, unit.family)
    found = begun_again(partial(drive, stage, planner), planner)
    return row_of(stage, found, None if found.failure is not None else score_drive(scene, found))
