"""Records that know what their plans cost."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from benchmark.records.drives import DriveRecord
from benchmark.records.planner_cost import PlannerCost, cost_path, read_matching_cost
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import PlannerFacts


def with_cost(record: RunRecord, roots: Sequence[Path], timings_of: Callable[[Path], Path]) -> RunRecord:
    """The record with what planning took, if that was noted; ``roots`` are folders of run directories.

    ``timings_of`` says where notes on a folder lie (`benchmark.machine.workspace.Workspace.timings_of`).
    """
    cost = _find_noted_cost(record.directory, record.run.planner, roots, timings_of)
    return record if cost is None else replace(record, cost=cost)


def with_drive_cost(record: DriveRecord, roots: Sequence[Path], timings_of: Callable[[Path], Path]) -> DriveRecord:
    """`with_cost` of a record of drives."""
    cost = _find_noted_cost(record.directory, record.facts.planner, roots, timings_of)
    return record if cost is None else replace(record, cost=cost)


def _find_noted_cost(
    directory: Path, planner: PlannerFacts, roots: Sequence[Path], timings_of: Callable[[Path], Path]
) -> PlannerCost | None:
    root = next((root for root in roots if directory.is_relative_to(root)), None)
    return None if root is None else read_matching_cost(cost_path(timings_of(root), root, directory), planner)
