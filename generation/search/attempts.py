"""Attempts as resumable work: found by content key on disk, computed where missing, by any executor.

Workers never open the data set: they are sent the scene that they work on.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, SerializerFunctionWrapHandler, field_serializer, model_serializer

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.metering import disable_malloc_trim
from benchmark.machine.storage import canonical_json, write_bytes, write_json
from benchmark.machine.workers import Executor
from benchmark.records.attempts import Attempt
from benchmark.records.scene_pages import SCHEMA, RefinementTrace, TraceFrame
from benchmark.runs.units import ResultStore, run_units
from benchmark.scene import Scene
from benchmark.scene_pages.page_tracks import find_origin
from generation.search.adversary import SearchOutcome, drive_ego, search_vehicles
from generation.search.candidates import Eligibility, compute_eligibility
from generation.search.definition import EarlierAdversary, Search, SearchUnit
from generation.search.driven_tracks import DrivenTracks
from generation.search.hyperparameters import DiscardRules, HyperParameters
from generation.search.verify import verify

SAME_M: Final = 1e-9
"""How far a track that is searched again for its rounds may be from the one that was kept; radians for the heading."""


Poses = tuple[tuple[float, float, float], ...]


class StoredDrive(BaseModel):
    """`DrivenTracks` on disk: ``others`` are first frames and poses by identifier."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    ego: Poses
    others: dict[str, tuple[int, Poses]]

    @classmethod
    def of(cls, driven: DrivenTracks) -> "StoredDrive":
        """Stored form of tracks."""
        return cls.model_validate({
            "ego": driven.ego.tolist(),
            "others": {name: (first, track.tolist()) for name, (first, track) in driven.others.items()},
        })  # fmt: skip

    @property
    def tracks(self) -> DrivenTracks:
        """The tracks."""
        others = {name: (first, np.array(poses, np.float64)) for name, (first, poses) in self.others.items()}
        return DrivenTracks(np.array(self.ego, np.float64), others)


