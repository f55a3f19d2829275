"""Recorded scene as a reference for plans: the car's motion, objects, road and route at its samples."""

from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.datasets.steps import KeyFrameSteps, TimedSteps, interpolate_values
from benchmark.geometry import Bools, Floats, poses_between, to_local, wrap_angle, yaw_of_quaternion
from benchmark.pdm.definition import ACCELERATION, SIDE_SPEED, SPEED, STATE_COLUMNS
from benchmark.pdm.plan_motion import HISTORY_KEY_FRAMES, build_history_rows
from benchmark.pdm.road_polygons import build_road_polygons, build_route
from benchmark.pdm.scoring import ScoringContext, remove_touching_objects
from benchmark.pdm.traffic import AGENT_CATEGORIES, KeyFrameObjects, interpolate_traffic
from benchmark.scene import Scene

MOTION_FRAMES: Final = 11
"""Recorded poses that a speed and an acceleration are taken from: a parabola through them."""


class RecordedScene:
    """Scene as plans are judged by it; what all samples share is made once.

    Steps of half a second are key frames where those are half a second apart, and times between them elsewhere
    (`benchmark.datasets.steps`).

    Attributes:
        motion: (K, 8) pose, velocity and acceleration of the rear axle: the first columns of a state.
        adversaries: (N,) which objects were made to be adversaries, as far as the scene says.
        complete: (K,) whether the recording goes on for 3 s, and all of it is known.
        references: Kept by `benchmark.pdm.plan_scoring`, by the samples that they are of.
    """

    def __init__(self, scene: Scene) -> None:
        self.references: dict[bytes, Any] = {}
        self._annotations = scene.annotations
        self._categories = scene.agents.categories
        self.instances = scene.agents.ids
        self.adversaries = np.isin(np.array(self.instances, dtype=object), scene.adversaries)
        self.seconds = scene.seconds[scene.keyframes]
        self._times_us, self._frames = scene.timestamps_us, estimate_motion(scene.ego.pose, scene.seconds)
        self.motion = self._frames[scene.keyframes]
        self._clock = KeyFrameSteps.of(scene)
        self.complete = np.arange(len(scene.keyframes)) + PLAN_STEPS < len(scene.keyframes)
        self._ahead = self._find_timed_steps(np.arange(PLAN_STEPS + 1))
        self._past = self._find_timed_steps(np.arange(1 - HISTORY_KEY_FRAMES, 1))
        for index, steps in self._ahead.items():
            self.complete[index] = steps.known.all()
        self.route = build_route(scene.ego.pose)
        self.road = build_road_polygons(scene.road_map, self.route)
        known = self._annotations
        yaw = yaw_of_quaternion(known.rotation)
        self._poses = np.concatenate([known.position[..., :2], yaw[..., None]], axis=-1)
        self._velocity = estimate_object_velocity(known.position[..., :2], known.valid, self.seconds)

    def build_context(self, samples: NDArray[np.int64]) -> ScoringContext:
        """Surroundings that plans of some complete samples are judged by."""
        now = np.zeros((len(samples), STATE_COLUMNS))
        now[:, :8] = self.motion[samples]
        before = samples[:, None] + np.arange(1 - HISTORY_KEY_FRAMES, 1)
        past, has_history = self.motion[np.maximum(before, 0)], before[:, 0] >= 0
        for row, steps in _rows_in(samples, self._past):
            past[row], has_history[row] = self._interpolate_motion(steps), steps.known.all()
        return ScoringContext(
            now=now,
            history=build_history_rows(past),
            has_history=has_history,
            traffic=remove_touching_objects(interpolate_traffic(self.key_frames(samples)), now),
            road=self.road,
            route=self.route,
        )

    def build_recorded_plans(self, samples: NDArray[np.int64]) -> Floats:
        """The recorded futures of complete samples as plans: (S, 6, 3) rear-axle poses in its frame at the sample."""
        now, last = self.motion[samples, None, :3], len(self.motion) - 1
        future = self.motion[np.minimum(samples[:, None] + np.arange(1, PLAN_STEPS + 1), last), :3]
        for row, steps in _rows_in(samples, self._ahead):
            future[row] = self._interpolate_motion(steps)[1:, :3]
        heading = wrap_angle(future[..., 2] - now[..., 2])
        return np.concatenate([to_local(future[..., :2], now), heading[..., None]], axis=-1)

    def key_frames(self, samples: NDArray[np.int64]) -> KeyFrameObjects:
        """Objects that are annotated at any step from now to 3 s later, of complete samples."""
        known, last = self._annotations, len(self.motion) - 1
        before = np.minimum(samples[:, None] + np.arange(PLAN_STEPS + 1), last)
        after, fraction = before.copy(), np.zeros(before.shape)
        for row, steps in _rows_in(samples, self._ahead):
            before[row], after[row], fraction[row] = steps.before, steps.after, steps.fraction
        window = (known.valid[:, before] & known.valid[:, after]).transpose(1, 0, 2)
        sample, agent = np.nonzero(window.any(axis=-1))
        annotated, rows = window[sample, agent], agent[:, None]
        before, after, fraction = before[sample], after[sample], fraction[sample]
        first = (np.arange(len(agent)), annotated.argmax(axis=1))
        nearer = np.where(fraction[first] <= 0.5, before[first], after[first])
        box, velocity = self._poses[rows, before], self._velocity[rows, before]
        if fraction.any():
            box = poses_between(box, self._poses[rows, after], fraction)
            velocity = velocity + fraction[..., None] * (self._velocity[rows, after] - velocity)
        return KeyFrameObjects(
            offsets=np.concatenate([[0], np.cumsum(np.bincount(sample, minlength=len(samples)))]),
            box=box,
            size=known.size[agent, nearer, :2],
            annotated=annotated,
            velocity=velocity,
            is_agent=np.array([self._categories[number].startswith(AGENT_CATEGORIES) for number in agent], np.bool_),
            number=agent,
        )

    def _find_timed_steps(self, steps: NDArray[np.int64]) -> dict[int, TimedSteps]:
        """Steps of the samples whose steps are no key frames, by number of the sample."""
        farthest = int(steps[np.abs(steps).argmax()])
        irregular = (at for at in range(len(self.motion)) if not self._clock.are_key_frames(at, farthest))
        return {index: self._clock.at(index, steps) for index in irregular}

    def _interpolate_motion(self, steps: TimedSteps) -> Floats:
        """(N, 8) motion at the times of steps."""
        return interpolate_values(self._frames, self._times_us, steps.times_us)


def _rows_in(samples: NDArray[np.int64], timed: Mapping[int, TimedSteps]) -> Iterator[tuple[int, TimedSteps]]:
    """Of those samples whose steps are no key frames the place among the samples, and the steps."""
    if timed:
        yield from ((row, timed[index]) for row, index in enumerate(samples.tolist()) if index in timed)


def estimate_motion(poses: Floats, seconds: Floats) -> Floats:
    """Velocity and acceleration of recorded poses, (T, 3) of the rear axle, global.

    (T, 8) pose, then velocity and acceleration along and across the body, then zero: those of the parabola through the
    eleven poses around each (the first and last eleven at the ends), by their own times in seconds.
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


def estimate_object_velocity(position: Floats, valid: Bools, seconds: Floats) -> Floats:
    """(N, K, 2) velocities of annotated objects, m/s.

    Central differences over the neighbouring key frames, one-sided where one lacks the object, zero where both do.
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
