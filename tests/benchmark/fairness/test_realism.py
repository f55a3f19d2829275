"""Features of motions that are formulas, divergences by hand, faults that were put in, and the literature's quirks."""

from dataclasses import replace

import numpy as np
import pytest
import shapely

from benchmark.fairness.ctg import (
    CtgMask,
    CtgNormalisation,
    CtgVersion,
    SceneTracks,
    compute_deviations,
    compute_histograms,
)
from benchmark.fairness.features import FEATURES, RoadEdge, extract_recorded_runs, extract_runs, find_stretches
from benchmark.fairness.realism import equal_bins, quantile_bins, w1
from benchmark.fairness.split_assessment import measure_realism
from benchmark.fairness.validity import NO_MAP, find_teleports, find_track_defects
from benchmark.geometry import Floats, box_gap
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.records.scene_assessment import TRACK_DEFECT_NAMES, StoredTrackDefects
from benchmark.road_map import RoadMap
from tests.benchmark.interactions.made import SECONDS, along, boxes, ego, made_scene, scene
from tests.hand_made import straight_road

KEYFRAMES = np.arange(0, len(SECONDS), 6)


def test_a_circle_has_the_acceleration_of_a_circle() -> None:
    angle = 8.0 / 40.0 * SECONDS
    circle = boxes(40.0 * np.sin(angle), 40.0 - 40.0 * np.cos(angle))
    circle[:, 4] = angle
    (run,) = extract_runs(scene(ego(5.0), circle), KEYFRAMES, 0)
    middle = slice(20, -20)
    assert run.values["speed"][middle] == pytest.approx(8.0, abs=0.02)
    assert run.values["yaw_rate"][middle] == pytest.approx(0.2, abs=1e-3)
    assert run.values["acceleration_across"][middle] == pytest.approx(1.6, abs=0.02)
    assert np.abs(run.values["acceleration_along"][middle]).max() < 0.05


def test_steady_braking_is_seen_as_it_is() -> None:
    (run,) = extract_runs(scene(ego(5.0), along(20.0, 3.5, 16.0, brakes=1.5)), KEYFRAMES, 0)
    middle = slice(20, -20)
    assert run.values["acceleration_along"][middle] == pytest.approx(-1.5, abs=0.05)
    assert np.abs(run.values["jerk_along"][middle]).max() < 0.5


def test_gap_and_time_to_contact_are_those_of_the_slow_version() -> None:
    tracks, keyframes = made_scene(0)
    for run in extract_recorded_runs(tracks, keyframes, "vehicle.car"):
        others, present = tracks.agents_at(run.times)
        present[run.agent] = False
        egos = tracks.ego_at(run.times)
        # The smoothed pose is not in the run; the recorded one differs by the noise of 5 cm that was put on.
        own = tracks.agents_at(run.times)[0][run.agent]
        gaps = np.where(present, box_gap(np.broadcast_to(own, others.shape), others), np.inf).min(axis=0)
        slow = np.minimum(np.minimum(gaps, box_gap(own, egos)), 40.0)
        assert run.values["gap"] == pytest.approx(slow, abs=0.3)
        assert (run.values["ttc"] <= 8.0).all() and (run.values["ttc"] >= 0.0).all()


def test_a_run_needs_five_keyframes_and_five_metres() -> None:
    line = np.column_stack([np.arange(10.0), np.zeros(10)])
    valid = np.arange(10) != 4
    assert find_stretches(valid, 2.0 * line) == [slice(5, 10)]
    assert find_stretches(np.ones(10, np.bool_), np.asarray(0.5 * line)) == []
    (inside,) = extract_runs(scene(ego(5.0), along(20.0, 3.5, 8.0)), KEYFRAMES, 0, between=(2.0, 6.0))
    assert inside.times[0] == pytest.approx(2.5) and inside.times[-1] == pytest.approx(5.5)


