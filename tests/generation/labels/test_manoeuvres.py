"""Every kind of manoeuvre on hand-made tracks: given along the ego's path, so that bends must not matter."""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, FRAME_HZ
from benchmark.errors import InputError
from benchmark.geometry import Floats, quaternion_from_yaw, to_global
from benchmark.records.attempts import ManoeuvreLabels
from benchmark.road_map import RoadMap, as_multipolygon
from benchmark.scene import EgoTrack, Scene
from generation.labels.interactions import VERTEX_STEP_M, PathFrame, compute_path_interaction
from generation.labels.labelling import compute_labels
from generation.labels.manoeuvres import Manoeuvre, find_encroachment, smooth_mask
from tests.hand_made import Car, scene_on_straight_road

EGO_M_S = 8.0
CURVATURES = {"straight": 0.0, "left bend": 1 / 40, "right bend": -1 / 40, "junction turn": 1 / 15}
Profile = Callable[[Floats], Floats]


@dataclass(frozen=True)
class Case:
    """A vehicle's station and offset over time along the ego's path; it faces where it goes, or ``turn`` off the path.

    ``seconds`` is how long the scene lasts, ``ego`` the ego's station.
    """

    kind: Manoeuvre
    station: Profile
    offset: Profile
    turn: float = 0.0
    seconds: float = 10.0
    ego: Profile = lambda t: EGO_M_S * t


def _eased(t: Floats, begin: float, end: float) -> Floats:
    share = np.clip((t - begin) / (end - begin), 0.0, 1.0)
    return np.asarray(share**2 * (3 - 2 * share))


def _held(value: float) -> Profile:
    return lambda t: np.full_like(t, value)


def _at(lead: float, gain: float = 0.0) -> Profile:
    """So far ahead of the ego's 8 m/s, gaining so much a second."""
    return lambda t: lead + (EGO_M_S + gain) * t


def _stopping(t: Floats) -> Floats:
    """8 m/s, braking at 1 m/s^2 to stand after 32 m."""
    return np.asarray(8.0 * np.minimum(t, 8.0) - 0.5 * np.minimum(t, 8.0) ** 2)


def _braking(t: Floats) -> Floats:
    """8 m/s, from 3 s on 1.5 s of braking at 3 m/s^2, then 2 m/s^2 back to 8 m/s."""
    brake, back = np.clip(t - 3.0, 0.0, 1.5), np.clip(t - 4.5, 0.0, 2.25)
    return np.asarray(14.0 + 8.0 * t - 1.5 * brake**2 - (4.5 * back - back**2))


