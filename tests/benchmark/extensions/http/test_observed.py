"""Observations on the wire: the exact request, and what comes out at the other end."""

import base64
import io
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.http.requests import CAMERAS, InferRequest
from benchmark.extensions.http.session import ObservationHistory, build_request
from benchmark.extensions.http.values import HttpImageFormat, NeuroncapHttpError, encode_image
from benchmark.geometry import quaternion_from_yaw, rotation_matrix
from benchmark.planning import Command
from tests.benchmark.extensions.http.made import SHARED, START_US, observed, picture


def test_keys_their_order_and_shapes_are_neuroncaps() -> None:
    body = build_request(observed(1), HttpImageFormat.TORCH).encoded()
    value = json.loads(body)
    assert list(value) == ["images", "ego2world", "canbus", "timestamp", "command", "calibration"]
    assert list(value["images"]) == list(CAMERAS)
    assert list(value["calibration"]) == ["camera2image", "camera2ego", "lidar2ego"]
    assert [list(value["calibration"][name]) for name in ("camera2image", "camera2ego")] == [list(CAMERAS)] * 2
    shapes = {name: np.shape(value[name]) for name in ("ego2world", "canbus", "timestamp", "command")}
    assert shapes == {"ego2world": (4, 4), "canbus": (16,), "timestamp": (), "command": ()}
    assert value["timestamp"] == START_US + 500_000 and value["command"] == 1
    # Position, rotation, acceleration, rotation rate, velocity.
    assert value["canbus"][:3] == [4.0, 20.0, 0.5] and value["canbus"][7:10] == [0.25, 0.5, 9.81]
    assert value["canbus"][10:] == [0.0, 0.0, 0.0625, 8.0, 0.0, 0.0]
    assert json.dumps(value).encode() == body


@pytest.mark.parametrize("form", list(HttpImageFormat))
def test_the_other_end_sees_what_was_seen(form: HttpImageFormat) -> None:
    sent, memory = [observed(index) for index in range(7)], ObservationHistory()
    found = [memory.observation(InferRequest.read(build_request(each, form).encoded()), tensors=True) for each in sent]
    for index, (there, here) in enumerate(zip(found, sent, strict=True)):
        assert there.index == index and there.timestamp_us == here.timestamp_us and there.command is Command.LEFT
        for name in ("position", "rotation", "velocity", "acceleration", "can_motion"):
            assert getattr(there.ego, name).tobytes() == getattr(here.ego, name).tobytes(), name
        np.testing.assert_allclose(there.ego.pose, here.ego.pose, atol=1e-12)
        assert there.ego.steering_angle is None and there.ego.source == "can_bus"
        for name, view in there.views.items():
            assert (view.load() == here.views[name].load()).all() and (view.camera.width, view.camera.height) == (8, 6)
            np.testing.assert_allclose(view.camera.intrinsic, here.views[name].camera.intrinsic)
            np.testing.assert_allclose(
                rotation_matrix(view.camera.rotation), rotation_matrix(here.views[name].camera.rotation), atol=1e-12
            )
        np.testing.assert_allclose(there.lidar.translation, here.lidar.translation)
        assert there.past_valid.tolist() == [index >= 4 - place for place in range(5)]
    assert found[6].past_poses[:, 0].tolist() == [8.0, 12.0, 16.0, 20.0, 24.0]
    assert found[1].past_poses[:, 0].tolist() == [0.0, 0.0, 0.0, 0.0, 4.0]


def test_a_picture_that_its_reader_changes_stays_as_it_was() -> None:
    there = ObservationHistory().observation(build_request(observed(), HttpImageFormat.PNG), tensors=False)
    there.views["CAM_FRONT"].load()[:] = 0
    assert (there.views["CAM_FRONT"].load() == picture(0)).all()


def test_the_sign_of_a_quaternion_survives_where_the_row_has_it() -> None:
    turned = observed(yaw=2.5)
    turned = replace(turned, ego=replace(turned.ego, rotation=-turned.ego.rotation))
    there = ObservationHistory().observation(build_request(turned, HttpImageFormat.PNG), tensors=False)
    assert there.ego.rotation.tobytes() == turned.ego.rotation.tobytes()
    # A row that means another rotation, as a CAN bus of another frame, decides nothing.
    request = build_request(turned, HttpImageFormat.PNG)
    row = request.canbus.copy()
    row[3:7] = [1.0, 0.0, 0.0, 0.0]
    there = ObservationHistory().observation(replace(request, canbus=row), tensors=False)
    np.testing.assert_allclose(there.ego.rotation, quaternion_from_yaw(np.array(2.5)), atol=1e-12)


def test_motion_that_nobody_measured_is_sent_in_the_form_of_a_row() -> None:
    unmeasured = observed()
    unmeasured = replace(unmeasured, ego=replace(unmeasured.ego, can_motion=None, source="derived"))
    row = build_request(unmeasured, HttpImageFormat.PNG).canbus
    assert row[13:].tolist() == [8.0, 0.0, 0.0] and row[12] == 0.0625 and row[7:9].tolist() == [0.25, 0.5]


