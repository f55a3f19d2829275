"""Driving scores by the clock, and in whatever frame the world is written down."""

from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.geometry import Floats
from benchmark.pdm.plan_motion import compute_comfort_series, compute_extremes, track_plans
from benchmark.pdm.plan_scoring import score_scene_plans
from benchmark.pdm.recorded_scene import RecordedScene
from benchmark.pdm.totals import DrivenPlan
from benchmark.planning import Plan, PlanFrame
from benchmark.scene import EgoTrack, Scene
from tests.benchmark.irregular_time import at_other_times, with_key_frames, without_key_frames
from tests.benchmark.turned_scenes import turned_scene
from tests.hand_made import Car, scene_on_straight_road

CARS = (Car(80.0, 198.25, 6.0), Car(60.0, 194.75, 10.0), Car(120.0, 201.75, 9.0, np.pi))
QUARTER = np.pi / 2


def in_a_bend(start_rad: float, turn_rad_s: float = 0.25, speed_m_s: float = 6.0) -> Scene:
    """The ego drives a circle; where it begins decides when its heading passes +-180 degrees."""
    scene = scene_on_straight_road(CARS)
    yaw = start_rad + turn_rad_s * scene.seconds
    radius = speed_m_s / turn_rad_s
    middle = np.array([100.0, 200.0])
    position = np.column_stack([middle + radius * np.column_stack([np.sin(yaw), -np.cos(yaw)]), np.zeros(len(yaw))])
    rotation = np.column_stack([np.cos(yaw / 2), np.zeros((len(yaw), 2)), np.sin(yaw / 2)])
    return replace(scene, ego=EgoTrack(position, rotation))


def plans_of(scene: Scene, speed_m_s: float = 6.0, turn_rad_s: float = 0.25) -> list[Plan | None]:
    angle = turn_rad_s * 0.5 * np.arange(1, 7)
    radius = speed_m_s / turn_rad_s
    waypoints = radius * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    return [Plan(waypoints, PlanFrame.EGO)] * len(scene.keyframes)


def without_ec(verdict: DrivenPlan | None) -> DrivenPlan | None:
    return None if verdict is None else replace(verdict, ec=None)


def require_alike(some: DrivenPlan | None, others: DrivenPlan | None) -> None:
    if some is None or others is None:
        assert some is others
        return
    one, other = asdict(some), asdict(others)
    metres = {"progress_m", "recorded_progress_m", "ep"}
    assert {name: one[name] for name in one if name not in metres} == {n: other[n] for n in one if n not in metres}
    assert [one[name] for name in metres] == pytest.approx([other[name] for name in metres], abs=1e-2)


@settings(max_examples=4, deadline=None)
@given(start_rad=st.floats(-np.pi, np.pi), turn_rad_s=st.sampled_from([0.25, -0.25, 0.6]))
def test_a_drive_through_180_degrees_scores_as_the_same_one_turned_by_a_quarter(
    start_rad: float, turn_rad_s: float
) -> None:
    scene = in_a_bend(start_rad, turn_rad_s)
    plans = plans_of(scene, turn_rad_s=turn_rad_s)
    found = score_scene_plans(scene, plans)
    assert sum(verdict is not None for verdict in found) == 10
    for turns in (1, 2, 3):
        for some, others in zip(found, score_scene_plans(turned_scene(scene, turns * QUARTER), plans)):
            require_alike(some, others)


def test_comfort_is_that_of_unwrapped_headings() -> None:
    samples = np.arange(3, 10)

    def extremes(scene: Scene) -> Floats:
        recorded = RecordedScene(scene)
        around = recorded.build_context(samples)
        return compute_extremes(
            compute_comfort_series(track_plans(recorded.build_recorded_plans(samples), around.now), around.history)
        )

    expected = extremes(in_a_bend(-2.0))
    # The heading turns at 0.25 rad/s; the official history lacks 0.1 s, so that it seems to turn faster there.
    assert np.abs(expected[:, 5]).max() < 0.4
    for start_rad in np.linspace(1.6, 3.0, 8):
        turned = turned_scene(in_a_bend(-2.0), float(start_rad) + 2.0)
        assert np.abs(np.diff(turned.ego.pose[:, 2])).max() > 6.0
        np.testing.assert_allclose(extremes(turned), expected, atol=1e-5)


@pytest.mark.parametrize("every", [1, 3])
def test_more_key_frames_of_the_same_motion_score_the_same(every: int) -> None:
    scene = in_a_bend(2.0)
    dense = with_key_frames(scene, np.arange(0, scene.keyframes[-1] + 1, every))
    often = score_scene_plans(dense, plans_of(dense))
    for sample, verdict in enumerate(score_scene_plans(scene, plans_of(scene))):
        require_alike(without_ec(verdict), without_ec(often[sample * 6 // every]))
    # Plans are compared with the one before, which is nearer in time.
    assert next(verdict.ec for verdict in often if verdict is not None) is None


def test_nothing_is_said_where_a_gap_lies_ahead_and_no_history_where_one_lies_behind() -> None:
    scene = in_a_bend(2.0)
    gap = without_key_frames(scene, 6)
    found = score_scene_plans(gap, plans_of(gap))
    assert [verdict is not None for verdict in found] == [False] * 6 + [True] * 3 + [False] * 6
    assert [verdict.hc for verdict in found[6:9] if verdict is not None] == [None] * 3
    whole = score_scene_plans(scene, plans_of(scene))
    for some, other in zip(found[6:9], whole[7:10], strict=True):
        assert some is not None and other is not None
        require_alike(replace(some, hc=None, ec=None), replace(other, hc=None, ec=None))


def test_shorter_gaps_are_interpolated() -> None:
    gaps = np.full(15, 0.5)
    gaps[5], gaps[6] = 0.7, 0.3
    scene = in_a_bend(2.0)
    moved = at_other_times(in_a_bend(2.0), gaps)
    seconds = moved.seconds
    # The same motion, looked at at other times: at the third key frame from now 0.2 s later than usual.
    yaw = 2.0 + 0.25 * seconds
    position = np.column_stack([100 + 24 * np.sin(yaw), 200 - 24 * np.cos(yaw), np.zeros(len(yaw))])
    rotation = np.column_stack([np.cos(yaw / 2), np.zeros((len(yaw), 2)), np.sin(yaw / 2)])
    tracks = [
        np.column_stack([np.interp(seconds, scene.seconds, axis) for axis in track.T])
        for track in scene.agents.position
    ]
    agents = replace(moved.agents, position=np.stack(tracks))
    moved = replace(moved, ego=EgoTrack(position, rotation), agents=agents)
    moved = with_key_frames(moved, moved.keyframes)
    regular, irregular = score_scene_plans(scene, plans_of(scene)), score_scene_plans(moved, plans_of(moved))
    for at in (0, 1, 2, 3, 4, 5, 7, 8):
        assert regular[at] is not None and irregular[at] is not None
        require_alike(without_ec(regular[at]), without_ec(irregular[at]))