class StoredAttempt(BaseModel):
    """A finished attempt on disk. ``poses`` are its (T - start, 3) executed poses, none where it was discarded.

    ``driven`` are tracks of an ego that reacted.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    agent: int
    report: Attempt
    poses: Poses
    driven: StoredDrive | None = None

    @model_serializer(mode="wrap")
    def _omit_what_was_recorded(self, plain: SerializerFunctionWrapHandler) -> dict[str, Any]:
        values: dict[str, Any] = plain(self)
        return {name: value for name, value in values.items() if name != "driven" or value is not None}

    @field_serializer("report")
    def _as_written(self, report: Attempt) -> dict[str, Any]:
        return report.as_json()

    @classmethod
    def of(cls, unit: SearchUnit, result: SearchOutcome) -> "StoredAttempt":
        """Stored form of an attempt."""
        poses = result.poses.tolist() if result.kept else []
        driven = result.driven if result.kept else None
        return cls(
            agent=unit.agent,
            report=result.attempt,
            poses=tuple((x, y, yaw) for x, y, yaw in poses),
            driven=None if driven is None else StoredDrive.of(driven),
        )

    def adversarial(self, scene: Scene) -> Scene:
        """The kept scene: the one that the attempt started from, earlier adversaries in it, with the stored track."""
        start, agent_id = self.report.launch_frame, self.report.agent
        known = self.agent < len(scene.agents) and scene.agents.ids[self.agent] == agent_id
        if not self.report.kept or start is None or not known:
            raise InputError(
                f"the stored attempt for {agent_id} in {self.report.scene} does not fit this scene; delete the "
                ".challenger folder of the output and run again"
            )
        poses: Floats = np.array(self.poses, dtype=np.float64)
        driven = scene if self.driven is None else self.driven.tracks.put_into(scene)
        return driven.with_adversary(self.agent, slice(start, start + len(poses)), poses)


def read_or_compute_eligibility(
    search: Search, scene_name: str, earlier: tuple[EarlierAdversary, ...], read: Callable[[], Scene], *, keep: bool
) -> Eligibility:
    """Vehicles of a scene that are tried, from disk if kept; ``read`` gives the scene with its earlier adversaries."""
    key, store = search.compute_eligibility_key(scene_name, earlier), open_eligibility_store(search)
    cached = store.get(key)
    if cached is not None and cached.scene_name == scene_name:
        return cached
    computed = compute_eligibility(drive_ego(read(), search.hyper.ego), search.hyper, search.seed)
    if keep:
        store.put(key, computed)
    return computed


def open_eligibility_store(search: Search) -> ResultStore[Eligibility]:
    """Store of choices of vehicles."""
    return ResultStore(search.state / "surveys", Eligibility)


def open_attempt_store(search: Search) -> ResultStore[StoredAttempt]:
    """Store of finished attempts."""
    return ResultStore(search.state / "attempts", StoredAttempt)


def read_cached_attempt(search: Search, unit: SearchUnit, *, with_rounds: bool = False) -> StoredAttempt | None:
    """A finished attempt, or ``None`` where there is none, it is damaged, or its rounds are wanted and not there."""
    stored = open_attempt_store(search).get(search.key(unit))
    if stored is None:
        return None
    report = stored.report
    of_unit = (unit.scene_name, unit.agent, unit.agent_id, unit.asked)
    same_unit = (report.scene, stored.agent, report.agent, report.asked) == of_unit
    unfinished = with_rounds and report.kept and not search.rounds_path(unit).is_file()
    return stored if same_unit and not unfinished else None


def run_attempts(
    search: Search,
    units: Sequence[SearchUnit],
    scene_of: Callable[[SearchUnit], Scene],
    executor: Executor,
    *,
    together: int = 1,
    keep_rounds: bool = False,
    label: str = "planning adversaries",
) -> list[StoredAttempt]:
    """Results of the units in their order; finished ones are read, missing ones are computed and kept.

    ``scene_of`` gives the scene of a unit with the earlier adversaries in it, here and for missing units only. A worker
    plans ``together`` units side by side, which pays on an accelerator; no result depends on it. With ``keep_rounds``,
    attempts whose rounds are missing are searched again; an `InputError` says so where that gives another track.
    """
    stored_attempts = [read_cached_attempt(search, unit, with_rounds=keep_rounds) for unit in units]
    missing = [index for index, stored in enumerate(stored_attempts) if stored is None]
    batches = [missing[first : first + together] for first in range(0, len(missing), together)]

    def work() -> Iterator[list[tuple[Scene, SearchUnit]]]:
        for batch in batches:
            yield [(scene_of(units[index]), units[index]) for index in batch]

    planned, before = functools.partial(_run_batch, search, keep_rounds), len(units) - len(missing)
    done = run_units(
        planned, work(), executor, total=len(batches), label=label, noun="vehicle", before=before, of=len(units)
    )
    for batch, results in zip(batches, done, strict=True):
        for index, stored in zip(batch, results, strict=True):
            stored_attempts[index] = stored
    return [stored for stored in stored_attempts if stored is not None]


def _run_batch(search: Search, keep_rounds: bool, work: Sequence[tuple[Scene, SearchUnit]]) -> list[StoredAttempt]:
    """Compute and keep a few attempts; runs in a worker."""
    # Batches of candidates are just large enough for each of a thousand arrays to be given back and cleared anew.
    disable_malloc_trim()
    vehicles = [(scene, unit.agent) for scene, unit in work]
    results = search_vehicles(
        vehicles,
        search.seed,
        search.hyper,
        search.prior(),
        keep_rounds=keep_rounds,
        earlier=[{link.agent_id: link.start for link in unit.earlier} for _, unit in work],
        asked=[unit.asked for _, unit in work],
    )
    stored_attempts = []
    for (scene, unit), result in zip(work, results, strict=True):
        stored = StoredAttempt.of(unit, _check_earlier_adversaries(result, unit, search.hyper))
        before = read_cached_attempt(search, unit)
        if before is not None:
            # Everything planned or drawn with this track stays valid.
            _require_same_track(before, stored)
            stored = before
        timing = {"scene": unit.scene_name, "agent": unit.agent_id, "seconds": result.stage_seconds}
        # Before the attempt, so that its time and rounds exist wherever the attempt does.
        write_bytes(search.timing_path(search.key(unit)), (canonical_json(timing) + "\n").encode(), durable=False)
        if keep_rounds and stored.report.kept:
            _write_rounds(search, unit, scene, result.rounds)
        if before is None:
            open_attempt_store(search).put(search.key(unit), stored)
        stored_attempts.append(stored)
    return stored_attempts


def _require_same_track(before: StoredAttempt, again: StoredAttempt) -> None:
    """The rounds must belong to the track that was kept."""
    poses, expected = (np.array(attempt.poses, dtype=np.float64).reshape(-1, 3) for attempt in (again, before))
    report, first_report = again.report, before.report
    same = (report.kept, report.launch_frame, poses.shape) == (
        first_report.kept,
        first_report.launch_frame,
        expected.shape,
    )
    if not same or not np.abs(poses - expected).max(initial=0.0) <= SAME_M:
        raise InputError(
            f"searching again for {first_report.agent} in {first_report.scene} gives another track here than the one "
            "that stored (other versions of numerical libraries can cause this), so its rounds cannot be stored; leave "
            "--keep-rounds out, or delete the output and generate it again"
        )


def _write_rounds(search: Search, unit: SearchUnit, scene: Scene, frames: tuple[TraceFrame, ...]) -> None:
    trace = RefinementTrace(
        schema=SCHEMA,
        scene=unit.scene_name,
        agent=unit.agent_id,
        origin_m=find_origin(scene),
        search=search.rounds_metadata(unit),
        frames=frames,
    )
    write_json(search.rounds_path(unit), trace.model_dump(mode="json", by_alias=True), indent=None)


def _check_earlier_adversaries(result: SearchOutcome, unit: SearchUnit, hyper: HyperParameters) -> SearchOutcome:
    """Discard an attempt beside which an earlier adversary would no longer pass verification."""
    if hyper.discards is DiscardRules.REFERENCE:
        return result
    limits = hyper.motion_model().limits
    for link in unit.earlier:
        finding = None if result.scene is None else verify(result.scene, link.agent, link.start, hyper, limits)
        if finding is not None:
            return result.discarded(finding)
    return result
