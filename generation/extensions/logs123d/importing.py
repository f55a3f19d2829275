"""Writing 123D logs as one nuScenes-format root."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from benchmark.datasets.scene_names import is_devkit_name
from benchmark.errors import InputError, did_you_mean
from benchmark.machine.storage import lock_folder
from benchmark.machine.workers import LocalProcesses
from benchmark.runs.units import run_units
from generation.extensions.logs123d.images import LogImages
from generation.extensions.logs123d.log_files import find_logs, read_log
from generation.extensions.logs123d.log_scene import build_log_scene, with_cameras
from generation.nuscenes_writer import DataSetPlan, finish_data_set
from generation.nuscenes_writer.numbering import SceneNumber, number_scenes
from generation.nuscenes_writer.scenes import WrittenScene, read_state, release_claim, write_scene_if_missing
from generation.sources.importing import VERSION_FOLDER

_DEFAULT_SPLIT = "val"


@dataclass(frozen=True, slots=True)
class LogImport:
    """How 123D logs become a data set.

    Attributes:
        maps: Folder of maps that logs share.
        sensors: Folder that paths of images begin in, where logs hold paths.
        images: Whether images go along.
        split: One split for all; by default what the logs say, ``train``, ``val`` or ``test``.
        scenes: Names of logs to take, ``LOG`` or ``SPLIT/LOG``; all by default.
        limit: So many at most, in the order of their folders.
    """

    maps: Path | None = None
    sensors: Path | None = None
    images: bool = True
    split: str | None = None
    scenes: Sequence[str] | None = None
    limit: int | None = None


class ImportedLog(NamedTuple):
    """A log that stands in the root, under its name, and what it lacks."""

    name: str
    split: str
    written: WrittenScene
    facts: Mapping[str, Any]

    @property
    def kept(self) -> bool:
        """Whether it was there already."""
        return self.written.kept


def import_123d(logs: Path, root: Path, settings: LogImport | None = None, *, workers: int = 1) -> list[ImportedLog]:
    """Write 123D logs as a root: key frames at 2 Hz, other frames as sweeps, maps as map expansion.

    Args:
        logs: DATA/logs, a split below it, or one log.
        root: Root to write; the same command resumes.
        settings: What to take along.
        workers: Number of processes; the bytes are the same.

    Returns:
        The logs, in the order of the scenes.

    Raises:
        InputError: If a log is damaged or of a kind that is not known, two have the same name, or the disk refuses.
    """
    settings = settings or LogImport()
    folders = _choose(logs, settings)
    plan = DataSetPlan(root=root, version=VERSION_FOLDER, split=settings.split or _DEFAULT_SPLIT, keeps_instances=True)
    with lock_folder(root):
        work, where = partial(_import_one, plan, settings, _number(folders)), LocalProcesses(workers)
        imported = list(run_units(work, folders, where, total=len(folders), label="importing logs", noun="log"))
        members: dict[str, list[str]] = {}
        for log in imported:
            members.setdefault(log.split, []).append(log.name)
        main = _DEFAULT_SPLIT if _DEFAULT_SPLIT in members else min(members)
        others = {split: names for split, names in sorted(members.items()) if split != main}
        finish_data_set(replace(plan, split=main), [log.written.key for log in imported], extra_splits=others)
    return imported


def _choose(logs: Path, settings: LogImport) -> list[Path]:
    """Folders of the logs that are asked for; folders are named after logs."""
    found = find_logs(logs)
    titles = {path: f"{path.parent.name}/{path.name}" for path in found}
    if settings.scenes is not None:
        known = {*titles.values(), *(path.name for path in found)}
        for name in settings.scenes:
            if name not in known:
                raise InputError(f"there is no log {name} below {logs}; {did_you_mean(name, known)}it has {len(found)}")
        found = tuple(path for path in found if {path.name, titles[path]} & {*settings.scenes})
    chosen = list(found[: settings.limit])
    twice = [name for name, count in Counter(path.name for path in chosen).items() if count > 1]
    if twice:
        both = ", ".join(titles[path] for path in chosen if path.name == twice[0])
        raise InputError(f"{logs} holds more than one log {twice[0]} ({both}); choose one with --scenes SPLIT/LOG")
    return chosen


def _number(folders: Sequence[Path]) -> dict[str, SceneNumber]:
    """Names in the tables, for the devkit's readers of CAN bus and maps, of logs that are not called like scenes."""
    others = [path.name for path in folders if not is_devkit_name(path.name)]
    # Their times are known only once they are read, and need not move.
    return number_scenes(dict.fromkeys(others, (0, 0)), {path.name for path in folders})


def _import_one(
    plan: DataSetPlan, settings: LogImport, numbers: Mapping[str, SceneNumber], folder: Path
) -> ImportedLog:
    log = read_log(folder)
    name, split = log.text("log_name"), settings.split or log.text("split").rpartition("_")[2] or _DEFAULT_SPLIT
    if name != folder.name:
        raise InputError(f"{folder} holds the log {name}; give the folder that name, or convert the log again")
    source = build_log_scene(log, settings.maps, images=settings.images)
    images = LogImages.of(source, settings.sensors) if source.cameras else None
    scene = source.scene if images is None else with_cameras(source, images.sizes())
    report = {**source.facts, "images": None if images is None else images.digest()}
    own = replace(plan, split=split, renderer=images)
    row = numbers[name].name if name in numbers else None
    number = None if row is None else SceneNumber(row, 0)
    try:
        written = write_scene_if_missing(own, scene, name=name, source_scene=name, report=report, number=number)
    except InputError:
        # An image that is found damaged late: nothing of its log stays.
        claim = read_state(own.claim_path(0, name))
        if claim is not None:
            release_claim(own, claim, frozenset())
            own.claim_path(0, name).unlink(missing_ok=True)
        raise
    return ImportedLog(name, split, written, source.facts)


def summarise_lacks(imported: Sequence[ImportedLog]) -> list[str]:
    """What logs lack or was left out, with the number of logs; the most frequent first."""
    counts = Counter(f"no {what}" for log in imported for what in log.facts["lacks"])
    counts.update(f"left out: {what}" for log in imported for what in log.facts["left_out"])
    counts.update(
        f"key frames without an image of {camera}: {count}"
        for log in imported
        for camera, count in log.facts["key_frames_without_image"].items()
    )
    counts.update(f"drawn anew without distortion: {name}" for log in imported for name in log.facts["redrawn"])
    return [f"{sentence} ({count} of {len(imported)})" for sentence, count in counts.most_common()]
