"""A planner behind the wire, without sockets: resets, time that goes back, what is refused, what is recorded."""

import json
from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.http.session import PlannerSession, PlanRequestError, build_request
from benchmark.extensions.http.values import HttpImageFormat
from benchmark.planning import Observation, Plan, PlanFrame, SceneInfo
from tests.benchmark.extensions.http.made import SHARED, Looking, observed
from tests.benchmark.planners import Remembering


def body(index: int, form: HttpImageFormat = HttpImageFormat.PNG) -> bytes:
    return build_request(observed(index), form).encoded()


def test_a_scene_is_planned_in_order_and_forgotten_at_reset() -> None:
    planner = Looking()
    session = PlannerSession(planner)
    assert session.reset() == b"true"
    first = [session.infer(body(index)) for index in range(3)]
    assert [each.index for each in planner.seen] == [0, 1, 2]
    session.reset()
    assert [session.infer(body(index)) for index in range(3)] == first and planner.resets == 2


def test_whoever_does_not_reset_begins_a_scene_all_the_same() -> None:
    planner = Looking()
    PlannerSession(planner).infer(body(4))
    assert planner.resets == 1 and planner.seen[0].index == 0


@pytest.mark.parametrize("later", [2, 1, 0])
def test_a_time_that_does_not_go_on_is_refused_and_not_planned(later: int) -> None:
    planner = Looking()
    session = PlannerSession(planner)
    session.infer(body(2))
    with pytest.raises(PlanRequestError, match="post /reset") as refused:
        session.infer(body(later))
    assert refused.value.status == 409 and len(planner.seen) == 1
    session.infer(body(3))
    assert len(planner.seen) == 2


def test_saved_tensors_want_a_flag_and_the_refusal_names_it() -> None:
    with pytest.raises(PlanRequestError, match="--accept-torch-tensors") as refused:
        PlannerSession(Looking()).infer(body(0, HttpImageFormat.TORCH))
    assert refused.value.status == 415
    tensors = PlannerSession(Looking(), tensors=True).infer(body(0, HttpImageFormat.TORCH))
    assert tensors == PlannerSession(Looking()).infer(body(0))


def test_what_cannot_be_read_has_a_status_of_its_own() -> None:
    with pytest.raises(PlanRequestError, match="not valid JSON") as refused:
        PlannerSession(Looking()).infer(b"{")
    assert refused.value.status == 422


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


def test_who_sees_more_than_the_wire_has_is_not_served() -> None:
    from adapters.registry import build_planner

    for name in ("idm", "log-replay", "constant-velocity-on-path"):
        with pytest.raises(InputError, match="which requests do not carry"):
            PlannerSession(build_planner(name))

    class Continuous(Looking):
        memory_crosses_scenes = True

        def begin_run(self) -> None:
            pass

    with pytest.raises(InputError, match="keeps state across scenes"):
        PlannerSession(Continuous())


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
