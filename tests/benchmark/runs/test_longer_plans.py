"""Plans that go on beyond 3 s: kept whole, judged as if they ended there, and said more of up to 6 s."""

import math
from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.datasets.sample_truth import compute_truth
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.geometry import Floats
from benchmark.metrics.longer_plans import compute_longer_rates
from benchmark.planning import Observation, Plan, PlanFrame
from benchmark.protocols import PROTOCOLS, exact
from benchmark.records.row_schema import SampleRow
from benchmark.records.run import load_record
from benchmark.truth import SampleTruth
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.collision import run_tables
from leaderboard.tables.contents import build_data_set_tables
from leaderboard.tables.longer_plans import longer_table
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.planners import Straight
from tests.benchmark.protocols import slow_protocols as slow
from tests.hand_made import Car, scene_on_straight_road

DATA = town_of_two(slow_leader=True)
ALL = EvalSettings(protocols=tuple(PROTOCOLS))


class FarSighted(Straight):
    """8 m/s and a gentle curve, for so many steps."""

    name = "far-sighted"

    def __init__(self, steps: int = 16, frame: PlanFrame = PlanFrame.EGO) -> None:
        super().__init__()
        self._steps, self._frame = steps, frame

    def plan(self, observation: Observation) -> Plan:
        seconds = 0.5 * np.arange(1, self._steps + 1)
        waypoints = np.column_stack([8.0 * seconds, 0.1 * seconds**2])
        modes = np.stack([waypoints, 0.5 * waypoints])
        if self._frame is PlanFrame.LIDAR:
            waypoints, modes = waypoints[:, ::-1] * [-1.0, 1.0], modes[..., ::-1] * [-1.0, 1.0]
        return Plan(waypoints, self._frame, modes=modes, mode_scores=np.array([0.7, 0.3]))


@pytest.mark.parametrize("shape", [(5, 2), (17, 2), (6, 3), (12,), (0, 2)])
def test_other_lengths_are_no_plans(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="6 to 16 waypoints"):
        Plan(np.zeros(shape), PlanFrame.EGO)


@pytest.mark.parametrize("frame", list(PlanFrame))
def test_a_longer_plan_is_kept_whole_and_gets_the_verdicts_of_its_first_3_s(tmp_path: Path, frame: PlanFrame) -> None:
    long = evaluate(DATA, "val", FarSighted(16, frame), tmp_path / "long", ALL)
    short = evaluate(DATA, "val", FarSighted(6, frame), tmp_path / "short", ALL)
    assert long.complete and load_record(long.directory) == long
    for one, other in zip(long.rows, short.rows, strict=True):
        assert one.plan is not None and other.plan is not None
        assert len(one.plan.waypoints) == 16 and one.plan.waypoints[:6] == other.plan.waypoints
        assert one.plan.modes is not None and len(one.plan.modes[0]) == 16
        assert one.outcomes == other.outcomes and one.diagnosis == other.diagnosis
        assert other.longer is None and one.longer is not None and len(one.longer.l2) == 12
    assert long.summary == short.summary


def test_the_table_has_the_horizons_that_plans_and_recordings_reach(tmp_path: Path) -> None:
    records = [evaluate(DATA, "val", FarSighted(steps), tmp_path / str(steps)) for steps in (6, 7, 9, 16)]
    assert [compute_longer_rates(record) is None for record in records] == [True, True, False, False]
    assert longer_table(DataSetRuns("d", records[:2])) is None
    four, six = (compute_longer_rates(record) for record in records[2:])
    assert four is not None and six is not None
    counts = [sum(_reaches(row, steps) for row in records[3].rows) for steps in (8, 10, 12)]
    assert [rate.denominator for rate in six.collision.values()] == counts and counts[0] > counts[2] > 0
    assert [rate.denominator for rate in four.collision.values()] == [counts[0], 0, 0]
    assert four.collision["4s"] == six.collision["4s"] and four.l2["6s"].value is None
    values = [rate.value for rate in six.collision.values()]
    assert values[-1] is not None and values[-1] > 0.0
    names = [table.name for table in run_tables("d", records[3:])]
    assert names[-1] == "longer-plans" and "longer-plans" not in [one.name for one in run_tables("d", records[:1])]
    assert "longer-plans" in [table.name for table in build_data_set_tables(DataSetRuns("d", records[3:])).front]


def _reaches(row: SampleRow, steps: int) -> bool:
    return row.longer is not None and None not in row.longer.l2[:steps]


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32), st.sampled_from([7, 10, 12]))
def test_contacts_beyond_3_s_are_those_of_polygons(seed: int, steps: int) -> None:
    rng = np.random.default_rng(seed)
    places = rng.uniform([30, 190, 0, -3], [90, 210, 9, 3], (6, 4)).tolist()
    cars = [Car(x=x, y=y, speed=speed, yaw=yaw) for x, y, speed, yaw in places]
    scene = scene_on_straight_road(tuple(cars), seconds=8.0)
    tokens = [str(index) for index in range(len(scene.keyframes))]
    truths, plain = compute_truth(scene, tokens, steps), compute_truth(scene, tokens)
    index = int(rng.integers(len(tokens)))
    truth = truths[index]
    assert np.array_equal(truth.ego_future[:6], plain[index].ego_future)
    plan: Floats = np.cumsum(rng.normal([0.0, 3.0], [0.4, 1.0], (steps, 2)), axis=0)
    collision, l2 = exact.evaluate_longer_plans([truth], plan[None])
    poses = [np.array([0.0, 0.0, math.pi / 2])]
    for step in range(steps):
        before = plan[step - 1] if step else np.zeros(2)
        dx, dy = plan[min(step + 1, steps - 1)] - before
        poses.append(np.array([*plan[step], math.atan2(dy, dx) if math.hypot(dx, dy) >= 0.3 else poses[-1][2]]))
    for step in range(steps):
        hit = any(_touches(truth, poses, step, share / 5) for share in range(1, 6))
        assert bool(collision[0, step]) == hit, step
        recorded = truth.ego_future[step, :2]
        wanted = math.dist(plan[step], recorded) if truth.ego_future_valid[step] else math.nan
        assert l2[0, step] == pytest.approx(wanted, nan_ok=True)


def _touches(truth: SampleTruth, poses: list[Floats], step: int, share: float) -> bool:
    mine = slow.ego_box(*slow.between(poses[step].tolist(), poses[step + 1].tolist(), share))
    ego = shapely.Polygon(slow.corners(mine))
    for boxes, there in zip(truth.boxes, truth.annotated):
        if not there[step + 1] or not (there[step] or share == 1.0):
            continue
        first, second = boxes[step].tolist(), boxes[step + 1].tolist()
        x, y, yaw = slow.between([*first[:2], first[4]], [*second[:2], second[4]], share)
        if ego.intersects(shapely.Polygon(slow.corners([x, y, *second[2:4], yaw]))):
            return True
    return False
