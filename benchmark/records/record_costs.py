"""Run records that know what their plans cost."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from benchmark.records.planner_cost import cost_of, cost_path
from benchmark.records.run import RunRecord


def with_cost(record: RunRecord, roots: Sequence[Path], timings_of: Callable[[Path], Path]) -> RunRecord:
    """A record that knows what planning took, if that was noted.

    Args:
        record: From below one of the folders.
        roots: Folders of run directories.
        timings_of: Where notes on what was made in a folder lie (`benchmark.machine.workspace.Workspace.timings_of`).

    Returns:
        The record.

    Raises:
        InputError: If a note is damaged.
    """
    for root in roots:
        if record.directory.is_relative_to(root):
            found = cost_of(cost_path(timings_of(root), root, record.directory), record.run.planner)
            return record if found is None else replace(record, cost=found)
    return record
