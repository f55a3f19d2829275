"""Bringing foreign recordings into nuScenes format."""

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Literal, NamedTuple

from benchmark.datasets.scenarionet import find_scenarionet, read_exchanged_scene
from benchmark.errors import InputError
from benchmark.machine.storage import lock_folder
from benchmark.machine.workers import LocalProcesses
from benchmark.runs.units import run_units
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan, finish_data_set
from generation.nuscenes_writer.scenes import WrittenScene, write_scene_if_missing
from generation.render.schematic import SchematicRenderer
from generation.sources.rig import build_default_cameras

VERSION_FOLDER = "v1.0-trainval"


@dataclass(frozen=True, slots=True)
class ImportSettings:
    """How ScenarioNet scenes, which have no images, become a data set.

    Attributes:
        width: Image width, pixels.
        height: Image height, pixels.
        frames: Which frames get images.
        images: Whether to draw images at all (schematic ones: the recordings have none).
        split: Name of the split; adversarial scenes are never in ``val``.
    """

    width: int = 448
    height: int = 256
    frames: Literal["all", "keyframes"] = "all"
    images: bool = True
    split: str = "val"


def import_scenarionet(source: Path, root: Path, settings: ImportSettings, *, workers: int) -> tuple[str, ...]:
    """Write ScenarioNet recordings as a nuScenes-format data set with one split.

    Files that were exported here (`benchmark.extensions.exchange`) say who is adversarial and how scenes were made.

    Args:
        source: A ScenarioNet pickle or a folder of them.
        root: Root to write; the same command resumes.
        settings: Image settings.
        workers: Number of processes.

    Returns:
        The scene names.

    Raises:
        InputError: If a file is refused, two files hold the same scene, adversarial scenes would come into ``val``, or
            the disk refuses.
    """
    files = find_scenarionet(source)
    renderer = SchematicRenderer(settings.width, settings.height) if settings.images else None
    plan = DataSetPlan(
        root=root,
        version=VERSION_FOLDER,
        split=settings.split,
        renderer=renderer,
        frames=settings.frames,
        source=None,
        keeps_instances=True,
    )
    with lock_folder(root):
        work, where = partial(_import_one, plan), LocalProcesses(workers)
        written = list(run_units(work, files, where, total=len(files), label="importing scenes"))
        names = [imported.name for imported in written]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise InputError(f"{source} holds more than one file of scene {twice[0]}; keep one of them")
        finish_data_set(plan, [imported.written.key for imported in written])
    return tuple(names)


class _ImportedScene(NamedTuple):
    name: str
    written: WrittenScene

    @property
    def kept(self) -> bool:
        return self.written.kept


def _import_one(plan: DataSetPlan, path: Path) -> _ImportedScene:
    exchanged = read_exchanged_scene(path)
    scene = add_default_rig(exchanged.scene)
    if scene.adversaries and plan.split == "val":
        raise InputError(f"{path} names adversaries, which are never in val; import it with --split adv")
    report = dict(exchanged.report)
    written = write_scene_if_missing(plan, scene, name=scene.name, source_scene=exchanged.source_scene, report=report)
    return _ImportedScene(scene.name, written)


def add_default_rig(scene: Scene) -> Scene:
    """The scene with six cameras where its source has none."""
    return scene if scene.cameras else replace(scene, cameras=build_default_cameras())
