"""Scenes on a straight road whose judgement is known."""

import numpy as np

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M
from benchmark.geometry import Floats
from benchmark.scene import Scene
from tests.hand_made import Car, scene_on_straight_road

LANE_Y, RIGHT_Y = 198.25, 194.75
LENGTH_M = 4.6
START_M = 20.0


def hard_stop(speed: float = 25.0, gap: float = 5.0) -> Scene:
    """The leader brakes at 9 m/s^2 to a stand from the first frame."""
    x = START_M + EGO_CENTER_FROM_REAR_AXLE_M + 0.5 * (EGO_LENGTH_M + LENGTH_M) + gap
    scene = scene_on_straight_road((Car(x, LANE_Y, speed),), ego_x=START_M, ego_speed=speed, seconds=8.0)
    time = np.minimum(scene.seconds, speed / 9.0)
    return driven(scene, 0, x + speed * time - 4.5 * time**2, np.full(len(scene.seconds), LANE_Y))


def far_cut_in(speed: float = 25.0) -> Scene:
    """It changes lanes 40 m ahead at the ego's speed and keeps it."""
    x = START_M + EGO_CENTER_FROM_REAR_AXLE_M + 0.5 * (EGO_LENGTH_M + LENGTH_M) + 40.0
    scene = scene_on_straight_road((Car(x, RIGHT_Y, speed),), ego_x=START_M, ego_speed=speed, seconds=8.0)
    return driven(
        scene, 0, x + speed * scene.seconds, RIGHT_Y + np.clip((scene.seconds - 1.0) * 1.2, 0.0, LANE_Y - RIGHT_Y)
    )


def driven(scene: Scene, agent: int, x: Floats, y: Floats) -> Scene:
    """The scene with a car that goes where it is told, heading where it goes."""
    yaw = np.arctan2(np.gradient(y), np.maximum(np.gradient(x), 1e-6))
    return scene.with_adversary(agent, slice(0, len(x)), np.column_stack([x, y, yaw]))
