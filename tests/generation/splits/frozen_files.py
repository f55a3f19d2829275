"""A small frozen split on a straight road: searched once, with images, in the format that everybody reads."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmark.datasets.roots import DataSet
from benchmark.scene import Camera, Scene
from generation.nuscenes_writer import DataSetPlan, SourceInfo
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import build_split
from generation.render.schematic import SchematicRenderer
from generation.splits.format import (
    FrozenAdversary,
    FrozenScene,
    FrozenSplit,
    RecordingsIdentity,
    SceneChoice,
    SearchMetadata,
    write_frozen,
)
from generation.splits.packaged import NamedSplit, read_frozen_split
from generation.splits.tracks import add_frozen_adversaries, compute_tables_digest
from tests.generation.labels.recorded_roads import CHEAP, write_source
from tests.hand_made import Car, scene_on_straight_road


class FrontRenderer(SchematicRenderer):
    """Draws as the schematic one, with the first camera alone."""

    def cameras(self, scene: Scene) -> tuple[Camera, ...]:
        return super().cameras(scene)[:1]


DRAWN = FrontRenderer(96, 54)
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
    drawn = {"renderer": DRAWN, "frames": "keyframes"}
    settings = replace(CHEAP, out=folder / "searched", freeze=file, **(drawn | changes))  # type: ignore[arg-type]
    build_split(source, "adv", settings)
    return read_frozen_split(file)


def drifting_split(source: DataSet, file: Path) -> NamedSplit:
    """A frozen split without a search: in each scene, and in each of two, another car drifts a little to the left."""
    plan = DataSetPlan(root=file.parent, split="adv", source=SourceInfo(source.name, source.fingerprint(), source.root))
    scenes = []
    for number, name in enumerate(source.scene_names(None)):
        recorded = source.scene(name)
        for agent in range(2):
            poses = np.column_stack([recorded.agents.position[agent, 6:, :2], recorded.agents.yaw[agent, 6:]])
            poses[:, 1] += np.linspace(0.0, 0.5 + 0.1 * number, len(poses))
            track = tuple((round(x, 3), round(y, 3), round(yaw, 5)) for x, y, yaw in poses.tolist())
            adversary = FrozenAdversary(
                instance=recorded.agents.ids[agent], launch_frame=6, recorded=track[0], track=track
            )
            frozen = FrozenScene(name=f"{name}-{agent:08d}", source=name, adversaries=(adversary,), tables="0" * 64)
            digest = compute_tables_digest(plan, add_frozen_adversaries(frozen, recorded), frozen)
            scenes.append(frozen.model_copy(update={"tables": digest}))
    split = FrozenSplit(
        recordings=RecordingsIdentity(name=source.name, fingerprint=source.fingerprint()),
        search=SearchMetadata(algorithm="none", hyper="none", prior="none", seed=0),
        chosen=SceneChoice(scenes=2, tried=4, survived=4, per_scene=None, total=None, surrogate=None),
        images=None,
        scenes=tuple(scenes),
    )
    write_frozen(file, split)
    return NamedSplit(file.stem, split)
