"""Score the stored plans of records of drives anew: after a change of scores, no planner has to run again."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.closed_loop.engines import restore_backend
from benchmark.closed_loop.scoring import VERSION
from benchmark.datasets.scene_facts import add_truth_facts
from benchmark.errors import InputError
from benchmark.machine.environment import read_machine_metadata as environment_facts
from benchmark.machine.extension import AbsentExtensionError
from benchmark.machine.storage import lock_folder
from benchmark.records.drives import DRIVE_FILES, DriveRecord, load_drives, summarise_episodes, write_drives
from benchmark.records.store import DRIVE_FILE, finish_replacement, pending_path
from benchmark.runs.caveats import list_drive_caveats
from benchmark.runs.drive_rows import compare_drive, mark_labelled
from benchmark.runs.redriving import redrive_and_score
from benchmark.runs.rescoring import (
    OpenedDataSets,
    RescoringResult,
    open_if_recorded_on,
    read_current_scene_facts,
    require_same_data,
)
from benchmark.runs.scene_reading import collect_truth_facts
from benchmark.untrusted.plan_plausibility import ComparedPlans

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

_MADE_BY_WRITING = {"schema_version", "status", "seed", "files"}


def rescore_drives(directory: Path, data: "DataSet") -> DriveRecord:
    """Score a record of drives anew from its stored plans, in its place.

    Plans, failures, the planner and the environment that it ran in stay. A record in which nothing would change is not
    written, so doing it twice changes no byte.

    Args:
        directory: Of the record; a replacement that was stopped half-way is finished first.
        data: The data set that it was driven on.

    Returns:
        The record with new scores. Failed drives stay as they are.

    Raises:
        InputError: If the record is damaged, the data set is another one, or the plans lead elsewhere than they did.
    """
    return _rescore(directory, lambda _: data)[0]


def rescore_all_drives(root: Path, open_split: Callable[[str], "DataSet"], data_name: str) -> Iterator[RescoringResult]:
    """Score all records of drives below a folder anew; one that cannot be does not stop the others.

    Args:
        root: Where to look.
        open_split: Opens the data set that holds a split; asked once for each split.
        data_name: Name of the data set; records of others are left alone.

    Yields:
        What became of each record, by path.

    Raises:
        InputError: If the folder does not exist.
    """
    if not root.is_dir():
        raise InputError(f"{root} does not exist; run challenger-bench drive first, or correct --out")
    opened: OpenedDataSets = {}

    def open_for(record: DriveRecord) -> "DataSet | None":
        return open_if_recorded_on(data_name, record.facts, opened, open_split)

    names = (DRIVE_FILE, pending_path(Path(), DRIVE_FILE).name)
    for directory in sorted({path.parent for name in names for path in root.rglob(name)}):
        try:
            yield RescoringResult(directory, _rescore(directory, open_for)[1])
        except AbsentExtensionError as absent:
            yield RescoringResult(directory, f"skipped: {absent}")
        except InputError as error:
            yield RescoringResult(directory, str(error), failed=True)


def _rescore(directory: Path, open_for: "Callable[[DriveRecord], DataSet | None]") -> tuple[DriveRecord, str]:
    """The record and what became of it; it is left alone where there is no data set for it."""
    if not directory.is_dir():
        raise InputError(f"no record of drives in {directory}; give the folder that holds its {DRIVE_FILE}")
    with lock_folder(directory):
        finish_replacement(directory, DRIVE_FILES)
        old = load_drives(directory)
        facts, measured = old.facts, old.facts.measured
        data = open_for(old)
        if data is None:
            return old, f"skipped: it belongs to data set {facts.data.name}; choose that one with --data"
        require_same_data(directory, facts, data, again="drive")
        maker = restore_backend(measured)
        truths = collect_truth_facts(data, facts.scenes)
        rows = mark_labelled([redrive_and_score(maker, data.scene(row.scene), data, row) for row in old.rows], truths)
        compared = ComparedPlans.joined(compare_drive(data.scene(row.scene), row) for row in rows)
        described = {name: getattr(facts, name) for name in type(facts).model_fields if name not in _MADE_BY_WRITING}
        scene_facts = add_truth_facts(read_current_scene_facts(facts, data), truths)
        described |= {
            "scoring": VERSION,
            "scene_facts": scene_facts,
            "caveats": list_drive_caveats(facts.planner, scene_facts, rows, measured, compared, facts.caveats),
        }
        same = list(old.rows) == rows and all(getattr(facts, name) == value for name, value in described.items())
        if same and old.summary == summarise_episodes(
            rows, described["scene_facts"], seed=facts.seed, engine=measured.engine
        ):
            return old, "current"
        described["rescored"] = environment_facts()
        return write_drives(directory, described, rows, seed=facts.seed), "rescored"
