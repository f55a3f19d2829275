"""Unseen, misforecast or misplanned: every branch of the rule on cases made by hand, and against a slow oracle."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from benchmark.geometry import Bools, Floats, boxes_overlap
from benchmark.metrics.diagnosis import DiagnosisReason, build_forecast_boxes, diagnose, match_forecasts, to_lidar_frame
from benchmark.planning import Forecasts, Plan, PlanFrame
from benchmark.protocols.contract import ProtocolOutcomes
from benchmark.protocols.exact import ExactProtocol
from benchmark.records.row_schema import DiagnosisRow
from benchmark.truth import SampleTruth
from tests.benchmark.metrics.slow_diagnosis import slow_reason
from tests.benchmark.metrics.test_disagreement import truth as empty_truth

AHEAD_M = 0.94
STRAIGHT = np.column_stack([np.zeros(6), 4.0 * np.arange(1, 7)])
CAR, BUS, WALKER = (4.6, 1.9), (11.0, 2.9), (0.7, 0.7)
NORTH = np.pi / 2


def truth(boxes: Floats, annotated: Bools | None = None, *, valid: int = 6) -> SampleTruth:
    """Boxes (M, 7, 5) around an ego that was recorded driving straight on."""
    boxes = np.asarray(boxes, np.float64).reshape(-1, 7, 5)
    there = np.ones(boxes.shape[:2], dtype=np.bool_) if annotated is None else annotated
    return replace(
        empty_truth(recorded=STRAIGHT, valid=valid),
        instances=tuple(f"object-{row}" for row in range(len(boxes))),
        categories=("vehicle.car",) * len(boxes),
        boxes=boxes,
        annotated=there,
        has_points=there,
        has_lidar_points=there,
    )


def moving(
    x: float, y: float, vx: float = 0.0, vy: float = 0.0, size: tuple[float, float] = CAR, yaw: float = NORTH
) -> Floats:
    """(7, 5) boxes at constant velocity."""
    seconds = 0.5 * np.arange(7)
    return np.column_stack([x + vx * seconds, y + vy * seconds, np.tile([*size, yaw], (7, 1))])


def expecting(*tracks: Floats | Sequence[Floats], scores: Sequence[Sequence[float]] | None = None) -> Forecasts:
    """Forecasts from tracks (7, 5); a list of tracks is one agent with several modes."""
    agents = [[track] if isinstance(track, np.ndarray) else list(track) for track in tracks]
    return Forecasts(
        boxes=np.array([modes[0][0] for modes in agents]).reshape(-1, 5),
        trajectories=np.array([[track[1:, :2] for track in modes] for modes in agents]).reshape(len(agents), -1, 6, 2),
        scores=np.ones((len(agents), 1)) if scores is None else np.array(scores, np.float64),
    )


def diagnosis(
    sample: SampleTruth, forecasts: Forecasts | None, waypoints: Floats = STRAIGHT, frame: PlanFrame = PlanFrame.LIDAR
) -> DiagnosisRow | None:
    plan = Plan(waypoints, frame, forecasts=forecasts)
    exact = ExactProtocol().evaluate([sample], plan.waypoints_in_lidar(AHEAD_M)[None])
    (found,) = diagnose([sample], [plan], exact)
    return found


def reason(
    sample: SampleTruth, forecasts: Forecasts | None, waypoints: Floats = STRAIGHT, frame: PlanFrame = PlanFrame.LIDAR
) -> str:
    found = diagnosis(sample, forecasts, waypoints, frame)
    assert found is not None
    assert found.cause == DiagnosisReason(found.reason).cause
    return found.reason


PARKED = moving(0.0, 14.0)
CUTTING_IN = moving(3.5, 8.0, vx=-1.4, vy=6.0)
KEEPING_ITS_LANE = moving(3.5, 8.0, vy=6.0)


def test_a_car_that_cuts_in_against_expectation_is_misforecast() -> None:
    found = diagnosis(truth(CUTTING_IN), expecting(KEEPING_ITS_LANE))
    assert found is not None
    assert (found.cause, found.reason, found.hit) == ("misforecast", "plan clear of forecast", "object-0")
    assert 0.0 < found.first_contact_s <= 3.0


def test_driving_into_what_was_expected_is_misplanned() -> None:
    assert diagnosis(truth(PARKED), expecting(PARKED)) == DiagnosisRow(
        cause="misplanned", reason="plan hits forecast", hit="object-0", first_contact_s=1.2
    )


@pytest.mark.parametrize("frame", PlanFrame)
def test_what_nothing_was_expected_of_is_unseen(frame: PlanFrame) -> None:
    waypoints = STRAIGHT if frame is PlanFrame.LIDAR else STRAIGHT[:, ::-1]
    nothing = Forecasts(np.zeros((0, 5)), np.zeros((0, 1, 6, 2)), np.zeros((0, 1)))
    assert reason(truth(PARKED), nothing, waypoints, frame) == DiagnosisReason.NOT_NEAR
    elsewhere = moving(0.0, 14.0 + 2.4) if frame is PlanFrame.LIDAR else moving(14.0 + AHEAD_M + 2.4, 0.0, yaw=0.0)
    assert reason(truth(PARKED), expecting(elsewhere), waypoints, frame) == DiagnosisReason.NOT_NEAR


def test_a_plan_that_touches_nothing_has_no_diagnosis() -> None:
    assert diagnosis(truth(moving(3.5, 14.0)), expecting(PARKED)) is None
    assert diagnosis(truth(np.zeros((0, 7, 5))), expecting(PARKED)) is None
    assert diagnose([], [], ExactProtocol().evaluate([], np.zeros((0, 6, 2)))) == []
    assert diagnose([], [], ProtocolOutcomes.from_rows([])) == []


def test_samples_do_not_mix() -> None:
    cases: list[tuple[SampleTruth, Forecasts | None]] = [
        (truth(PARKED), expecting(PARKED)),
        (truth(moving(8.0, 8.0)), expecting(PARKED)),
        (truth(CUTTING_IN), expecting(KEEPING_ITS_LANE)),
        (truth(PARKED), None),
    ]
    truths, plans = [one for one, _ in cases], [Plan(STRAIGHT, PlanFrame.LIDAR, forecasts=two) for _, two in cases]
    exact = ExactProtocol().evaluate(truths, np.array([plan.waypoints for plan in plans]))
    together = diagnose(truths, plans, exact)
    assert together == [diagnosis(*case) for case in cases]
    assert [None if row is None else row.reason for row in together] == [
        DiagnosisReason.HITS,
        None,
        DiagnosisReason.CLEAR,
        DiagnosisReason.NONE,
    ]


@pytest.mark.parametrize(
    ("scores", "expected"),
    [
        ((0.7, 0.3), DiagnosisReason.CLEAR_OF_LIKELIEST),
        ((0.9, 0.1), DiagnosisReason.CLEAR),
        ((0.3, 0.7), DiagnosisReason.HITS),
    ],
)
def test_the_most_likely_mode_decides_and_another_likely_one_is_named(
    scores: tuple[float, float], expected: DiagnosisReason
) -> None:
    modes = expecting([KEEPING_ITS_LANE, CUTTING_IN], scores=[scores])
    assert reason(truth(CUTTING_IN), modes) == expected


def walker_at(x: float, y: float = 14.0) -> Floats:
    return moving(x, y, size=WALKER)


WALKING, TWO_WALKERS = walker_at(0.0), np.array([walker_at(0.0), walker_at(1.4)])
LATER, FROM_1_S = np.array([[True] * 7, [False] + [True] * 6]), np.arange(7)[None] >= 2
BUS_AHEAD, EMERGING = moving(0.0, 16.0, size=BUS), moving(-9.0, 14.0, vx=6.0, yaw=0.0)
HITS, CLEAR, NOT_NEAR = DiagnosisReason.HITS, DiagnosisReason.CLEAR, DiagnosisReason.NOT_NEAR


@pytest.mark.parametrize(
    ("sample", "forecasts", "expected"),
    [
        # A forecast that is hit at another time is hit.
        (truth(PARKED), expecting(moving(0.0, 14.0, vy=3.0)), HITS),
        (truth(PARKED), expecting(moving(0.0, 14.0, vy=5.0)), CLEAR),
        (truth(PARKED), None, DiagnosisReason.NONE),
        # Its recording ends early.
        (truth(PARKED, np.arange(7)[None] < 4, valid=3), expecting(PARKED), HITS),
        # A walker beside a known car was not known.
        (truth(np.array([WALKING, moving(1.95, 14.3)])), expecting(moving(1.95, 14.3)), NOT_NEAR),
        (truth(WALKING), expecting(moving(1.95, 14.3)), NOT_NEAR),
        (truth(WALKING), expecting(walker_at(0.8, 14.3)), HITS),
        # A forecast is of one object only, the nearest.
        (truth(TWO_WALKERS), expecting(walker_at(1.2)), NOT_NEAR),
        (truth(TWO_WALKERS), expecting(walker_at(0.3)), HITS),
        (truth(TWO_WALKERS), expecting(walker_at(1.3), walker_at(1.0)), HITS),
        # The centre of a long vehicle may be off along it but not across.
        (truth(BUS_AHEAD), expecting(moving(0.3, 19.5, size=BUS)), HITS),
        (truth(BUS_AHEAD), expecting(moving(0.3, 22.0, size=BUS)), NOT_NEAR),
        (truth(BUS_AHEAD), expecting(moving(3.5, 16.0)), NOT_NEAR),
        # What appears later is compared with where others were expected then.
        (truth(EMERGING, FROM_1_S), expecting(EMERGING), HITS),
        (truth(EMERGING, FROM_1_S), expecting(moving(-3.0, 14.0, vx=-6.0, yaw=0.0)), NOT_NEAR),
        (truth(EMERGING, FROM_1_S), expecting(moving(-3.0, 14.0, vx=-1.0, yaw=0.0)), CLEAR),
        # What is there now takes its forecast before what appears later.
        (truth(np.array([walker_at(1.5), WALKING]), LATER), expecting(walker_at(0.5)), NOT_NEAR),
    ],
)
def test_reasons_of_cases_made_by_hand(sample: SampleTruth, forecasts: Forecasts | None, expected: str) -> None:
    assert reason(sample, forecasts) == expected


def test_a_car_that_drifts_sideways_or_backs_up_is_not_turned() -> None:
    drifting, backing = moving(2.4, 12.0, vx=0.3), moving(2.0, 8.0, vy=-4.0)
    aside, back = (build_forecast_boxes(each[0], each[None, 1:, :2]) for each in (drifting, backing))
    assert aside[..., 4] == pytest.approx(NORTH) and back[..., 4] == pytest.approx(NORTH)
    assert not boxes_overlap(np.array([0.0, 12.0, 4.084, 1.85, NORTH]), aside).any()
    assert back[0, 4::5, 1] == pytest.approx(backing[1:, 1])


def test_a_forecast_turns_along_its_path() -> None:
    angle = np.linspace(0.0, 1.2, 7)
    bend = np.column_stack([20.0 * np.cos(angle), 20.0 * np.sin(angle), np.tile(CAR, (7, 1)), angle + NORTH])
    boxes = build_forecast_boxes(bend[0], bend[None, 1:, :2])[0, 4::5]
    assert boxes[:5, 4] == pytest.approx(bend[1:6, 4], abs=0.02)
    assert boxes[:, :2] == pytest.approx(bend[1:, :2])


def random_case(seed: int) -> tuple[SampleTruth, Forecasts, Floats]:
    """A busy street: half of the objects are forecast, more or less well, and some forecasts are of nobody."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 9))
    sizes = np.array([CAR, BUS, WALKER])[rng.integers(0, 3, count)]
    yaw = rng.uniform(-np.pi, np.pi, count)
    speed = rng.choice([0.0, 1.0, 5.0, 9.0], count)
    tracks = np.array(
        [
            moving(x, y, v * np.cos(a), v * np.sin(a), (length, width), a)
            for (x, y), v, a, (length, width) in zip(rng.uniform([-5, -3], [5, 22], (count, 2)), speed, yaw, sizes)
        ]
    )
    annotated = np.ones((count, 7), dtype=np.bool_)
    annotated[rng.random(count) < 0.3, : int(rng.integers(1, 5))] = False
    guesses = np.concatenate([tracks, tracks[rng.integers(0, count, 2)]])[rng.random(count + 2) < 0.7]
    modes = int(rng.integers(1, 4))
    boxes = guesses[:, 0] + rng.normal(0, [0.7, 0.7, 0.1, 0.1, 0.05], (len(guesses), 5))
    boxes[:, 2:4] = np.abs(boxes[:, 2:4]) + 0.1
    steps = rng.normal(0, 0.8, (len(guesses), modes, 6, 2)).cumsum(axis=2)
    scores = rng.dirichlet(np.ones(modes), len(guesses))
    forecasts = Forecasts(boxes, guesses[:, None, 1:, :2] + steps, scores)
    waypoints = np.cumsum(rng.normal([0.0, 3.0], [0.8, 1.5], (6, 2)), axis=0)
    return truth(tracks, annotated), forecasts, waypoints


