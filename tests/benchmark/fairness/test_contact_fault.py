"""Tracks up to contacts of plans and recordings, and whose fault they are on a scene's map."""

from dataclasses import replace

import numpy as np
import pytest
from shapely.geometry import MultiPolygon

from benchmark.fairness.contact_fault import (
    attribute_contact,
    judge_contact,
    load_roads,
    make_contact_grid,
    trace_recorded_contact,
)
from benchmark.fairness.plan_severity import measure_plan_severities, trace_first_contact
from benchmark.geometry import Floats, boxes_overlap
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.records.fault import StoredFault
from benchmark.road_map import Handedness, RoadMap
from benchmark.scene import Scene
from tests.benchmark.fake_data import FakeData
from tests.hand_made import Car, scene_on_straight_road

INNER, OUTER = 198.25, 194.75
"""Lanes eastwards; the ego is in the inner one."""
EGO_M_S = 8.0


def straight(speed: float, left_m_s: float = 0.0) -> Floats:
    """(6, 2) a plan in the lidar frame: x right, y forward."""
    seconds = 0.5 * np.arange(1, 7)
    return np.column_stack([-left_m_s * seconds, speed * seconds])


def planned(scene: Scene, index: int, plan: Floats) -> StoredFault | None:
    truth = FakeData({scene.name: scene}).truth(scene.name)[index]
    (row,) = measure_plan_severities([truth], plan[None], scene=scene)
    assert row.contact is not None
    return row.contact.fault


def said(fault: StoredFault | None) -> tuple[str, str]:
    assert fault is not None
    return fault.verdict, fault.reason


@pytest.mark.parametrize("index", [0, 1, 3, 12])
def test_tracks_of_a_plan_are_the_recording_and_then_the_plan(index: int) -> None:
    scene = scene_on_straight_road((Car(75.0, INNER, 5.0),), ego_speed=EGO_M_S, seconds=12.0)
    truth = FakeData({scene.name: scene}).truth(scene.name)[index]
    tracks = trace_first_contact(truth, straight(20.0), scene)
    assert tracks is not None
    contact_s = tracks.times_s[-1]
    assert np.allclose(np.diff(tracks.times_s), 0.1)
    assert contact_s - tracks.times_s[0] == pytest.approx(min(contact_s, 5.0), abs=0.1)
    assert boxes_overlap(tracks.ego.boxes()[-1], tracks.other.boxes()[-1])
    assert not boxes_overlap(tracks.ego.boxes()[-2], tracks.other.boxes()[-2])
    # The other is where it is recorded; the ego is until the sample, and goes on by its plan without a jump.
    assert np.allclose(tracks.other.pose[:, 0], 75.0 + 5.0 * tracks.times_s, atol=0.02)
    steps, before = np.diff(tracks.ego.pose[:, 0]), tracks.times_s[1:] <= 0.5 * index + 1e-6
    assert np.allclose(steps[before], 0.1 * EGO_M_S, atol=0.02)
    assert np.allclose(steps[~before], 2.0, atol=0.02)


def test_verdicts_on_plans_as_one_sees_them() -> None:
    leader = scene_on_straight_road((Car(75.0, INNER, 5.0),), ego_speed=EGO_M_S)
    assert said(planned(leader, 2, straight(20.0))) == ("ego", "rear-end")
    standing = scene_on_straight_road((Car(75.0, INNER, 0.0),), ego_speed=EGO_M_S)
    assert said(planned(standing, 2, straight(EGO_M_S))) == ("ego", "standing")
    follower = scene_on_straight_road((Car(35.0, INNER, 8.0),), ego_speed=EGO_M_S)
    assert said(planned(follower, 2, straight(1.0))) == ("other", "rear-end")
    beside = scene_on_straight_road((Car(50.0, OUTER, 8.0),), ego_speed=EGO_M_S)
    changed = planned(beside, 4, straight(EGO_M_S, left_m_s=-1.5))
    assert said(changed) == ("ego", "lane-change") and changed is not None
    assert changed.entry_s is not None and 0.0 < changed.entry_s < 1.5 and changed.time_left_s == 0.0
    oncoming = scene_on_straight_road((Car(120.0, 201.75, 9.0, np.pi),), ego_speed=EGO_M_S)
    assert said(planned(oncoming, 4, straight(EGO_M_S, left_m_s=1.2))) == ("ego", "wrong-side")


def test_without_a_scene_nothing_is_said_and_without_a_map_little() -> None:
    scene = scene_on_straight_road((Car(50.0, OUTER, 8.0),), ego_speed=EGO_M_S)
    truth = FakeData({scene.name: scene}).truth(scene.name)[4]
    plan = straight(EGO_M_S, left_m_s=-1.5)
    (row,) = measure_plan_severities([truth], plan[None])
    assert row.contact is not None and row.contact.fault is None
    nowhere = replace(scene, road_map=RoadMap("nowhere", MultiPolygon()))
    assert said(planned(nowhere, 4, plan)) == ("unclear", "no-map")


def test_who_came_a_moment_ago_has_a_short_track() -> None:
    scene = scene_on_straight_road((Car(75.0, INNER, 5.0),), ego_speed=EGO_M_S, seconds=12.0)
    scene.agents.valid[0, :60] = False
    tracks = trace_recorded_contact(ContinuousTracks.of_scene(scene), 0, 6.0)
    assert tracks.times_s[0] == pytest.approx(5.0, abs=0.1) and tracks.times_s[-1] == 6.0


@pytest.mark.parametrize(("first_s", "count"), [(0.0, 51), (6.95, 1), (7.0, 1), (6.9, 2), (-50.0, 51)])
def test_the_grid_ends_at_the_contact_and_begins_where_both_are_known(first_s: float, count: int) -> None:
    grid = make_contact_grid(7.0, first_s)
    assert len(grid) == count and grid[-1] == 7.0 and grid[0] >= first_s - 1e-6


def test_the_side_of_traffic_is_that_of_the_lanes_unless_somebody_says_it() -> None:
    scene = scene_on_straight_road((Car(50.0, OUTER, 8.0),), ego_speed=EGO_M_S)
    data = FakeData({scene.name: scene})
    sided = data.with_driving_side(Handedness.LEFT).scene(scene.name)
    assert sided.driving_side is Handedness.LEFT and scene.driving_side is None
    tracks = trace_recorded_contact(ContinuousTracks.of_scene(scene), 0, 3.0)
    assert load_roads(scene) is load_roads(scene)
    stored, found = attribute_contact(sided, tracks), judge_contact(sided, tracks)
    assert (stored.verdict, stored.reason) == (found.verdict, found.reason)
