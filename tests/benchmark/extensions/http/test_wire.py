"""Observations and answers on the wire, without sockets: exact requests, what is taken, refused and recorded."""

import base64
import io
import json
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark import api
from benchmark.errors import InputError
from benchmark.extensions.http.answers import ModelAnswer
from benchmark.extensions.http.requests import CAMERAS, InferRequest
from benchmark.extensions.http.session import ObservationHistory, PlannerSession, PlanRequestError, build_request
from benchmark.extensions.http.values import HttpImageFormat, NeuroncapHttpError, encode_image
from benchmark.geometry import quaternion_from_yaw, rotation_matrix
from benchmark.pdm.plan_motion import plan_to_poses
from benchmark.planning import Command, Forecasts, Observation, Plan, PlanFrame, SceneInfo
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.cli.test_supervised_planners import MORTAL
from tests.benchmark.closed_loop.seeing import Looking, picture
from tests.benchmark.extensions.http.made import SHARED, START_US, observed
from tests.benchmark.planners import Remembering


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


def test_motion_that_nobody_measured_is_sent_and_six_cameras_are_asked_for() -> None:
    with pytest.raises(InputError, match=r"CAM_FRONT .*--sensor schematic"):
        build_request(observed(views={}), HttpImageFormat.PNG)
    unmeasured = observed()
    unmeasured = replace(unmeasured, ego=replace(unmeasured.ego, can_motion=None, source="derived"))
    row = build_request(unmeasured, HttpImageFormat.PNG).canbus
    assert row[13:].tolist() == [8.0, 0.0, 0.0] and row[12] == 0.0625 and row[7:9].tolist() == [0.25, 0.5]


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
    body = {**json.loads(build_request(observed(), HttpImageFormat.PNG).encoded()), "path": "/etc/passwd"}
    body["images"]["CAM_EXTRA"] = "/etc/passwd"
    # Members that the protocol has not are passed over.
    assert list(InferRequest.read(json.dumps(body).encode()).images) == list(CAMERAS)
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


SIX = [[float(step), 0.0] for step in range(1, 7)]
AUX = ("objects_in_bev", "object_classes", "object_scores", "object_ids", "future_trajs")
UNEVEN = {"objects_in_bev": [[1, 2, 3, 4, 5]], "object_scores": [0.1, 0.2]}
TAKEN: list[tuple[str, Any, tuple[int, ...]]] = [
    ("nothing beside", {"trajectory": SIX, "aux_outputs": {}}, (6, 2)),
    ("nulls", {"trajectory": SIX, "aux_outputs": {"objects_in_bev": None, "future_trajs": None}}, (6, 2)),
    ("empty lists", {"trajectory": SIX, "aux_outputs": {name: [] for name in AUX}}, (6, 2)),
    ("whole numbers", {"trajectory": [[1, 0]] * 6, "aux_outputs": {}}, (6, 2)),
    ("a third column", {"trajectory": [[1.0, 0.0, 0.1]] * 6, "aux_outputs": {}}, (6, 3)),
    ("four waypoints", {"trajectory": SIX[:4], "aux_outputs": {}}, (4, 2)),
    ("none", {"trajectory": [], "aux_outputs": {}}, (0,)),
    ("NaN", {"trajectory": [[float("nan"), 0.0]] * 2, "aux_outputs": {}}, (2, 2)),
    ("lists of different lengths", {"trajectory": SIX, "aux_outputs": UNEVEN}, (6, 2)),
    ("more than is known", {"trajectory": SIX, "aux_outputs": {"segmentation": [[1.0]]}, "more": 1}, (6, 2)),
]
NO_JSON = (b"", b"Internal Server Error", b"[" * 100_000, b'{"trajectory": ', b"\xff\xfe")
NOT_TAKEN: list[tuple[str, Any, str]] = [
    ("no trajectory", {"aux_outputs": {}}, "has no trajectory"),
    ("nothing beside it", {"trajectory": SIX}, "has no aux_outputs"),
    ("null beside it", {"trajectory": SIX, "aux_outputs": None}, "write {}"),
    ("ragged", {"trajectory": [[1.0, 0.0], [2.0]], "aux_outputs": {}}, "not a rectangular list"),
    ("null in it", {"trajectory": [[1.0, None]] * 6, "aux_outputs": {}}, "not a number"),
    ("text in it", {"trajectory": [["1", "2"]] * 6, "aux_outputs": {}}, "not a number"),
    ("truth in it", {"trajectory": [[True, 0]] * 6, "aux_outputs": {}}, "not a number"),
    ("a number beyond numbers", {"trajectory": [[10**400, 0]] * 6, "aux_outputs": {}}, "not a rectangular list"),
    ("objects of four", {"trajectory": SIX, "aux_outputs": {"objects_in_bev": [[1, 2, 3, 4]]}}, "N x 5"),
    ("an empty object", {"trajectory": SIX, "aux_outputs": {"objects_in_bev": [[]]}}, "or null"),
    ("classes that are none", {"trajectory": SIX, "aux_outputs": {"object_classes": [1]}}, "not a list of strings"),
    ("a list", [SIX], "not a JSON object"),
    ("a text", "plan", "not a JSON object"),
    *((f"no JSON: {body[:9]!r}", body, "not valid JSON") for body in NO_JSON),
]