SEEDS = st.integers(0, 10**6)


@settings(max_examples=40, deadline=None)
@given(SEEDS)
def test_the_verdict_is_that_of_the_slow_rule(seed: int) -> None:
    sample, forecasts, waypoints = random_case(seed)
    found = diagnosis(sample, forecasts, waypoints)
    if found is None:
        return
    slow = slow_reason(sample, waypoints, forecasts, found.hit)
    assume(not slow.close)
    assert found.reason == slow.reason


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_the_frame_of_the_plan_does_not_matter(seed: int) -> None:
    sample, forecasts, waypoints = random_case(seed)
    in_ego = np.column_stack([waypoints[:, 1], -waypoints[:, 0]])
    boxes = forecasts.boxes.copy()
    boxes[:, :2] = np.column_stack([boxes[:, 1] + AHEAD_M, -boxes[:, 0]])
    boxes[:, 4] -= NORTH
    paths = np.stack([forecasts.trajectories[..., 1] + AHEAD_M, -forecasts.trajectories[..., 0]], axis=-1)
    seen_from_axle = Forecasts(boxes, paths, forecasts.scores)
    back = to_lidar_frame(seen_from_axle, PlanFrame.EGO, AHEAD_M)
    assert back.boxes == pytest.approx(forecasts.boxes) and back.trajectories == pytest.approx(forecasts.trajectories)
    plan = Plan(in_ego, PlanFrame.EGO)
    expected = diagnosis(sample, back, plan.waypoints_in_lidar(AHEAD_M))
    assert diagnosis(sample, seen_from_axle, in_ego, PlanFrame.EGO) == expected


@settings(max_examples=20, deadline=None)
@given(SEEDS)
def test_who_foresees_everything_only_misplans(seed: int) -> None:
    sample, _, waypoints = random_case(seed)
    # Objects that turn on the spot are foreseen by nobody who forecasts centres: those here keep their heading.
    found = diagnosis(sample, expecting(*sample.boxes), waypoints)
    assert found is None or found.reason == DiagnosisReason.HITS


def test_matching_leaves_out_what_has_no_forecast() -> None:
    sample = truth(np.array([PARKED, CUTTING_IN, moving(-20.0, 5.0)]))
    assert match_forecasts(sample, expecting(CUTTING_IN, PARKED)) == {"object-0": 1, "object-1": 0}
    assert match_forecasts(sample, expecting(moving(40.0, 40.0))) == {}
