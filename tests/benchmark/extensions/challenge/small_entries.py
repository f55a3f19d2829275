"""A small town of two recordings on a straight road, an honest entry of it, and ways to forge one."""

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.datasets.roots import DataSet, open_data
from benchmark.geometry import Floats
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from generation.render.schematic import SchematicRenderer
from tests.hand_made import Car, scene_on_straight_road

LANE_M = 3.5
CARS = (
    Car(62.0, 194.75, 9.0),
    Car(95.0, 198.25, 8.0),
    Car(45.0, 201.75, 8.0),
    Car(70.0, 205.25, 0.0),
    Car(66.0, 208.0, 1.0, category="human.pedestrian.adult", size=(0.7, 0.7, 1.8)),
    Car(30.0, 194.75, 8.5, category="vehicle.truck", size=(7.0, 2.5, 3.0)),
)
CUTTER, LEADER, ONCOMING, PARKED, PEDESTRIAN, TRUCK = range(len(CARS))
RECORDINGS = ("scene-9901", "scene-9902")
VERSION = "v1.0-mini"
Row = dict[str, Any]
RENDERER = SchematicRenderer(96, 54)


def recording(name: str, *, ahead_m: float = 0.0) -> Scene:
    cars = (Car(62.0 + ahead_m, 194.75, 9.0), *CARS[1:])
    return scene_on_straight_road(cars, seconds=8.0, name=name)


def cut_in(scene: Scene, *, late_s: float = 2.0, aside_m: float = LANE_M, over_s: float = 4.0) -> Scene:
    """The car in the next lane comes over, in front of the ego."""
    frames = slice(int(12 * late_s), len(scene.timestamps_us))
    seconds = scene.seconds[frames]
    share = np.clip((seconds - seconds[0]) / over_s, 0.0, 1.0)
    place = scene.agents.position[CUTTER, frames, :2].copy()
    place[:, 1] += aside_m * 0.5 * (1.0 - np.cos(np.pi * share))
    return scene.with_adversary(CUTTER, frames, headed(place, scene))


def headed(place: Floats, scene: Scene) -> Floats:
    """(F, 3) poses that look where they go."""
    speed = np.gradient(place, scene.seconds[1], axis=0)
    return np.column_stack([place, np.arctan2(speed[:, 1], speed[:, 0])])


def write(
    root: Path, split: str, scenes: list[tuple[Scene, str]], renderer: SchematicRenderer | None = RENDERER
) -> DataSet:
    """Write scenes by their names in a data set."""
    plan = DataSetPlan(root=root, split=split, version=VERSION, renderer=renderer, frames="keyframes")
    keys = [write_scene(plan, scene, name=name, source_scene=scene.name, report={}) for scene, name in scenes]
    finish_data_set(plan, keys)
    return open_data(root)


def recordings(root: Path) -> DataSet:
    return write(root, "val", [(recording(name, ahead_m=2.0 * at), name) for at, name in enumerate(RECORDINGS)])


def honest(root: Path) -> DataSet:
    scenes = [recording(name, ahead_m=2.0 * at) for at, name in enumerate(RECORDINGS)]
    return write(root, "adv", [(cut_in(scene), f"{scene.name}-a") for scene in scenes])


@dataclass(frozen=True)
class Forged:
    """A copy of an honest entry, to be changed."""

    root: Path

    @classmethod
    def copy(cls, entry: Path, to: Path) -> "Forged":
        shutil.copytree(entry, to, ignore=shutil.ignore_patterns(".challenger"))
        return cls(to)

    @property
    def folder(self) -> Path:
        return self.root / VERSION

    @contextmanager
    def rows(self, table: str) -> Iterator[list[Row]]:
        """Rows of a table, written again afterwards."""
        path = self.folder / f"{table}.json"
        rows = json.loads(path.read_text())
        yield rows
        path.write_text(json.dumps(rows))

    def read(self, table: str) -> list[Row]:
        rows: list[Row] = json.loads((self.folder / f"{table}.json").read_text())
        return rows

    def scene(self, name: str = "scene-9901-a") -> Row:
        return next(row for row in self.read("scene") if row["name"] == name)

    def samples(self, name: str = "scene-9901-a") -> list[str]:
        """Tokens in time order."""
        token = self.scene(name)["token"]
        rows = [row for row in self.read("sample") if row["scene_token"] == token]
        return [row["token"] for row in sorted(rows, key=lambda row: row["timestamp"])]

    def instance(self, agent: int, name: str = "scene-9901-a") -> str:
        """Token of a car of `CARS` in a scene: they are written in their order."""
        inside = set(self.samples(name))
        present = {row["instance_token"] for row in self.read("sample_annotation") if row["sample_token"] in inside}
        return [str(row["token"]) for row in self.read("instance") if row["token"] in present][agent]

    def annotations(self, change: Callable[[int, Row], object], agent: int, name: str = "scene-9901-a") -> None:
        """Change the annotations of a car; the function is given the keyframe and the row."""
        instance = self.instance(agent, name)
        at = {token: index for index, token in enumerate(self.samples(name))}
        with self.rows("sample_annotation") as rows:
            for row in rows:
                if row["instance_token"] == instance:
                    change(at[row["sample_token"]], row)

    def drop_annotations(self, agent: int, keep: Callable[[int], bool], name: str = "scene-9901-a") -> None:
        """Leave out annotations of a car, chains and counts mended; without any left the instance goes too."""
        instance = self.instance(agent, name)
        at = {token: index for index, token in enumerate(self.samples(name))}
        with self.rows("sample_annotation") as rows:
            mine = [row for row in rows if row["instance_token"] == instance]
            left = sorted(
                (row for row in mine if keep(at[row["sample_token"]])), key=lambda row: at[row["sample_token"]]
            )
            for place, row in enumerate(left):
                row["prev"] = left[place - 1]["token"] if place else ""
                row["next"] = left[place + 1]["token"] if place + 1 < len(left) else ""
            rows[:] = [row for row in rows if row["instance_token"] != instance] + left
        with self.rows("instance") as instances:
            row = next(row for row in instances if row["token"] == instance)
            if not left:
                instances.remove(row)
                return
            row["nbr_annotations"] = len(left)
            row["first_annotation_token"], row["last_annotation_token"] = left[0]["token"], left[-1]["token"]

    def data_rows(self, channel: str, name: str = "scene-9901-a") -> list[Row]:
        """Rows of ``sample_data`` of a sensor, in time order."""
        wanted = set(self.samples(name))
        rows = [
            row
            for row in self.read("sample_data")
            if row["sample_token"] in wanted and f"/{channel}/" in row["filename"]
        ]
        return sorted(rows, key=lambda row: row["timestamp"])

    def image(self, channel: str, keyframe: int, name: str = "scene-9901-a") -> Path:
        return self.root / str(self.data_rows(channel, name)[keyframe]["filename"])
