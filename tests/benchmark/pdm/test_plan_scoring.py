"""A scene's plans judged: what a good driver gets, what each fault costs, and what has no verdict."""

from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
from shapely.geometry import MultiPolygon

from benchmark.pdm import plan_scoring as judging
from benchmark.pdm.plan_scoring import score_scene_plans
from benchmark.planning import Plan, PlanFrame
from benchmark.road_map import RoadMap
from benchmark.scene import Scene
from tests.hand_made import Car, scene_on_straight_road

ONES = {"nc": 1.0, "dac": 1.0, "ddc": 1.0, "ep": 1.0, "ttc": 1.0, "lk": 1.0}
EMPTY = scene_on_straight_road(())


def plans(scene: Scene, speed: float = 8.0, across: float = 0.0) -> list[Plan | None]:
    time = 0.5 * np.arange(1, 7)
    waypoints = np.column_stack([speed * time, across * (time / 3) ** 2])
    return [Plan(waypoints, PlanFrame.EGO)] * len(scene.keyframes)


def verdicts(scene: Scene, given: list[Plan | None] | None = None) -> list[dict[str, Any]]:
    found = score_scene_plans(scene, plans(scene) if given is None else given)
    return [asdict(verdict) for verdict in found if verdict is not None]


def scores(verdict: dict[str, Any]) -> dict[str, float]:
    return {name: verdict[name] for name in ONES}


def test_who_drives_on_in_its_lane_has_everything() -> None:
    found = verdicts(EMPTY)
    assert len(found) == 10 and all(scores(verdict) == ONES for verdict in found)
    assert [verdict["hc"] for verdict in found] == [None] * 3 + [1.0] * 7
    assert [verdict["ec"] for verdict in found] == [None] + [1.0] * 9
    assert all(verdict["forgiven"] == [] and verdict["collision_s"] is None for verdict in found)
    assert found[0]["progress_m"] == pytest.approx(24.0, abs=0.1)


def test_samples_without_plan_or_future_have_no_verdict_and_nothing_to_agree_with() -> None:
    given = plans(EMPTY)
    given[4] = None
    found = score_scene_plans(EMPTY, given)
    assert [verdict is None for verdict in found] == [sample == 4 or sample >= 10 for sample in range(16)]
    agreement = [verdict.ec for verdict in found[:7] if verdict is not None]
    assert agreement == [None, 1.0, 1.0, 1.0, None, 1.0]
    assert score_scene_plans(EMPTY, [None] * 16) == [None] * 16


def test_a_map_that_says_nothing_gives_no_verdicts() -> None:
    for road_map in (RoadMap("boston-seaport", MultiPolygon()), replace(EMPTY.road_map, lanes={})):
        scene = replace(EMPTY, road_map=road_map)
        assert score_scene_plans(scene, plans(scene)) == [None] * 16


def test_running_into_a_standing_car_costs_everything_and_a_standing_thing_half() -> None:
    for category, nc in (("vehicle.car", 0.0), ("movable_object.barrier", 0.5)):
        found = verdicts(scene_on_straight_road((Car(75.0, 198.25, category=category),)))
        assert found[0]["nc"] == nc and found[0]["ttc"] == 0.0
        assert found[0]["collision_s"] == pytest.approx(2.5, abs=0.2) and found[0]["ttc_s"] < found[0]["collision_s"]


def test_being_run_into_from_behind_is_nobodys_fault_here() -> None:
    found = verdicts(scene_on_straight_road((Car(40.0, 198.25, 14.0),)))
    assert found[0]["nc"] == 1.0 and found[0]["collision_s"] is None
    # In TTC it counts as ahead: 0.9 s later it is, seen from where the car is now (as officially).
    assert found[0]["ttc"] == 0.0


def test_whom_a_plan_touches_first_and_when_it_touches_the_adversary() -> None:
    """From behind comes a fast car, ahead stands another one; the plan is hit, and runs into the second."""
    scene = scene_on_straight_road((Car(40.0, 198.25, 14.0), Car(75.0, 198.25)))
    behind, ahead = scene.agents.ids[:2]

    def who(adversaries: tuple[str, ...]) -> tuple[Any, ...]:
        found = verdicts(replace(scene, adversaries=adversaries))[0]
        assert found["first_contact_s"] < found["collision_s"] == pytest.approx(2.5, abs=0.2)
        assert found["hit"] == behind
        return found["hit_adversary"], found["adversary_contact_s"]

    first_s = verdicts(scene)[0]["first_contact_s"]
    assert who(()) == (False, None)
    assert who((behind,)) == (True, first_s)
    assert who((ahead,)) == (False, verdicts(scene)[0]["collision_s"])
    free = verdicts(EMPTY)[0]
    assert (free["hit"], free["first_contact_s"], free["hit_adversary"]) == (None, None, False)


def test_leaving_the_road_and_the_wrong_side_and_what_the_recorded_driver_fails() -> None:
    off, wrong = (verdicts(EMPTY, plans(EMPTY, across=across)) for across in (-7.0, 5.0))
    assert off[0]["dac"] == 0.0 and off[0]["lk"] == 0.0
    assert wrong[0]["dac"] == 1.0 and wrong[0]["ddc"] < 1.0
    assert verdicts(EMPTY, plans(EMPTY, across=0.3))[0]["lk"] == 1.0
    found = verdicts(scene_on_straight_road((), ego_y=192.0))
    assert all(verdict["dac"] == 0.0 and "dac" in verdict["forgiven"] for verdict in found)
    assert not any(verdict["forgiven"] for verdict in off)


def test_standing_still_makes_no_progress() -> None:
    found = verdicts(EMPTY, plans(EMPTY, speed=0.0))
    assert found[5]["ep"] < 0.6 and found[5]["hc"] == 0.0
    assert found[5]["progress_m"] < found[5]["recorded_progress_m"] == pytest.approx(24.0, abs=0.1)


def test_plans_that_contradict_each_other_do_not_agree() -> None:
    given = [plan if sample % 2 else plans(EMPTY, speed=2.0)[0] for sample, plan in enumerate(plans(EMPTY))]
    found = verdicts(EMPTY, given)
    assert [verdict["ec"] for verdict in found] == [None] + [0.0] * 9


def test_samples_that_are_too_far_apart_have_no_agreement() -> None:
    start = EMPTY.timestamps_us[0]
    slow = replace(EMPTY, timestamps_us=start + (EMPTY.timestamps_us - start) * 6 // 5)
    assert all(verdict["ec"] is None for verdict in verdicts(slow))


def test_batches_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_on_straight_road()
    whole = score_scene_plans(scene, plans(scene, across=2.0))
    monkeypatch.setattr(judging, "AT_ONCE", 3)
    assert score_scene_plans(scene, plans(scene, across=2.0)) == whole and whole[0] is not None


@pytest.mark.parametrize("metres", [1e4, 1e3, 1e-3, 1e-9])
def test_no_plan_is_too_far_or_too_small(metres: float) -> None:
    rng = np.random.default_rng(7)
    for frame in PlanFrame:
        given: list[Plan | None] = [Plan(metres * rng.uniform(-1, 1, (6, 2)), frame) for _ in EMPTY.keyframes]
        for verdict in verdicts(EMPTY, given):
            assert all(0.0 <= verdict[name] <= 1.0 for name in ONES) and np.isfinite(verdict["progress_m"])