def test_two_halves_of_one_law_are_near_and_a_shift_is_what_it_is() -> None:
    rng = np.random.default_rng(0)
    first, second = rng.normal(size=4000), rng.normal(size=4000)
    assert w1(first, first + 0.7) == pytest.approx(0.7) and w1(first, second) < 0.1
    assert quantile_bins(first, second).divergence < 0.01 < quantile_bins(first + 1.0, second).divergence
    assert quantile_bins(first, second).reference.tolist() == [200] * 20
    assert equal_bins(np.full(5, 99.0), second).counts[-1] == 5
    assert len(equal_bins(np.zeros(3), np.zeros(9)).counts) == 20


def test_noise_on_recordings_blinds_equal_bins_and_not_quantile_bins() -> None:
    rng = np.random.default_rng(1)
    recorded = np.concatenate([rng.normal(0, 0.5, 9800), rng.normal(0, 30.0, 200)])
    braking = rng.normal(-2.0, 0.5, 2000)
    assert equal_bins(braking, recorded).divergence < quantile_bins(braking, recorded).divergence


def test_the_worst_feature_is_named_and_halves_stand_beside() -> None:
    recorded, swerving = {}, {}
    for number in range(4):
        tracks, keyframes = made_scene(number)
        recorded[f"scene-{number}"] = extract_recorded_runs(tracks, keyframes, "vehicle.car")
        changed = tracks.agents.copy()
        changed[0, :, 1] += 1.2 * np.sin(2 * np.pi * tracks.seconds / 3.0)
        swerving[f"scene-{number}"] = extract_runs(replace(tracks, agents=changed), keyframes, 0)
    found = measure_realism(swerving, recorded)
    assert found is not None and [feature.name for feature in found.features] == list(FEATURES)
    # Of the features of swerving, not of those of driving along.
    assert found.worst.name in FEATURES[1:6]
    across = found.features[FEATURES.index("acceleration_across")]
    assert across.w1_in_halves is not None and across.w1_in_halves > 1.0 and across.realism < across.realism_of_halves  # type: ignore[operator]
    assert across.interval is not None and across.interval[0] <= across.realism + 0.05
    assert measure_realism(swerving, recorded) == found, "seeded"
    assert measure_realism({}, recorded) is None and measure_realism(swerving, {}) is None
    same = measure_realism(recorded, recorded)
    assert same is not None and same.worst.realism == 1.0 and same.mean == 1.0


def faults(track: Floats, *others: Floats, road_map: RoadMap | None = None) -> StoredTrackDefects:
    tracks = scene(ego(3.0), track, *others)
    return find_track_defects(tracks, 0, slice(None), road_map)


def test_a_car_that_drives_has_no_faults() -> None:
    road = straight_road()
    own = along(40.0, 198.25, 6.0)
    found = faults(own, along(80.0, 198.25, 6.0), road_map=road)
    assert found == StoredTrackDefects.model_validate(dict.fromkeys(TRACK_DEFECT_NAMES, False))
    assert faults(own).unknown == {"off_road": NO_MAP, "against_traffic": NO_MAP}


def test_each_fault_is_found() -> None:
    road = straight_road()
    own = along(40.0, 198.25, 6.0)
    assert faults(along(40.0, 198.25, 12.0, brakes=9.0)).beyond_limits
    assert faults(along(40.0, 192.5, 6.0), road_map=road).off_road
    assert not faults(along(40.0, 193.0 - 0.95 + 0.95 - 0.2 + 0.95, 6.0), road_map=road).off_road
    beside = along(40.0, 198.25 + 1.9 + 0.4, 6.0)
    assert faults(own, beside).hovering and not faults(own, beside).contact
    assert not faults(own, along(40.0, 198.25 + 1.9 + 0.6, 6.0)).hovering
    assert faults(own, along(40.0, 199.0, 6.0)).contact
    wrong_way = boxes(140.0 - 6.0 * SECONDS, np.full(len(SECONDS), 198.25))
    assert faults(wrong_way, road_map=road).against_traffic
    jumping = own.copy()
    jumping[50:, 0] += 2.0
    assert faults(jumping).teleport and find_teleports(SECONDS, jumping).sum() == 1
    spinning = own.copy()
    spinning[50:, 4] += 0.6
    assert faults(spinning).teleport


