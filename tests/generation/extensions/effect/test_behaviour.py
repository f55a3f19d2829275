"""Each fault of behaviour is found on a track that has it, and not on the same track cut short of its limit."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, EGO_LENGTH_M, FRAME_HZ
from benchmark.geometry import Floats
from benchmark.scene import Scene
from generation.extensions.effect.behaviour import find_behaviour_fault, iterate_behaviour_faults
from generation.search.verify import DiscardReason
from tests.hand_made import Car, scene_on_straight_road

SECONDS = 16.0
TIME = np.arange(round(SECONDS * FRAME_HZ)) / FRAME_HZ
TOUCHING = 50 + EGO_CENTER_FROM_REAR_AXLE_M + 0.5 * (EGO_LENGTH_M + 4.6) * np.array([-1, 1])
"""Centres of a car that touches the ego from behind, and ahead, at the first frame."""
FAR = Car(300.0, 205.25, 0.0, np.pi)


def drive(x: Floats | float, y: Floats | float, yaw: Floats | float, *others: Car) -> Scene:
    """The ego drives at 8 m/s from x = 50 on y = 198.25; agent 0 is the adversary from the first frame on."""
    scene = scene_on_straight_road((FAR, *others), seconds=SECONDS)
    poses = np.column_stack(np.broadcast_arrays(x, y, yaw)).astype(np.float64)
    return scene.with_adversary(0, slice(0, len(TIME)), poses)


def faults(scene: Scene) -> list[DiscardReason]:
    return [fault.reason for fault in iterate_behaviour_faults(scene, 0, 0)]


def stop_after(speed: float, seconds: float) -> Floats:
    """Metres driven by a car that stops at once after so many seconds."""
    return speed * np.minimum(TIME, seconds)


def turn_across(stop_s: float) -> Scene:
    """North across the road at 2 m/s from its southern edge."""
    return drive(100.0, 193.0 + stop_after(2.0, stop_s), np.pi / 2)


def weave(period_s: float) -> Scene:
    """0.25 m/s^2 times the square of the period to both sides, at 10 m/s."""
    turn = 2 * np.pi / period_s
    away = 1.6 / turn**2
    y = 194.75 + away * np.sin(turn * TIME)
    return drive(20 + 10 * TIME, y, np.arctan2(away * turn * np.cos(turn * TIME), 10.0))


def circle(turned_rad: float) -> Scene:
    yaw = np.minimum(TIME * turned_rad / 10.0, turned_rad)
    step = 3.0 / FRAME_HZ * (TIME * turned_rad / 10.0 < turned_rad)
    return drive(200 + np.cumsum(step * np.cos(yaw)), 198 + np.cumsum(step * np.sin(yaw)), yaw)


def leave_road(seconds: float) -> Scene:
    away = np.abs(TIME - 4.0 - seconds / 2) < seconds / 2
    return drive(20 + 10 * TIME, np.where(away, 191.0, 194.75), 0.0)


def against(seconds: float) -> Scene:
    """West on the lane of the east, then it is gone to its own; the lane is changed in a frame."""
    return drive(300 - 8 * TIME, np.where(TIME - seconds < 0, 194.75, 205.25), np.pi)


STUCK = drive(TOUCHING[1] + 0.9 + 8 * TIME, 198.25, 0.0)
CASES = [
    (DiscardReason.AGAINST_TRAFFIC, against(15.8), against(1.5)),
    (DiscardReason.ACROSS_ROAD, turn_across(6.5), turn_across(3.0)),
    (
        DiscardReason.PRESSING,
        drive(TOUCHING[0] - 3.5 + 8 * TIME, 198.25, 0.0),
        drive(TOUCHING[0] - 4.5 + 8 * TIME, 198.25, 0.0),
    ),
    (DiscardReason.RIDING_BESIDE, drive(52 + 8 * TIME, 195.2, 0.0), drive(52 + 8 * TIME, 194.6, 0.0)),
    (DiscardReason.STICKING, STUCK, drive(TOUCHING[1] + 1.1 + 8 * TIME, 198.25, 0.0)),
    (DiscardReason.CIRCLING, circle(np.deg2rad(280)), circle(np.deg2rad(260))),
    (DiscardReason.OFF_ROAD, leave_road(1.3), leave_road(0.8)),
    (DiscardReason.HEAD_ON, drive(200 - stop_after(5.0, 4.0), 198.25, np.pi), drive(200 - 1.0 * TIME, 198.25, np.pi)),
    (DiscardReason.WEAVING, weave(2.2), weave(4.0)),
]


@pytest.mark.parametrize(("reason", "bad", "good"), CASES, ids=[case[0].value for case in CASES])
def test_a_fault_is_found_beyond_its_limit_alone(reason: DiscardReason, bad: Scene, good: Scene) -> None:
    assert reason in faults(bad)
    assert reason not in faults(good)


def test_a_finding_says_when_how_much_and_with_whom() -> None:
    finding = find_behaviour_fault(STUCK, 0, 0)
    assert finding is not None
    assert (finding.reason, finding.other, finding.frame, finding.limit) == (DiscardReason.STICKING, "ego", 0, 3.0)
    assert finding.value == pytest.approx(SECONDS - 1 / FRAME_HZ, abs=1e-3)


def test_overtaking_that_ends_in_its_lane_and_a_u_turn_are_no_faults() -> None:
    """West in the lane of the east for four seconds, and along its own before and after."""
    overtaking = (TIME > 4.0) & (TIME < 8.0)
    assert DiscardReason.AGAINST_TRAFFIC not in faults(
        drive(300 - 8 * TIME, np.where(overtaking, 198.25, 201.75), np.pi)
    )
    yaw = np.clip((TIME - 4.0) * 0.7, 0.0, np.pi)
    step = 4.0 / FRAME_HZ
    assert faults(drive(100 + np.cumsum(step * np.cos(yaw)), 194.0 + np.cumsum(step * np.sin(yaw)), yaw)) == []


def test_who_comes_from_a_driveway_or_drives_in_a_car_park_is_not_off_the_road() -> None:
    pull_out = drive(100 + 2 * TIME, np.maximum(188.0, np.minimum(188.0 + 1.5 * TIME, 194.75)), 0.0)
    assert DiscardReason.OFF_ROAD not in faults(pull_out)
    leaving = leave_road(1.3)
    park = {"park": shapely.box(0, 180, 400, 193)}
    assert DiscardReason.OFF_ROAD not in faults(replace(leaving, road_map=replace(leaving.road_map, carparks=park)))


def test_a_car_that_stands_has_no_fault_of_behaviour() -> None:
    assert faults(drive(100.0, 198.25, np.pi)) == []
    assert faults(drive(100.0, 198.25, np.pi / 2)) == []
