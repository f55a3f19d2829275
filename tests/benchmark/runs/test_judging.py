"""Verdicts beside plans: the same whatever is judged with a sample, none where there is no plan."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import InputError
from benchmark.metrics.places import PlaceKind, SampleContext
from benchmark.planning import Forecasts, Observation, Plan, PlanFrame
from benchmark.protocols import PROTOCOLS
from benchmark.records.row_schema import SampleRow
from benchmark.runs.judging import judge_plans, parse_plan
from benchmark.runs.plan_rows import plan_scene
from benchmark.runs.scene_reading import SceneReading
from benchmark.scene import Scene
from benchmark.truth import SampleTruth
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.planners import Failing, Straight
from tests.hand_made import Car, scene_on_straight_road

ALL = tuple(PROTOCOLS)
DATA = town_of_two(slow_leader=True)
SCENE = "scene-9902"
Rows = list[dict[str, Any]]
Truths = tuple[SampleTruth, ...]


class Known(SceneReading):
    """A scene of which so much is known as a test says; without a map unless it says otherwise."""

    def __init__(self, truths: Sequence[SampleTruth], scene: Scene | None = None) -> None:
        self.truth = tuple(truths)
        self.mapped = self.recording = scene
        self.around = tuple(SampleContext(PlaceKind.BEND, 0.0) for _ in truths)


def judge(
    rows: Sequence[dict[str, Any]], truths: Sequence[SampleTruth], protocols: Sequence[str], scene: Scene | None = None
) -> list[SampleRow]:
    return judge_plans([rows], Known(truths, scene), protocols)[0]


class Foreseeing(Straight):
    """Expects two others to stay where they are."""

    name = "foreseeing"

    def __init__(self, forecasts: Any = None) -> None:
        super().__init__()
        self.forecasts = forecasts or Forecasts(
            np.array([[9.0, 0.0, 4.5, 2.0, 0.0], [30.0, 3.0, 4.5, 2.0, 0.0]]),
            np.tile([[[9.0, 0.0]], [[30.0, 3.0]]], (1, 1, 6)).reshape(2, 1, 6, 2),
            np.ones((2, 1)),
        )

    def plan(self, observation: Observation) -> Plan:
        return Plan(super().plan(observation).waypoints, PlanFrame.EGO, forecasts=self.forecasts)


def planned(planner: Straight, tmp_path: Any) -> Rows:
    return plan_scene(planner, DATA, SCENE, tmp_path / "rows.jsonl", "key", fresh=True).rows


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Rows:
    return planned(Failing(), tmp_path_factory.mktemp("judging"))


@pytest.fixture(scope="module")
def truths() -> Truths:
    return DATA.truth(SCENE)


def test_every_protocol_gives_the_outcomes_that_it_gives_alone(rows: Rows, truths: Truths) -> None:
    together = judge(rows, truths, ALL)
    for name in ALL:
        alone = judge(rows, truths, (name,))
        assert [row.outcomes.get(name) for row in together] == [row.outcomes.get(name) for row in alone]
    by_hand = PROTOCOLS["uniad"].evaluate(
        [truths[0]], np.array([parse_plan(rows[0]["plan"]).waypoints_in_lidar(truths[0].lidar_ahead_m)])
    )
    assert together[0].outcomes["uniad"].model_dump() == by_hand.as_rows()[0]


def test_a_sample_is_judged_alike_in_any_company(rows: Rows, truths: Truths) -> None:
    whole = judge(rows, truths, ALL)

    @settings(max_examples=15, deadline=None)
    @given(st.lists(st.integers(0, 15), unique=True))
    def judged_alike(places: list[int]) -> None:
        some = judge([rows[place] for place in places], [truths[place] for place in places], ALL)
        assert some == [whole[place] for place in places]

    judged_alike()


def test_a_sample_without_a_plan_has_no_verdict(rows: Rows, truths: Truths) -> None:
    judged = judge(rows, truths, ALL)
    assert [row.index for row in judged if not row.outcomes] == [3]
    assert judged[3].status == "failed" and judged[3].diagnosis is None and judged[3].disagreements == {}
    assert judged[3].complete and judged[3].error
    nothing = [{**row, "plan": None, "status": "failed", "error": "no weights"} for row in rows]
    assert all(row.outcomes == {} for row in judge(nothing, truths, ALL))


def test_what_is_diagnosed_is_what_exact_calls_a_collision(rows: Rows, truths: Truths) -> None:
    judged = [row for row in judge(rows, truths, ALL) if row.outcomes]
    hits = [any(row.outcomes["exact"].collision or ()) for row in judged]
    assert any(hits) and not all(hits)
    assert [row.diagnosis is not None for row in judged] == hits
    without = judge(rows, truths, ("uniad", "vad"))
    assert all(row.diagnosis is None and row.disagreements == {} for row in without)
    assert all(set(row.outcomes) <= {"uniad", "vad"} for row in without)


def test_plans_are_severe_where_they_touch_somebody(rows: Rows, truths: Truths) -> None:
    judged = judge(rows, truths, ("exact",), scene=DATA.scene(SCENE))
    assert judged[3].severity is None and judged[3].status == "failed"
    touched = [row for row in judged if row.severity is not None and row.severity.contact is not None]
    # Later the recorded ego itself is inside the leader: no plan can be blamed for that.
    diagnosed = [row.index for row in judged if row.diagnosis is not None and row.diagnosis.first_contact_s > 0.1]
    assert [row.index for row in touched] == diagnosed and diagnosed
    for row in touched:
        assert row.severity is not None and row.severity.contact is not None and row.diagnosis is not None
        assert (row.severity.contact.agent, row.severity.contact.time_s) == (
            row.diagnosis.hit,
            row.diagnosis.first_contact_s,
        )
        # The ego runs into a slow leader at 8 m/s.
        assert row.severity.contact.kind == "front" and row.severity.contact.impact_speed_m_s == pytest.approx(6.0)
        assert row.severity.contact.at_fault is True and row.severity.near is None
        fault = row.severity.contact.fault
        assert fault is not None and (fault.verdict, fault.reason) == ("ego", "rear-end")


def test_who_comes_from_the_side_is_nobodys_fault_without_a_map(tmp_path: Any) -> None:
    """The other changes into the ego's lane from the left while the ego drives in the middle of its own."""
    data = FakeData({"side": scene_on_straight_road((Car(50.0, 204.25, 9.0, -0.12),), name="side", ego_speed=9.0)})
    made = plan_scene(Straight(), data, "side", tmp_path / "rows.jsonl", "key", fresh=True).rows
    found = {}
    for scene in (None, data.scene("side")):
        judged = judge(made, data.truth("side"), ("exact",), scene=scene)
        contacts = [row.severity.contact for row in judged if row.severity is not None and row.severity.contact]
        found[scene is None] = [contact.at_fault for contact in contacts if contact.kind == "lateral"]
        if scene is not None:
            told = {contact.fault and (contact.fault.verdict, contact.fault.reason) for contact in contacts}
            assert told == {("other", "lane-change")}
    assert found[True] and set(found[True]) == {None} and set(found[False]) == {False}