CASES = {
    "cuts in from the left": Case(Manoeuvre.CUT_IN_LEFT, _at(10.0), lambda t: 3.5 * (1 - _eased(t, 3, 5))),
    "cuts in from the right": Case(Manoeuvre.CUT_IN_RIGHT, _at(10.0), lambda t: 3.5 * (_eased(t, 3, 5) - 1)),
    "overtakes and cuts in": Case(Manoeuvre.CUT_IN_LEFT, _at(-12.0, 3.0), lambda t: 3.5 * (1 - _eased(t, 6, 8))),
    "overtakes on the left": Case(Manoeuvre.OVERTAKING_LEFT, _at(-12.0, 3.0), _held(3.5)),
    "overtakes on the right": Case(Manoeuvre.OVERTAKING_RIGHT, _at(-12.0, 3.0), _held(-3.5)),
    "weaves ahead": Case(Manoeuvre.LEADING, _at(10.0), lambda t: 1.95 * (_eased(t, 2, 4) - _eased(t, 4.5, 6.5))),
    "overtakes one that stops": Case(Manoeuvre.OVERTAKING_LEFT, lambda t: 5.0 * t - 4.0, _held(3.5), ego=_stopping),
    "passes one that stands": Case(
        Manoeuvre.PASSING_WIDE, lambda t: 5.0 * t - 24.0, _held(3.5), seconds=14.0, ego=_stopping
    ),
    "drives alongside": Case(Manoeuvre.SQUEEZING_LEFT, _at(-0.5), _held(2.5)),
    "drives alongside, right": Case(Manoeuvre.SQUEEZING_RIGHT, _at(-0.5), _held(-2.5)),
    "tailgates": Case(Manoeuvre.TAILGATING, _at(-8.0), _held(0.0)),
    "follows": Case(Manoeuvre.FOLLOWING, _at(-20.0), _held(0.0)),
    "leads": Case(Manoeuvre.LEADING, _at(15.0), _held(0.0)),
    "brakes ahead": Case(Manoeuvre.BRAKING_AHEAD, _braking, _held(0.0)),
    "is slow ahead": Case(Manoeuvre.BLOCKING, lambda t: 45.0 + 3.0 * t, _held(0.0), seconds=7.5),
    "is a little slow ahead": Case(Manoeuvre.BLOCKING, lambda t: 25.0 + 5.5 * t, _held(0.0), seconds=8.0),
    "stands ahead": Case(Manoeuvre.BLOCKING, _held(40.0), _held(0.0), ego=_stopping),
    "stands across": Case(Manoeuvre.BLOCKING, _held(40.0), _held(0.0), np.pi / 2, ego=_stopping),
    "comes towards": Case(Manoeuvre.ONCOMING, lambda t: 90.0 - 6.0 * t, _held(1.95), np.pi, seconds=8.0),
    "crosses before": Case(Manoeuvre.CROSSING, _held(60.0), lambda t: 11.0 - 3.0 * t, -np.pi / 2),
    "crosses behind": Case(Manoeuvre.CROSSING, _held(20.0), lambda t: 3.0 * t - 11.0, np.pi / 2),
    "stays in the blind spot": Case(Manoeuvre.BLIND_SPOT_LEFT, _at(-4.0), _held(3.2)),
    "stays in the right blind spot": Case(Manoeuvre.BLIND_SPOT_RIGHT, _at(-4.0), _held(-3.2)),
    "passes in the lane after the next": Case(Manoeuvre.PASSING_WIDE, _at(-12.0, 3.0), _held(7.0)),
    "comes by in its own lane": Case(Manoeuvre.PASSING_WIDE, lambda t: 90.0 - 6.0 * t, _held(3.5), np.pi),
    "crosses long before": Case(Manoeuvre.DISTANT, _held(62.0), lambda t: 3.0 - 3.0 * t, -np.pi / 2),
    "is far away": Case(Manoeuvre.DISTANT, _at(0.0), _held(16.0)),
}


def _on_path(station: Floats, offset: Floats, curvature: float) -> Floats:
    """(T, 3) poses of places beside a path of constant curvature that starts at the origin along +x."""
    heading = curvature * station
    if curvature == 0.0:
        center = np.column_stack([station, np.zeros_like(station)])
    else:
        center = np.column_stack([np.sin(heading), 1 - np.cos(heading)]) / curvature
    normal = np.column_stack([-np.sin(heading), np.cos(heading)])
    return np.column_stack([center + offset[:, None] * normal, heading])


def scene_of(case: Case, curvature: float = 0.0) -> Scene:
    """The scene of a case, without a map; the ego's body centre starts at the origin."""
    t = np.arange(round(case.seconds * FRAME_HZ)) / FRAME_HZ
    station, offset = case.station(t), case.offset(t)
    ego = _on_path(case.ego(t), np.zeros_like(t), curvature)
    other = _on_path(station, offset, curvature)
    drift = np.arctan2(np.gradient(offset, t), np.maximum(np.gradient(station, t), 0.5)) if case.turn == 0.0 else 0.0
    other[:, 2] += case.turn + drift
    return placed(_one_car(case.seconds), ego, other)


@cache
def _one_car(seconds: float) -> Scene:
    """Without a map."""
    scene = scene_on_straight_road((Car(0.0, 0.0),), seconds=seconds)
    nowhere = RoadMap("nowhere", as_multipolygon(scene.road_map.drivable_area.buffer(-1e3)))
    return replace(scene, road_map=nowhere)


