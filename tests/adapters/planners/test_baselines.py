"""Constant velocity, log replay and ego status on hand-made roads."""

import hashlib
from collections.abc import Callable
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from safetensors.torch import load_file, save

from adapters.planners.constant_velocity import ConstantVelocity
from adapters.planners.constant_velocity_on_path import ConstantVelocityOnPath
from adapters.planners.ego_status import EgoStatus, read_ego_status
from adapters.planners.log_replay import LogReplay
from adapters.planners.stop import Stop
from benchmark.errors import InputError
from benchmark.geometry import quaternion_from_yaw
from benchmark.machine.storage import read_json
from benchmark.planning import PlanFrame, SceneInfo
from benchmark.scene import EgoTrack, Scene
from tests.benchmark.fake_data import observation, sample_truth
from tests.hand_made import Car, scene_on_straight_road

NOWHERE = SceneInfo("scene", "boston-seaport", ())


def test_constant_velocity_keeps_speed_and_heading() -> None:
    scene = scene_on_straight_road(ego_speed=7.0)
    plan = ConstantVelocity().plan(observation(scene, 4, {}))
    assert plan.frame is PlanFrame.EGO
    assert plan.waypoints == pytest.approx(np.column_stack([3.5 * np.arange(1, 7), np.zeros(6)]))


def test_stop_stays_where_the_car_is_however_fast_it_drives() -> None:
    plans = [Stop().plan(observation(scene_on_straight_road(ego_speed=speed), 4, {})) for speed in (0.0, 13.0)]
    assert all(plan.frame is PlanFrame.EGO and (plan.waypoints == 0.0).all() for plan in plans)
    # The lidar stays too: standing, the reference point is not moved along a heading that changes.
    assert (plans[0].waypoints_in_lidar() == 0.0).all()


def on_path(scene: Scene) -> ConstantVelocityOnPath:
    planner = ConstantVelocityOnPath()
    planner.reset(NOWHERE)
    planner.reveal(scene)
    return planner


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 15), st.floats(0.0, 15.0))
def test_the_recorded_future_is_replayed_and_goes_on_beyond_the_recording(index: int, speed: float) -> None:
    """Of an ego that keeps its speed, the plan along its path is the same; without a past it has no speed."""
    scene = scene_on_straight_road(ego_speed=speed)
    replay, truth = LogReplay(), sample_truth(scene, index)
    replay.reset(NOWHERE)
    replay.reveal(scene)
    found = [replay.plan(observation(scene, index, {}))]
    if index:
        found.append(on_path(scene).plan(observation(scene, index, {})))
    for plan in found:
        valid = truth.ego_future_valid
        assert plan.waypoints_in_lidar()[valid] == pytest.approx(truth.ego_future[valid, :2], abs=1e-3)
    assert found[0].waypoints[:, 1] == pytest.approx(0.5 * speed * np.arange(1, 7), abs=1e-3)
    assert index == 0 or found[1].waypoints[:, 0] == pytest.approx(0.5 * speed * np.arange(1, 7), abs=1e-3)


def test_on_the_path_follows_bends_and_keeps_the_present_speed() -> None:
    scene, radius = scene_on_straight_road((), ego_speed=8.0), 30.0
    # A quarter of a circle to the left that is driven slower and slower.
    angle = 1.5 * np.sqrt(np.linspace(0.0, 1.0, len(scene.timestamps_us)))
    position = np.column_stack([radius * np.sin(angle), radius * (1.0 - np.cos(angle)), np.zeros(len(angle))])
    turning = replace(scene, ego=EgoTrack(position, quaternion_from_yaw(angle)))
    seen = observation(turning, 6, {})
    speed = float(seen.ego.velocity[0])
    waypoints = on_path(turning).plan(seen).waypoints
    turned = speed * 0.5 * np.arange(1, 7) / radius
    inside = turned + angle[scene.keyframes[6]] < angle[-1]
    assert inside.sum() >= 3
    arc = radius * np.column_stack([np.sin(turned), 1.0 - np.cos(turned)])
    assert waypoints[inside] == pytest.approx(arc[inside], abs=0.02)
    # The recorded car slows down, the plan does not.
    future = sample_truth(turning, 6).ego_future[inside]
    assert np.hypot(*waypoints[inside][-1]) > np.hypot(*future[-1, :2]) + 0.5


def test_on_the_path_sees_nobody_and_planners_forget_at_reset() -> None:
    empty, busy = (scene_on_straight_road(cars) for cars in ((), (Car(60.0, 198.25, 0.0),)))
    plans = [on_path(scene).plan(observation(scene, 3, {})).waypoints for scene in (empty, busy)]
    assert (plans[0] == plans[1]).all()
    planner, replay = on_path(busy), LogReplay()
    planner.reset(NOWHERE)
    with pytest.raises(RuntimeError, match="only after reveal"):
        planner.plan(observation(busy, 0, {}))
    replay.reveal(busy)
    replay.reset(NOWHERE)
    with pytest.raises(IndexError):
        replay.plan(observation(busy, 0, {}))


def test_the_card_of_the_packaged_weights_is_theirs() -> None:
    folder = files("adapters") / "weights"
    digest = hashlib.sha256((folder / "ego_status.safetensors").read_bytes()).hexdigest()
    facts = read_json(Path(str(folder / "ego_status.json")))
    assert facts["sha256"] == digest == EgoStatus().weights_sha256
    assert len((folder / "ego_status.safetensors").read_bytes()) < 200_000
    for figures in facts["held_out"].values():
        assert figures["l2_3s"] < figures["constant_velocity_l2_3s"]


def test_ego_status_drives_on_and_sees_only_the_ego() -> None:
    planner = EgoStatus()
    alone = planner.plan(observation(scene_on_straight_road((), ego_speed=8.0), 6, {}))
    busy = planner.plan(observation(scene_on_straight_road(ego_speed=8.0), 6, {}))
    assert (alone.waypoints == busy.waypoints).all()
    assert alone.waypoints[5, 0] == pytest.approx(24.0, abs=3.0)
    assert np.abs(alone.waypoints[:, 1]).max() < 1.0


def test_a_past_that_is_not_there_is_not_looked_at() -> None:
    first = read_ego_status(observation(scene_on_straight_road(), 0, {}))
    assert not first.past_valid.any()
    assert torch.isfinite(first.features()).all()
    third = read_ego_status(observation(scene_on_straight_road(ego_speed=8.0), 2, {}))
    assert third.past_valid.tolist() == [[False, False, True, True]]
    assert third.past[0, 2:, 0] == pytest.approx([-8.0, -4.0])


@pytest.mark.parametrize(
    "damage",
    [
        lambda state: save(state).replace(b'"F32"', b'"%s"' % (b"x" * 100_000), 1),
        lambda state: save({name: tensor * np.nan for name, tensor in state.items()}),
        lambda state: save({name: tensor[:1] for name, tensor in state.items()}),
        lambda state: save({"x" * 10_000: torch.zeros(1)}),
        lambda state: b"",
    ],
)
def test_hostile_weights_are_one_short_sentence(tmp_path: Path, damage: Callable[[Any], bytes]) -> None:
    path = tmp_path / "a.safetensors"
    path.write_bytes(damage(load_file(str(files("adapters") / "weights" / "ego_status.safetensors"))))
    with pytest.raises(InputError) as refusal:
        EgoStatus(path)
    said = str(refusal.value)
    assert str(path) in said and "train ego-status" in said and len(said) < 600 and said.isprintable()
