"""Messages of AlpaSim as its own code encoded them, poses and routes, and the golden sets."""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmark import api
from benchmark.extensions.alpasim.messages import METHODS, build_message, decode_message, encode_message
from benchmark.extensions.alpasim.poses import (
    LocalFrame,
    Poses,
    build_route,
    decode_trajectory,
    derive_command,
    derive_states,
    encode_trajectory,
    thin_path,
)
from benchmark.geometry import quaternion_from_yaw
from benchmark.planning import Command
from benchmark.untrusted.files import GRPC_MESSAGE
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.alpasim.made import straight

SHARED = Path(__file__).resolve().parents[4].parent / "shared" / "golden" / "alpasim"
STILL = quaternion_from_yaw(np.array(0.0))


def test_bytes_are_those_that_the_specification_tells() -> None:
    message = build_message("DriveRequest", session_uuid="ab", time_now_us=1, time_query_us=2)
    assert encode_message(message).hex() == "0a026162" + "19" + "01" + "00" * 7 + "21" + "02" + "00" * 7
    assert encode_message(build_message("DriveResponse", terminate_session=True)) == b"\x20\x01"
    assert decode_message("DriveResponse", b"\x20\x01", GRPC_MESSAGE).terminate_session
    assert METHODS["/egodriver.EgodriverService/drive"] == ("DriveRequest", "DriveResponse")


def test_fields_of_later_versions_are_passed_over() -> None:
    known = build_message("DriveSessionRequest", session_uuid="a", random_seed=7)
    later = encode_message(known) + b"\xba\x3e\x03new"
    assert decode_message("DriveSessionRequest", later, GRPC_MESSAGE).random_seed == 7


def test_poses_pass_the_wire_in_single_precision_near_the_origin_and_not_far_from_it() -> None:
    far = Poses(np.array([1_700_000_000_000_000]), np.array([[1234.5678, 2345.6789, 1.0]]), np.array([STILL]))
    frame = LocalFrame(far.position[0] - [12.3456, 0.0, 0.0], int(far.times_us[0]))
    sent = decode_trajectory(encode_trajectory(frame.to_local(far)))
    assert sent.times_us[0] == 1_000_000
    np.testing.assert_allclose(sent.position[0], [12.3456, 0.0, 0.0], atol=1e-6)
    assert np.abs(decode_trajectory(encode_trajectory(far)).position - far.position).max() > 1e-5


def test_velocities_are_in_the_rig_and_rates_are_left_positive() -> None:
    velocity, rate = derive_states(straight(speed=5.0, yaw=2.0))
    np.testing.assert_allclose(velocity, np.tile([5.0, 0.0, 0.0], (3, 1)), atol=1e-12)
    np.testing.assert_allclose(rate, 0.0, atol=1e-12)
    angle = 0.05 * np.arange(5)
    turning = Poses(np.arange(5) * 100_000, np.zeros((5, 3)), quaternion_from_yaw(angle))
    np.testing.assert_allclose(derive_states(turning)[1][:, 2], 0.5, atol=1e-9)


def test_a_route_has_twenty_points_from_beside_the_car_and_goes_straight_on_beyond_the_end() -> None:
    path = thin_path(np.column_stack([np.arange(0.0, 30.0, 0.1), np.zeros(300), np.full(300, 5.0)]))
    assert np.diff(path[:, 0])[:-1].min() >= 0.2 - 1e-9
    yaw = 0.1
    route = build_route(path, np.array([10.0, -0.5, 5.0]), quaternion_from_yaw(np.array(yaw)))
    assert route.shape == (20, 3) and (route[:, 2] == 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(np.diff(route, axis=0), axis=1), 80 / 19)
    np.testing.assert_allclose(route[0, :2], [0.5 * np.sin(yaw), 0.5 * np.cos(yaw)])
    cut = build_route(thin_path(path[:-1], 0.0), np.array([10.0, 0.0, 5.0]), STILL)
    assert len(cut) == 5
    assert build_route(thin_path(np.zeros((4, 3))), np.zeros(3), STILL).tolist() == [[0.0, 0.0, 0.0]]


@pytest.mark.parametrize(
    ("aside", "speed", "command"),
    [(2.5, 5.0, Command.LEFT), (-2.5, 5.0, Command.RIGHT), (1.5, 5.0, Command.STRAIGHT), (2.5, 0.0, Command.STRAIGHT)],
)
def test_the_command_is_that_of_the_waypoint_three_seconds_ahead(aside: float, speed: float, command: Command) -> None:
    away = np.arange(0.0, 40.0, 5.0)
    route = np.column_stack([away, np.where(away >= 15.0, aside, 0.0), np.zeros(len(away))])
    route[-2:] = np.nan
    assert derive_command(route, speed) is command
    assert derive_command(np.full((20, 3), np.nan), speed) is Command.STRAIGHT


@pytest.mark.skipif(not SHARED.is_dir(), reason="the recorded sessions are not here")
@pytest.mark.parametrize("name", ["sessions", "traffic", "reactions"])
def test_recorded_sessions_agree(name: str) -> None:
    checks = api.verify("alpasim", SHARED / name)
    assert checks and all(check.ok for check in checks), [check for check in checks if not check.ok]


@pytest.mark.skipif(not SHARED.is_dir(), reason="the recorded sessions are not here")
def test_a_damaged_set_is_refused_in_a_sentence(tmp_path: Path) -> None:
    folder = tmp_path / "traffic"
    folder.mkdir()
    for path in (SHARED / "traffic").iterdir():
        (folder / path.name).write_bytes(path.read_bytes())
    (packed,) = folder.glob("*lead.bin.gz")
    packed.write_bytes(packed.read_bytes()[:900])
    done = run_here("verify", "alpasim", "--golden", folder)
    assert done.code == 2 and "get it again" in done.err and "Traceback" not in done.err


def test_a_message_is_told_as_json_tells_it() -> None:
    from benchmark.extensions.alpasim.verification import _agrees

    message = build_message("Vec3", x=0.1, y=float("nan"))
    assert _agrees(message, json.loads('{"x": 0.1, "y": "NaN"}'))
    assert not _agrees(message, {"x": 0.2, "y": "NaN"}) and not _agrees(message, {"x": 0.1})