def placed(scene: Scene, ego: Floats, other: Floats) -> Scene:
    """The scene with other tracks of the body centres, (T, 3) each."""
    position = scene.agents.position.copy()
    position[0, :, :2] = other[:, :2]
    axle = ego[:, :2] - EGO_CENTER_FROM_REAR_AXLE_M * np.column_stack([np.cos(ego[:, 2]), np.sin(ego[:, 2])])
    return replace(
        scene,
        ego=EgoTrack(np.column_stack([axle, np.zeros(len(ego))]), quaternion_from_yaw(ego[:, 2])),
        agents=replace(scene.agents, position=position, yaw=other[None, :, 2]),
    )


def tracks(scene: Scene) -> tuple[Floats, Floats]:
    """(T, 3) centres of the ego's and the vehicle's bodies."""
    return scene.ego.boxes[:, [0, 1, 4]], scene.agents.boxes[0][:, [0, 1, 4]]


def kinds(labels: ManoeuvreLabels) -> list[Manoeuvre]:
    return [Manoeuvre(item.kind) for item in labels.occurred]


@pytest.mark.parametrize("bend", CURVATURES)
@pytest.mark.parametrize("name", CASES)
def test_each_kind_is_named_on_straight_roads_and_in_bends(name: str, bend: str) -> None:
    case = CASES[name]
    labels = compute_labels(scene_of(case, CURVATURES[bend]), 0, 0)
    assert labels.manoeuvre == case.kind, kinds(labels)
    assert labels.occurred[0].kind == labels.manoeuvre
    assert len(set(kinds(labels))) == len(labels.occurred)


def test_all_kinds_have_a_case() -> None:
    assert {case.kind for case in CASES.values()} == set(Manoeuvre)


def test_a_cut_in_begins_when_the_body_reaches_into_the_ego_s_way() -> None:
    labels = compute_labels(scene_of(CASES["cuts in from the left"]), 0, 0)
    cut_in, later = labels.occurred[0], labels.occurred[1]
    # The near side of a 1.9 m wide car reaches the 1.73 m wide strip at 1.815 m (4.0 s), a corner sooner.
    assert 3.6 <= cut_in.first_s <= 4.0
    assert later.kind == Manoeuvre.LEADING and later.first_s == pytest.approx(cut_in.first_s, abs=0.1)
    assert cut_in.least_gap_m == pytest.approx(10.0 - 0.5 * (4.6 + 4.084), abs=0.25)
    assert labels.encroachment is not None and not labels.encroachment.ego_first
    assert labels.encroachment.seconds == pytest.approx((10.0 - 4.342) / EGO_M_S, abs=0.1)


def test_what_happened_far_away_first_is_not_the_primary_kind() -> None:
    labels = compute_labels(scene_of(Case(
        Manoeuvre.SQUEEZING_RIGHT,
        lambda t: 25.0 + EGO_M_S * t - 25.0 * _eased(t, 2, 8),
        lambda t: -2.5 * _eased(t, 1, 2.5),
        seconds=12.0,
    )), 0, 0)  # fmt: skip
    assert labels.manoeuvre == Manoeuvre.SQUEEZING_RIGHT
    assert kinds(labels)[0] is Manoeuvre.SQUEEZING_RIGHT


def test_the_duration_of_a_steady_state_is_the_whole_scene() -> None:
    (tailgating, following) = compute_labels(scene_of(CASES["tailgates"]), 0, 0).occurred
    assert (tailgating.kind, following.kind) == (Manoeuvre.TAILGATING, Manoeuvre.FOLLOWING)
    assert tailgating.first_s == 0.0 and tailgating.duration_s == pytest.approx(10.0, abs=0.01)


def test_frames_before_the_launch_do_not_count() -> None:
    scene = scene_of(CASES["cuts in from the left"])
    late = compute_labels(scene, 0, 84)
    assert late.manoeuvre == Manoeuvre.LEADING and late.occurred[0].first_s == pytest.approx(7.0)