def read(value: Any) -> ModelAnswer:
    return ModelAnswer.read(json.dumps(value).encode())


@pytest.mark.parametrize(("_", "value", "shape"), TAKEN, ids=[name for name, _, _ in TAKEN])
def test_what_the_client_takes(_: str, value: Any, shape: tuple[int, ...]) -> None:
    answer = read(value)
    assert answer.trajectory.shape == shape and answer.objects.shape[1:] == (5,)


@pytest.mark.parametrize(("_", "value", "says"), NOT_TAKEN, ids=[name for name, _, _ in NOT_TAKEN])
def test_what_the_client_does_not_take(_: str, value: Any, says: str) -> None:
    with pytest.raises(NeuroncapHttpError, match=says):
        ModelAnswer.read(value if isinstance(value, bytes) else json.dumps(value).encode())


NOTHING_DETECTED = {"objects_shape": [0, 5], "future_shape": [0, 0, 0, 2], "classes": []}


@pytest.mark.skipif(not SHARED.exists(), reason="the recorded reactions are not here")
def test_all_recorded_reactions_of_the_official_client() -> None:
    recorded = json.loads((SHARED / "client_reactions.json").read_text())["reactions"]
    assert len(recorded) == 18
    for each in recorded:
        body, client = each["body"], each["client"]
        try:
            found = ModelAnswer.read((body if isinstance(body, str) else json.dumps(body)).encode())
        except NeuroncapHttpError:
            assert not client["accepted"], each["answer"]
            continue
        if each["answer"] == "objects_empty_list":
            # Its client refuses what servers of the forks may answer.
            client = {"accepted": True, "trajectory_shape": [6, 2], **NOTHING_DETECTED}
        assert client["accepted"], each["answer"]
        shapes = [list(array.shape) for array in (found.trajectory, found.objects, found.futures)]
        assert shapes == [client["trajectory_shape"], client["objects_shape"], client["future_shape"]], each["answer"]
        assert list(found.classes) == client["classes"]


def test_what_is_taken_and_cannot_be_driven_is_no_plan() -> None:
    values = {name: value for name, value, _ in TAKEN}
    for name in ("four waypoints", "none", "NaN"):
        with pytest.raises(NeuroncapHttpError, match="a plan"):
            read(values[name]).plan()
    # Of a third column nothing is driven.
    plan = read({"trajectory": [[1.0, 2.0, 0.1]] * 6, "aux_outputs": {}}).plan()
    assert plan.waypoints.tolist() == [[1.0, 2.0]] * 6 and plan.frame is PlanFrame.EGO and plan.forecasts is None


def test_a_plan_survives_the_wire_to_the_last_bit() -> None:
    waypoints = np.cumsum(np.random.default_rng(3).normal(1.7, 0.4, (6, 2)), axis=0)
    there = ModelAnswer.of_plan(Plan(waypoints, PlanFrame.EGO), 0.94)
    assert ModelAnswer.read(there.encoded()).plan().waypoints.tobytes() == waypoints.tobytes()
    # Of a longer plan six waypoints are sent.
    longer = Plan(np.vstack([waypoints, waypoints + 20.0]), PlanFrame.EGO)
    assert (ModelAnswer.of_plan(longer, 0.94).trajectory == waypoints).all()


