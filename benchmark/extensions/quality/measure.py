"""The main path: which scenes, which weights, score each scene, write the record; the same command goes on."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import torch

from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings
from benchmark.extensions.quality.definition import QualityDefinition, list_required_weights
from benchmark.extensions.quality.scoring import QualityNetworks, find_image_file, load_networks, score_scene
from benchmark.extensions.quality.segmentation import transformers_version
from benchmark.machine.devices import select_device, select_worker_device
from benchmark.machine.several_devices import count_workers, find_device_in_turn, parse_device_names
from benchmark.machine.storage import content_key, lock_folder, sanitise_file_name
from benchmark.machine.workers import LocalProcesses, default_workers, worker_number
from benchmark.records.quality import QUALITY_SCHEMA, QualityRecord, SceneQualityRows, WeightsFacts, write_quality
from benchmark.report.words import pluralise
from benchmark.runs.judging import JudgedScenes, describe_data
from benchmark.runs.scene_work import make_reopener
from benchmark.runs.units import ResultStore, Shard, ShardProgress, run_units
from benchmark.weights.folders import compute_content_hash, require_folder_of

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


@dataclass(frozen=True, slots=True)
class QualitySettings:
    """How to measure.

    Attributes:
        definition: Definition of the measurement.
        weights: Folder of weights that the user has, or ``None`` for the cache.
        device: Where networks run (`benchmark.machine.devices.select_worker_device`): ``cuda`` stands for all GPUs, one
            after the other; ``auto`` for GPUs where there are any; several names, between commas, for a process on
            each.
        scenes: Only these scenes of the split.
        limit: Only the first so many scenes.
        workers: Number of processes; 0 is one for each GPU where networks run on GPUs or for each device that is named,
            else one for each processor. The result does not depend on it.
    """

    definition: QualityDefinition
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
    """Settings that every unit of work needs, picklable; `device` may name several, `keys` are of each scene's rows."""

    directory: Path
    definition: QualityDefinition
    folders: Mapping[str, Path]
    device: str
    keys: Mapping[str, str]

    @property
    def store(self) -> ResultStore[SceneQualityRows]:
        """Where rows of scenes are kept."""
        return ResultStore(self.directory / "scenes", SceneQualityRows)


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
        settings: Definition, scenes, weights and device of the measurement.
        reopen: Opens the data set in another process; by default from its root, version and name.

    Returns:
        The record, in ``<out>/<data>/<split>/<masks>-<hash>``.

    Raises:
        InputError: If the split or a scene is unknown, weights or transformers are missing, images are missing or
            broken, or another command is writing the same record.
    """
    chosen = _choose_scenes(settings, data, split)
    job, weight_facts, libraries = _build_job(data, split, out, settings, chosen)
    facts = describe_data(JudgedScenes(data, split, chosen), "scene_facts", "review") | {
        "definition": settings.definition.as_json(),
        "weights": weight_facts,
        "device": _find_first_device(job).type,
    }
    facts["environment"] |= {"transformers": libraries["transformers"]}
    with lock_folder(job.directory):
        opener = reopen or make_reopener(data)
        rows = list(_score_scenes(job, data, opener, _count_processes(settings)))
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
) -> ShardProgress:
    """Score the scenes of one shard as `measure_quality` does and keep their rows; no record is written."""
    chosen = _choose_scenes(settings, data, split)
    job, _, _ = _build_job(data, split, out, settings, chosen)
    mine = shard.part(chosen)
    own = replace(job, keys={name: job.keys[name] for name in mine})
    for _ in _score_scenes(own, data, reopen or make_reopener(data), _count_processes(settings)):
        pass
    return ShardProgress(job.directory, len(mine), len(chosen))


def _build_job(
    data: "DataSet", split: str, out: Path, settings: QualitySettings, chosen: tuple[str, ...]
) -> tuple[_Job, dict[str, WeightsFacts], dict[str, str]]:
    """Job of a measurement: settings of every unit of work, weights and libraries."""
    definition, needed = settings.definition, list_required_weights(settings.definition.masks)
    device = select_device(parse_device_names(settings.device)[0])
    folders = {weights.name: require_folder_of(weights, settings.weights) for weights in needed}
    weight_facts = {
        weights.name: WeightsFacts(
            repository=weights.repository,
            revision=weights.revision,
            content=compute_content_hash(weights, folders[weights.name]),
        )
        for weights in needed
    }
    contents = {name: of.content for name, of in weight_facts.items()}
    # Rows made with other versions of these libraries may differ in the last digits.
    libraries = {"torch": torch.__version__, "transformers": transformers_version()}
    identity = content_key(QUALITY_SCHEMA, data.fingerprint(), definition.as_json(), contents, device.type, libraries)
    part = () if len(chosen) == len(data.scene_names(split)) else chosen
    directory = _quality_directory(out, data.name, split, definition, part)
    keys = {name: content_key(identity, name, _list_image_sizes(data, name, definition)) for name in chosen}
    return _Job(directory, definition, folders, settings.device, keys), weight_facts, libraries


def _quality_directory(
    out: Path, data_name: str, split: str, definition: QualityDefinition, part: tuple[str, ...]
) -> Path:
    """Directory of a record: another definition or another part of the scenes has another one."""
    usual = definition == QualityDefinition(masks=definition.masks) and not part
    suffix = "" if usual else f"-{content_key(definition.as_json(), list(part))[:8]}"
    return out / sanitise_file_name(data_name) / sanitise_file_name(split) / f"{definition.masks}{suffix}"


def describe_plan(data: "DataSet", split: str, settings: QualitySettings) -> str:
    """Sentences on what would be done, and what is missing for it: for ``--dry-run``."""
    definition = settings.definition
    chosen = _choose_scenes(settings, data, split)
    sweeps = definition.frames == "all"
    frames = sum(len(video) for name in chosen for video in data.videos(name, sweeps=sweeps).values())
    lines = [
        f"would score {pluralise(len(chosen), 'scene')} of {split} with {pluralise(frames, 'image')}; masks from "
        f"{definition.masks}"
    ]
    for weights in list_required_weights(definition.masks):
        try:
            lines.append(f"{weights.name}: in {require_folder_of(weights, settings.weights)}")
        except InputError as error:
            lines.append(f"{weights.name}: {error}")
    return "\n".join(lines)


def _score_scenes(
    job: _Job, data: "DataSet", reopen: Callable[[], "DataSet"], workers: int
) -> Iterator[SceneQualityRows]:
    """Rows in the order of the scenes; those that are kept are not made again, and networks load only for others."""
    stored_rows = {name: job.store.get(key, name) for name, key in job.keys.items()}
    open_scenes = [name for name, stored in stored_rows.items() if stored is None]
    work = partial(_score_in_worker, job, reopen)
    if open_scenes and workers == 1:
        work = partial(_score_here, job, data, load_networks(job.definition, job.folders, _find_first_device(job)))
    where, before = LocalProcesses(workers), len(job.keys) - len(open_scenes)
    scored = run_units(work, open_scenes, where, total=len(open_scenes), label="video quality", before=before)
    new_rows = {rows.scene: rows for rows in scored}
    yield from (stored_rows[name] or new_rows[name] for name in job.keys)


def _score_here(job: _Job, data: "DataSet", networks: QualityNetworks, scene: str) -> SceneQualityRows:
    rows = score_scene(data, scene, job.definition, networks)
    job.store.put(job.keys[scene], rows, scene)
    return rows


_in_this_process: dict[str, tuple["DataSet", QualityNetworks]] = {}
"""Data set and networks of a worker process, opened once."""


def _score_in_worker(job: _Job, reopen: Callable[[], "DataSet"], scene: str) -> SceneQualityRows:
    key = content_key(sorted(job.keys.values()), job.device)
    if key not in _in_this_process:
        place = select_worker_device(find_device_in_turn(job.device), worker_number())
        networks = load_networks(job.definition, job.folders, place)
        _in_this_process[key] = (reopen(), networks)
    return _score_here(job, *_in_this_process[key], scene)


def _list_image_sizes(data: "DataSet", scene: str, definition: QualityDefinition) -> list[tuple[str, int | None]]:
    """Size in bytes of each image that will be read: frames rendered anew must not meet the scores of the old ones."""
    videos = data.videos(scene, sweeps=definition.frames == "all")
    paths = [find_image_file(view, definition) for views in videos.values() for view in views]
    return [(path.name, path.stat().st_size if path.is_file() else None) for path in paths]


def _find_first_device(job: _Job) -> torch.device:
    return select_device(parse_device_names(job.device)[0])


def _choose_scenes(settings: QualitySettings, data: "DataSet", split: str) -> tuple[str, ...]:
    return EvalSettings(scenes=settings.scenes, limit=settings.limit).chosen(data, split)


def _count_processes(settings: QualitySettings) -> int:
    """Number of processes, where 0 has been decided; raises `InputError` if a device would be without work."""
    if count := count_workers(settings.workers, settings.device):
        return count
    device = select_device(parse_device_names(settings.device)[0])
    if device.type != "cuda":
        return default_workers()
    return 1 if device.index is not None else torch.cuda.device_count()
