"""Effect of a scene on a panel, and the order of scenes by it."""

import numpy as np
import pytest

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Floats
from benchmark.interactions.driver_simulation import DrivingSituation, ReferenceDriver, simulate_drivers
from benchmark.interactions.reaction import Driver
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.scene import Scene
from generation.extensions.effect.panel import DISTRACTED, SceneEffect, measure_effect, order_scenes
from tests.hand_made import Car, scene_on_straight_road


def stopped_ahead(x: float, y: float = 198.25) -> Scene:
    """A car that stands in the ego's way, or beside it, all the time."""
    scene = scene_on_straight_road((Car(x, y, 0.0), Car(x + 6.0, 198.25, 0.0)), seconds=8.0)
    poses = np.column_stack([scene.agents.position[0, 12:, :2], scene.agents.yaw[0, 12:]])
    return scene.with_adversary(0, slice(12, 12 + len(poses)), poses)


def straight_plans(scene: Scene, speed: float) -> Floats:
    """(K, 6, 2) plans of the lidar, straight ahead at a speed."""
    ahead = speed * 0.5 * np.arange(1, PLAN_STEPS + 1)
    return np.broadcast_to(np.column_stack([0 * ahead, ahead]), (len(scene.keyframes), PLAN_STEPS, 2)).copy()


def test_a_plan_counts_if_its_first_contact_is_with_the_adversary() -> None:
    scene = stopped_ahead(100.0)
    effect = measure_effect(
        "s", scene, "blocking", {"fast": [straight_plans(scene, 16.0)], "still": [straight_plans(scene, 0.0)]}
    )
    assert 0.3 < effect.members["fast"] <= 1.0
    beside = measure_effect("s", stopped_ahead(100.0, 194.0), "none", {"fast": [straight_plans(scene, 16.0)]})
    assert beside.members["fast"] == 0.0
    assert effect.members[DISTRACTED] > beside.members[DISTRACTED] == 0.0


def test_seeds_of_a_member_are_averaged_and_members_too() -> None:
    scene = stopped_ahead(100.0)
    fast, still = straight_plans(scene, 16.0), straight_plans(scene, 0.0)
    alone = measure_effect("s", scene, "blocking", {"one": [fast]})
    both = measure_effect("s", scene, "blocking", {"one": [fast, still]})
    assert both.members["one"] == pytest.approx(0.5 * alone.members["one"], abs=1e-6)
    weighted = (2**0.5 * both.members["one"] + both.members[DISTRACTED]) / (2**0.5 + 1.0)
    assert both.probability == pytest.approx(weighted, abs=1e-6)


def test_samples_without_a_plan_do_not_count() -> None:
    scene = stopped_ahead(100.0)
    plans = straight_plans(scene, 16.0)
    everything = measure_effect("s", scene, "blocking", {"one": [plans]}).members["one"]
    plans[::2] = np.nan
    assert measure_effect("s", scene, "blocking", {"one": [plans]}).members["one"] == pytest.approx(everything, abs=0.2)


def test_the_distracted_driver_brakes_a_second_later() -> None:
    situation = DrivingSituation.of(ContinuousTracks.of_scene(stopped_ahead(100.0)))
    careful, late = simulate_drivers(situation, [ReferenceDriver(Driver.CC), ReferenceDriver(Driver.CC, late_steps=10)])
    braking = [int(np.argmax(motion.speed < motion.speed[0] - 1.0)) for motion in (careful, late)]
    assert 8 <= braking[1] - braking[0] <= 12
    assert careful.free_from == late.free_from


def effect(name: str, kind: str, probability: float, adversary: str = "") -> SceneEffect:
    return SceneEffect(name, kind, (adversary or name,), {"one": (probability,)})


def test_the_order_prefers_effect_then_new_kinds_and_drops_inert_scenes() -> None:
    found = [
        effect("a", "cut-in-left", 0.5), effect("b", "cut-in-left", 0.33), effect("c", "crossing", 0.3),
        effect("d", "crossing", 0.0), effect("e", "oncoming", 0.1),
    ]  # fmt: skip
    effects = {each.name: each for each in found}
    assert order_scenes(effects, dict.fromkeys("abcde", "one"), 5) == ["a", "c", "b", "e"]
    assert order_scenes(effects, dict(zip("abcde", "12345")), 2) == ["a", "c", "b", "e"]


def test_further_scenes_of_a_recording_come_last() -> None:
    effects = {each.name: each for each in (effect("a", "x", 0.5), effect("b", "y", 0.4), effect("c", "z", 0.1))}
    assert order_scenes(effects, {"a": "one", "b": "one", "c": "two"}, 1) == ["a", "c", "b"]


def test_the_same_adversary_does_the_same_once() -> None:
    found = (effect("a", "x", 0.5, "car"), effect("b", "x", 0.4, "car"), effect("c", "x", 0.1, "truck"))
    effects = {each.name: each for each in found}
    assert order_scenes(effects, dict.fromkeys("abc", "one"), 2) == ["a", "c", "b"]
    effects["b"] = effect("b", "y", 0.4, "car")
    assert order_scenes(effects, dict.fromkeys("abc", "one"), 2) == ["a", "b", "c"]
