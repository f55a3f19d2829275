"""The embedded data set ``mini``: the procedural town, rendered and written in nuScenes format."""

from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final, Literal

from benchmark.errors import InputError
from benchmark.machine.storage import content_key, lock_folder, read_cached_json, write_json
from benchmark.machine.workers import LocalProcesses
from benchmark.machine.workspace import EMBEDDED_VERSION, is_finished
from benchmark.records.driven_ego import DRIVEN
from benchmark.records.drives import DriveRecord, find_drives
from benchmark.records.off_path import OFF_PATH
from benchmark.records.store import DRIVE_FILE
from benchmark.runs.units import run_units
from generation.nuscenes_writer import DataSetPlan, finish_data_set
from generation.nuscenes_writer.plan import SHARED_TABLES_VERSION, STATE_FOLDER
from generation.nuscenes_writer.scenes import WrittenScene, write_scene_if_missing
from generation.render.schematic import SchematicRenderer
from generation.sources.first_town import FIRST_SCENES, read_first_scene
from generation.sources.town import (
    MOST_TRAIN_SCENES,
    TOWN_VERSION,
    build_town_scene,
    build_town_scene_driven,
    build_town_scene_off_path,
    list_town_scene_names,
)
from generation.sources.town.driven_ego import PlannerDrive, select_lasting_drives

VERSION_FOLDER = "v1.0-mini"

Split = Literal["val", "train"]
_NOTE: Final = Path(STATE_FOLDER) / "town.json"
_PICTURES: Final[tuple[Literal["asked", "keyframes", "all"], ...]] = ("asked", "keyframes", "all")
_Work = tuple[Split, int, PlannerDrive | None]


@dataclass(frozen=True, slots=True)
class TownSettings:
    """Settings of the town data set.

    Attributes:
        val_scenes: Number of evaluation scenes.
        train_scenes: Number of training scenes.
        seed: Seed of maps and traffic.
        width: Image width, pixels.
        height: Image height, pixels.
        frames: Which frames get images: all 12 Hz frames or the 2 Hz keyframes.
        images: Whether there are cameras at all; without them a thousand scenes are written in minutes.
        off_path: Whether the ego of training scenes gets off its path and comes back.
        driven: Folder with one record of drives through training scenes of the same seed: these are the training
            scenes, and their ego goes where it was driven.
        pictures: Which of these frames are drawn now; the same settings with ``all`` draw what is left, and no table
            changes by it. ``asked``: each scene when it is looked at (`draw_town_scene`).
        crossing: Most pedestrians more who cross the way of the ego of a training scene when it comes.
        version: Of the town: 1 is ten packaged evaluation scenes of seed 0, 2 all that the town's code makes. ``None``:
            that of ``mini`` where it has what is asked for.
    """

    val_scenes: int = FIRST_SCENES
    train_scenes: int = 0
    seed: int = 0
    width: int = 448
    height: int = 256
    frames: Literal["all", "keyframes"] = "all"
    images: bool = True
    off_path: bool = False
    driven: Path | None = None
    pictures: Literal["all", "keyframes", "asked"] = "all"
    crossing: int = 0
    version: int | None = None

    @property
    def is_first(self) -> bool:
        """Whether it is of the town's first version."""
        has_all = self.val_scenes <= FIRST_SCENES and (self.seed, self.train_scenes, self.driven) == (0, 0, None)
        if self.version == 1 and not has_all:
            raise InputError(
                f"version 1 of the town has {FIRST_SCENES} evaluation scenes of seed 0 and no training scenes; take "
                "version 2"
            )
        return has_all and (self.version or EMBEDDED_VERSION) == 1

    @property
    def _is_redrawn(self) -> bool:
        """Whether images can be drawn at any time from the settings alone."""
        return self.images and self.driven is None and not self.is_first

    def plan(self, root: Path) -> DataSetPlan:
        """What is written of it at a root."""
        return DataSetPlan(
            root=root,
            version=VERSION_FOLDER,
            split="val",
            renderer=SchematicRenderer(self.width, self.height) if self.images else None,
            frames=self.frames,
            pictures="none" if self.pictures == "asked" else self.pictures,
            drawn_by="town" if self._is_redrawn else None,
        )

    def note(self, root: Path) -> dict[str, Any]:
        """What a root that was made of it remembers."""
        made_of: dict[str, Any] = {"key": self.folder_name(root.name)}
        if self.is_first and self.pictures != "all":
            made_of["pictures"] = self.pictures
        if self._is_redrawn:
            made_of["settings"] = {name: value for name, value in asdict(self).items() if name != "driven"}
        return made_of

    def drawn_name(self, name: str) -> str:
        """A name for what happens in the scenes and how they look: all that a measured number depends on."""
        return f"{name}-{content_key(*self._drawn())[:12]}"

    def folder_name(self, name: str) -> str:
        """Folder in the cache, named by everything the bytes depend on."""
        return f"{name}-{content_key(*self._drawn(), SHARED_TABLES_VERSION)[:12]}"

    def _drawn(self) -> tuple[object, ...]:
        settings = asdict(self)
        # Nothing is measured on images not yet drawn, and the folder name does not change when they are.
        del settings["pictures"], settings["version"]
        if not self.off_path:
            # A town of an earlier version is still the same town.
            del settings["off_path"]
        if not self.crossing:
            del settings["crossing"]
        if self.driven is None:
            del settings["driven"]
        else:
            settings["driven"] = _read_drive_record(self.driven).content_id
        return settings, "1" if self.is_first else TOWN_VERSION, SchematicRenderer(self.width, self.height).version


