"""`Observation` of every sample: images, ego motion and command; nothing of the future but the command."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.datasets.can_bus import CanBus, compute_ego_state
from benchmark.datasets.drawn_later import Artist
from benchmark.datasets.sample_truth import compute_planar_lidar_poses, compute_recorded_command
from benchmark.datasets.sensors import read_views
from benchmark.datasets.steps import KeyFrameSteps, interpolate_values
from benchmark.datasets.tables import Row
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats
from benchmark.planning import Observation
from benchmark.scene import Scene

PAST_KEYFRAMES: Final = 5
"""Ego poses that a planner is given: now and two seconds back, at steps of half a second."""


def read_observations(
    nusc: Any, root: Path, scene: Scene, samples: Sequence[Row], can_bus: CanBus, artist: Artist | None = None
) -> Iterator[Observation]:
    """Inputs that a planner may see at each sample, for the scene's K rows in time order, at any rate of key frames.

    Refuses calibrations that make no sense, file names that leave the root, and scenes of which some images are
    missing. Where all are missing the scene is one without images: only looking at one is an error then. An ``artist``
    draws what is missing.
    """
    views = [read_views(nusc, root, sample) for sample in samples]
    if artist is None:
        _require_all_or_none(scene.name, [view.path for by_camera in views for view in by_camera.values()])
    else:
        views = [{name: artist.show(scene.name, view) for name, view in of_sample.items()} for of_sample in views]
    lidar_poses, clock, axle_poses = compute_planar_lidar_poses(scene), KeyFrameSteps.of(scene), scene.ego.pose
    for index, sample in enumerate(samples):
        past_poses, past_valid = compute_past(scene, axle_poses, clock, index)
        frame = int(scene.keyframes[index])
        yield Observation(
            scene=scene.name,
            sample_token=sample["token"],
            index=index,
            timestamp_us=int(scene.timestamps_us[frame]),
            views=views[index],
            lidar=scene.lidar,
            ego=compute_ego_state(scene.ego, scene.timestamps_us, frame, can_bus),
            past_poses=past_poses,
            past_valid=past_valid,
            command=compute_recorded_command(scene, clock, lidar_poses, index),
        )


def compute_past(scene: Scene, axle_poses: Floats, clock: KeyFrameSteps, index: int) -> tuple[Floats, Bools]:
    """(5, 3) poses of the rear axle at steps of half a second up to a sample, oldest first, and (5,) which are known.

    From (T, 3) poses at the frames. Unknown is what was before the scene began or beyond a gap that is too long; the
    oldest one that is known stands there.
    """
    steps = np.arange(1 - PAST_KEYFRAMES, 1)
    if clock.are_key_frames(index, 1 - PAST_KEYFRAMES):
        past = index + steps
        return axle_poses[scene.keyframes[np.maximum(past, 0)]], past >= 0
    at = clock.at(index, steps)
    poses = interpolate_values(axle_poses, scene.timestamps_us, at.times_us)
    return poses[np.maximum(np.arange(PAST_KEYFRAMES), np.count_nonzero(~at.known))], at.known


def _require_all_or_none(scene: str, paths: Sequence[Path]) -> None:
    missing = [path for path in paths if not path.is_file()]
    if missing and len(missing) < len(paths):
        raise InputError(
            f"image {missing[0]} is missing ({len(missing)} of the {len(paths)} images of scene {scene} are); complete "
            "the data set or leave the scene out"
        )
