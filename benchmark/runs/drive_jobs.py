"""What is driven: a job, its units, and where each is kept."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from benchmark.closed_loop.driving import Stage
from benchmark.closed_loop.riding import RideMaker
from benchmark.closed_loop.sensors import Sensor
from benchmark.machine.storage import content_key
from benchmark.records.drive_schema import DriveRow, Measured
from benchmark.records.run_schema import LABELS, PlannerFacts
from benchmark.runs.code_identity import code_sha256, is_current
from benchmark.runs.plan_rows import PlannerFactory
from benchmark.runs.units import ResultStore

FORMAT: Final = 1
"""Raised whenever the drives of an unchanged planner in an unchanged engine would change."""
KEPT: Final = "drives"
"""Folder of kept drives in a record's directory."""
_LOOP: Final = "benchmark.closed_loop.driving:drive"


@dataclass(frozen=True, slots=True)
class Unit:
    """One scene, one of its scenarios if it has any, and one run."""

    scene: str
    run: int
    family: str = ""

    @property
    def name(self) -> str:
        """Of its file."""
        return "-".join([self.scene, *([self.family] if self.family else []), str(self.run)])


Paths = list[list[list[float]]]
"""Waypoints of some plans, as JSON has them."""


@dataclass(frozen=True, slots=True)
class KeptDrive:
    """Stored result of a unit.

    Attributes:
        scoring: Version of its scores: drives that were scored by earlier definitions are scored again.
        plan: Its plans of the instants at which the ego was still where it was recorded.
        recorded: What was recorded there.
        loaded: Code that its planner had loaded (`benchmark.runs.code_identity.loaded_code`).
    """

    row: DriveRow
    scoring: int
    plan: Paths
    recorded: Paths
    loaded: dict[str, str]


@dataclass(frozen=True, slots=True)
class Job:
    """Settings that every unit of work needs; picklable.

    Attributes:
        factory: Builds the planner; ``None`` where there is one object alone.
        ladder: Reference drivers that drive the same encounters.
        keep_considered: Whether what an adversary considered is kept beside the record.
        costs: File of what its planner takes (`benchmark.records.planner_cost.cost_path`); ``None`` notes nothing.
    """

    directory: Path
    fingerprint: str
    planner: PlannerFacts
    measured: Measured
    maker: RideMaker
    sensor: Sensor
    timeout_s: float
    fresh: bool
    factory: PlannerFactory | None = None
    ladder: tuple[str, ...] = ()
    keep_considered: bool = False
    costs: Path | None = None

    def key(self, unit: Unit) -> str:
        """Content key of a unit. No score is part of it: kept drives are scored again."""
        who = self.planner.model_dump(mode="json", exclude=LABELS)
        code = [code_sha256(type(self.maker)), code_sha256(type(self.sensor)), code_sha256(Stage, made_by=_LOOP)]
        # Nobody else than an adversary is made elsewhere.
        adversary = getattr(self.maker, "adversary", None)
        code += [] if adversary is None else [code_sha256(type(adversary))]
        what = self.measured.model_dump(mode="json")
        return content_key("drive", FORMAT, self.fingerprint, unit.scene, unit.family, unit.run, who, what, code)

    def kept(self, unit: Unit) -> KeptDrive | None:
        """Stored result of a unit, made by code as it is now."""
        kept = None if self.fresh else self.store.get(self.key(unit), unit.name)
        return kept if kept is not None and is_current(kept.loaded) else None

    @property
    def store(self) -> ResultStore[KeptDrive]:
        """Where drives are kept."""
        return ResultStore(self.directory / KEPT, KeptDrive)


class Task(NamedTuple):
    """A unit of a job."""

    job: Job
    unit: Unit
