"""A planner as an egodriver service: calls in and out of order, sessions side by side, pictures, bad motion."""

import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from benchmark.closed_loop.episodes import run_episode
from benchmark.constants import CAMERA_NAMES
from benchmark.extensions.alpasim import sessions
from benchmark.extensions.alpasim.cameras import encode_camera
from benchmark.extensions.alpasim.connection import CONTRACT
from benchmark.extensions.alpasim.messages import EGODRIVER, METHODS, build_message, decode_message, encode_message
from benchmark.extensions.alpasim.model import egodriver_planner
from benchmark.extensions.alpasim.poses import Poses, decode_trajectory, encode_states, encode_trajectory
from benchmark.extensions.alpasim.session import EgodriverService
from benchmark.extensions.alpasim.sessions import CallRefusedError
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from benchmark.untrusted.files import GRPC_PICTURE
from benchmark.untrusted.http_images import encode_picture
from tests.benchmark.closed_loop.seeing import Looking, picture, small_cameras
from tests.benchmark.extensions.alpasim.made import on_stage, serving, straight


class Turning:
    """Ahead at its speed and to the left, and remembers what it saw."""

    name = "turning"

    def __init__(self) -> None:
        self.seen: list[Observation] = []
        self.resets = 0

    def reset(self, scene: SceneInfo) -> None:
        self.seen, self.resets = [], self.resets + 1

    def plan(self, observation: Observation) -> Plan:
        self.seen.append(observation)
        steps = 0.5 * np.arange(1, 7)
        return Plan(np.column_stack([steps * float(observation.ego.velocity[0]), 0.2 * steps]), PlanFrame.EGO)


class Caller:
    """Calls a service, without a socket."""

    def __init__(self, build: Callable[[], Any] = Turning, **options: Any) -> None:
        self.built: list[Any] = []

        def keep() -> Any:
            self.built.append(build())
            return self.built[-1]

        self.service = EgodriverService(keep, cameras={}, **options)

    def call(self, name: str, message: str, metadata: dict[str, str] | None = None, **fields: Any) -> Any:
        data = encode_message(build_message(message, **fields))
        answer = self.service.call(EGODRIVER + name, data, metadata or {})
        return decode_message(METHODS[EGODRIVER + name][1], answer, GRPC_PICTURE)

    def start(self, uuid: str = "a", cameras: Any = (), **metadata: str) -> None:
        spec = {"vehicle": {"available_cameras": list(cameras)}}
        self.call("start_session", "DriveSessionRequest", metadata, session_uuid=uuid, rollout_spec=spec)

    def move(self, poses: Poses, states: Any = (), uuid: str = "a") -> None:
        self.call(
            "submit_egomotion_observation",
            "RolloutEgoTrajectory",
            session_uuid=uuid,
            trajectory=encode_trajectory(poses),
            dynamic_states=list(states),
        )

    def drive(self, now_us: int, uuid: str = "a") -> Poses:
        answer = self.call(
            "drive", "DriveRequest", session_uuid=uuid, time_now_us=now_us, time_query_us=now_us + 100_000
        )
        return decode_trajectory(answer.trajectory)


def refusal(work: Callable[[], Any]) -> str:
    with pytest.raises(CallRefusedError) as refused:
        work()
    return refused.value.code


def test_a_standing_plan_is_told_again_from_where_the_car_is() -> None:
    caller = Caller()
    caller.start()
    poses = straight(12, speed=5.0)
    answers = []
    for row in range(12):
        caller.move(poses.at(slice(row, row + 1)) if row > 1 else poses.at(slice(row + 1)))
        answers.append(caller.drive(int(poses.times_us[row])))
    assert [observation.timestamp_us for observation in caller.built[0].seen] == [1_000_000, 1_500_000, 2_000_000]
    for row, answer in enumerate(answers):
        assert answer.times_us[0] == poses.times_us[row] and (np.diff(answer.times_us) > 0).all() and answer.are_unit
        np.testing.assert_allclose(answer.position[0], poses.position[row], atol=1e-6)
        assert answer.times_us[-1] >= poses.times_us[row] + 2_500_000
    # Between two plans the waypoints are those of the first, at the same times.
    np.testing.assert_array_equal(answers[6].position[1:], answers[5].position[1:])
    last = answers[10]
    heading = np.arctan2(0.1, 2.5) + 0.3
    yaw = 2.0 * np.arctan2(last.rotation[2, 3], last.rotation[2, 0])
    assert yaw == pytest.approx(heading, abs=1e-3)
    caller.drive(int(poses.times_us[11]))
    assert len(caller.built[0].seen) == 3


