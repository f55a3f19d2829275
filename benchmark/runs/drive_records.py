"""The record of all drives of a planner: its fields, what its planner took, and what is kept no longer."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmark.closed_loop.scoring import VERSION
from benchmark.datasets.scene_facts import with_truth
from benchmark.machine.storage import writing_to
from benchmark.records.considered import FOLDER as CONSIDERED
from benchmark.records.drive_schema import DriveRow
from benchmark.records.drives import DriveRecord, write_drives
from benchmark.records.planner_cost import gather_costs, note_cost
from benchmark.records.run_schema import TruthFacts
from benchmark.runs.caveats import drive_caveats
from benchmark.runs.drive_jobs import KEPT, Job, Unit
from benchmark.runs.drive_rows import with_labels
from benchmark.runs.drive_settings import DriveSettings
from benchmark.runs.drive_work import UnitResult, costs_of
from benchmark.runs.judges import JudgedScenes, described
from benchmark.runs.plan_rows import supervision_said
from benchmark.untrusted.plans_beside_recording import ComparedPlans

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


@dataclass(frozen=True)
class JobResults:
    """All drives of a job.

    Attributes:
        data: The data set.
        split: Which of its splits.
        scenes: The scenes that were driven.
        job: What was driven.
        units: Its units.
        results: Of the units, in their order.
        settings: How they were driven.
        truths: What the data set holds of each scene's truth.
    """

    data: "DataSet"
    split: str
    scenes: tuple[str, ...]
    job: Job
    units: Sequence[Unit]
    results: Sequence[UnitResult]
    settings: DriveSettings
    truths: Mapping[str, TruthFacts]

    @cached_property
    def rows(self) -> list[DriveRow]:
        """Of the record."""
        return with_labels([result.row for result in self.results], self.truths)

    @cached_property
    def of_data(self) -> dict[str, Any]:
        """What the record says of its data."""
        scenes = JudgedScenes(self.data, self.split, self.scenes)
        said = described(scenes, "scene_facts", "frozen_split", "review", "generated")
        return {**said, "scene_facts": with_truth(said["scene_facts"], self.truths)}


def _config(of: JobResults) -> dict[str, Any]:
    return {
        "seed": of.settings.seed,
        "timeout_s": of.settings.timeout_s,
        **supervision_said(of.job.factory),
        **({"categories": dict(of.data.categories)} if of.data.categories else {}),
    }


def _caveats(of: JobResults) -> Any:
    compared = ComparedPlans.joined(result.compared for result in of.results)
    door = getattr(of.job.factory, "caveats", ())
    return drive_caveats(of.job.planner, of.of_data["scene_facts"], of.rows, of.job.measured, compared, door)


FIELDS: Final[Mapping[str, Callable[[JobResults], Any]]] = {
    "planner": lambda of: of.job.planner,
    "measured": lambda of: of.settings.measured,
    "runs": lambda of: of.settings.runs_made,
    "scoring": lambda of: VERSION,
    "config": _config,
    "caveats": _caveats,
}
"""What the record says of its drives, by field."""


def write_record(of: JobResults) -> DriveRecord:
    """Write the record of a job, note what its planner took, and remove what is kept of other scenes."""
    said = of.of_data | {name: make(of) for name, make in FIELDS.items()}
    record = write_drives(of.job.directory, said, of.rows, seed=of.settings.seed)
    if of.job.costs is not None:
        gather_costs(of.job.costs, of.job.planner)
        note_cost(of.job.costs, of.job.planner, costs_of(of.job, of.results, of.settings.processes))
    _tidy(of.job, of.units)
    return record


def _tidy(job: Job, units: Sequence[Unit]) -> None:
    """Remove what is kept of scenes that are none of this record's any more; further runs of its own stay."""
    wanted = {_without_run(job.store.path(unit.name)) for unit in units}
    for folder in (job.directory / KEPT, job.directory / CONSIDERED):
        with writing_to(folder):
            for path in folder.iterdir() if folder.is_dir() else ():
                if _without_run(path) not in wanted:
                    path.unlink()


def _without_run(path: Path) -> str:
    return path.stem.rpartition("-")[0]