def test_a_vehicle_that_was_always_ahead_does_not_cut_in() -> None:
    wobbling = replace(CASES["leads"], offset=lambda t: 0.6 * np.sin(2 * t))
    assert compute_labels(scene_of(wobbling), 0, 0).manoeuvre == Manoeuvre.LEADING


@pytest.mark.parametrize("name", CASES)
def test_moving_and_turning_the_world_changes_nothing(name: str) -> None:
    scene = scene_of(CASES[name], CURVATURES["left bend"])
    move = np.random.default_rng(list(name.encode())).uniform(-1, 1, 3) * [2000, 2000, np.pi]
    angle = move[2]
    ego, other = (np.column_stack([to_global(track[:, :2], move), track[:, 2] + angle]) for track in tracks(scene))
    before, after = compute_labels(scene, 0, 0), compute_labels(placed(scene, ego, other), 0, 0)
    assert kinds(after) == kinds(before)
    first = [item.first_s for item in before.occurred]
    assert [item.first_s for item in after.occurred] == pytest.approx(first, abs=0.1)
    assert after.closest_approach.gap_m == pytest.approx(before.closest_approach.gap_m, abs=1e-6)


@pytest.mark.parametrize("bend", ["straight", "right bend"])
@pytest.mark.parametrize("name", CASES)
def test_mirroring_swaps_left_and_right(name: str, bend: str) -> None:
    scene = scene_of(CASES[name], CURVATURES[bend])
    ego, other = (track * [1.0, -1.0, -1.0] for track in tracks(scene))
    swap = {"left": "right", "right": "left"}

    def mirrored(word: str) -> str:
        head, _, side = word.rpartition("-")
        return f"{head}-{swap[side]}" if side in swap else word

    before, after = compute_labels(scene, 0, 0), compute_labels(placed(scene, ego, other), 0, 0)
    assert sorted(kinds(after)) == sorted(mirrored(kind) for kind in kinds(before))
    assert after.manoeuvre == mirrored(before.manoeuvre)
    assert after.closest_approach.side == swap.get(before.closest_approach.side, before.closest_approach.side)


@pytest.mark.parametrize("frame", [0, 1, 50, 118, 119])
@pytest.mark.parametrize("name", ["leads", "tailgates", "is slow ahead", "drives in the next lane", "is far away"])
def test_one_noisy_frame_adds_no_kind(name: str, frame: int) -> None:
    beside = Case(Manoeuvre.PASSING_WIDE, _at(12.0), _held(3.5))
    scene = scene_of(replace(CASES.get(name, beside), seconds=10.0 if name != "is slow ahead" else 7.5))
    ego, other = tracks(scene)
    noisy = other.copy()
    # Out of the ego's way, or into it.
    frame = min(frame, len(noisy) - 1)
    noisy[frame, 1] = 4.0 if noisy[frame, 1] == 0.0 else 0.0
    assert set(kinds(compute_labels(placed(scene, ego, noisy), 0, 0))) <= set(kinds(compute_labels(scene, 0, 0)))


def test_a_condition_is_settled_by_majority() -> None:
    flicker = np.zeros(20, dtype=np.bool_)
    flicker[[4, 10, 11]] = True
    assert not smooth_mask(flicker).any() and smooth_mask(~flicker).all()
    step = np.arange(20) >= 7
    assert (smooth_mask(step) == step).all()


def test_a_standing_ego_is_challenged_by_nothing_beside_or_behind_it() -> None:
    for name in ("drives alongside", "tailgates", "stays in the blind spot"):
        still = replace(CASES[name], ego=_held(0.0), station=_held(CASES[name].station(np.zeros(1))[0]))
        assert compute_labels(scene_of(still), 0, 0).manoeuvre == Manoeuvre.PASSING_WIDE, name


