"""The world as it was driven, as a `Scene`: what privileged planners, sensors and scores look at.

Up to the first planning instant it is the recording, from then on what was simulated; it ends with now, and nothing of
the recording after now is in it. The road map stays: roads do not depend on who drives.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from benchmark.closed_loop.riding import TICK_US, YAW, Motion, X, Y
from benchmark.closed_loop.route import Route
from benchmark.geometry import quaternion_from_yaw
from benchmark.scene import Annotations, EgoTrack, Scene

_SEEN: Final = 4
"""nuScenes' visibility of what is seen whole."""


def driven_scene(recorded: Scene, route: Route, motion: Motion) -> Scene:
    """Scene of all that has happened up to the last instant of a motion.

    The recorded frames before, then the instants of the motion; planning instants are keyframes.

    Args:
        recorded: The scene that was driven; of it nothing after the first instant of the motion is taken but the map,
            the cameras, the list of agents, and the height of the road along the recorded path.
        motion: Since the first planning instant, which is a keyframe of the recording.
    """
    first = int(np.searchsorted(recorded.timestamps_us, motion.times_us[0]))
    ticks = len(motion.ticks)
    driven = EgoTrack(
        np.column_stack([motion.ego[:, [X, Y]], route.heights_beside(motion.ego)]),
        quaternion_from_yaw(motion.ego[:, YAW]),
    )
    head, size = recorded.first_frames(first), recorded.agents.size
    known = head.annotations
    position = motion.position[:, motion.ticks]
    present = motion.present[:, motion.ticks]
    counts = np.where(present, 1, 0)
    later = Annotations(
        position=position,
        rotation=quaternion_from_yaw(motion.yaw[:, motion.ticks]),
        size=np.repeat(size[:, None], ticks, axis=1),
        valid=present,
        attribute=np.full(present.shape, "", dtype=np.str_),
        visibility=_SEEN * counts,
        num_lidar_pts=counts,
        num_radar_pts=np.zeros_like(counts),
    )
    joined = {
        name: np.concatenate([getattr(known, name), getattr(later, name)], axis=1)
        for name in Annotations.__dataclass_fields__
    }
    return replace(
        recorded,
        timestamps_us=np.concatenate([head.timestamps_us, motion.times_us]),
        keyframes=np.concatenate([head.keyframes, first + motion.ticks]),
        ego=EgoTrack(
            np.concatenate([head.ego.position, driven.position]), np.concatenate([head.ego.rotation, driven.rotation])
        ),
        agents=replace(
            recorded.agents,
            position=np.concatenate([head.agents.position, motion.position], axis=1),
            yaw=np.concatenate([head.agents.yaw, motion.yaw], axis=1),
            valid=np.concatenate([head.agents.valid, motion.present], axis=1),
        ),
        annotations=Annotations(**joined),
        sweep_poses=None,
    )


def with_the_end_held(scene: Scene, ticks: int) -> Scene:
    """A scene that goes on for some ticks as it ends: every agent stays where it is (HUGSIM keeps its last list so)."""
    frames = np.concatenate([np.arange(len(scene.timestamps_us)), np.full(ticks, len(scene.timestamps_us) - 1)])
    keys = np.concatenate([np.arange(len(scene.keyframes)), np.full(ticks, len(scene.keyframes) - 1)])
    more = scene.timestamps_us[-1] + TICK_US * np.arange(1, ticks + 1)
    known, agents = scene.annotations, scene.agents
    return replace(
        scene,
        timestamps_us=np.concatenate([scene.timestamps_us, more]),
        keyframes=np.concatenate([scene.keyframes, len(scene.timestamps_us) + np.arange(ticks)]),
        ego=EgoTrack(scene.ego.position[frames], scene.ego.rotation[frames]),
        agents=replace(
            agents, position=agents.position[:, frames], yaw=agents.yaw[:, frames], valid=agents.valid[:, frames]
        ),
        annotations=Annotations(**{name: getattr(known, name)[:, keys] for name in Annotations.__dataclass_fields__}),
    )