@pytest.mark.parametrize("fault", ["zeros", "local frame", "none sent"])
def test_speed_comes_from_poses_where_what_was_sent_is_wrong(fault: str) -> None:
    caller, poses = Caller(), straight(4, speed=6.0, yaw=2.0)
    caller.start()
    velocity, zeros = np.zeros((4, 3)), np.zeros((4, 3))
    if fault == "local frame":
        velocity[:, :2] = 6.0 * np.array([np.cos(2.0), np.sin(2.0)])
    caller.move(poses, () if fault == "none sent" else encode_states(velocity, zeros, zeros))
    caller.drive(int(poses.times_us[-1]))
    assert caller.built[0].seen[0].ego.velocity == pytest.approx([6.0, 0.0], abs=1e-3)


def test_what_was_sent_counts_where_it_agrees() -> None:
    caller, poses = Caller(), straight(4, speed=6.0)
    caller.start()
    velocity = np.tile([6.2, 0.1, 0.0], (4, 1))
    caller.move(poses, encode_states(velocity, np.tile([0.0, 0.0, 0.3], (4, 1)), np.tile([1.0, 0.5, 0.0], (4, 1))))
    caller.drive(int(poses.times_us[-1]))
    ego = caller.built[0].seen[0].ego
    assert [*ego.velocity, *ego.acceleration, ego.yaw_rate] == pytest.approx([6.2, 0.1, 1.0, 0.5, 0.3], abs=1e-6)


def test_sessions_are_side_by_side_and_planners_are_used_again() -> None:
    caller = Caller()
    for uuid in "ab":
        caller.start(uuid)
    caller.move(straight(3, speed=5.0), uuid="a")
    caller.move(straight(3, speed=9.0), uuid="b")
    slow, fast = (caller.drive(1_200_000, uuid) for uuid in "ab")
    assert np.linalg.norm(fast.position[1] - fast.position[0]) > 1.5 * np.linalg.norm(
        slow.position[1] - slow.position[0]
    )
    assert len(caller.built) == 2
    for uuid in "ab":
        caller.call("close_session", "DriveSessionCloseRequest", session_uuid=uuid)
    caller.start("c")
    assert len(caller.built) == 2 and refusal(lambda: caller.drive(1_200_000, "a")) == "NOT_FOUND"


def test_sessions_that_nobody_asks_make_room(monkeypatch: pytest.MonkeyPatch) -> None:
    caller = Caller()
    for number in range(sessions.MOST_SESSIONS):
        caller.start(str(number))
    assert refusal(lambda: caller.start("more")) == "RESOURCE_EXHAUSTED"
    monkeypatch.setattr(sessions, "IDLE_S", 0.0)
    caller.start("more")
    assert len(caller.built) == sessions.MOST_SESSIONS


def test_calls_that_cannot_be_are_refused_by_code() -> None:
    caller, poses = Caller(), straight(3)
    assert len(caller_without_motion(caller)) == 0
    assert refusal(lambda: caller.start("a")) == "ALREADY_EXISTS"
    assert refusal(lambda: caller.start("x" * 201)) == "INVALID_ARGUMENT"
    broken = Poses(poses.times_us, poses.position, 2.0 * poses.rotation)
    assert refusal(lambda: caller.move(broken)) == "INVALID_ARGUMENT"
    assert (
        refusal(lambda: caller.move(Poses(poses.times_us, poses.position * np.nan, poses.rotation)))
        == "INVALID_ARGUMENT"
    )
    assert refusal(lambda: caller.move(poses, [{}])) == "INVALID_ARGUMENT"
    assert refusal(lambda: caller.service.call(EGODRIVER + "drive", b"\xff", {})) == "INVALID_ARGUMENT"
    with pytest.raises(LookupError):
        caller.service.call("/egodriver.EgodriverService/shut_down", b"", {})
    # Older poses, a batch of none and the recorded future are taken, and change nothing.
    caller.move(poses)
    caller.move(poses)
    caller.move(poses.at(slice(0)))
    future = {"trajectory": encode_trajectory(straight(50)), "timestamp_us": 1_200_000}
    caller.call("submit_recording_ground_truth", "GroundTruthRequest", session_uuid="a", ground_truth=future)
    assert len(caller.drive(1_200_000)) == 7


