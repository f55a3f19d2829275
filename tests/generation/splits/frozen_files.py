"""A small frozen split on a straight road: searched once, with images, in the format that everybody reads."""

from dataclasses import replace
from pathlib import Path

from benchmark.datasets.roots import DataSet
from benchmark.scene import Scene
from generation.build.settings import BuildSettings
from generation.build.split import build_split
from generation.render.schematic import SchematicRenderer
from generation.splits.packaged import NamedSplit, frozen_split
from tests.generation.labels.recorded_roads import CHEAP, write_source
from tests.hand_made import Car, scene_on_straight_road

DRAWN = SchematicRenderer(96, 54)
BUILT = BuildSettings(out=Path(), version="v1.0-mini", renderer=DRAWN, frames="keyframes")


def road(name: str, ahead_m: float, *, seconds: float = 8.0) -> Scene:
    """The ego and three cars; with cameras."""
    cars = (Car(52.0 + ahead_m, 194.75, 9.0), Car(95.0, 198.25, 8.0), Car(45.0, 201.75, 8.0))
    return scene_on_straight_road(cars, seconds=seconds, name=name)


def recordings(root: Path, *, moved_m: float = 0.0, seconds: float = 8.0) -> DataSet:
    """Two recorded scenes."""
    scenes = road("scene-9901", 10.0 + moved_m, seconds=seconds), road("scene-9902", 2.0 + moved_m, seconds=seconds)
    return write_source(root, *scenes)


def frozen_file(source: DataSet, folder: Path, **changes: object) -> NamedSplit:
    """What a search found, frozen; the searched root is ``searched`` in the same folder."""
    file = folder / "road-adv-1.json"
    settings = replace(CHEAP, out=folder / "searched", freeze=file, renderer=DRAWN, frames="keyframes", **changes)  # type: ignore[arg-type]
    build_split(source, "adv", settings)
    return frozen_split(file)
