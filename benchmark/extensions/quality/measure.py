"""The main path: which scenes, which weights, score each scene, write the record; the same command goes on."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings
from benchmark.extensions.quality.definition import Definition, needed_for
from benchmark.extensions.quality.scoring import Networks, image_file, load_networks, score_scene
from benchmark.extensions.quality.segmentation import transformers_version
from benchmark.machine.devices import device_of, device_of_worker
from benchmark.machine.several_devices import device_in_turn, device_names, workers_for
from benchmark.machine.storage import content_key, file_name, only_writer
from benchmark.machine.workers import LocalProcesses, default_workers, worker_number
from benchmark.records.quality import QUALITY_SCHEMA, QualityRecord, SceneRows, WeightsFacts, write_quality
from benchmark.report.words import counted
from benchmark.runs.judging import JudgedScenes, described
from benchmark.runs.scene_work import reopening
from benchmark.runs.units import FinishedShard, ResultStore, Shard, run_units
from benchmark.weights.folders import content_hash, folder_of

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


@dataclass(frozen=True, slots=True)
class QualitySettings:
    """How to measure.

    Attributes:
        definition: What is measured.
        weights: Folder of weights that the user has, or ``None`` for the cache.
        device: Where networks run (`benchmark.machine.devices.device_of_worker`): ``cuda`` stands for all GPUs, one
            after the other; ``auto`` for GPUs where there are any; several names, between commas, for a process on
            each.
        scenes: Only these scenes of the split.
        limit: Only the first so many scenes.
        workers: Number of processes; 0 is one for each GPU where networks run on GPUs or for each device that is named,
            else one for each processor. The result does not depend on it.
    """

    definition: Definition
    weights: Path | None = None
    device: str = "auto"
    scenes: tuple[str, ...] | None = None
    limit: int | None = None
    workers: int = 0

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise InputError(f"--workers must be 0 or more, got {self.workers}")


@dataclass(frozen=True, slots=True)
class _Job:
    """Settings that every unit of work needs; picklable.

    Attributes:
        folders: Of weights by name.
        device: Where networks run, perhaps several names.
        keys: Content key of each scene's rows.
    """

    directory: Path
    definition: Definition
    folders: Mapping[str, Path]
    device: str
    keys: Mapping[str, str]

    @property
    def store(self) -> ResultStore[SceneRows]:
        """Where rows of scenes are kept."""
        return ResultStore(self.directory / "scenes", SceneRows)


def measure_quality(
    data: "DataSet",
    split: str,
    out: Path,
    settings: QualitySettings,
    *,
    reopen: Callable[[], "DataSet"] | None = None,
) -> QualityRecord:
    """Score a split and write the record.

    Args:
        data: The data set.
        split: Which of its splits.
        out: Folder of quality records.
        settings: What is measured of which scenes, with which weights and device.
        reopen: Opens the data set in another process; by default from its root, version and name.

    Returns:
        The record, in ``<out>/<data>/<split>/<masks>-<hash>``.

    Raises:
        InputError: If the split or a scene is unknown, weights or transformers are missing, images are missing or
            broken, or another command is writing the same record.
    """
    chosen = _chosen(settings, data, split)
    job, weight_facts, libraries = _job_of(data, split, out, settings, chosen)
    facts = described(JudgedScenes(data, split, chosen), "scene_facts", "review") | {
        "definition": settings.definition.as_json(),
        "weights": weight_facts,
        "device": _first(job).type,
    }
    facts["environment"] |= {"transformers": libraries["transformers"]}
    with only_writer(job.directory):
        opener = reopen or reopening(data)
        rows = list(_scored(job, data, opener, _processes(settings)))
        record = write_quality(job.directory, facts, rows)
        job.store.tidy(job.keys)
    return record


def measure_shard(
    data: "DataSet",
    split: str,
    out: Path,
    settings: QualitySettings,
    shard: Shard,
    *,
    reopen: Callable[[], "DataSet"] | None = None,
) -> FinishedShard:
    """Score the scenes of one shard as `measure_quality` does and keep their rows; no record is written."""
    chosen = _chosen(settings, data, split)
    job, _, _ = _job_of(data, split, out, settings, chosen)
    mine = shard.part(chosen)
    own = replace(job, keys={name: job.keys[name] for name in mine})
    for _ in _scored(own, data, reopen or reopening(data), _processes(settings)):
        pass
    return FinishedShard(job.directory, len(mine), len(chosen))


def _job_of(
    data: "DataSet", split: str, out: Path, settings: QualitySettings, chosen: tuple[str, ...]
) -> tuple[_Job, dict[str, WeightsFacts], dict[str, str]]:
    """Job of a measurement: settings of every unit of work, weights and libraries."""
    definition, needed = settings.definition, needed_for(settings.definition.masks)
    device = device_of(device_names(settings.device)[0])
    folders = {weights.name: folder_of(weights, settings.weights) for weights in needed}
    weight_facts = {
        weights.name: WeightsFacts(
            repository=weights.repository,
            revision=weights.revision,
            content=content_hash(weights, folders[weights.name]),
        )
        for weights in needed
    }
    contents = {name: of.content for name, of in weight_facts.items()}
    # Rows that another version of these libraries made may differ in the last digits.
    libraries = {"torch": torch.__version__, "transformers": transformers_version()}
    identity = content_key(QUALITY_SCHEMA, data.fingerprint(), definition.as_json(), contents, device.type, libraries)
    part = () if len(chosen) == len(data.scene_names(split)) else chosen
    directory = _quality_directory(out, data.name, split, definition, part)
    keys = {name: content_key(identity, name, _image_sizes(data, name, definition)) for name in chosen}
    return _Job(directory, definition, folders, settings.device, keys), weight_facts, libraries


def _quality_directory(out: Path, data_name: str, split: str, definition: Definition, part: tuple[str, ...]) -> Path:
    """Directory of a record: another definition or another part of the scenes has another one."""
    usual = definition == Definition(masks=definition.masks) and not part
    suffix = "" if usual else f"-{content_key(definition.as_json(), list(part))[:8]}"
    return out / file_name(data_name) / file_name(split) / f"{definition.masks}{suffix}"


def plan_of(data: "DataSet", split: str, settings: QualitySettings) -> str:
    """Sentences on what would be done, and what is missing for it: for ``--dry-run``."""
    definition = settings.definition
    chosen = _chosen(settings, data, split)
    sweeps = definition.frames == "all"
    frames = sum(len(video) for name in chosen for video in data.videos(name, sweeps=sweeps).values())
    lines = [
        f"would score {counted(len(chosen), 'scene')} of {split} with {counted(frames, 'image')}; masks from "
        f"{definition.masks}"
    ]
    for weights in needed_for(definition.masks):
        try:
            lines.append(f"{weights.name}: in {folder_of(weights, settings.weights)}")
        except InputError as error:
            lines.append(f"{weights.name}: {error}")
    return "\n".join(lines)


def _scored(job: _Job, data: "DataSet", reopen: Callable[[], "DataSet"], workers: int) -> Iterator[SceneRows]:
    """Rows in the order of the scenes; those that are kept are not made again, and networks load only for others."""
    stored_rows = {name: job.store.get(key, name) for name, key in job.keys.items()}
    open_scenes = [name for name, stored in stored_rows.items() if stored is None]
    work = partial(_in_worker, job, reopen)
    if open_scenes and workers == 1:
        work = partial(_here, job, data, load_networks(job.definition, job.folders, _first(job)))
    where, before = LocalProcesses(workers), len(job.keys) - len(open_scenes)
    scored = run_units(work, open_scenes, where, total=len(open_scenes), label="video quality", before=before)
    new_rows = {rows.scene: rows for rows in scored}
    yield from (stored_rows[name] or new_rows[name] for name in job.keys)


def _here(job: _Job, data: "DataSet", networks: Networks, scene: str) -> SceneRows:
    rows = score_scene(data, scene, job.definition, networks)
    job.store.put(job.keys[scene], rows, scene)
    return rows


_in_this_process: dict[str, tuple["DataSet", Networks]] = {}
"""Data set and networks of a worker process, opened once."""


def _in_worker(job: _Job, reopen: Callable[[], "DataSet"], scene: str) -> SceneRows:
    key = content_key(sorted(job.keys.values()), job.device)
    if key not in _in_this_process:
        place = device_of_worker(device_in_turn(job.device), worker_number())
        networks = load_networks(job.definition, job.folders, place)
        _in_this_process[key] = (reopen(), networks)
    return _here(job, *_in_this_process[key], scene)


def _image_sizes(data: "DataSet", scene: str, definition: Definition) -> list[tuple[str, int | None]]:
    """Size in bytes of each image that will be read: frames rendered anew must not meet the scores of the old ones."""
    videos = data.videos(scene, sweeps=definition.frames == "all")
    paths = [image_file(view, definition) for views in videos.values() for view in views]
    return [(path.name, path.stat().st_size if path.is_file() else None) for path in paths]


def _first(job: _Job) -> torch.device:
    return device_of(device_names(job.device)[0])


def _chosen(settings: QualitySettings, data: "DataSet", split: str) -> tuple[str, ...]:
    return EvalSettings(scenes=settings.scenes, limit=settings.limit).chosen(data, split)


def _processes(settings: QualitySettings) -> int:
    """Number of processes, where 0 has been decided; raises `InputError` if a device would be without work."""
    if count := workers_for(settings.workers, settings.device):
        return count
    device = device_of(device_names(settings.device)[0])
    if device.type != "cuda":
        return default_workers()
    return 1 if device.index is not None else torch.cuda.device_count()
