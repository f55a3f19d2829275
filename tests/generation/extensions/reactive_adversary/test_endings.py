"""Endings that are looked at together are those that are looked at one by one, to the last bit."""

import numpy as np

from benchmark.geometry import Floats, wrap_angle
from generation.extensions.reactive_adversary.safe_endings import SurroundingTracks
from tests.hand_made import Car, scene_on_straight_road


def find_slowly(around: SurroundingTracks, poses: Floats, executed: int) -> Floats | None:
    last = min(executed, len(around.frame_seconds) - 1)
    if around.compute_clear_seconds(poses[: last + 1]) < np.inf:
        return None
    endings = around.generate_endings(poses, executed)
    return next((each for each in endings if around.compute_clear_seconds(each, last) == np.inf), None)


def test_endings_are_those_found_one_by_one() -> None:
    draw = np.random.default_rng(0)
    cars = tuple(
        Car(float(x), float(y), float(speed), float(yaw))
        for x, y, speed, yaw in zip(
            draw.uniform(40, 160, 20), draw.uniform(190, 208, 20), draw.uniform(0, 10, 20), draw.choice([0, np.pi], 20)
        )
    )
    scene = scene_on_straight_road(cars, seconds=10.0)
    found = {True: 0, False: 0}
    for frame in (12, 80):
        around = SurroundingTracks.of(scene, 0, frame, int(scene.timestamps_us[0]) + 30_000)
        for _ in range(40):
            count, executed = int(draw.integers(2, 37)), int(draw.integers(0, 14))
            yaw = np.cumsum(draw.normal(0, 0.02, count)) + draw.choice([0.0, 3.1])
            steps = np.column_stack([np.cos(yaw), np.sin(yaw)]) * draw.uniform(0, 12) / 12
            places = np.cumsum(steps, axis=0) + [draw.uniform(40, 160), draw.uniform(192, 206)]
            poses = np.column_stack([places, wrap_angle(yaw)])
            slow, fast = find_slowly(around, poses, executed), around.ending(poses, executed)
            found[slow is None] += 1
            assert (slow is None) == (fast is None)
            if slow is not None and fast is not None:
                np.testing.assert_array_equal(fast, slow)
    assert min(found.values()) > 10
