"""Small recorded data sets on a straight road, and a cheap way to build from them."""

from dataclasses import replace
from pathlib import Path

from benchmark.datasets.roots import DataSet, open_data
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from generation.pipeline.settings import BuildSettings
from generation.search.hyperparameters import HyperParameters
from tests.generation.search.driving_prior import DrivingPrior
from tests.hand_made import Car, scene_on_straight_road

HYPER = HyperParameters(candidates=24, rounds=2)
CHEAP = BuildSettings(out=Path(), hyper=HYPER, prior=DrivingPrior, version="v1.0-mini")
QUICK = replace(CHEAP, hyper=replace(HYPER, candidates=8, rounds=1, tries=1))
"""Where it does not matter how good what is found is."""
BUSY = (
    Car(62.0, 194.75, 9.0),
    Car(95.0, 198.25, 8.0),
    Car(45.0, 201.75, 8.0),
    Car(40.0, 194.75, 9.0),
    Car(60.0, 205.25, 0.0),
    Car(62.0, 208.0, 1.0, category="human.pedestrian.adult"),
)


def recorded(name: str, cars: tuple[Car, ...] = BUSY, seconds: float = 8.0) -> Scene:
    """A scene without cameras."""
    return replace(scene_on_straight_road(cars, seconds=seconds, name=name), cameras=())


def write_source(root: Path, *scenes: Scene) -> DataSet:
    """A data set of scenes, open."""
    plan = DataSetPlan(root=root, split="val", version="v1.0-mini")
    keys = [write_scene(plan, scene, name=scene.name, source_scene=scene.name, report={}) for scene in scenes]
    finish_data_set(plan, keys)
    return open_data(root)


def contents(root: Path) -> dict[str, bytes]:
    """Everything below a folder; only how long work took may differ."""
    files = (path for path in sorted(root.rglob("*")) if path.is_file())
    return {str(path.relative_to(root)): path.read_bytes() for path in files}
