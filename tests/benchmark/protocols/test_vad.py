"""VAD keeps boxes with lidar points: radar points alone do not make an object in its evaluation."""

from dataclasses import replace

import numpy as np
import pytest

from benchmark.datasets.sample_truth import compute_truth
from benchmark.geometry import Floats
from benchmark.protocols import PROTOCOLS
from benchmark.truth import SampleTruth
from tests.hand_made import Car, scene_on_straight_road


def parked_ahead(lidar_points: int, radar_points: int) -> SampleTruth:
    """A car parked on the recorded path, with so many points on it at every keyframe."""
    scene = scene_on_straight_road((Car(x=75.0, y=200.0, speed=0.0),), seconds=5.0)
    known = scene.annotations
    lidar, radar = (np.full_like(known.num_lidar_pts, count) for count in (lidar_points, radar_points))
    annotations = replace(known, num_lidar_pts=lidar, num_radar_pts=radar)
    tokens = [str(index) for index in range(len(scene.keyframes))]
    return compute_truth(replace(scene, annotations=annotations), tokens)[0]


def straight_into(sample: SampleTruth) -> Floats:
    """A plan that reaches the car at its second step and stands in it."""
    place = sample.boxes[0, 0, :2]
    return np.array([0.5 * place, *[place] * 5])


@pytest.mark.parametrize("name", ["vad", "vad-23"])
@pytest.mark.parametrize(("lidar_points", "radar_points", "seen"), [(1, 0, True), (3, 9, True), (0, 9, False)])
def test_a_box_with_radar_points_alone_cannot_be_hit(
    name: str, lidar_points: int, radar_points: int, seen: bool
) -> None:
    sample = parked_ahead(lidar_points, radar_points)
    assert sample.has_points[0].all(), "the box has points of some sensor"
    outcomes = PROTOCOLS[name].evaluate([sample], straight_into(sample)[None])
    assert bool(outcomes.step("before_mask")[0, 1:].all()) == seen
    assert bool(outcomes.step("before_mask").any()) == seen
    assert PROTOCOLS[name].version == 2


def test_the_others_are_as_before() -> None:
    sample = parked_ahead(0, 9)
    plan = straight_into(sample)[None]
    assert PROTOCOLS["uniad"].evaluate([sample], plan).step("before_mask")[0, 1:].all()
    assert not PROTOCOLS["sparsedrive"].evaluate([sample], plan).step("before_mask").any()