def test_a_plan_of_the_lidar_is_sent_as_the_engines_read_it() -> None:
    plan = Plan(np.column_stack([0.2 * np.arange(6.0) ** 2, 4.0 * np.arange(1, 7)]), PlanFrame.LIDAR)
    back = ModelAnswer.read(ModelAnswer.of_plan(plan, 0.94).encoded()).plan()
    assert back.waypoints.tobytes() == np.ascontiguousarray(plan_to_poses(plan, 0.94)[:, :2]).tobytes()
    # To the right of the car is y below zero.
    assert back.waypoints[-1, 0] > 20.0 and back.waypoints[-1, 1] < -3.0


@pytest.mark.parametrize("frame", list(PlanFrame))
def test_forecasts_come_back_in_the_ego_frame(frame: PlanFrame) -> None:
    boxes = np.array([[2.0, 15.0, 4.5, 1.9, np.pi / 2]])
    ways = boxes[0, :2] + np.array([[[0.0, step] for step in range(1, 7)], [[step, 0.0] for step in range(1, 7)]])
    forecasts = Forecasts(boxes, ways[None], np.array([[0.7, 0.3]]))
    plan = Plan(np.ones((6, 2)), frame, forecasts=forecasts)
    back = ModelAnswer.read(ModelAnswer.of_plan(plan, 0.94).encoded()).plan().forecasts
    assert back is not None and back.scores.tolist() == [[0.5, 0.5]]
    if frame is PlanFrame.EGO:
        wanted, moved = boxes, ways[None]
    else:
        # 2 m right and 15 m ahead of the lidar, looking ahead, driving on or to the right.
        wanted = np.array([[15.94, -2.0, 4.5, 1.9, 0.0]])
        moved = wanted[0, :2] + np.array([[[[s, 0.0] for s in range(1, 7)], [[0.0, -s] for s in range(1, 7)]]])
    np.testing.assert_allclose(back.boxes, wanted, atol=1e-12)
    np.testing.assert_allclose(back.trajectories, moved, atol=1e-12)


def test_forecasts_that_say_nothing_are_left_out_and_the_plan_stays() -> None:
    aux = {"objects_in_bev": [[1, 2, 4, 2, 0]], "future_trajs": [[[[0.0, 0.0]] * 5]]}
    assert read({"trajectory": SIX, "aux_outputs": aux}).plan().forecasts is None
    aux = {"objects_in_bev": [[1, 2, -4, 2, 0]], "future_trajs": [[[[0.0, 0.0]] * 6]]}
    assert read({"trajectory": SIX, "aux_outputs": aux}).plan().forecasts is None


def body(index: int, form: HttpImageFormat = HttpImageFormat.PNG) -> bytes:
    return build_request(observed(index), form).encoded()


@pytest.mark.path
def test_a_scene_is_planned_in_order_and_forgotten_at_reset() -> None:
    planner = Looking()
    session = PlannerSession(planner)
    assert session.reset() == b"true"
    first = [session.infer(body(index)) for index in range(3)]
    assert [each.index for each in planner.seen] == [0, 1, 2]
    session.reset()
    assert [session.infer(body(index)) for index in range(3)] == first and planner.resets == 2


def test_a_time_that_does_not_go_on_is_refused_and_not_planned() -> None:
    planner = Looking()
    session = PlannerSession(planner)
    session.infer(body(2))
    # Whoever does not reset begins a scene all the same.
    assert planner.resets == 1 and planner.seen[0].index == 0
    for later in (2, 1, 0):
        with pytest.raises(PlanRequestError, match="post /reset") as refused:
            session.infer(body(later))
        assert refused.value.status == 409 and len(planner.seen) == 1
    session.infer(body(3))
    assert len(planner.seen) == 2


def test_saved_tensors_want_a_flag_and_what_cannot_be_read_has_a_status_of_its_own() -> None:
    with pytest.raises(PlanRequestError, match="not valid JSON") as refused:
        PlannerSession(Looking()).infer(b"{")
    assert refused.value.status == 422
    with pytest.raises(PlanRequestError, match="--accept-torch-tensors") as refused:
        PlannerSession(Looking()).infer(body(0, HttpImageFormat.TORCH))
    assert refused.value.status == 415
    tensors = PlannerSession(Looking(), tensors=True).infer(body(0, HttpImageFormat.TORCH))
    assert tensors == PlannerSession(Looking()).infer(body(0))