def test_forecasts_reach_the_diagnosis_and_the_record(tmp_path: Any, truths: Truths) -> None:
    judged = judge(planned(Foreseeing(), tmp_path), truths, ALL)
    assert all(row.plan is not None and row.plan.forecasts is not None for row in judged)
    causes = {row.diagnosis.cause for row in judged if row.diagnosis is not None}
    assert causes and "not attributable" not in causes


@pytest.mark.parametrize(
    "forecasts",
    [
        Forecasts(np.zeros((0, 5)), np.zeros((0, 1, 6, 2)), np.zeros((0, 1))),
        Forecasts(np.zeros((0, 5)), np.zeros((0, 6, 2)), np.zeros(0)),
    ],
)
def test_forecasts_of_nobody_are_forecasts(forecasts: Forecasts, tmp_path: Any, truths: Truths) -> None:
    rows = planned(Foreseeing(forecasts), tmp_path)
    assert rows[0]["plan"]["forecasts"] == {"boxes": [], "trajectories": [], "scores": []}
    again = parse_plan(rows[0]["plan"]).forecasts
    assert again is not None and again.boxes.shape == (0, 5) and again.trajectories.shape[2:] == (6, 2)
    assert len(judge(rows, truths, ALL)) == 16


@pytest.mark.parametrize(
    ("forecasts", "says"),
    [
        (Forecasts(np.zeros((2, 7)), np.zeros((2, 1, 6, 2)), np.ones((2, 1))), "forecast boxes have shape"),
        (Forecasts(np.zeros((2, 5)), np.zeros((2, 1, 12, 2)), np.ones((2, 1))), "forecast trajectories have shape"),
        (Forecasts(np.zeros((2, 5)), np.zeros((2, 1, 6, 2)), np.ones((1, 1))), "forecast scores have shape"),
        (Forecasts(np.full((2, 5), np.nan), np.zeros((2, 1, 6, 2)), np.ones((2, 1))), "must be finite"),
        (Forecasts(np.zeros((2, 5)), np.zeros(2), np.ones((2, 1))), "Error"),
        (Forecasts(np.zeros((2, 5)), np.zeros((2, 0, 6, 2)), np.ones((2, 0))), "at least one mode"),
    ],
)
def test_forecasts_of_another_form_are_the_planners_failure(forecasts: Forecasts, says: str, tmp_path: Any) -> None:
    rows = planned(Foreseeing(forecasts), tmp_path)
    assert all(row["status"] == "failed" and says in row["error"] for row in rows)


