"""What NeuroNCAP's client takes as an answer and what it does not, and what becomes of plans on the wire."""

import json
from typing import Any

import numpy as np
import pytest

from benchmark.extensions.http.answers import ModelAnswer
from benchmark.extensions.http.values import NeuroncapHttpError
from benchmark.pdm.plan_motion import plan_to_poses
from benchmark.planning import Forecasts, Plan, PlanFrame
from tests.benchmark.extensions.http.made import SHARED

SIX = [[float(step), 0.0] for step in range(1, 7)]
TAKEN: list[tuple[str, Any, tuple[int, ...]]] = [
    ("nothing beside", {"trajectory": SIX, "aux_outputs": {}}, (6, 2)),
    ("nulls", {"trajectory": SIX, "aux_outputs": {"objects_in_bev": None, "future_trajs": None}}, (6, 2)),
    ("whole numbers", {"trajectory": [[1, 0]] * 6, "aux_outputs": {}}, (6, 2)),
    ("a third column", {"trajectory": [[1.0, 0.0, 0.1]] * 6, "aux_outputs": {}}, (6, 3)),
    ("four waypoints", {"trajectory": SIX[:4], "aux_outputs": {}}, (4, 2)),
    ("none", {"trajectory": [], "aux_outputs": {}}, (0,)),
    ("NaN", {"trajectory": [[float("nan"), 0.0]] * 2, "aux_outputs": {}}, (2, 2)),
    (
        "lists of different lengths",
        {"trajectory": SIX, "aux_outputs": {"objects_in_bev": [[1, 2, 3, 4, 5]], "object_scores": [0.1, 0.2]}},
        (6, 2),
    ),
    ("more than is known", {"trajectory": SIX, "aux_outputs": {"segmentation": [[1.0]]}, "more": 1}, (6, 2)),
]
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
    ("an empty list", {"trajectory": SIX, "aux_outputs": {"objects_in_bev": []}}, "or null"),
    ("classes that are none", {"trajectory": SIX, "aux_outputs": {"object_classes": [1]}}, "not a list of strings"),
    ("a list", [SIX], "not a JSON object"),
    ("a text", "plan", "not a JSON object"),
]


def read(value: Any) -> ModelAnswer:
    return ModelAnswer.read(json.dumps(value).encode())


@pytest.mark.parametrize(("_", "value", "shape"), TAKEN, ids=[name for name, _, _ in TAKEN])
def test_what_the_client_takes(_: str, value: Any, shape: tuple[int, ...]) -> None:
    assert read(value).trajectory.shape == shape


@pytest.mark.parametrize(("_", "value", "says"), NOT_TAKEN, ids=[name for name, _, _ in NOT_TAKEN])
def test_what_the_client_does_not_take(_: str, value: Any, says: str) -> None:
    with pytest.raises(NeuroncapHttpError, match=says):
        read(value)


@pytest.mark.parametrize("body", [b"", b"Internal Server Error", b"[" * 100_000, b'{"trajectory": ', b"\xff\xfe"])
def test_what_is_no_json(body: bytes) -> None:
    with pytest.raises(NeuroncapHttpError, match="not valid JSON"):
        ModelAnswer.read(body)


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
        assert client["accepted"], each["answer"]
        shapes = [list(array.shape) for array in (found.trajectory, found.objects, found.futures)]
        assert shapes == [client["trajectory_shape"], client["objects_shape"], client["future_shape"]], each["answer"]
        assert list(found.classes) == client["classes"]


@pytest.mark.parametrize("name", ["four waypoints", "none", "NaN"])
def test_what_is_taken_and_cannot_be_driven_is_no_plan(name: str) -> None:
    value = next(value for known, value, _ in TAKEN if known == name)
    with pytest.raises(NeuroncapHttpError, match="a plan"):
        read(value).plan()


def test_of_a_third_column_nothing_is_driven() -> None:
    plan = read({"trajectory": [[1.0, 2.0, 0.1]] * 6, "aux_outputs": {}}).plan()
    assert plan.waypoints.tolist() == [[1.0, 2.0]] * 6 and plan.frame is PlanFrame.EGO and plan.forecasts is None


def test_a_plan_survives_the_wire_to_the_last_bit() -> None:
    waypoints = np.cumsum(np.random.default_rng(3).normal(1.7, 0.4, (6, 2)), axis=0)
    there = ModelAnswer.of_plan(Plan(waypoints, PlanFrame.EGO), 0.94)
    assert ModelAnswer.read(there.encoded()).plan().waypoints.tobytes() == waypoints.tobytes()


def test_a_plan_of_the_lidar_is_sent_as_the_engines_read_it() -> None:
    plan = Plan(np.column_stack([0.2 * np.arange(6.0) ** 2, 4.0 * np.arange(1, 7)]), PlanFrame.LIDAR)
    back = ModelAnswer.read(ModelAnswer.of_plan(plan, 0.94).encoded()).plan()
    assert back.waypoints.tobytes() == np.ascontiguousarray(plan_to_poses(plan, 0.94)[:, :2]).tobytes()
    # To the right of the car is y below zero.
    assert back.waypoints[-1, 0] > 20.0 and back.waypoints[-1, 1] < -3.0


def test_of_a_longer_plan_six_waypoints_are_sent() -> None:
    longer = Plan(np.column_stack([4.0 * np.arange(1, 13), np.zeros(12)]), PlanFrame.EGO)
    assert ModelAnswer.of_plan(longer, 0.94).trajectory.shape == (6, 2)


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