def test_frames_at_which_it_is_not_there_do_not_count() -> None:
    jumping = along(40.0, 198.25, 6.0)
    jumping[:20, 0] = jumping[20, 0]
    tracks = scene(ego(3.0), jumping)
    assert find_track_defects(tracks, 0, slice(None)).beyond_limits
    late = tracks.valid.copy()
    late[0, :20] = False
    assert not find_track_defects(replace(tracks, valid=late), 0, slice(None)).beyond_limits


def ctg_scene(angle: float = 0.0, noise: float = 0.0) -> SceneTracks:
    tracks, _ = made_scene(2)
    times = 0.1 * np.arange(101)
    cars = tracks.agents_at(times)[0][[0, 1, 3]] + np.array([100.0, 50.0, 0, 0, 0])
    rng = np.random.default_rng(0)
    x, y = (cars[..., axis] + rng.normal(0, noise, cars.shape[:2]) for axis in range(2))
    place = np.stack([x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)], axis=-1)
    return SceneTracks(place, cars[..., 4] + angle)


@pytest.mark.parametrize("version", CtgVersion)
def test_the_literatures_deviation_changes_when_the_map_is_turned(version: CtgVersion) -> None:
    settings = (version, CtgNormalisation.SCENE, CtgMask.NONE)
    recorded = compute_histograms([ctg_scene()], *settings)
    assert compute_deviations(recorded, recorded)["mean_real_dev"] == 0.0
    turned = compute_deviations(compute_histograms([ctg_scene(0.8)], *settings), recorded)
    assert turned["mean_real_dev"] > 0.001
    if version is CtgVersion.CTG:
        noisy = compute_deviations(compute_histograms([ctg_scene(noise=0.05)], *settings), recorded)
        assert noisy["mean_real_dev_int"] > turned["mean_real_dev_int"]
    else:
        assert "mean_real_dev_int" not in turned


def test_agents_that_appear_late_or_stand_do_not_count() -> None:
    whole = ctg_scene()
    late = SceneTracks(whole.position.copy(), whole.yaw.copy())
    late.position[0, :8], late.yaw[0, :8] = np.nan, np.nan
    settings = (CtgVersion.CTG, CtgNormalisation.DATASET, CtgMask.CURRENT_SPEED)
    without = SceneTracks(whole.position[1:], whole.yaw[1:])
    jerks = [compute_histograms([each], *settings)["jerk"] for each in (late, without)]
    assert jerks[0] == pytest.approx(jerks[1])
    standing = SceneTracks(np.repeat(whole.position[:, :1], 101, axis=1), whole.yaw)
    assert compute_histograms([standing], *settings)["velocity"].sum() == 0.0


def test_nobody_gives_no_runs() -> None:
    empty = ContinuousTracks(
        SECONDS, ego(3.0), np.empty((0, len(SECONDS), 5)), np.zeros((0, len(SECONDS)), np.bool_), ()
    )
    assert extract_recorded_runs(empty, KEYFRAMES, "vehicle.car") == []


def test_how_far_a_body_reaches_over_the_edge_of_the_road() -> None:
    island = shapely.Polygon([(-50, -50), (50, -50), (50, 50), (-50, 50)], [[(10, -2), (14, -2), (14, 2), (10, 2)]])
    edge = RoadEdge(shapely.MultiPolygon([island]))
    boxes = np.array([[0.0, 0.0, 4.0, 2.0, 0.0], [49.0, 20.0, 4.0, 2.0, 0.0], [90.0, 0.0, 4.0, 2.0, 0.0],
                      [0.0, 0.0, 4.0, 2.0, np.pi / 2], [9.0, 0.0, 4.0, 2.0, 0.0]])  # fmt: skip
    # 8 m to the island, 1 m over, far outside, 9 m to the island, 1 m inside the island's hole.
    assert edge.measure_overhang(boxes) == pytest.approx([-8.0, 1.0, 5.0, -9.0, 1.0])
    whole = RoadEdge(shapely.MultiPolygon([shapely.box(-99, -99, 99, 99)]))
    assert whole.measure_overhang(boxes[:1]) == pytest.approx([-20.0])
