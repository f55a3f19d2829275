"""Contacts of records again with the tracks of both users up to them: what a picture of whose fault it is shows."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.closed_loop.engines import restore_backend
from benchmark.closed_loop.fault_attribution import trace_contact
from benchmark.closed_loop.observation_builder import NoSensor
from benchmark.fairness.fault_definition import ContactTracks
from benchmark.fairness.plan_severity import trace_first_contact
from benchmark.metrics.failures import Failure, find_failures
from benchmark.records.drives import DriveRecord, load_drives
from benchmark.records.run import RunRecord, load_record
from benchmark.records.store import DRIVE_FILE
from benchmark.runs.judging import parse_plan
from benchmark.runs.redriving import StoredPlans, redrive_with_sensor
from benchmark.runs.rescoring import open_as_recorded, require_same_data
from benchmark.runs.scene_reading import SceneReading
from benchmark.scene import Scene

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


@dataclass(frozen=True, slots=True)
class TracedContact:
    """A contact of a planner in a scene; ``moment`` says when, in words."""

    scene: Scene
    planner: str
    index: int
    moment: str
    tracks: ContactTracks


def open_with_data(
    directory: Path, open_split: "Callable[[str], DataSet]"
) -> "tuple[RunRecord | DriveRecord, DataSet]":
    """A record of either kind and the data set that it ran on.

    Args:
        directory: Of the record.
        open_split: Opens the data set that holds a split.

    Raises:
        InputError: If there is no record, it is damaged, or the data set is another.
    """
    if (directory / DRIVE_FILE).is_file():
        drives = load_drives(directory)
        data = open_as_recorded(drives.facts, {}, open_split)
        require_same_data(directory, drives.facts, data, again="drive")
        return drives, data
    record = load_record(directory)
    data = open_as_recorded(record.run, {}, open_split)
    require_same_data(directory, record.run, data)
    return record, data


def trace_worst_contacts(
    record: RunRecord | DriveRecord, data: "DataSet", scenes: Sequence[str] | None = None
) -> Iterator[TracedContact]:
    """The worst contact of each scene of a record (`find_failures`), that of the worst scene first.

    Args:
        record: A run record, whose plans are followed through the recorded traffic, or drives, which are driven again.
        data: The data set that it ran on.
        scenes: Only these.

    Raises:
        InputError: If ``exact`` judged the record in another version, or a drive leads elsewhere than it did.
    """
    for failed in find_failures(record).scenes:
        if scenes is not None and failed.scene not in scenes:
            continue
        worst, scene = failed.failures[0], data.scene(failed.scene)
        tracks: ContactTracks | None
        if isinstance(record, DriveRecord):
            tracks, moment = _trace_drive(record, data, scene, worst), "driving"
        else:
            tracks, moment = _trace_plan(record, data, scene, worst), f"plan of {worst.moment_s:.1f} s"
        if tracks is not None:
            when = "" if worst.contact_s is None else f", contact at {worst.contact_s:.1f} s"
            yield TracedContact(scene, record.planner, worst.index, f"{moment}{when}", tracks)


def _trace_drive(record: DriveRecord, data: "DataSet", scene: Scene, failure: Failure) -> ContactTracks:
    row = next(row for row in record.rows if (row.scene, row.run) == (failure.scene, failure.index) and row.touches)
    maker = restore_backend(record.facts.measured)
    episode = redrive_with_sensor(maker, NoSensor(), scene, data, row, StoredPlans(row))
    touch = episode.touch or episode.passed[0]
    return trace_contact(episode.motion, touch)


def _trace_plan(record: RunRecord, data: "DataSet", scene: Scene, failure: Failure) -> ContactTracks | None:
    row = next(row for row in record.rows if row.sample_token == failure.sample_token)
    truth = SceneReading(data, scene.name).truth[failure.index]
    assert row.plan is not None, "a sample that collides has a plan"
    plan = parse_plan(row.plan.model_dump(mode="json")).judged
    return trace_first_contact(truth.by_clock, plan.waypoints_in_lidar(truth.lidar_ahead_m), scene)
