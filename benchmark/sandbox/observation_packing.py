"""Compact encoding of observations: the numbers of all arrays in one block, plain values beside it.

Ready-made encodings look at every object by itself, which costs as much as all else that is done for a sample. Of
pictures there are names here, calibration and poses (`shared_images.py` has what is on them).
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.planning import CameraView, Command, EgoState, NoViews, Observation
from benchmark.scene import Camera, LidarMount

Layout = tuple[tuple[np.dtype[Any], tuple[int, ...]] | None, ...]
"""Type and shape of each array; ``None`` where there is none."""
_ALIGNED_BYTES: Final = 8


class ObservationPacker:
    """Packs the observations of one planner; what stays as it was is said once."""

    def __init__(self) -> None:
        self._said: Layout | None = None

    def packed(self, seen: Observation) -> tuple[Any, ...]:
        """An observation as plain values, the layout of its arrays if it is another one, and their bytes."""
        ego, lidar = seen.ego, seen.lidar
        arrays: list[NDArray[Any] | None] = [
            *(ego.pose, ego.position, ego.rotation, ego.velocity, ego.acceleration),
            *(ego.can_motion, ego.can_motion_after, seen.past_poses, seen.past_valid),
            *(lidar.translation, lidar.rotation),
        ]
        unseeing, views = isinstance(seen.views, NoViews), []
        for name, view in () if unseeing else seen.views.items():
            camera = view.camera
            arrays += [camera.translation, camera.rotation, camera.intrinsic, view.global_T_ego]
            views.append((name, camera.name, camera.width, camera.height, str(view.path), view.timestamp_us))
        layout: Layout = tuple(None if array is None else (array.dtype, array.shape) for array in arrays)
        known, self._said = layout == self._said, layout
        values = (seen.scene, seen.sample_token, seen.index, seen.timestamp_us, int(seen.command))
        motion = (ego.yaw_rate, ego.steering_angle, ego.source)
        return values, motion, None if unseeing else views, None if known else layout, _join_bytes(arrays)


class ObservationUnpacker:
    """The planner's side."""

    def __init__(self) -> None:
        self._places: list[tuple[tuple[int, ...], np.dtype[Any], int] | None] = []
        self._folders: dict[str, Path] = {}

    def unpack(self, packed: Sequence[Any], load: Callable[[str], NDArray[np.uint8]]) -> Observation:
        """The observation, equal in every number and type; `load` reads the picture of a camera."""
        values, motion, views, layout, data = packed
        if layout is not None:
            self._places = _compute_offsets(layout)
        arrays: Iterator[Any] = iter(
            [None if place is None else np.ndarray(place[0], place[1], data, place[2]) for place in self._places]
        )
        scene, sample_token, index, timestamp_us, command = values
        yaw_rate, steering_angle, source = motion
        pose, position, rotation, velocity, acceleration, can_motion, can_motion_after = (
            next(arrays) for _ in range(7)
        )
        past_poses, past_valid, lidar_translation, lidar_rotation = (next(arrays) for _ in range(4))
        camera_views: dict[str, CameraView] = NoViews() if views is None else {}
        for name, called, width, height, path, time_us in views or ():
            translation, camera_rotation, intrinsic, view_pose = (next(arrays) for _ in range(4))
            camera = Camera(called, translation, camera_rotation, intrinsic, width, height)
            camera_views[name] = CameraView(camera, self._path(path), time_us, view_pose, partial(load, name))
        ego = EgoState(
            pose,
            position,
            rotation,
            velocity,
            acceleration,
            yaw_rate,
            steering_angle,
            source,
            can_motion,
            can_motion_after,
        )
        return Observation(
            scene,
            sample_token,
            index,
            timestamp_us,
            camera_views,
            LidarMount(lidar_translation, lidar_rotation),
            ego,
            past_poses,
            past_valid,
            Command(command),
        )

    def _path(self, text: str) -> Path:
        """A path; pictures of a camera lie in one folder, which is made a path of once."""
        folder, _, name = text.rpartition("/")
        if not folder or name in ("", ".", ".."):
            return Path(text)
        known = self._folders.get(folder)
        if known is None:
            known = self._folders[folder] = Path(folder)
        return known / name


def _join_bytes(arrays: Sequence[NDArray[Any] | None]) -> bytearray:
    """The bytes of arrays one after the other, each beginning where every number may."""
    pieces = []
    for array in arrays:
        if array is not None:
            piece = array.tobytes()
            pieces.append(piece)
            if len(piece) % _ALIGNED_BYTES:
                pieces.append(bytes(-len(piece) % _ALIGNED_BYTES))
    return bytearray(b"".join(pieces))


def _compute_offsets(layout: Layout) -> list[tuple[tuple[int, ...], np.dtype[Any], int] | None]:
    places: list[tuple[tuple[int, ...], np.dtype[Any], int] | None] = []
    place = 0
    for entry in layout:
        if entry is None:
            places.append(None)
            continue
        kind, shape = entry
        places.append((shape, kind, place))
        size = kind.itemsize * math.prod(shape)
        place += size + -size % _ALIGNED_BYTES
    return places
