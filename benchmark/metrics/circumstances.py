"""What each sample of a scene is sorted by: the place of the recorded car and its speed."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.metrics.places import Place, Places
from benchmark.pdm.definition import SIDE_SPEED, SPEED
from benchmark.pdm.recording import recorded_motion
from benchmark.scene import Scene

SPEED_DECIMALS: Final = 3
"""Of stored speeds: below them, processors differ."""


@dataclass(frozen=True, slots=True)
class Circumstances:
    """Place and speed of the recorded car at one sample.

    The place is that of its middle; the speed is that of the parabola through eleven recorded poses, as for driving
    scores.
    """

    place: Place
    speed_m_s: float


def circumstances_of(scene: Scene) -> tuple[Circumstances, ...]:
    """Place and speed of the recorded car at every sample, in time order; without a map every place is unknown."""
    places, boxes = Places(scene.road_map), scene.ego.boxes[scene.keyframes]
    motion = recorded_motion(scene.ego.pose, scene.seconds)[scene.keyframes]
    speeds = np.hypot(motion[:, SPEED], motion[:, SIDE_SPEED])
    return tuple(
        Circumstances(places.of(box, box), round(float(speed), SPEED_DECIMALS)) for box, speed in zip(boxes, speeds)
    )
