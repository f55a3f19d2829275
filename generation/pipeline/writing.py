"""Generated scenes as a data set on disk: shipped to workers one by one, rendered, put together, or withdrawn."""

import functools
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from pydantic import ValidationError

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.scene_assessments import (
    ASSESSMENTS_FILE,
    collect_assessments,
    collect_realism,
    format_assessments,
    read_assessments,
    read_assessments_file,
)
from benchmark.datasets.scene_names import PROVENANCE, find_names, read_scene_times
from benchmark.datasets.tables import find_variant_folders
from benchmark.errors import InputError
from benchmark.fairness.scene_assessment import AdversaryProvenance, assess_scene
from benchmark.fairness.split_assessment import measure_split_realism
from benchmark.machine.extension import AbsentExtensionError, import_from_extension
from benchmark.machine.storage import canonical_json, content_key, read_cached_json, read_json, write_bytes, writing_to
from benchmark.machine.workers import Executor
from benchmark.records.attempts import list_adversary_reports
from benchmark.records.scene_assessment import DEFINITION, SceneAssessment
from benchmark.records.scene_pages import KEPT_ROUNDS_FOLDER, RefinementTrace, kept_rounds_path
from benchmark.runs.units import ResultStore, run_units
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan, finish_data_set
from generation.nuscenes_writer.numbering import SceneNumber, number_scenes
from generation.nuscenes_writer.plan import STATE_FOLDER
from generation.nuscenes_writer.scenes import WrittenScene, read_state, read_stored_fragment, write_scene_if_missing

CONFLICTS_FILE: Final = "conflicts.json"


@dataclass(frozen=True, slots=True)
class WritingJob:
    """One scene to write: a recording, or a variant of it.

    ``variant`` numbers its root in the ``per-variant`` layout and is part of its tokens in any. ``make`` turns the
    recorded scene into what is written and goes to workers by pickle. ``last_attempt`` is the content key of the
    attempt that made its last adversary, with that one's place; ``identity`` the source of its tokens, if not its
    motion; ``tracks`` how its adversaries were made, if it is to be judged where it is written; ``number`` its name and
    times in the tables, if not its own.
    """

    name: str
    written_as: str
    source_scene: str
    variant: int
    make: Callable[[Scene], Scene]
    report: dict[str, Any]
    last_attempt: tuple[str, int] | None = None
    identity: str | None = None
    judgements: tuple[SceneAssessment, ...] = ()
    tracks: AdversaryProvenance | None = None
    number: SceneNumber | None = None

    def name_in_data_set(self, plan: DataSetPlan) -> str:
        """Name by which `benchmark.datasets.roots.open_data` knows the scene."""
        return f"v{self.variant}/{self.written_as}" if plan.layout == "per-variant" else self.written_as


def number_jobs(plan: DataSetPlan, jobs: Sequence[WritingJob], source: DataSet) -> list[WritingJob]:
    """Jobs of all generated scenes of a root with their numbers, which their order and executor do not change.

    Roots that have one variant of each recording keep its name and times, and roots of earlier versions those that they
    have, to which records refer.
    """
    if plan.layout == "per-variant" or not jobs or _is_unnumbered(plan):
        return list(jobs)
    recorded = read_scene_times(source.root, source.version)
    times = {job.written_as: recorded[job.source_scene] for job in jobs}
    numbers = number_scenes(times, {job.source_scene for job in jobs})
    return [replace(job, number=numbers.get(job.written_as)) for job in jobs]


def _is_unnumbered(plan: DataSetPlan) -> bool:
    """Whether a root is finished and its scenes have their own names in the tables."""
    made = read_cached_json(plan.root / plan.version / PROVENANCE)
    return isinstance(made, dict) and bool(made.get("scenes")) and not find_names(made)


def write_scenes(
    plan: DataSetPlan,
    jobs: Sequence[WritingJob],
    read: Callable[[str], Scene],
    executor: Executor,
    *,
    timing: Path,
    label: str = "rendering",
) -> list[str]:
    """Render and write scenes that are not there already; content keys for `finish_data_set` in the order of the jobs.

    The bytes do not depend on ``executor``. ``read`` gives a recorded scene by name; it is called here, so that workers
    need not open the source. No result depends on the notes in the folder ``timing``.
    """
    _remove_other_layout(plan)
    # Variants of one recording after each other: it is read once.
    order = sorted(range(len(jobs)), key=lambda index: (jobs[index].source_scene, index))

    def shipments() -> Iterator[tuple[Scene, WritingJob]]:
        for job in (jobs[index] for index in order):
            yield job.make(read(job.source_scene)), job

    work = functools.partial(_write_one, plan, timing)
    done = run_units(work, shipments(), executor, total=len(jobs), label=label)
    written = dict(zip(order, done, strict=True))
    return [written[index].key for index in range(len(jobs))]