def build_town_data_set(root: Path, settings: TownSettings, *, workers: int) -> Path:
    """Write the town data set, or finish writing it; nothing is done when it is there with these settings.

    Args:
        root: Root of the data set.
        settings: Settings of the town.
        workers: Number of processes.

    Returns:
        ``root``.

    Raises:
        InputError: If no scene is asked for, or more than have names, the drives are not of this town's training
            scenes, or the disk refuses.
    """
    if settings.val_scenes < 1 or settings.train_scenes < 0:
        raise InputError("the town needs at least one evaluation scene (--town-scenes) and no negative numbers")
    if settings.off_path and not settings.train_scenes:
        raise InputError("only training scenes leave the path; give --train-scenes with --off-path")
    if settings.crossing < 0 or (settings.crossing and not settings.train_scenes and settings.driven is None):
        raise InputError(
            f"--crossing is a number of pedestrians in training scenes, got {settings.crossing}; give 0 or more, with "
            "--train-scenes or --driven"
        )
    # The largest number is checked before a billion of them are listed.
    list_town_scene_names("val", settings.val_scenes)
    list_town_scene_names("train", settings.train_scenes)
    drives = _read_drives(settings)
    numbers = list(range(settings.train_scenes)) if settings.driven is None else list(drives)
    names = list_town_scene_names("train", max(numbers, default=-1) + 1)
    train = [names[number] for number in numbers]
    if _is_made(root, settings):
        return root
    plan = settings.plan(root)
    work: list[_Work] = [("val", index, None) for index in range(settings.val_scenes)]
    work += [("train", index, drives.get(index)) for index in numbers]
    job = partial(_write_one, plan, settings)
    with lock_folder(root, wait=True):
        if _is_made(root, settings):
            return root
        where = LocalProcesses(workers)
        written = list(run_units(job, work, where, total=len(work), label="building the town"))
        finish_data_set(plan, [scene.key for scene in written], extra_splits={"train": train} if train else None)
        write_json(root / _NOTE, settings.note(root))
    return root


def _is_made(root: Path, settings: TownSettings) -> bool:
    """Whether a root is finished and as the settings say, with as many images as they ask for or more."""
    note = read_cached_json(root / _NOTE)
    enough = _PICTURES[_PICTURES.index(settings.pictures) :]
    return is_finished(root) and note in [replace(settings, pictures=pictures).note(root) for pictures in enough]