def caller_without_motion(caller: Caller) -> Poses:
    caller.start("a")
    return caller.drive(1_000_000)


def test_a_planner_that_fails_is_a_sentence(capsys: pytest.CaptureFixture[str]) -> None:
    class Failing(Turning):
        def plan(self, observation: Observation) -> Plan:
            raise RuntimeError("out of memory")

    caller = Caller(Failing)
    caller.start()
    caller.move(straight(2))
    assert refusal(lambda: caller.drive(1_100_000)) == "INTERNAL"
    assert "failed to plan: RuntimeError: out of memory" in capsys.readouterr().err


def declared(names: Any = CAMERA_NAMES, **options: Any) -> list[Any]:
    cameras = {camera.name: camera for camera in small_cameras()}
    return [encode_camera(cameras[name], name, **options) for name in names]


def test_a_planner_of_images_needs_all_cameras_declared_and_seen() -> None:
    caller = Caller(Looking, wants_images=True)
    with pytest.raises(CallRefusedError, match="CAM_BACK was not declared; start the server with --cameras"):
        caller.start(cameras=declared([name for name in CAMERA_NAMES if name != "CAM_BACK"]))
    caller.start(cameras=declared())
    caller.move(straight(2))
    for number, name in enumerate(CAMERA_NAMES):
        assert len(caller.drive(1_100_000)) == 0
        pixels = encode_picture(picture(number), "png")
        for data in (b"no picture", pixels):
            image = {"frame_end_us": 1_100_000, "image_bytes": data, "logical_id": name}
            caller.call("submit_image_observation", "RolloutCameraImage", session_uuid="a", camera_image=image)
    assert len(caller.drive(1_100_000)) == 7
    (seen,) = caller.built[0].seen
    np.testing.assert_array_equal(seen.views["CAM_BACK"].load(), picture(CAMERA_NAMES.index("CAM_BACK")))
    undeclared = {"logical_id": "CAM_TOP", "image_bytes": b""}

    def send() -> None:
        caller.call("submit_image_observation", "RolloutCameraImage", session_uuid="a", camera_image=undeclared)

    assert refusal(send) == "INVALID_ARGUMENT"


def test_bodies_of_cameras_are_turned_to_their_optical_axes() -> None:
    optical, body = Caller(Looking, wants_images=True), Caller(Looking, wants_images=True)
    optical.start(cameras=declared())
    body.start(cameras=declared(body=True), **{CONTRACT: "1"})
    for name in CAMERA_NAMES:
        one, other = (caller.service._sessions.find("a").cameras[name] for caller in (optical, body))
        assert one is not None and other is not None
        np.testing.assert_allclose(np.abs(one[1].rotation @ other[1].rotation), 1.0, atol=1e-6)


def test_over_sockets_sessions_run_at_the_same_time_and_give_what_one_gives() -> None:
    with serving(Looking, wants_images=True) as server:
        alone = run_episode(on_stage(), egodriver_planner(server.url, image_format="png"))
        found: list[Any] = []
        drive = lambda: found.append(run_episode(on_stage(), egodriver_planner(server.url, image_format="png")))  # noqa: E731
        threads = [threading.Thread(target=drive) for _ in range(2)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert alone.failure is None and len(found) == 2
    for each in found:
        assert each.failure is None
        np.testing.assert_allclose(each.plans[-1].waypoints, alone.plans[-1].waypoints, atol=1e-6)