def test_absent_frames_do_not_count() -> None:
    scene = scene_of(CASES["cuts in from the left"])
    valid = scene.agents.valid.copy()
    valid[0, 40:] = False
    labels = compute_labels(replace(scene, agents=replace(scene.agents, valid=valid)), 0, 0)
    assert Manoeuvre.CUT_IN_LEFT not in kinds(labels) and labels.closest_approach.frame < 40
    # Two frames decide nothing.
    valid[0] = np.isin(np.arange(valid.shape[1]), [70, 71])
    labels = compute_labels(replace(scene, agents=replace(scene.agents, valid=valid)), 0, 0)
    assert kinds(labels) == [Manoeuvre.DISTANT] and labels.closest_approach.frame in (70, 71)
    # Appearing inside the ego's way is not entering it.
    valid[0] = np.arange(valid.shape[1]) >= 70
    labels = compute_labels(replace(scene, agents=replace(scene.agents, valid=valid)), 0, 0)
    assert labels.manoeuvre == Manoeuvre.LEADING and labels.closest_approach.frame >= 70


@pytest.mark.parametrize("name", CASES)
def test_the_last_frames_alone_are_described_too(name: str) -> None:
    scene = scene_of(replace(CASES[name], seconds=10.0))
    for start in (118, 119):
        labels = compute_labels(scene, 0, start)
        assert labels.occurred and labels.closest_approach.frame >= start
        assert all(np.isfinite([item.first_s, item.duration_s, item.least_gap_m]).all() for item in labels.occurred)


def test_wrong_use_is_one_sentence() -> None:
    scene = scene_of(CASES["leads"])
    for agent, start in ((1, 0), (-1, 0), (0, 120), (0, -1)):
        with pytest.raises(InputError, match="to label; choose one that exists"):
            compute_labels(scene, agent, start)
    ego, other = tracks(scene)
    other[5, 0] = np.nan
    with pytest.raises(InputError, match="not finite"):
        compute_labels(placed(scene, ego, other), 0, 0)
    gone = replace(scene, agents=replace(scene.agents, valid=np.zeros_like(scene.agents.valid)))
    with pytest.raises(InputError, match="is absent"):
        compute_labels(gone, 0, 0)


@settings(max_examples=20, deadline=None)
@given(
    curvature=st.floats(-1 / 12, 1 / 12), station=st.floats(0, 60), offset=st.floats(-6, 6), speed=st.floats(0.2, 12)
)
def test_projection_agrees_with_the_nearest_of_many_points(
    curvature: float, station: float, offset: float, speed: float
) -> None:
    t = np.arange(97) / FRAME_HZ
    ego = _on_path(speed * t, np.zeros_like(t), curvature)
    boxes = np.column_stack([ego[:, :2], np.full((97, 2), 2.0), ego[:, 2]])
    path = PathFrame.of(boxes)
    point = _on_path(np.array([station]), np.array([offset]), curvature)[:, :2]
    found, across, _ = path.project(point[:, None], path.ego_stations[48:49], 80.0)
    dense = np.linspace(-80, 80, 64001) + path.ego_stations[48]
    places = np.column_stack([np.interp(dense, path.stations, path.vertices[:, axis]) for axis in (0, 1)])
    distance = np.hypot(*(places - point[0]).T)
    assert abs(across[0, 0]) == pytest.approx(float(distance.min()), abs=5e-3)
    at = np.array([np.interp(found[0, 0], path.stations, path.vertices[:, axis]) for axis in (0, 1)])
    assert float(np.hypot(*(at - point[0]))) == pytest.approx(abs(across[0, 0]), abs=1e-6)


@pytest.mark.parametrize("bend", CURVATURES)
def test_the_ego_s_own_station_is_the_way_it_drove(bend: str) -> None:
    t = np.arange(96) / FRAME_HZ
    # Stops for two seconds on the way, with the noise of a standing localisation.
    driven = EGO_M_S * (t - np.clip(t - 3.0, 0.0, 2.0))
    ego = _on_path(driven, 0.01 * np.sin(50 * t), CURVATURES[bend])
    path = PathFrame.of(np.column_stack([ego[:, :2], np.full((96, 2), 2.0), ego[:, 2]]))
    assert path.ego_stations == pytest.approx(driven, abs=0.1)