def draw_town_scene(root: Path, name: str, *, sweeps: bool) -> None:
    """Draw the images of one scene of a town, where they are missing; another command that does it is waited for.

    Args:
        root: Root that `build_town_data_set` wrote.
        name: Name of the scene.
        sweeps: Whether those between samples are drawn, too.

    Raises:
        InputError: If the root does not remember what it was made of, or the disk refuses.
    """
    note: Any = read_cached_json(root / _NOTE)
    try:
        settings = replace(TownSettings(**note["settings"]), pictures="all" if sweeps else "keyframes")
        split, index = _find_scene(settings, name)
    except (TypeError, KeyError, ValueError):
        raise InputError(
            f"{root} no longer says what it was made of ({_NOTE}), so its images cannot be drawn; build it again"
        ) from None
    with lock_folder(root / STATE_FOLDER / "drawing" / name, wait=True):
        _write_one(settings.plan(root), settings, (split, index, None))


def _find_scene(settings: TownSettings, name: str) -> tuple[Split, int]:
    val = list_town_scene_names("val", settings.val_scenes)
    if name in val:
        return "val", val.index(name)
    return "train", list_town_scene_names("train", settings.train_scenes).index(name)


def _read_drive_record(folder: Path) -> DriveRecord:
    records = find_drives(folder)
    if len(records) != 1:
        raise InputError(
            f"{folder} holds {len(records) or 'no'} records of drives ({DRIVE_FILE}); give --driven a folder of one"
        )
    return records[0]


def _read_drives(settings: TownSettings) -> dict[int, PlannerDrive]:
    if settings.driven is None:
        return {}
    if settings.off_path or settings.train_scenes:
        raise InputError("--driven sets the training scenes itself; leave --train-scenes and --off-path out")
    record = _read_drive_record(settings.driven)
    measured = record.facts.measured
    if measured.engine != "default" or measured.agents != "replay":
        raise InputError(
            f"{settings.driven} was driven with --engine {measured.engine} --agents {measured.agents}; give drives "
            "in which other road users do as recorded (--engine default --agents replay)"
        )
    if measured.until != "contact":
        raise InputError(
            f"{settings.driven} was driven with --until {measured.until}, which removes cars that touch the ego; drive "
            "without it"
        )
    known = {name: number for number, name in enumerate(list_town_scene_names("train", MOST_TRAIN_SCENES))}
    drives = select_lasting_drives(record.rows)
    strange = next((name for name in drives if name not in known), None)
    if strange is not None or not drives:
        raise InputError(
            f"{settings.driven} holds no drive through training scenes of the town"
            f"{f', but one through {strange}' if strange else ''}; drive its split train (--data, --split train)"
        )
    return {known[name]: PlannerDrive.of_row(record.planner, row) for name, row in drives.items()}


def _write_one(plan: DataSetPlan, settings: TownSettings, work: _Work) -> WrittenScene:
    split, index, driven = work
    report: dict[str, Any] = {}
    seed, off_path, crossing = settings.seed, settings.off_path, settings.crossing if split == "train" else 0
    if settings.is_first:
        scene = read_first_scene(index)
        return write_scene_if_missing(plan, scene, name=scene.name, source_scene=scene.name, report=report)
    if driven is not None:
        scene, learned = build_town_scene_driven(index, driven, seed=seed, crossing=crossing)
        report[DRIVEN] = learned.as_json()
    elif off_path and split == "train":
        scene, excursions = build_town_scene_off_path(index, seed=seed, crossing=crossing)
        report[OFF_PATH] = [excursion.as_json() for excursion in excursions]
    else:
        scene = build_town_scene(split, index, seed=seed, crossing=crossing)
    return write_scene_if_missing(plan, scene, name=scene.name, source_scene=scene.name, report=report)
