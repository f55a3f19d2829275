"""Failures of a planner from its record, the worst first: contacts with whom, when and at whose fault, and crashes.

In open loop a sample fails if its plan touches something within 3 s under ``exact``, and its contact is the first one;
fault is attributed as in the table of effects (`benchmark.metrics.effect`). Of drives it is the contact that ended one,
else the first. Contacts with an adversary come first, then those at the planner's fault, then the hardest.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from benchmark.metrics.effect import AT_3_S, attributes_contacts, collect_sample_contacts, knows_contact_partners
from benchmark.records.drives import DriveRecord
from benchmark.records.fault import FaultVerdict, StoredFault, blames_ego
from benchmark.records.rows import SampleRows, find_raised_line
from benchmark.records.run import RunRecord

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

_FAULT_ORDER: Final[dict[FaultVerdict | None, int]] = {
    FaultVerdict.EGO: 0,
    None: 1,
    FaultVerdict.SHARED: 2,
    FaultVerdict.UNCLEAR: 3,
    FaultVerdict.OTHER: 4,
}


@dataclass(frozen=True, slots=True)
class Failure:
    """A contact of a plan, or of a drive.

    Attributes:
        index: Number of the sample in its scene, or of the run of a drive.
        sample_token: ``None`` of drives.
        moment_s: When the plan was made, seconds since the scene's first sample; 0 of drives.
        contact_s: When something is touched first, on the same clock; of drives, seconds since the ego drives.
        hit: Instance that is touched; ``None``, like ``contact_s``, where an old record does not say it.
        category: Its category; ``None`` where the record does not say it and no data set was given.
        adversary: Whether it is an adversary; ``None`` where the record does not say that.
        at_fault: Whether it is the planner's fault (``fault@1``); ``None`` where the record does not say it.
        delta_v_m_s: Change of the ego's velocity; ``None`` where the record does not say it.
        fault: Whose fault it is, and why; likewise.
    """

    scene: str
    index: int
    sample_token: str | None
    moment_s: float
    contact_s: float | None
    hit: str | None
    category: str | None
    adversary: bool | None
    at_fault: bool | None
    delta_v_m_s: float | None
    fault: StoredFault | None = None

    @property
    def order(self) -> tuple[bool, int, float, str, int]:
        """Key to sort by, the worst first."""
        speed, verdict = self.delta_v_m_s or 0.0, None if self.fault is None else self.fault.verdict
        return self.adversary is not True, _FAULT_ORDER[verdict], -speed, self.scene, self.index


@dataclass(frozen=True, slots=True)
class Crash:
    """A sample or a drive for which there is no plan: ``raised`` is what the planner raised, in a line."""

    scene: str
    index: int
    sample_token: str | None
    moment_s: float
    raised: str


@dataclass(frozen=True, slots=True)
class FailedScene:
    """A scene with failures, the worst first, among ``counted`` samples or drives that have a verdict."""

    scene: str
    counted: int
    failures: tuple[Failure, ...]


@dataclass(frozen=True)
class Failures:
    """Failures in a record, by scene: the scene of the worst one first.

    ``counted`` and ``scenes_counted`` are samples or drives that have a verdict, and their scenes.
    """

    record: RunRecord | DriveRecord
    scenes: tuple[FailedScene, ...]
    crashes: tuple[Crash, ...]
    counted: int
    scenes_counted: int

    @property
    def unit(self) -> str:
        """What is counted: a sample, or a drive."""
        return "drive" if isinstance(self.record, DriveRecord) else "sample"

    @cached_property
    def worst(self) -> tuple[Failure, ...]:
        """All failures, the worst first: the first n of them are in the first n scenes."""
        found = (failure for scene in self.scenes for failure in scene.failures)
        return tuple(sorted(found, key=lambda failure: failure.order))


def find_failures(record: RunRecord | DriveRecord, data: "DataSet | None" = None, limit: int | None = None) -> Failures:
    """Failures of a planner from its record; no planner runs.

    Args:
        record: A run record, or a record of drives.
        data: The data set that it ran on: open-loop records do not say of which category an object is.
        limit: Look up categories in the first so many scenes only, as each has to be read.

    Returns:
        The failures, the worst first.

    Raises:
        InputError: If ``exact`` judged the record in another version than the present one.
    """
    found = _find_in_drives(record) if isinstance(record, DriveRecord) else _find_in_samples(record)
    if data is None or isinstance(record, DriveRecord):
        return found
    known = set(data.scene_names())
    scenes = [
        _with_categories(scene, data) if scene.scene in known and (limit is None or place < limit) else scene
        for place, scene in enumerate(found.scenes)
    ]
    return replace(found, scenes=tuple(scenes))


def _find_in_samples(record: RunRecord) -> Failures:
    columns, contacts = record.columns, collect_sample_contacts(record)
    scenes, tokens, index, times = (columns.values(name) for name in ("scene", "sample_token", "index", "timestamp_us"))
    began = {scene: min(times[place] for place in places) for scene, places in columns.places_of_scenes.items()}
    says_whom = knows_contact_partners(record) or not attributes_contacts(record)
    counted: dict[str, int] = {}
    failures: list[Failure] = []
    for row in np.flatnonzero(contacts.counted).tolist():
        place = int(columns.planned[row])
        scene, hit, severity = scenes[place], contacts.hits[row], contacts.severity[row]
        counted[scene] = counted.get(scene, 0) + 1
        if not contacts.any_contact[row, AT_3_S]:
            continue
        moment_s = (times[place] - began[scene]) * 1e-6
        failures.append(
            Failure(
                scene,
                index[place],
                tokens[place],
                moment_s,
                None if hit is None else moment_s + hit[1],
                None if hit is None else hit[0],
                None,
                bool(contacts.adversary[row, AT_3_S]) if says_whom else None,
                None if severity is None else blames_ego(severity.fault),
                None if severity is None else severity.delta_v_ego_m_s,
                None if severity is None else severity.fault,
            )
        )
    crashes = [
        Crash(
            row.scene,
            row.index,
            row.sample_token,
            (row.timestamp_us - began[row.scene]) * 1e-6,
            find_raised_line(row.error),
        )
        for row in SampleRows.of(record.rows).of_failed_scenes()
        if row.error is not None
    ]
    return _collect(record, failures, crashes, counted)


def _find_in_drives(record: DriveRecord) -> Failures:
    counted: dict[str, int] = {}
    failures: list[Failure] = []
    crashes: list[Crash] = []
    for row in record.rows:
        if row.failure is not None:
            crashes.append(Crash(row.scene, row.run, None, 0.0, find_raised_line(row.failure.text)))
        if row.failure is not None or row.unlabelled:
            continue
        counted[row.scene] = counted.get(row.scene, 0) + 1
        contact = row.contact or row.first_contact
        if contact is not None:
            failures.append(
                Failure(
                    row.scene,
                    row.run,
                    None,
                    0.0,
                    contact.seconds,
                    contact.agent,
                    contact.category,
                    contact.adversary,
                    blames_ego(contact.fault),
                    contact.delta_v_ego,
                    contact.fault,
                )
            )
    return _collect(record, failures, crashes, counted)


def _collect(
    record: RunRecord | DriveRecord, failures: Iterable[Failure], crashes: Sequence[Crash], counted: Mapping[str, int]
) -> Failures:
    by_scene: dict[str, list[Failure]] = {}
    for failure in sorted(failures, key=lambda failure: failure.order):
        by_scene.setdefault(failure.scene, []).append(failure)
    scenes = tuple(FailedScene(scene, counted[scene], tuple(found)) for scene, found in by_scene.items())
    return Failures(record, scenes, tuple(crashes), sum(counted.values()), len(counted))


def _with_categories(scene: FailedScene, data: "DataSet") -> FailedScene:
    agents = data.scene(scene.scene).agents
    known = dict(zip(agents.ids, agents.categories, strict=True))
    return replace(
        scene, failures=tuple(replace(failure, category=known.get(failure.hit or "")) for failure in scene.failures)
    )