def test_without_its_six_cameras_an_observation_is_refused() -> None:
    blind = observed(views={})
    with pytest.raises(InputError, match=r"CAM_FRONT .*--sensor schematic"):
        build_request(blind, HttpImageFormat.PNG)


BREAKS = {
    "no images": (("images",), None, "no images"),
    "a camera less": (("images", "CAM_BACK"), None, "images has no CAM_BACK"),
    "a number as picture": (("images", "CAM_BACK"), 7, "not base64"),
    "not base64": (("images", "CAM_BACK"), "%%%", "not base64"),
    "a picture that is none": (("images", "CAM_BACK"), "aGVsbG8=", "not a readable picture"),
    "a path as picture": (("images", "CAM_BACK"), "/etc/passwd", "not base64|not a readable picture"),
    "a flat pose": (("ego2world",), [0.0] * 16, "the shape 16, not 4 x 4"),
    "no rotation": (("ego2world",), [[2, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "not a pose"),
    "a mirror": (("ego2world",), [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "not a pose"),
    "nowhere": (("ego2world",), [[1, 0, 0, 1e300], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "m away"),
    "a short row": (("canbus",), [0.0] * 15, "the shape 15, not 16"),
    "NaN": (("canbus",), [float("nan")] * 16, "NaN"),
    "a time with a point": (("timestamp",), 1.5, "whole number"),
    "a truth as time": (("timestamp",), True, "whole number"),
    "a time before time": (("timestamp",), -1, "whole number"),
    "a fourth command": (("command",), 3, "from 0 to 2"),
    "no calibration": (("calibration",), None, "no calibration"),
    "a lens that looks nowhere": (
        ("calibration", "camera2image", "CAM_FRONT"), [[0, 0, 0], [0, 0, 0], [0, 0, 1]], "not a pinhole",
    ),
    "a lidar without a place": (("calibration", "lidar2ego"), None, "no lidar2ego"),
}  # fmt: skip


@pytest.mark.parametrize("name", BREAKS)
def test_a_request_that_cannot_be_is_refused_and_nothing_is_remembered(name: str) -> None:
    path, value, says = BREAKS[name]
    body = json.loads(build_request(observed(), HttpImageFormat.PNG).encoded())
    place = body
    for step in path[:-1]:
        place = place[step]
    if value is None:
        del place[path[-1]]
    else:
        place[path[-1]] = value
    memory = ObservationHistory()
    with pytest.raises(NeuroncapHttpError, match=says):
        memory.observation(InferRequest.read(json.dumps(body).encode()), tensors=True)
    assert memory.last_us is None


def test_members_that_the_protocol_has_not_are_passed_over() -> None:
    value = {**json.loads(build_request(observed(), HttpImageFormat.PNG).encoded()), "path": "/etc/passwd"}
    value["images"]["CAM_EXTRA"] = "/etc/passwd"
    assert list(InferRequest.read(json.dumps(value).encode()).images) == list(CAMERAS)


@pytest.mark.skipif(not SHARED.exists(), reason="the recorded sessions are not here")
@pytest.mark.parametrize("name", ["session_plain", "session_with_objects_and_dim_jitter"])
def test_recorded_requests_are_written_again_to_the_byte(name: str) -> None:
    found = 0
    for each in json.loads((SHARED / f"{name}.json").read_text())["exchanges"]:
        if each["path"] != "/infer" or each.get("left_out"):
            continue
        request = InferRequest.read(each["request_body"].encode())
        assert request.encoded().decode() == each["request_body"]
        there = ObservationHistory().observation(request, tensors=True)
        for number, view in enumerate(there.views.values()):
            rows, columns = np.indices((8, 8))
            made = np.stack([10 * (number + 1) + rows, 100 + columns, np.full((8, 8), 7)], axis=-1)
            assert (view.load() == made).all()
        # What our client makes of what our server saw is what NeuroNCAP's client sent, pictures as saved here.
        again = build_request(there, HttpImageFormat.TORCH)
        assert list(again.images) == list(request.images)
        np.testing.assert_allclose(again.ego2world, request.ego2world, atol=1e-12)
        np.testing.assert_allclose(again.canbus[7:], request.canbus[7:])
        assert (again.timestamp, again.command) == (request.timestamp, request.command)
        found += 1
    assert found >= 3


def test_saved_pictures_have_neuroncaps_members() -> None:
    pixels = picture(0)
    # As pictures from files are.
    pixels.flags.writeable = False
    text = encode_image(pixels, HttpImageFormat.TORCH)
    with zipfile.ZipFile(io.BytesIO(base64.b64decode(text, validate=True))) as archive:
        names = set(archive.namelist())
    assert {"archive/data.pkl", "archive/byteorder", "archive/data/0", "archive/version"} <= names
    assert "\n" not in text