def _write_one(plan: DataSetPlan, timing: Path, shipped: tuple[Scene, WritingJob]) -> WrittenScene:
    scene, job = shipped
    started = time.process_time()
    written = write_scene_if_missing(
        plan,
        scene,
        name=job.written_as,
        source_scene=job.source_scene,
        report=job.report,
        variant=job.variant,
        identity=job.identity,
        number=job.number,
    )
    if job.tracks is not None:
        _assess_scene(plan, written.key, scene, job.tracks)
    note = timing / f"{written.key}.timing.json"
    # A scene that was complete takes no time: its time of rendering is kept.
    if not note.exists():
        value = {"scene": job.written_as, "seconds": {"rendering": time.process_time() - started}}
        write_bytes(note, (canonical_json(value) + "\n").encode(), durable=False)
    return written


def publish_reports(root: Path, files: dict[str, bytes]) -> None:
    """Write the reports of a build on itself; a data set finished with other reports is not finished any more."""
    if mark_unfinished_if_changed(root, files):
        for name, data in files.items():
            write_bytes(root / name, data)


def mark_unfinished_if_changed(root: Path, files: dict[str, bytes]) -> bool:
    """Take a finished data set's mark away where its files say other things than these, or nothing; true if so."""
    if all((root / name).is_file() and (root / name).read_bytes() == data for name, data in files.items()):
        return False
    mark_unfinished(root)
    return True


@dataclass(frozen=True)
class WrittenScenes:
    """Scenes of a data set that are written, and become it. ``keys`` are those that `write_scenes` returned."""

    plan: DataSetPlan
    jobs: Sequence[WritingJob]
    keys: Sequence[str]
    source: DataSet

    @functools.cached_property
    def judged(self) -> list[tuple[SceneAssessment, ...]]:
        """The judgements of each scene, in the order of the jobs."""
        return [
            job.judgements if job.tracks is None else _read_cached_assessments(self.plan, key) or ()
            for job, key in zip(self.jobs, self.keys, strict=True)
        ]


def _publish_rounds(written: WrittenScenes) -> None:
    """Put the rounds of scenes' last adversaries where scene pages look, outside of the fingerprint; remove others."""
    plan, wanted = written.plan, set()
    for job, key in zip(written.jobs, written.keys, strict=True):
        content = _read_rounds(plan, job, key)
        if content is not None:
            path = kept_rounds_path(plan.root, job.name_in_data_set(plan))
            wanted.add(path)
            if not path.is_file() or path.read_bytes() != content:
                write_bytes(path, content)
    for path in (plan.root / KEPT_ROUNDS_FOLDER).glob("*"):
        if path not in wanted:
            with writing_to(path):
                path.unlink()


def _publish_assessments(written: WrittenScenes) -> None:
    """Put what is said of the scenes beside the tables of each root; it is no part of the fingerprint."""
    plan = written.plan
    of_root: dict[Path, dict[str, tuple[SceneAssessment, ...]]] = {}
    for job, judged in zip(written.jobs, written.judged, strict=True):
        if judged:
            root = plan.data_root(job.variant if plan.layout == "per-variant" else 0)
            of_root.setdefault(root, {})[job.written_as] = judged
    for root, scenes in of_root.items():
        folder = root / plan.version
        if _read_published_file(folder) != scenes:
            write_bytes(folder / ASSESSMENTS_FILE, format_assessments(scenes).encode())


def _publish_conflicts(written: WrittenScenes) -> None:
    """Say beside the tables what each adversary does that its recording did not; it is no part of the fingerprint."""
    plan, of_root = written.plan, dict[Path, dict[str, Any]]()
    for job in written.jobs:
        launches = [
            (entry["agent"], entry["launch_frame"]) for entry in list_adversary_reports(job.report) if "agent" in entry
        ]
        if not launches:
            continue
        recorded = written.source.scene(job.source_scene)
        try:
            conflicts = import_from_extension("search", "conflicts")(recorded, job.make(recorded), launches)
        except AbsentExtensionError:
            return
        root = plan.data_root(job.variant if plan.layout == "per-variant" else 0)
        of_root.setdefault(root, {})[job.written_as] = conflicts
    for root, scenes in of_root.items():
        content = (canonical_json({"schema": 1, "scenes": scenes}, indent=1) + "\n").encode()
        path = root / plan.version / CONFLICTS_FILE
        if not path.is_file() or path.read_bytes() != content:
            write_bytes(path, content)


def _finish(written: WrittenScenes) -> None:
    finish_data_set(written.plan, written.keys)


