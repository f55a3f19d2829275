"""One unit of driving: one scene and one run, driven and scored, here or in another process.

What came of it is kept under a content key, in a file of its own that is written last: finished units are read. A kept
drive that was scored by earlier definitions is driven again by its stored plans, without its planner.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from benchmark.closed_loop.drives.asking import Reason
from benchmark.closed_loop.drives.driving import Drive, Stage, drive
from benchmark.closed_loop.drives.riding import RecordedCan, RideMaker
from benchmark.closed_loop.drives.sensors import NoSensor, Sensor
from benchmark.closed_loop.scores.scoring import VERSION, score_drive
from benchmark.errors import InputError
from benchmark.machine.storage import content_key, content_seed, file_name, read_json, write_json
from benchmark.planning import Observation, Plan, PlanFrame, Planner, SceneInfo
from benchmark.records.drive_schema import DriveRow, Measured
from benchmark.records.run_schema import PlannerFacts
from benchmark.runs.code_identity import code_sha256
from benchmark.runs.drive_rows import DECIMALS, row_of
from benchmark.runs.plan_rows import PlannerFactory, seed_everything
from benchmark.scene import Scene

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

FORMAT: Final = 1
"""Raised whenever the drives of an unchanged planner in an unchanged engine would change."""
KEPT: Final = "drives"
"""Folder of kept drives in a record's directory."""
_LOOP: Final = "benchmark.closed_loop.drives.driving:drive"
_LONG_S: Final = 3600.0
"""Nothing that is stored is late."""


@dataclass(frozen=True, slots=True)
class Unit:
    """One scene and one run."""

    scene: str
    run: int


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
        return content_key("drive", FORMAT, self.fingerprint, unit.scene, unit.run, who, what, code)

    def path(self, unit: Unit) -> Path:
        """File of a unit; scene names may hold slashes."""
        return self.directory / KEPT / f"{file_name(unit.scene)}-{unit.run}.json"


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
    row = _driven(job, data, scene, unit.run, planner)
    if row.failure is None or row.failure.reason != Reason.TIMEOUT.value:
        # How long a plan takes is the machine's matter: the same command tries again.
        write_kept(path, key, row)
    return UnitResult(unit, row, time.perf_counter() - started)


def can_of(data: "DataSet", name: str) -> RecordedCan:
    """What the recorded car measured in a scene."""
    return RecordedCan.of((observation.ego for observation in data.observations(name)), data.root)


def driven_again(maker: RideMaker, scene: Scene, data: "DataSet", row: DriveRow) -> DriveRow:
    """Drive the stored plans of a drive and score it anew; its planner is not asked.

    Args:
        maker: The engine that drove it.
        scene: Its scene, with its map.
        data: The data set.
        row: The drive.

    Returns:
        The drive with new scores. A failed one stays as it is: it has none.

    Raises:
        InputError: If the plans lead elsewhere than they did.
    """
    if row.status == "failed":
        return row
    found = redriven(maker, NoSensor(), scene, data, row, StoredPlans(row))
    made = row_of(scene, row.run, found, None if found.failure is not None else score_drive(scene, found))
    if made.ticks != row.ticks or made.contact != row.contact:
        raise InputError(_elsewhere(row))
    return made


def redriven(
    maker: RideMaker, sensor: Sensor, scene: Scene, data: "DataSet", row: DriveRow, plans: "StoredPlans"
) -> Drive:
    """What happened in a stored drive, everybody in it, from its plans.

    Args:
        maker: The engine that drove it.
        sensor: What looks again.
        scene: Its scene, with its map.
        data: The data set.
        row: The drive.
        plans: Of this row.

    Returns:
        The drive; one in which the planner failed ends where it did.

    Raises:
        InputError: If the plans lead elsewhere than they did.
    """
    found = drive(Stage(scene, can_of(data, row.scene), row.run, maker, sensor, _LONG_S), plans)
    ticks = found.motion.ticks
    states = np.round(found.motion.ego[ticks], DECIMALS).tolist()
    if (found.motion.times_us[ticks].tolist(), states) != (row.ticks.time_us, row.ticks.ego):
        raise InputError(_elsewhere(row))
    return found


def _elsewhere(row: DriveRow) -> str:
    return (
        f"the stored plans of {row.scene}, run {row.run}, lead elsewhere than they did: the engine or the data set "
        "has changed since; run the same drive command again"
    )


class StoredPlans:
    """The planner of a drive that was driven already: its plans, in their order."""

    name = "stored plans"

    def __init__(self, row: DriveRow) -> None:
        self._plans = [Plan(np.array(plan.waypoints, np.float64), PlanFrame(plan.frame)) for plan in row.plans]
        self._next = 0

    def reset(self, scene: SceneInfo) -> None:
        """Begin with the first."""
        self._next = 0

    def plan(self, observation: Observation) -> Plan:
        """The next one; raises `LookupError` where there is none."""
        if self._next >= len(self._plans):
            raise LookupError("there are no more stored plans")
        self._next += 1
        return self._plans[self._next - 1]


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


def _driven(job: Job, data: "DataSet", scene: Scene, run: int, planner: Planner) -> DriveRow:
    stage = Stage(scene, can_of(data, scene.name), run, job.maker, job.sensor, job.timeout_s)
    found = drive(stage, planner)
    return row_of(scene, run, found, None if found.failure is not None else score_drive(scene, found))
