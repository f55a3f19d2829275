"""Who was first on the recording and who is now, in numbers and in a sentence."""

from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.scene import Scene
from generation.extensions.effect.conflicts import describe_conflicts
from tests.hand_made import Car, scene_on_straight_road

LEADER = Car(80.0, 198.25, 8.0)


def changed(scene: Scene, start: int, poses: Floats) -> Scene:
    return scene.with_adversary(0, slice(start, start + len(poses)), poses)


def describe(recorded: Scene, adversarial: Scene, start: int) -> dict[str, Any]:
    (conflict,) = describe_conflicts(recorded, adversarial, [(recorded.agents.ids[0], start)])
    return conflict


def braking() -> tuple[Scene, Scene]:
    """A leader 25 m ahead of the ego's front loses 14 m to it from the first second on."""
    scene = scene_on_straight_road((LEADER,), seconds=8.0)
    poses = np.column_stack([scene.agents.position[0, 12:, :2], scene.agents.yaw[0, 12:]])
    seconds = np.arange(len(poses)) / 12
    poses[:, 0] -= np.where(seconds < 2.0, 1.5 * seconds**2, 6.0 + 2.0 * (seconds - 2.0))
    return scene, changed(scene, 12, poses)


def test_a_leader_that_brakes_leaves_less_time_than_it_did() -> None:
    conflict = describe(*braking(), 12)
    assert (conflict["kind"], conflict["first_recorded"], conflict["first_now"]) == ("same-way", "other", "other")
    assert 0 < conflict["pet_now_s"] < conflict["pet_recorded_s"]
    assert str(conflict["sentence"]).startswith("the car ")
    assert str(conflict["sentence"]).endswith(f"on the recording it was {conflict['pet_recorded_s']:.1f} s ahead")


def test_a_parked_truck_that_crosses_did_not_use_the_egos_path() -> None:
    scene = scene_on_straight_road((Car(85.0, 191.0, 0.0, np.pi / 2, "vehicle.truck"),), seconds=8.0)
    y = 191.0 + np.minimum(np.arange(84) * 4.0 / 12, 14.0)
    poses = np.column_stack([np.full(84, 85.0), y, np.full(84, np.pi / 2)])
    conflict = describe(scene, changed(scene, 12, poses), 12)
    assert (conflict["kind"], conflict["first_recorded"], conflict["pet_recorded_s"]) == ("crossing", "none", None)
    assert conflict["first_now"] == "other" and conflict["pull_out"] is True
    assert conflict["sentence"] == (
        f"the truck pulls out and crosses the ego's path {conflict['pet_now_s']:.1f} s ahead of the ego; "
        "on the recording it did not use the ego's path"
    )


def test_a_vehicle_beside_has_no_conflict() -> None:
    scene = scene_on_straight_road((Car(55.0, 194.75, 8.0),), seconds=8.0)
    poses = np.column_stack([scene.agents.position[0, 12:, :2], scene.agents.yaw[0, 12:]])
    conflict = describe(scene, changed(scene, 12, poses), 12)
    assert (conflict["kind"], conflict["first_now"], conflict["pet_now_s"]) == ("none", "none", None)


def test_an_adversary_that_is_not_in_the_recording_is_refused() -> None:
    recorded, adversarial = braking()
    with pytest.raises(InputError, match="has no adversary somebody"):
        describe_conflicts(recorded, adversarial, [("somebody", 12)])
