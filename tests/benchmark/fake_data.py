"""A data set in memory over hand-made scenes, with truth and observations straight from the scene."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.constants import COMMAND_LATERAL_M, PLAN_STEPS
from benchmark.datasets.annotated_objects import AnnotationCount
from benchmark.datasets.can_bus import CanBus, compute_ego_state
from benchmark.datasets.categories import CategoryNames
from benchmark.datasets.scene_facts import build_scene_facts
from benchmark.geometry import Bools, Floats, to_local, wrap_angle
from benchmark.machine.storage import content_key, make_token
from benchmark.planning import CameraView, Command, Observation
from benchmark.records.review import SplitReview
from benchmark.records.run_schema import SceneFacts
from benchmark.road_map import Handedness
from benchmark.scene import Scene
from benchmark.truth import SampleTruth
from tests.hand_made import Car, scene_on_straight_road

HISTORY = 5


def town_of_two(*, slow_leader: bool = False) -> "FakeData":
    """Two straight-road scenes of 8 s; with a slow leader the ego would run into it if it kept its speed."""
    leader = (Car(75.0, 198.25, 2.0),) if slow_leader else ()
    return FakeData(
        {
            "scene-9901": scene_on_straight_road(name="scene-9901"),
            "scene-9902": scene_on_straight_road(
                (*leader, Car(60.0, 194.75, 10.0), Car(120.0, 201.75, 9.0, np.pi)), name="scene-9902"
            ),
        }
    )


@dataclass
class FakeData:
    scenes: dict[str, Scene]
    root: Path = Path("fake")
    version: str = "v1.0-fake"
    name: str = "fake"
    views: dict[str, CameraView] = field(default_factory=dict)
    train: tuple[str, ...] = ()
    categories: CategoryNames = ()
    driving_side: Handedness | None = None

    def with_driving_side(self, side: Handedness | None) -> "FakeData":
        sided = {name: replace(scene, driving_side=side) for name, scene in self.scenes.items()}
        return replace(self, scenes=sided, driving_side=side)

    def with_categories(self, categories: CategoryNames) -> "FakeData":
        return self

    def annotation_counts(self, names: Sequence[str]) -> dict[str, AnnotationCount]:
        return {name: AnnotationCount(int(self.scenes[name].annotations.valid.sum()), {}) for name in names}

    def splits(self) -> dict[str, tuple[str, ...]]:
        return {split: self.scene_names(split) for split in self.split_names()}

    def split_names(self) -> tuple[str, ...]:
        return ("train", "val") if self.train else ("val",)

    def scene_names(self, split: str | None = None) -> tuple[str, ...]:
        names = sorted(self.scenes)
        return tuple(name for name in names if split is None or (name in self.train) == (split == "train"))

    def review(self, split: str | None = None) -> SplitReview:
        return SplitReview(waiting=self.scene_names(split))

    def scene(self, name: str) -> Scene:
        return self.scenes[name]

    def keyframe_rows(self, name: str) -> dict[str, str]:
        return {make_token("CAM_FRONT", truth.sample_token): truth.sample_token for truth in self.truth(name)}

    def has_map(self, name: str) -> bool:
        return True

    def has_lidar(self, name: str) -> bool:
        return True

    def provenance(self) -> dict[str, Any] | None:
        return None

    def scene_facts(self, names: Sequence[str]) -> dict[str, SceneFacts]:
        return {name: build_scene_facts(name, {}, self.scenes[name].description) for name in names}

    def fingerprint(self) -> str:
        return content_key([(name, self.scenes[name].agents.position.tolist()) for name in sorted(self.scenes)])

    def truth(self, name: str) -> tuple[SampleTruth, ...]:
        return tuple(sample_truth(self.scenes[name], index) for index in range(len(self.scenes[name].keyframes)))

    def observations(self, name: str) -> Iterator[Observation]:
        scene = self.scenes[name]
        for index in range(len(scene.keyframes)):
            yield observation(scene, index, self.views)

    def videos(self, name: str, *, sweeps: bool) -> dict[str, tuple[CameraView, ...]]:
        return {camera: (view,) for camera, view in self.views.items()}


def sample_truth(scene: Scene, index: int) -> SampleTruth:
    count = len(scene.keyframes)
    ahead = float(scene.lidar.translation[0])
    pose = scene.ego.pose[scene.keyframes]
    lidar = np.column_stack(
        [pose[:, :2] + ahead * np.column_stack([np.cos(pose[:, 2]), np.sin(pose[:, 2])]), pose[:, 2]]
    )
    steps = np.arange(index, index + PLAN_STEPS + 1)
    valid = steps < count
    at = np.minimum(steps, count - 1)
    rows = np.flatnonzero((scene.annotations.valid[:, at] & valid).any(axis=1))
    boxes = np.empty((len(rows), PLAN_STEPS + 1, 5))
    boxes[..., :2] = in_lidar_axes(scene.annotations.position[rows][:, at, :2], lidar[index])
    boxes[..., 2:4] = scene.annotations.size[rows][:, at, :2]
    frames = scene.keyframes[at]
    boxes[..., 4] = wrap_angle(scene.agents.yaw[rows][:, frames] - lidar[index, 2] + np.pi / 2)
    future = np.column_stack(
        [in_lidar_axes(lidar[at[1:], :2], lidar[index]), wrap_angle(lidar[at[1:], 2] - lidar[index, 2] + np.pi / 2)]
    )
    annotated: Bools = scene.annotations.valid[rows][:, at] & valid
    points = scene.annotations.num_lidar_pts[rows][:, at] > 0
    return SampleTruth(
        scene=scene.name, sample_token=make_token(scene.name, index), index=index,
        timestamp_us=int(scene.timestamps_us[scene.keyframes[index]]), lidar_pose=lidar[index], lidar_ahead_m=ahead,
        ego_future=future, ego_future_valid=valid[1:], command=_command(future[valid[1:]]),
        instances=tuple(scene.agents.ids[row] for row in rows),
        categories=tuple(scene.agents.categories[row] for row in rows), boxes=boxes, annotated=annotated,
        has_points=points & annotated, has_lidar_points=points & annotated,
    )  # fmt: skip


def in_lidar_axes(points: Floats, pose: Floats) -> Floats:
    forward_left = to_local(points, pose)
    return np.stack([-forward_left[..., 1], forward_left[..., 0]], axis=-1)


def observation(scene: Scene, index: int, views: dict[str, CameraView]) -> Observation:
    frame = int(scene.keyframes[index])
    pose = scene.ego.pose[scene.keyframes]
    past = np.arange(index - HISTORY + 1, index + 1)
    return Observation(
        scene=scene.name, sample_token=make_token(scene.name, index), index=index,
        timestamp_us=int(scene.timestamps_us[frame]), views=views, lidar=scene.lidar,
        ego=compute_ego_state(scene.ego, scene.timestamps_us, frame, CanBus(None, None)),
        past_poses=pose[np.maximum(past, 0)], past_valid=past >= 0, command=sample_truth(scene, index).command,
    )  # fmt: skip


def _command(future: Floats) -> Command:
    lateral = future[-1, 0] if len(future) else 0.0
    if lateral >= COMMAND_LATERAL_M:
        return Command.RIGHT
    return Command.LEFT if lateral <= -COMMAND_LATERAL_M else Command.STRAIGHT
