"""A policy behind gRPC as a planner: what is sent, what is taken, and every way to fail."""

import re
import socket
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest

from benchmark.closed_loop.episodes import run_episode
from benchmark.errors import InputError
from benchmark.extensions.alpasim.connection import CONTRACT
from benchmark.extensions.alpasim.messages import build_message
from benchmark.extensions.alpasim.model import egodriver_planner
from benchmark.extensions.alpasim.poses import encode_trajectory
from benchmark.geometry import rotation_matrix
from benchmark.planning import PlannerAwayError, PlannerGoneError
from benchmark.runs.plan_rows import run_with_restarts
from tests.benchmark.extensions.alpasim.made import (
    Answer,
    Refused,
    Scripted,
    ahead,
    nothing,
    on_stage,
    scripted,
    straight,
)


@pytest.fixture(scope="module")
def driven() -> Scripted:
    """A drive, and what the policy was asked in it."""
    with scripted() as log:
        planner = egodriver_planner(f"mine={log.url}", image_format="png", remote_cameras="CAM_FRONT=camera_front_wide")
        assert planner.name == "mine" and planner.settings["cameras"] == {"CAM_FRONT": "camera_front_wide"}
        found = run_episode(on_stage(), planner)
        planner.end_session()
    assert found.failure is None and found.end == "end" and len(found.plans) == 7
    assert found.notes == ("1.5 s: began with 1.0 s of recorded motion, not 1.7 s",)
    return log


def test_a_session_names_no_scene_and_declares_cameras_as_they_are_calibrated(driven: Scripted) -> None:
    (start,) = driven.of("start_session")
    assert start.debug_info.scene_id == start.session_uuid and len(start.session_uuid) == 36
    cameras = {camera.logical_id: camera for camera in start.rollout_spec.vehicle.available_cameras}
    assert len(cameras) == 6 and "camera_front_wide" in cameras and "CAM_FRONT" not in cameras
    front = cameras["camera_front_wide"]
    view = next(camera for camera in on_stage().sensor.look(on_stage().scene).cameras if camera.name == "CAM_FRONT")
    pinhole = front.intrinsics.opencv_pinhole_param
    assert [pinhole.focal_length_x, pinhole.principal_point_y] == [view.intrinsic[0, 0], view.intrinsic[1, 2]]
    assert (front.intrinsics.resolution_w, front.intrinsics.resolution_h) == (view.width, view.height)
    assert [len(pinhole.radial_coeffs), len(pinhole.tangential_coeffs), len(pinhole.thin_prism_coeffs)] == [6, 2, 4]
    quat = front.rig_to_camera.quat
    np.testing.assert_allclose([quat.w, quat.x, quat.y, quat.z], view.rotation, atol=1e-7)


def test_history_comes_first_then_new_poses_and_never_a_later_one(driven: Scripted) -> None:
    batches = [
        [pose.timestamp_us for pose in each.trajectory.poses] for each in driven.of("submit_egomotion_observation")
    ]
    drives = driven.of("drive")
    assert [batch[-1] for batch in batches] == [drive.time_now_us for drive in drives]
    times = [time for batch in batches for time in batch]
    assert times == sorted(set(times)) and times[0] == 1_000_000
    assert all(drive.time_query_us - drive.time_now_us == 500_000 for drive in drives)
    assert not driven.of("submit_recording_ground_truth") and not any(drive.renderer_data for drive in drives)
    first = driven.of("submit_egomotion_observation")[0]
    assert len(first.dynamic_states) == len(first.trajectory.poses)
    position = first.trajectory.poses[0].pose.vec
    assert [position.x, position.y, position.z] == [0.0, 0.0, 0.0]


def test_all_of_an_instant_comes_before_its_drive_and_the_session_is_closed(driven: Scripted) -> None:
    names = [name for name, _ in driven.asked]
    assert names[:2] == ["get_version", "start_session"] and names[-1] == "close_session"
    groups = "|".join(names[2:-1]).split("drive")[:-1]
    for group in groups:
        assert group.count("submit_image") == 6 and group.count("submit_route") == group.count("submit_egomotion") == 1
    image = driven.of("submit_image_observation")[0].camera_image
    assert image.image_bytes.startswith(b"\x89PNG") and image.frame_start_us == image.frame_end_us == 1_000_000
    assert all(len(route.route.waypoints) == 20 for route in driven.of("submit_route"))


def replaced(**changes: Any) -> Answer:
    return lambda log, request: ahead(log, request, **changes)


