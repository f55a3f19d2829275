"""Stored plans lie where the protocols judge them."""

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.geometry import Floats, to_global
from benchmark.metrics.diagnosis import to_lidar_frame
from benchmark.planning import PlanFrame
from benchmark.protocols.exact import compute_plan_boxes
from benchmark.records.row_schema import SampleRow
from benchmark.report.placement import agent_box_at, ego_box, place_plan
from benchmark.runs.judging import parse_plan
from tests.benchmark.records.test_run import row
from tests.benchmark.report.one_scene import FRAMES, agent, sheet

AXLE = np.array([12.0, -7.0, 2.1])
AHEAD_M = 0.94


def sample(frame: str, seed: int = 0) -> SampleRow:
    """A plan along a curve, with modes and forecasts."""
    rng = np.random.default_rng(seed)
    steps = np.cumsum(rng.uniform(0.0, 3.0, (6, 2)), axis=0)
    plan = {
        "frame": frame, "waypoints": steps.tolist(), "modes": [steps.tolist(), (steps[:, ::-1] + 1).tolist()],
        "mode_scores": [0.7, 0.3],
        "forecasts": {
            "boxes": rng.uniform(-20, 20, (3, 5)).tolist(), "scores": [[0.2, 0.8], [0.6, 0.4], [0.5, 0.5]],
            "trajectories": rng.uniform(-20, 20, (3, 2, 6, 2)).tolist(),
        },
    }  # fmt: skip
    return SampleRow.model_validate({**row("s", 0).model_dump(), "lidar_ahead_m": AHEAD_M, "plan": plan})


def in_sheet(points: Floats) -> Floats:
    """From the lidar frame of the sample, by its definition."""
    origin = AXLE[:2] + AHEAD_M * np.array([np.cos(AXLE[2]), np.sin(AXLE[2])])
    return to_global(points, np.array([*origin, AXLE[2] - np.pi / 2]))


@pytest.mark.parametrize("frame", ["lidar", "ego"])
@pytest.mark.parametrize("seed", range(5))
def test_plans_lie_exactly_where_the_protocols_put_them(frame: str, seed: int) -> None:
    stored = sample(frame, seed)
    placed = place_plan(stored, AXLE)
    assert placed is not None and stored.plan is not None
    plan = parse_plan(stored.plan.model_dump())
    expected = plan.waypoints_in_lidar(AHEAD_M)
    np.testing.assert_array_equal(placed.waypoints, in_sheet(expected))
    boxes = compute_plan_boxes(expected)
    np.testing.assert_allclose(placed.footprints[:, :2], in_sheet(boxes[:, :2]), atol=1e-9)
    np.testing.assert_allclose(placed.footprints[:, 4], boxes[:, 4] + AXLE[2] - np.pi / 2, atol=1e-9)
    np.testing.assert_array_equal(placed.footprints[:, 2:4], boxes[:, 2:4])


@pytest.mark.parametrize("frame", ["lidar", "ego"])
def test_forecasts_lie_where_the_diagnosis_puts_them(frame: str) -> None:
    stored = sample(frame)
    placed = place_plan(stored, AXLE)
    assert placed is not None and placed.forecasts is not None and stored.plan is not None
    plan = parse_plan(stored.plan.model_dump())
    assert plan.forecasts is not None
    expected = to_lidar_frame(plan.forecasts, PlanFrame(frame), AHEAD_M)
    likeliest = expected.trajectories[np.arange(3), expected.scores.argmax(axis=1)]
    np.testing.assert_allclose(placed.forecasts.paths, in_sheet(likeliest), atol=1e-12)
    np.testing.assert_allclose(placed.forecasts.boxes[:, :2], in_sheet(expected.boxes[:, :2]), atol=1e-12)
    np.testing.assert_allclose(placed.forecasts.boxes[:, 4], expected.boxes[:, 4] + AXLE[2] - np.pi / 2, atol=1e-12)


def test_an_ego_plan_straight_ahead_leads_straight_ahead() -> None:
    stored = SampleRow.model_validate(
        {**row("s", 0).model_dump(), "plan": {"frame": "ego", "waypoints": [[5.0 * k, 0.0] for k in range(1, 7)]}}
    )
    placed = place_plan(stored, np.array([100.0, 50.0, np.pi / 2]))
    assert placed is not None
    np.testing.assert_allclose(placed.waypoints, [[100.0, 50.0 + 0.94 + 5.0 * k] for k in range(1, 7)], atol=1e-9)
    np.testing.assert_allclose(placed.start[:2], [100.0, 50.0 + 0.94 + 0.5], atol=1e-9)


def test_the_plan_itself_is_no_other_mode_and_failures_have_no_plan() -> None:
    placed = place_plan(sample("lidar"), AXLE)
    assert placed is not None and len(placed.modes) == 1
    assert place_plan(row("s", 0, status="failed"), AXLE) is None


def test_lists_of_wrong_lengths_are_one_sentence() -> None:
    damaged = SampleRow.model_validate({**row("s", 0).model_dump(), "plan": {"frame": "ego", "waypoints": [[1.0]]}})
    with pytest.raises(InputError, match="wrong lengths"):
        place_plan(damaged, AXLE)


def test_objects_move_linearly_between_frames_and_turn_the_short_way() -> None:
    x = [0.0, 1.0, None, *[3.0] * (FRAMES - 3)]
    yaw = [3.1, -3.1, None, *[0.0] * (FRAMES - 3)]
    scene = sheet(agents=[{**agent("a", 0.0, 0.0), "x_m": x, "yaw_rad": yaw}])
    between = agent_box_at(scene, scene.agents[0], 0.5 / 12)
    assert between is not None and between[0] == pytest.approx(0.5, abs=1e-4)
    assert abs(np.cos(between[4]) + 1.0) < 1e-4
    assert agent_box_at(scene, scene.agents[0], 1.5 / 12) is None
    assert agent_box_at(scene, scene.agents[0], 99.0) is None


def test_the_egos_body_is_ahead_of_its_axle() -> None:
    scene = sheet(ego={**sheet().ego.model_dump(), "yaw_rad": [np.pi / 2] * FRAMES})
    np.testing.assert_allclose(ego_box(scene, 3), [0.0, 1.44, 4.084, 1.85, np.pi / 2], atol=1e-9)
