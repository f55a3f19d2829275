"""What a recorded scene gives to judge plans by: the car's motion, objects, road and route at its samples."""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats, to_local, wrap_angle, yaw_of_quaternion
from benchmark.pdm.comfort import HISTORY_KEY_FRAMES, history_rows
from benchmark.pdm.definition import ACCELERATION, SIDE_SPEED, SPEED, STATE_COLUMNS
from benchmark.pdm.layers import road_of, route_of
from benchmark.pdm.scoring import Surroundings, log_replay
from benchmark.pdm.traffic import AGENT_CATEGORIES, KeyFrames, at_states
from benchmark.scene import Scene

MOTION_FRAMES: Final = 11
"""Recorded poses that a speed and an acceleration are taken from: a parabola through them."""


class RecordedScene:
    """A scene as plans are judged by it; what all samples share is made once.

    Attributes:
        seconds: (K,) time of each key frame.
        motion: (K, 8) pose, velocity and acceleration of the rear axle: the first columns of a state.
        complete: (K,) whether the recording goes on for 3 s.
        references: Kept by `benchmark.pdm.judging`, by the samples that they are of.
    """

    def __init__(self, scene: Scene) -> None:
        self.references: dict[bytes, Any] = {}
        self._annotations = scene.annotations
        self._categories = scene.agents.categories
        self.seconds = scene.seconds[scene.keyframes]
        self.motion = recorded_motion(scene.ego.pose, scene.seconds)[scene.keyframes]
        self.complete = np.arange(len(scene.keyframes)) + PLAN_STEPS < len(scene.keyframes)
        self.route = route_of(scene.ego.pose)
        self.road = road_of(scene.road_map, self.route)
        known = self._annotations
        yaw = yaw_of_quaternion(known.rotation)
        self._poses = np.concatenate([known.position[..., :2], yaw[..., None]], axis=-1)
        self._velocity = recorded_velocity(known.position[..., :2], known.valid, self.seconds)

    def surroundings(self, samples: NDArray[np.int64]) -> Surroundings:
        """What plans of some samples are judged by.

        Args:
            samples: (S,) numbers of key frames, all with 3 s of recording after them.

        Returns:
            Surroundings of S samples.
        """
        now = np.zeros((len(samples), STATE_COLUMNS))
        now[:, :8] = self.motion[samples]
        before = samples[:, None] + np.arange(1 - HISTORY_KEY_FRAMES, 1)
        return Surroundings(
            now=now,
            history=history_rows(self.motion[np.maximum(before, 0)]),
            has_history=before[:, 0] >= 0,
            traffic=log_replay(at_states(self.key_frames(samples)), now),
            road=self.road,
            route=self.route,
        )

    def recorded_plans(self, samples: NDArray[np.int64]) -> Floats:
        """The recorded futures as plans.

        Args:
            samples: (S,) numbers of key frames, all with 3 s of recording after them.

        Returns:
            (S, 6, 3) poses of the rear axle in its frame at the sample.
        """
        now = self.motion[samples, None, :3]
        future = self.motion[samples[:, None] + np.arange(1, PLAN_STEPS + 1), :3]
        heading = wrap_angle(future[..., 2] - now[..., 2])
        return np.concatenate([to_local(future[..., :2], now), heading[..., None]], axis=-1)

    def key_frames(self, samples: NDArray[np.int64]) -> KeyFrames:
        """Objects that are annotated at any key frame from now to 3 s later.

        Args:
            samples: (S,) numbers of key frames, all with 3 s of recording after them.

        Returns:
            The objects of each sample.
        """
        known = self._annotations
        steps = np.arange(PLAN_STEPS + 1)
        window = known.valid[:, samples[:, None] + steps].transpose(1, 0, 2)
        sample, agent = np.nonzero(window.any(axis=-1))
        columns = samples[sample, None] + steps
        annotated = window[sample, agent]
        first = columns[np.arange(len(agent)), annotated.argmax(axis=1)]
        return KeyFrames(
            offsets=np.concatenate([[0], np.cumsum(np.bincount(sample, minlength=len(samples)))]),
            box=self._poses[agent[:, None], columns],
            size=known.size[agent, first, :2],
            annotated=annotated,
            velocity=self._velocity[agent[:, None], columns],
            is_agent=np.array([self._categories[number].startswith(AGENT_CATEGORIES) for number in agent], np.bool_),
        )


def recorded_motion(poses: Floats, seconds: Floats) -> Floats:
    """Velocity and acceleration of recorded poses.

    Args:
        poses: (T, 3) x, y, yaw of the rear axle, global.
        seconds: (T,) their times.

    Returns:
        (T, 8) pose, then velocity and acceleration along and across the body, then zero: those of the parabola through
        the eleven poses around each (the first and last eleven at the ends), by their own times.
    """
    count = len(poses)
    window = min(MOTION_FRAMES, count)
    start = np.clip(np.arange(count) - window // 2, 0, count - window)
    around = start[:, None] + np.arange(window)
    time = seconds[around] - seconds[:, None]
    order = min(2, window - 1)
    fits = np.linalg.pinv(time[..., None] ** np.arange(order + 1))
    offset = poses[around][..., :2] - poses[:, None, :2]
    derivatives = np.zeros((count, 3, 2))
    derivatives[:, : order + 1] = np.einsum("tpw,twx->tpx", fits, offset)
    frame = np.concatenate([np.zeros((count, 2)), poses[:, 2:]], axis=1)
    motion = np.zeros((count, 8))
    motion[:, :3] = poses
    motion[:, SPEED : SIDE_SPEED + 1] = to_local(derivatives[:, 1], frame)
    motion[:, ACCELERATION : ACCELERATION + 2] = to_local(2.0 * derivatives[:, 2], frame)
    return motion


def recorded_velocity(position: Floats, valid: Bools, seconds: Floats) -> Floats:
    """Velocities of annotated objects.

    Args:
        position: (N, K, 2) centres at the key frames, global.
        valid: (N, K) where they are annotated.
        seconds: (K,) times.

    Returns:
        (N, K, 2) m/s: central differences over the neighbouring key frames, one-sided where one of them lacks the
        object, zero where both do.
    """
    count = len(seconds)
    before = np.maximum(np.arange(count) - 1, 0)
    after = np.minimum(np.arange(count) + 1, count - 1)
    first = np.where(valid[:, before], before, np.arange(count))
    last = np.where(valid[:, after], after, np.arange(count))
    rows = np.arange(len(position))[:, None]
    span = seconds[last] - seconds[first]
    moved = position[rows, last] - position[rows, first]
    return np.where((span > 0)[..., None], moved / np.where(span > 0, span, 1.0)[..., None], 0.0)
