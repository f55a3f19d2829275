"""Facts of samples that importers need: tokens, poses, recorded lidar futures, orders. Turning points in the plane."""

from collections.abc import Callable, Collection, Set
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmark.constants import COMMAND_LATERAL_M, PLAN_STEPS
from benchmark.datasets.contents import list_scenes_by_split
from benchmark.datasets.split_names import sort_as_exported
from benchmark.geometry import Bools, Floats, rotation_matrix, yaw_of_quaternion
from benchmark.planning import Command
from benchmark.scene import Scene

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

_NOTHING_RAD = 1e-12


def rotate(points: Floats, angle_rad: ArrayLike) -> Floats:
    """Points, (..., 2), turned counter-clockwise by (...) angles; one of zero up to rounding changes nothing."""
    angle = np.asarray(angle_rad, np.float64)
    angle = np.where(np.abs(angle) < _NOTHING_RAD, 0.0, angle)
    cosine, sine = np.cos(angle), np.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], axis=-1)


UNDECIDED_M: Final = 0.05
"""So near to the border between two commands either may have been stored: official converters work in three dimensions
and single precision."""


@dataclass(frozen=True, slots=True)
class OtherSplits:
    """The other splits of the data set, for files that belong to one of them."""

    data: "DataSet"
    split: str

    def first(self, fits: Callable[[Set[str]], bool]) -> str | None:
        """Name of the first other split that a file fits, by its sample tokens."""
        for split, scenes in list_scenes_by_split(self.data)[0].items():
            tokens = {sample for scene in scenes for sample in self.data.keyframe_rows(scene).values()}
            if split != self.split and fits(tokens):
                return split
        return None


@dataclass(frozen=True)
class RecordedSamples:
    """S samples.

    Attributes:
        ego_pose: (S, 3) planar x, y, heading of the rear axle, global.
        lidar_in_ego: (S, 3) x, y of the lidar in the ego frame, and yaw of its axes.
        future: (S, 6, 2) recorded positions of the lidar, in its own frame at the sample (x right, y forward); 0 where
            not valid.
        valid: (S, 6) whether the keyframe exists.
        by_time: Rows in the order of info files that are sorted by time.
        by_table: Rows in the order of info files that are not sorted: scene by scene.
    """

    name: str
    tokens: tuple[str, ...]
    scenes: tuple[str, ...]
    timestamps_us: NDArray[np.int64]
    ego_pose: Floats
    lidar_in_ego: Floats
    future: Floats
    valid: Bools
    by_time: NDArray[np.int64]
    by_table: NDArray[np.int64]
    others: OtherSplits | None = None

    @cached_property
    def row_of(self) -> dict[str, int]:
        """Row by token."""
        return {token: row for row, token in enumerate(self.tokens)}

    @property
    def complete(self) -> Bools:
        """(S,) whether six key frames follow."""
        return np.asarray(self.valid.all(axis=1))

    @cached_property
    def _last_lateral_m(self) -> Floats:
        """(S,) x of the last valid recorded position; 0 where there is none."""
        last = np.maximum(self.valid.sum(axis=1) - 1, 0)
        return np.where(self.valid.any(axis=1), self.future[np.arange(len(self.tokens)), last, 0], 0.0)

    @cached_property
    def commands(self) -> NDArray[np.int64]:
        """(S,) driving commands as all repositories derive them."""
        x = self._last_lateral_m
        turned = np.where(x >= COMMAND_LATERAL_M, Command.RIGHT, Command.STRAIGHT)
        return np.where(x <= -COMMAND_LATERAL_M, Command.LEFT, turned).astype(np.int64)

    def may_have_command(self, row: int, command: int) -> bool:
        """Whether a stored command is possible for a sample."""
        if command == self.commands[row]:
            return True
        x = float(self._last_lateral_m[row])
        side = Command.RIGHT if x > 0 else Command.LEFT
        return abs(abs(x) - COMMAND_LATERAL_M) <= UNDECIDED_M and command in (side, Command.STRAIGHT)

    def possible_orders(self) -> tuple["RecordedSamples", ...]:
        """Samples in every order of info files that are sorted by time, the likelier one first.

        Where scenes overlap in time, as variants of one recording do, a converter mixes them, but info files exported
        here keep them apart (`benchmark.datasets.split_names`). No planner with memory runs on mixed variants;
        recordings of two cars at the same time have official info files.
        """
        exported = sort_as_exported(self.scenes, self.timestamps_us)
        if np.array_equal(exported, self.by_time):
            return (self,)
        variants = len(np.unique(self.timestamps_us)) < len(self.timestamps_us)
        apart = replace(self, by_time=exported)
        return (apart, self) if variants else (self, apart)

    def of_scenes(self, scenes: Collection[str]) -> "RecordedSamples":
        """Samples with the orders of info files that hold only some scenes."""
        chosen = np.isin(np.array(self.scenes), list(scenes))
        return replace(self, by_time=self.by_time[chosen[self.by_time]], by_table=self.by_table[chosen[self.by_table]])


def read_recorded_samples(data: "DataSet", split: str) -> RecordedSamples:
    """The samples of a split.

    Args:
        data: The data set.
        split: The split.

    Returns:
        They, scene by scene.

    Raises:
        InputError: If the split is unknown or the data broken.
    """
    tokens: list[str] = []
    scenes: list[str] = []
    parts: list[tuple[NDArray[np.int64], Floats, Floats, Floats, Bools]] = []
    for name in data.scene_names(split):
        scene = data.scene(name)
        of_scene = [truth.sample_token for truth in data.truth(name)]
        tokens += of_scene
        scenes += [name] * len(of_scene)
        parts.append(_scene_arrays(scene))
    times, poses, mounts, futures, valid = (np.concatenate(part) for part in zip(*parts, strict=True))
    return RecordedSamples(
        name=f"split {split!r} of {data.name}",
        tokens=tuple(tokens),
        scenes=tuple(scenes),
        timestamps_us=times,
        ego_pose=poses,
        lidar_in_ego=mounts,
        future=futures,
        valid=valid,
        # Stable, as Python's sort: variants of one recording share their times.
        by_time=np.argsort(times, kind="stable"),
        by_table=np.arange(len(tokens)),
        others=OtherSplits(data, split),
    )


def _scene_arrays(scene: Scene) -> tuple[NDArray[np.int64], Floats, Floats, Floats, Bools]:
    frames = scene.keyframes
    count = len(frames)
    mount = np.array([*scene.lidar.translation[:2], float(yaw_of_quaternion(scene.lidar.rotation))])
    steps = np.arange(count)[:, None] + np.arange(1, PLAN_STEPS + 1)
    valid = steps < count
    futures = _lidar_futures(scene, np.minimum(steps, count - 1))
    return (
        scene.timestamps_us[frames],
        scene.ego.pose[frames],
        np.tile(mount, (count, 1)),
        np.where(valid[..., None], futures, 0.0),
        valid,
    )


def _lidar_futures(scene: Scene, steps: NDArray[np.int64]) -> Floats:
    """(K, 6, 2) recorded lidar origins in the lidar frame of each keyframe: in space, as the official converters do."""
    frames = scene.keyframes
    turn, position = rotation_matrix(scene.ego.rotation[frames]), scene.ego.position[frames]
    lidar = position + turn @ scene.lidar.translation
    axes = turn @ rotation_matrix(scene.lidar.rotation)
    away = lidar[steps] - lidar[:, None]
    return np.asarray(np.einsum("kij,ksi->ksj", axes, away)[..., :2])
