"""`Observation` of every sample: images, ego motion and command; nothing of the future but the command."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.datasets.can_bus import CanBus, ego_state
from benchmark.datasets.sample_truth import command_of, ego_future, planar_lidar_poses
from benchmark.datasets.sensors import read_views
from benchmark.datasets.tables import Row
from benchmark.errors import InputError
from benchmark.planning import Observation
from benchmark.scene import Scene

PAST_KEYFRAMES: Final = 5
"""Ego poses that a planner is given: now and two seconds back."""


def observations_of_scene(
    nusc: Any, root: Path, scene: Scene, samples: Sequence[Row], can_bus: CanBus
) -> Iterator[Observation]:
    """What a planner may see at each sample.

    Args:
        nusc: ``NuScenes`` of the devkit.
        root: Data set root.
        scene: The scene.
        samples: Rows of the scene's K samples in time order.
        can_bus: CAN bus messages of the scene.

    Yields:
        One observation a sample, in time order.

    Raises:
        InputError: If a calibration makes no sense, a file name leaves the root, or some of the scene's images are
            missing. Where all are missing the scene is one without images: only looking at one is an error then.
    """
    views = [read_views(nusc, root, sample) for sample in samples]
    _require_all_or_none(scene.name, [view.path for by_camera in views for view in by_camera.values()])
    lidar_poses, ego_poses = planar_lidar_poses(scene), scene.ego.pose[scene.keyframes]
    for index, sample in enumerate(samples):
        past = index - PAST_KEYFRAMES + 1 + np.arange(PAST_KEYFRAMES)
        frame = int(scene.keyframes[index])
        yield Observation(
            scene=scene.name,
            sample_token=sample["token"],
            index=index,
            timestamp_us=int(scene.timestamps_us[frame]),
            views=views[index],
            lidar=scene.lidar,
            ego=ego_state(scene.ego, scene.timestamps_us, frame, can_bus),
            past_poses=ego_poses[np.maximum(past, 0)],
            past_valid=past >= 0,
            command=command_of(*ego_future(lidar_poses, index)),
        )


def _require_all_or_none(scene: str, paths: Sequence[Path]) -> None:
    missing = [path for path in paths if not path.is_file()]
    if missing and len(missing) < len(paths):
        raise InputError(
            f"image {missing[0]} is missing, {len(missing)} of the {len(paths)} images of scene {scene} are; complete "
            "the data set or leave the scene out"
        )