@settings(max_examples=20, deadline=None)
@given(speed=st.sampled_from([0.0, 0.3, 4.0, 11.9, 12.0, 12.1]), noise=st.sampled_from([0.0, 1e-16, 1e-9, 0.3]))
def test_vertices_are_a_step_apart_by_the_distance_itself(speed: float, noise: float) -> None:
    along = speed * np.arange(96) / FRAME_HZ
    ego = np.column_stack([along, noise * np.sin(37 * along), np.full((96, 2), 2.0), np.zeros(96)])
    chosen = [0]
    for frame in range(1, len(ego)):
        if np.hypot(*(ego[frame, :2] - ego[chosen[-1], :2])) >= VERTEX_STEP_M:
            chosen.append(frame)
    path = PathFrame.of(ego)
    first = int(np.argmin(np.abs(path.stations)))
    assert path.vertices[first : first + len(chosen)].tolist() == ego[chosen, :2].tolist()


@settings(max_examples=20, deadline=None)
@given(lead=st.floats(-30, 30), gain=st.floats(-3, 3), offset=st.floats(-2, 2))
def test_encroachment_agrees_with_trying_all_pairs_of_frames(lead: float, gain: float, offset: float) -> None:
    scene = scene_of(Case(Manoeuvre.LEADING, _at(lead, gain), _held(offset), seconds=4.0))
    met = compute_path_interaction(scene.ego.boxes, scene.agents.boxes[0], scene.seconds, scene.agents.valid[0], 0)
    found = find_encroachment(met)
    least = np.inf
    for frame in np.flatnonzero(smooth_mask(met.inside)):
        for other in range(len(met.seconds)):
            apart = met.other.rear[frame] >= met.ego.front[other] or met.other.front[frame] <= met.ego.rear[other]
            least = least if apart else min(least, abs(met.seconds[frame] - met.seconds[other]))
    assert (found is None) == np.isinf(least)
    assert found is None or found.seconds == pytest.approx(least)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(2, 40),
    scale=st.sampled_from([0.0, 1e-3, 1.0, 20.0, 1e5]),
    ego_scale=st.sampled_from([0.0, 1e-3, 1.0, 20.0]),
    present=st.floats(0.0, 1.0),
)
def test_whatever_the_tracks_there_are_labels_in_json(
    seed: int, count: int, scale: float, ego_scale: float, present: float
) -> None:
    rng = np.random.default_rng(seed)
    scene = scene_of(replace(CASES["leads"], seconds=count / FRAME_HZ))
    ego, other = (
        np.column_stack([np.cumsum(rng.normal(0, size, (count, 2)), axis=0), rng.uniform(-4, 4, count)])
        for size in (ego_scale, scale)
    )
    start = int(rng.integers(count))
    valid = rng.uniform(size=(1, count)) <= present
    valid[0, int(rng.integers(start, count))] = True
    wild = placed(scene, ego, other)
    labels = compute_labels(replace(wild, agents=replace(wild.agents, valid=valid)), 0, start)
    assert json.loads(json.dumps(labels.as_json(), allow_nan=False)) == labels.as_json()
    assert valid[0, labels.closest_approach.frame] and labels.closest_approach.frame >= start


def test_after_the_recording_the_ego_goes_on_as_fast_as_at_its_end() -> None:
    seconds = np.arange(25) / 12.0
    ego = np.column_stack([8.0 * seconds, np.zeros(25), np.full(25, 4.0), np.full(25, 2.0), np.zeros(25)])
    standing = np.tile([ego[-1, 0] + 2.0 + 40.0 + 2.0, 0.0, 4.0, 2.0, 0.0], (25, 1))
    met = compute_path_interaction(ego, standing, seconds, np.ones(25, dtype=np.bool_), 0)
    np.testing.assert_allclose(met.reach_s, 5.0 + seconds[-1] - seconds, atol=1e-6)