def with_poses(make: Any) -> Answer:
    """An answer from the poses of a good one."""

    def answer(log: Scripted, request: Any) -> Any:
        good = ahead(log, request)
        poses = make(log, request, [*good.trajectory.poses])
        return build_message("DriveResponse", trajectory=build_message("Trajectory", poses=poses))

    return answer


def shifted(us: int) -> Answer:
    def make(log: Scripted, request: Any, poses: list[Any]) -> list[Any]:
        for pose in poses:
            pose.timestamp_us += us
        return poses

    return with_poses(make)


def spoiled(**numbers: float) -> Answer:
    def make(log: Scripted, request: Any, poses: list[Any]) -> list[Any]:
        for name, number in numbers.items():
            part = poses[3].pose.vec if name in "xyz" and name == "x" else poses[3].pose.quat
            setattr(part, name, number)
        return poses

    return with_poses(make)


def fails(code: str) -> Answer:
    def answer(log: Scripted, request: Any) -> Any:
        raise Refused(code)

    return answer


@pytest.mark.parametrize(
    ("answer", "says"),
    [
        (nothing, "empty"),
        (with_poses(lambda log, request, poses: poses[:1]), "one pose"),
        (shifted(2000), r"start off by \+2.000 ms"),
        (shifted(-300_000), "start off by -300.000 ms"),
        (spoiled(x=float("nan")), "NaN"),
        (spoiled(w=0.5), "quaternion not unit"),
        (with_poses(lambda log, request, poses: [poses[0], poses[0], *poses]), "times not rising"),
        (fails("INTERNAL"), "gRPC error INTERNAL.*no GPU"),
        (fails("RESOURCE_EXHAUSTED"), "--image-format jpeg"),
        (lambda log, request: b"\xff\xff\xff", "cannot be read"),
    ],
)
def test_what_cannot_be_driven_fails_by_name(answer: Answer, says: str) -> None:
    with scripted(drive=answer) as log:
        planner = egodriver_planner(log.url)
        found = run_episode(on_stage(), planner)
        planner.end_session()
    assert found.failure is not None and found.failure.reason == "raised" and found.end == "failed"
    assert re.search(says, found.failure.text)
    assert log.asked[-1][0] == "close_session"


def test_all_in_the_past_is_refused() -> None:
    def answer(log: Scripted, request: Any) -> Any:
        # Times before 0 are not on the wire.
        return (ahead if request.time_now_us < 6_500_000 else shifted(-5_500_000))(log, request)

    with scripted(drive=answer) as log:
        found = run_episode(on_stage(8.0), egodriver_planner(log.url))
    assert found.failure is not None and "all in the past" in found.failure.text


def test_a_short_trajectory_is_held_and_noted_and_backwards_is_taken() -> None:
    with scripted(drive=replaced(seconds=1.0)) as log:
        found = run_episode(on_stage(), egodriver_planner(log.url))
    assert found.failure is None and found.end == "end"
    held, begun = found.notes
    assert held == "0.0 s: ends after 1.0 s, last pose held, and 5 times more"
    assert begun == "1.5 s: began with 1.0 s of recorded motion, not 1.7 s; ends after 1.0 s, last pose held"
    np.testing.assert_allclose(found.plans[0].waypoints[1:], [[8.0, 0.0]] * 5, atol=1e-4)
    with scripted(drive=replaced(speed=-2.0)) as log:
        back = run_episode(on_stage(), egodriver_planner(log.url))
    assert back.failure is None and back.plans[0].waypoints[-1, 0] < -5.0


def test_a_long_trajectory_gives_eight_seconds_and_sampled_ones_are_modes() -> None:
    def answer(log: Scripted, request: Any) -> Any:
        made = ahead(log, request, seconds=12.0)
        made.debug_info.sampled_trajectories.append(ahead(log, request, seconds=9.0, speed=4.0).trajectory)
        made.debug_info.sampled_trajectories.append(ahead(log, request, seconds=1.0).trajectory)
        # By convention this is a pickle; this one would end the test.
        made.debug_info.unstructured_debug_info = b"cos\n_exit\n(I1\ntR."
        return made

    with scripted(drive=answer) as log:
        found = run_episode(on_stage(), egodriver_planner(log.url))
    plan = found.plans[0]
    assert plan.waypoints.shape == (16, 2) and plan.modes is not None and plan.modes.shape == (1, 16, 2)
    np.testing.assert_allclose(plan.modes[0, -1], [32.0, 0.0], atol=1e-4)