def _publish_realism(written: WrittenScenes) -> None:
    """Compare the adversaries of a finished data set with its recordings, once, and say so beside their judgements."""
    plan = written.plan
    data = open_data(plan.root, version=plan.version)
    judged = collect_assessments(data.root, data.version)
    if not judged or collect_realism(data.root, data.version) is not None:
        return
    realism = measure_split_realism(data, judged, written.source)
    for folder in (plan.root / name for name in find_variant_folders(plan.root) or [""]):
        scenes = read_assessments(folder / plan.version)
        write_bytes(folder / plan.version / ASSESSMENTS_FILE, format_assessments(scenes, realism).encode())


PUBLISHERS: Final[tuple[Callable[[WrittenScenes], None], ...]] = (
    _publish_rounds,
    _publish_assessments,
    _publish_conflicts,
    _finish,
    _publish_realism,
)
"""Steps that turn written scenes into a data set, in this order: realism is read from the finished one."""


def publish(written: WrittenScenes) -> None:
    """Make a data set of written scenes."""
    for step in PUBLISHERS:
        step(written)


def _read_published_file(folder: Path) -> dict[str, tuple[SceneAssessment, ...]] | None:
    """File that was published before; nothing if it is damaged, so that it is written again."""
    try:
        published = read_assessments_file(folder)
    except InputError:
        return None
    return None if published is None else published.scenes


def _assess_scene(plan: DataSetPlan, key: str, scene: Scene, tracks: AdversaryProvenance) -> None:
    """Judge a scene where it is written, once."""
    if _read_cached_assessments(plan, key) is None:
        _open_assessment_store(plan).put(content_key(DEFINITION, key), tuple(assess_scene(scene, tracks)), key)


def _read_cached_assessments(plan: DataSetPlan, key: str) -> tuple[SceneAssessment, ...] | None:
    return _open_assessment_store(plan).get(content_key(DEFINITION, key), key)


def _open_assessment_store(plan: DataSetPlan) -> ResultStore[tuple[SceneAssessment, ...]]:
    return ResultStore(plan.state / "judgements", tuple[SceneAssessment, ...])


def _read_rounds(plan: DataSetPlan, job: WritingJob, key: str) -> bytes | None:
    """The rounds of a scene's last adversary under the names of the data set, if they were kept."""
    if job.last_attempt is None:
        return None
    attempt, place = job.last_attempt
    path, fragment = plan.state / "rounds" / f"{attempt}.json", read_stored_fragment(plan, key)
    if fragment is None or not path.is_file():
        return None
    try:
        trace = RefinementTrace.model_validate(read_json(path))
    except ValidationError as error:
        raise InputError(f"{path} is damaged; delete it and run the same challenger-bench generate again") from error
    named = trace.model_copy(update={"scene": job.name_in_data_set(plan), "agent": fragment["adversaries"][place]})
    return (canonical_json(named.model_dump(mode="json", by_alias=True)) + "\n").encode()


def _remove_other_layout(plan: DataSetPlan) -> None:
    """Take away what an earlier build wrote in the other layout: a reader of the folder would open that one."""
    if not plan.state.is_dir():
        return
    suffixed = plan.layout == "suffixed"
    roots = [plan.root / name for name in find_variant_folders(plan.root)] if suffixed else [plan.root]
    tables = [root / plan.version / f"{table}.json" for root in roots for table in (*NUSCENES_TABLES, "splits")]
    left = [table for table in tables if table.exists()]
    if not left:
        return
    other = replace(plan, layout="per-variant" if suffixed else "suffixed")
    claims = filter(None, map(read_state, sorted((plan.state / "claims").glob("*.json"))))
    sensor_files = [other.data_root(claim["variant"]) / path for claim in claims for path in claim["files"]]
    # The tables are removed last: they tell a killed command that there is something to remove.
    marks = (root / plan.version / name for root in roots for name in (PROVENANCE, ASSESSMENTS_FILE, CONFLICTS_FILE))
    for path in (*marks, *sensor_files, *left):
        with writing_to(path):
            path.unlink(missing_ok=True)


def mark_unfinished(root: Path) -> None:
    """Remove a data set's mark, rounds and judgements, lest they be read beside reports of another build."""
    for path in (*_list_marks(root), *(root / KEPT_ROUNDS_FOLDER).glob("*")):
        with writing_to(path):
            # Another shard may remove it at the same moment.
            path.unlink(missing_ok=True)


def withdraw(root: Path) -> None:
    """Remove an earlier build's tables, lest they pass for this one's, which found nothing; pictures stay for later."""
    if not (root / STATE_FOLDER).is_dir():
        return
    mark_unfinished(root)
    for table in (*NUSCENES_TABLES, "splits"):
        for path in (*root.glob(f"*/{table}.json"), *root.glob(f"v*/*/{table}.json")):
            with writing_to(path):
                path.unlink()


def _list_marks(root: Path) -> list[Path]:
    names = (PROVENANCE, ASSESSMENTS_FILE, CONFLICTS_FILE)
    return [path for name in names for path in (*root.glob(f"*/{name}"), *root.glob(f"v*/*/{name}"))]