def test_a_plan_reads_back_as_it_was_given(tmp_path: Any) -> None:
    class Multimodal(Straight):
        def plan(self, observation: Observation) -> Plan:
            one = super().plan(observation).waypoints
            return Plan(one, PlanFrame.LIDAR, np.stack([one, 2 * one]), np.array([0.7, 0.3]))

    plan = parse_plan(planned(Multimodal(), tmp_path)[0]["plan"])
    assert plan.frame is PlanFrame.LIDAR and plan.forecasts is None
    assert plan.modes is not None and np.array_equal(plan.modes[1], 2 * plan.waypoints)
    assert plan.mode_scores is not None and plan.mode_scores.tolist() == [0.7, 0.3]


@pytest.mark.parametrize(
    "damage",
    [
        {"modes": [[[1.0, 2.0]], [[1.0]]]},
        {"waypoints": [[1.0, 0.0]] * 5},
        {"forecasts": {"boxes": [[0.0] * 5], "trajectories": [[]], "scores": [[]]}},
        {"forecasts": {"boxes": [[0.0] * 4], "trajectories": [[[[0.0, 0.0]] * 6]], "scores": [[1.0]]}},
        {"forecasts": {"boxes": [[0.0] * 5], "trajectories": [], "scores": [[1.0]]}},
    ],
)
def test_a_stored_plan_of_another_form_is_one_sentence(damage: dict[str, Any], rows: Rows) -> None:
    with pytest.raises(InputError, match=r"waypoints|a stored plan cannot be read"):
        parse_plan({**rows[0]["plan"], **damage})


def test_other_samples_and_unknown_protocols_are_refused(rows: Rows, truths: Truths) -> None:
    with pytest.raises(ValueError, match="do not have the same samples"):
        judge(rows[1:], truths, ALL)
    with pytest.raises(InputError, match="unknown protocol"):
        judge(rows, truths, ("nonsense",))
    assert judge([], [], ALL) == []


class Swerving(Straight):
    """Leaves to the left, for 8 s."""

    name = "swerving"

    def plan(self, observation: Observation) -> Plan:
        seconds = 0.5 * np.arange(1, 17)
        return Plan(np.column_stack([6.0 * seconds, 0.4 * seconds**2]), PlanFrame.EGO)


class InLidar(Straight):
    """The same way as `Straight`, said of the lidar."""

    name = "in-lidar"

    def plan(self, observation: Observation) -> Plan:
        waypoints = super().plan(observation).waypoints
        return Plan(waypoints[:, ::-1] * [-1.0, 1.0], PlanFrame.LIDAR)


def test_planners_that_are_judged_together_get_the_rows_that_they_get_alone(tmp_path: Any) -> None:
    reading = SceneReading(DATA, SCENE)
    planners = (Failing(), Foreseeing(), Swerving(), InLidar(), Straight())
    rows_of = [planned(planner, tmp_path / planner.name) for planner in planners]
    alone = [judge_plans([rows], SceneReading(DATA, SCENE), ALL)[0] for rows in rows_of]
    assert any(row.driving is not None and row.driving.ec is not None for row in alone[1])
    assert any(row.longer is not None for row in alone[2])
    assert judge_plans(rows_of, reading, ALL) == alone
    assert judge_plans(rows_of[::-1], reading, ALL) == alone[::-1]
    assert judge_plans([], reading, ALL) == []