def test_terminate_session_ends_the_drive_with_what_it_has() -> None:
    def answer(log: Scripted, request: Any) -> Any:
        made = ahead(log, request) if len(log.of("drive")) < 6 else build_message("DriveResponse")
        made.terminate_session = len(log.of("drive")) >= 6
        return made

    with scripted(drive=answer) as log:
        found = run_episode(on_stage(8.0), egodriver_planner(log.url))
    assert found.failure is None and found.end == "end" and found.terminated
    assert "terminate_session" in found.notes[-1] and len(found.plans) == 5 and len(found.motion.ticks) == 6


def test_a_late_policy_fails_and_one_that_hangs_at_the_start_too() -> None:
    with scripted(drive=lambda log, request: None) as log:
        found = run_episode(on_stage(), egodriver_planner(log.url, deadline_s=0.3))
    assert found.failure is not None and found.failure.reason == "timeout" and "0.3 s" in found.failure.text


def test_a_policy_that_forgets_its_session_begins_again_and_one_that_stays_away_ends_the_command() -> None:
    lost = [True]

    def answer(log: Scripted, request: Any) -> Any:
        if len(log.of("drive")) == 3 and lost.pop():
            raise Refused("NOT_FOUND", "unknown session")
        return ahead(log, request)

    with scripted(drive=answer) as log:
        planner = egodriver_planner(log.url)
        found = run_with_restarts(lambda: run_episode(on_stage(), planner), planner)
        assert found.end == "end" and len(log.of("start_session")) == 2
    with pytest.raises(PlannerAwayError, match="is not there for"):
        run_episode(on_stage(), planner)


def test_what_is_no_egodriver_service_is_told_at_once(monkeypatch: pytest.MonkeyPatch) -> None:
    import benchmark.extensions.alpasim.model as module

    monkeypatch.setattr(module, "ALIVE_S", 0.5)
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        with pytest.raises(PlannerAwayError, match="nobody answers"):
            egodriver_planner(f"grpc://127.0.0.1:{taken.getsockname()[1]}").require_alive()
    with scripted(start_session=fails("UNIMPLEMENTED")) as log, pytest.raises(PlannerGoneError, match="egodriver"):
        egodriver_planner(log.url).require_alive()
        run_episode(on_stage(), egodriver_planner(log.url))
    with scripted(get_version=fails("UNIMPLEMENTED")) as log:
        egodriver_planner(log.url).require_alive()
        assert run_episode(on_stage(), egodriver_planner(log.url)).end == "end"


def test_a_server_of_the_first_contract_is_told_bodies_of_cameras(monkeypatch: pytest.MonkeyPatch) -> None:
    import benchmark.extensions.alpasim.model as module

    monkeypatch.setattr(module.EgodriverPlanner, "_negotiate", lambda self: 1)
    with scripted() as log:
        assert run_episode(on_stage(), egodriver_planner(log.url)).end == "end"
    (start,) = log.of("start_session")
    assert {CONTRACT: "1"}.items() <= log.metadata[0].items()
    front = next(camera for camera in start.rollout_spec.vehicle.available_cameras if camera.logical_id == "CAM_FRONT")
    quat = front.rig_to_camera.quat
    forward = rotation_matrix(np.array([quat.w, quat.x, quat.y, quat.z]))[:, 0]
    np.testing.assert_allclose(forward, [1.0, 0.0, 0.0], atol=0.02)


def test_options_that_do_not_fit_are_refused() -> None:
    with pytest.raises(InputError, match="jpeg or png"):
        egodriver_planner("grpc://127.0.0.1:1", image_format="torch")
    with pytest.raises(InputError, match="NAME=OTHER"):
        egodriver_planner("grpc://127.0.0.1:1", remote_cameras="CAM_FRONT")
    with pytest.raises(InputError, match="twice"):
        egodriver_planner("grpc://127.0.0.1:1", remote_cameras="CAM_FRONT=a,CAM_BACK=a")
    with pytest.raises(InputError, match="only plain gRPC"):
        egodriver_planner("grpcs://127.0.0.1:1")


def test_missing_pictures_are_told() -> None:
    with scripted() as log:
        found = run_episode(replace(on_stage(), sensor=Blind()), egodriver_planner(log.url))
    assert found.failure is not None and "no images" in found.failure.text and not log.of("drive")


class Blind:
    """Cameras that show nothing."""

    name = "blind"
    facts: Mapping[str, Any] = MappingProxyType({})
    cameras = ()

    def look(self, scene: Any) -> "Blind":
        return self

    def views(self, driven: Any) -> dict[str, Any]:
        return {}


def test_poses_by_hand_are_sound() -> None:
    assert len(encode_trajectory(straight(4)).poses) == 4
