"""CAN bus messages derived from the ego track."""

from dataclasses import replace

import numpy as np
import pytest

from benchmark.geometry import quaternion_from_yaw
from benchmark.scene import EgoTrack, Scene
from generation.nuscenes_writer.can_bus import MESSAGES, derive_messages
from tests.generation.nuscenes_writer.written_roots import short_scene


def circling(speed: float, radius: float, acceleration: float = 0.0) -> Scene:
    """The ego on a left-hand circle."""
    scene = short_scene(seconds=6.0)
    time = scene.seconds
    yaw = (speed * time + 0.5 * acceleration * time**2) / radius
    centre = np.array([100.0, 200.0])
    position = np.column_stack([centre[0] + radius * np.sin(yaw), centre[1] - radius * np.cos(yaw), 0 * yaw])
    return replace(scene, ego=EgoTrack(position, quaternion_from_yaw(yaw)))


def test_a_steady_turn() -> None:
    messages = derive_messages(circling(8.0, 25.0))
    for pose in messages["pose"][50:]:
        assert pose["vel"] == pytest.approx([8.0, 0.0, 0.0], abs=0.1)
        assert pose["accel"] == pytest.approx([0.0, 8.0**2 / 25.0, 9.81], abs=0.3)
        assert pose["rotation_rate"] == pytest.approx([0.0, 0.0, 8.0 / 25.0], abs=0.01)
    wheel = messages["steeranglefeedback"][100]["value"]
    assert np.tan(wheel / 14.9) / 2.588 == pytest.approx(1 / 25.0, rel=0.02)
    assert messages["vehicle_monitor"][4]["vehicle_speed"] == pytest.approx(28.8, abs=0.4)
    assert messages["zoe_veh_info"][-1]["odom"] == pytest.approx(8.0 * 5.9, rel=0.01)


def test_braking_on_a_straight_road() -> None:
    scene = short_scene(seconds=4.0)
    x = 50 + 10 * scene.seconds - scene.seconds**2
    position = np.column_stack([x, scene.ego.position[:, 1:]])
    messages = derive_messages(replace(scene, ego=replace(scene.ego, position=position)))
    pose = messages["pose"][100]
    seconds = (pose["utime"] - int(scene.timestamps_us[0])) * 1e-6
    assert pose["vel"][0] == pytest.approx(10 - 2 * seconds, abs=0.02)
    assert pose["accel"] == pytest.approx([-2.0, 0.0, 9.81], abs=0.02)


def test_positions_are_the_track() -> None:
    scene = circling(8.0, 25.0)
    for pose in derive_messages(scene)["pose"][::50]:
        time = (pose["utime"] - scene.timestamps_us[0]) * 1e-6
        expected = [np.interp(time, scene.seconds, column) for column in scene.ego.position.T]
        assert pose["pos"] == pytest.approx(expected, abs=1e-5)
        assert np.linalg.norm(pose["orientation"]) == pytest.approx(1.0, abs=1e-5)


def test_the_future_does_not_matter() -> None:
    scene = circling(8.0, 25.0)
    other = scene.ego.position.copy()
    other[40:] += 5.0
    changed = replace(scene, ego=replace(scene.ego, position=other))
    until = int(scene.timestamps_us[39])
    for kind in MESSAGES:
        pairs = zip(derive_messages(scene)[kind], derive_messages(changed)[kind])
        assert all(first == second for first, second in pairs if first["utime"] <= until)


def test_a_car_that_stands_and_one_short_scene() -> None:
    scene = short_scene(seconds=3.0, ego_speed=0.0)
    messages = derive_messages(scene)
    assert all(row["value"] == 0.0 for row in messages["steeranglefeedback"])
    assert len(messages["route"]) >= 2
    short = derive_messages(short_scene(seconds=0.25))
    assert len(short["pose"]) == 9
    assert all(np.isfinite(row["vel"]).all() for row in short["pose"])


def test_rates_and_summary() -> None:
    messages = derive_messages(circling(8.0, 25.0))
    assert set(messages["meta"]) == set(MESSAGES)
    counts = {kind: messages["meta"][kind]["message_count"] for kind in MESSAGES}
    assert counts == {kind: len(messages[kind]) for kind in MESSAGES}
    assert np.diff([row["utime"] for row in messages["pose"]]).tolist() == [20_000] * (counts["pose"] - 1)
    assert messages["meta"]["vehicle_monitor"]["var_stats"]["vehicle_speed"]["mean"] == pytest.approx(28.8, abs=0.5)
