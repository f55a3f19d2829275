"""Maps of sessions from a data set that has their scenes, by name."""

from collections.abc import Callable
from typing import Final

import numpy as np

from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.extensions.alpasim.poses import SECOND_US
from benchmark.extensions.alpasim.traffic.session_log import SessionLog
from benchmark.extensions.alpasim.traffic.session_scene import MapFrame
from benchmark.geometry import to_global, wrap_angle

FARTHEST_M: Final = 1.0
"""The session's ego and the recording's are the same car."""


def find_map_in(data: DataSet) -> Callable[[SessionLog], MapFrame]:
    """Gives the map of a session whose scene the data set has, and where the session's local frame is in it.

    The session's first pose of the ego is that of the scene's first frame; if its later ones, up to the hand-over, are
    then elsewhere than recorded, or there is no such scene, that is an `InputError`.
    """
    known = frozenset(data.scene_names())

    def find(log: SessionLog) -> MapFrame:
        if log.scene_id not in known:
            raise InputError(
                f"{data.name} has no scene {log.scene_id}; start the server with its data set, or no --maps"
            )
        scene = data.scene(log.scene_id)
        times = log.ego.poses.times_us
        local, yaw = log.ego.resample(times)
        seconds, boxes = (times - times[0]) / SECOND_US, scene.ego.boxes
        there = np.column_stack([np.interp(seconds, scene.seconds, boxes[:, axis]) for axis in range(2)])
        turn = float(wrap_angle(boxes[0, 4] - yaw[0]))
        origin = np.array([*(boxes[0, :2] - to_global(local[0, :2], np.array([0.0, 0.0, turn]))), turn])
        off_m = float(np.hypot(*(to_global(local[:, :2], origin) - there).T).max())
        if off_m > FARTHEST_M:
            raise InputError(
                f"the ego of the session is up to {off_m:.1f} m away from that of {log.scene_id} in {data.name}; "
                "it is another recording: start the server without --maps"
            )
        return MapFrame(scene.road_map, origin)

    return find