def test_what_draws_from_global_generators_draws_the_same_after_each_reset() -> None:
    session, answers = PlannerSession(Remembering()), []
    for _ in range(2):
        session.reset()
        answers.append([session.infer(body(index)) for index in range(3)])
    assert answers[0] == answers[1] and answers[0][0] != answers[0][1]


class Faulty(Looking):
    """Does something wrong."""

    name = "faulty"

    def __init__(self, fault: str) -> None:
        super().__init__()
        self.fault = fault

    def reset(self, scene: SceneInfo) -> None:
        if self.fault == "resets badly":
            raise RuntimeError("not today")

    def plan(self, observation: Observation) -> Any:
        if self.fault == "raises":
            raise RuntimeError("no idea\nat all")
        if self.fault == "exits":
            raise SystemExit(0)
        if self.fault == "answers nothing":
            return None
        if self.fault == "answers NaN":
            plan = Plan(np.ones((6, 2)), PlanFrame.EGO)
            plan.waypoints[0, 0] = np.nan
            return plan
        return super().plan(observation)


@pytest.mark.parametrize(
    ("fault", "says"),
    [
        ("raises", "RuntimeError: no idea$"),
        ("exits", "SystemExit: 0"),
        ("answers nothing", "answered NoneType"),
        ("answers NaN", "ValueError"),
        ("resets badly", "not today"),
    ],
)
def test_a_planner_that_fails_is_a_sentence_and_the_next_is_answered(
    fault: str, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    planner = Faulty(fault)
    session = PlannerSession(planner)
    with pytest.raises(PlanRequestError, match=says) as refused:
        session.reset()
        session.infer(body(0))
    assert refused.value.status == 500 and "faulty failed to" in str(refused.value)
    assert "Traceback" not in capsys.readouterr().err
    planner.fault = ""
    session.infer(body(1))


class Recorded(Looking):
    """The scripted model of the recorded sessions: its own speed, a little further aside at each call."""

    name = "recorded"

    def plan(self, observation: Observation) -> Plan:
        self.seen.append(observation)
        ahead = 0.5 * float(observation.ego.velocity[0]) * np.arange(1, 7)
        return Plan(np.column_stack([ahead, 0.02 * self.calls * np.arange(1, 7)]), PlanFrame.EGO)

    calls = 0


@pytest.mark.skipif(not SHARED.exists(), reason="the recorded sessions are not here")
@pytest.mark.parametrize("name", ["session_plain", "session_with_objects_and_dim_jitter"])
def test_recorded_sessions_are_answered_to_the_byte(name: str) -> None:
    planner, asked = Recorded(), 0
    session = PlannerSession(planner, tensors=True)
    for each in json.loads((SHARED / f"{name}.json").read_text())["exchanges"]:
        if each["path"] == "/reset":
            assert session.reset().decode() == each["response_body"]
        if each["path"] != "/infer":
            continue
        planner.calls += 1
        if each.get("left_out"):
            continue
        answer = session.infer(each["request_body"].encode()).decode()
        asked += 1
        if name == "session_plain":
            assert answer == each["response_body"]
        # Our planners tell no class, score or number of objects: of these sessions the plan alone is the same.
        found, recorded = json.loads(answer), json.loads(each["response_body"])
        assert json.dumps(found["trajectory"]) == json.dumps(recorded["trajectory"])
        assert list(found) == list(recorded) and list(found["aux_outputs"]) == list(recorded["aux_outputs"])
    assert asked >= 3


def test_a_served_planner_that_dies_is_an_answer_and_the_next_reset_begins_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "mortal_planner.py").write_text(MORTAL)
    monkeypatch.syspath_prepend(str(tmp_path))
    planner = api.load_planner("mortal_planner:Mortal")()
    session = PlannerSession(planner)
    assert session.reset() == b"true"
    planner.close()  # type: ignore[attr-defined]
    with pytest.raises(PlanRequestError):
        session.infer(b"{}")
    assert session.reset() == b"true"
    planner.close()  # type: ignore[attr-defined]


def test_limits_are_of_planners_of_other_packages() -> None:
    assert "--sample-limit is of planners" in refusal("serve", "--model", "stop", "--sample-limit", "5")
