"""What is written: the plans of a run record in the frames of result files."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from adapters.result_files.contract import FileFrame, Rows
from adapters.result_files.frames import file_waypoints
from adapters.result_files.samples import RecordedSamples
from benchmark.constants import PLAN_STEPS
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.planning import Plan, PlanFrame
from benchmark.records.run import RunRecord


@dataclass(frozen=True)
class DumpedPlans:
    """Plans to be written, by row and in the order of rows; all have the same `steps`, waypoints."""

    samples: RecordedSamples
    scenes: tuple[str, ...]
    plans: dict[int, Plan]
    steps: int

    @classmethod
    def of_record(cls, record: RunRecord, samples: RecordedSamples) -> "DumpedPlans":
        """The plans of a record; one without any is an `InputError`."""
        plans = {
            samples.row_of[row.sample_token]: Plan(np.array(row.plan.waypoints), PlanFrame(row.plan.frame))
            for row in record.rows
            if row.plan is not None
        }
        if not plans:
            raise InputError(f"{record.directory} has no plan to write into a result file; see its failures.txt")
        steps = min(len(plan.waypoints) for plan in plans.values())
        return cls(samples, tuple(record.run.scenes), dict(sorted(plans.items())), steps)

    @cached_property
    def info_rows(self) -> Rows:
        """Rows of the scenes that ran, in the likelier order of an info file that is sorted by time."""
        return self.samples.in_orders()[0].of_scenes(self.scenes).by_time

    def waypoints(self, row: int, frame: FileFrame, steps: int = PLAN_STEPS) -> Floats:
        """(K, 2) waypoints of a sample in the frame of a file, metres."""
        return file_waypoints(self.plans[row], frame, self.samples.lidar_in_ego[row])[:steps]

    def by_token(self, frame: FileFrame) -> Iterator[tuple[str, int, Floats]]:
        """Token, row and (6, 2) waypoints of each sample that has a plan."""
        for row in self.plans:
            yield self.samples.tokens[row], row, self.waypoints(row, frame)

    def require_all(self, format_name: str) -> None:
        """Refuse to write a file that names no samples where some have no plan."""
        missing = [self.samples.tokens[row] for row in self.info_rows.tolist() if row not in self.plans]
        if missing:
            raise InputError(
                f"a file of the format {format_name} names no samples, so each needs a plan, and {len(missing)} have "
                f"none, the first {missing[0]}; choose another format"
            )


def written(folder: Path, name: str) -> Path:
    """Path of a file to be written in a folder that exists."""
    folder.mkdir(parents=True, exist_ok=True)
    return folder / name
