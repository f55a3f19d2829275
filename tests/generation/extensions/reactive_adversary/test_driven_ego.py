"""A reference driver in the ego's place: it answers, those behind it too, and what it cannot answer is dropped."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.geometry import Floats, boxes_overlap
from benchmark.interactions.driver_simulation import DrivingSituation, ReferenceDriver, simulate_drivers
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.machine.workers import LocalProcesses
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.driven_ego import (
    ACROSS_M_S2,
    DRIVERS,
    FASTEST_M_S2,
    HARDEST_M_S2,
    DrivenWorld,
    EgoDrive,
    get_undisturbed,
    smooth_station,
)
from generation.extensions.reactive_adversary.followers import find_followers
from generation.extensions.reactive_adversary.pressing import LEAST_PRESSURE, PressingPlanning, measure_pressure
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import build_split
from generation.search.attempts import StoredDrive
from generation.search.presets import build_hyper_parameters
from generation.search.proposals import run_searches
from generation.search.threat_settings import EgoDriver
from generation.search.verify import DiscardReason
from generation.splits.building import build_frozen
from generation.splits.format import DRIVEN_SCHEMA, SCHEMA
from generation.splits.packaged import NamedSplit, list_packaged_splits, read_frozen_split
from tests.generation.labels.recorded_roads import CHEAP, contents, recorded, write_source
from tests.generation.search.driving_prior import DrivingPrior, unchanged
from tests.hand_made import Car, scene_on_straight_road

LEADER, FOLLOWER, BESIDE, ONCOMING = range(4)
CARS = (Car(66.0, 198.25, 8.0), Car(30.0, 198.25, 8.0), Car(30.0, 194.75, 8.0), Car(150.0, 201.75, 8.0, np.pi))


def road(seconds: float = 12.0) -> Scene:
    return scene_on_straight_road(CARS, seconds=seconds)


def braking_leader(scene: Scene, braking_m_s2: float, until_m_s: float, start: int = 24) -> Floats:
    """(F, 3) of the leader, which brakes down to a speed."""
    time = scene.seconds[start:] - scene.seconds[start]
    speed = np.maximum(8.0 - braking_m_s2 * time, until_m_s)
    x = scene.agents.position[LEADER, start, 0] + np.concatenate(
        [[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) / 12)]
    )
    return np.column_stack([x, np.full(len(x), 198.25), np.zeros(len(x))])


def drive(scene: Scene, track: Floats, driver: EgoDriver = EgoDriver.CAREFUL, start: int = 24) -> EgoDrive:
    return DrivenWorld.of(scene, driver, LEADER).finish(start, track)


@pytest.mark.parametrize("driver", [EgoDriver.CAREFUL, EgoDriver.IDM])
def test_ego_and_follower_answer_a_leader_that_brakes_and_nobody_else_does(driver: EgoDriver) -> None:
    scene = road()
    track = braking_leader(scene, 1.0, 4.0)
    drive_ = drive(scene, track, driver)
    assert drive_.contact is None and drive_.find_failure(scene) is None
    assert drive_.has_reacted(get_undisturbed(scene, driver))
    follower = scene.agents.ids[FOLLOWER]
    assert set(drive_.tracks.others) == {follower}
    changed = drive_.tracks.put_into(scene).with_adversary(LEADER, slice(24, len(scene.seconds)), track)
    assert changed.adversaries == (scene.agents.ids[LEADER],)
    bodies = changed.agents.boxes
    for agent in range(4):
        assert not (changed.agents.valid[agent] & boxes_overlap(changed.ego.boxes, bodies[agent])).any()
    assert not boxes_overlap(bodies[FOLLOWER], bodies[LEADER]).any()
    first, _ = drive_.tracks.others[follower]
    for agent in (BESIDE, ONCOMING):
        np.testing.assert_array_equal(bodies[agent], scene.agents.boxes[agent])
    np.testing.assert_array_equal(bodies[FOLLOWER, :first], scene.agents.boxes[FOLLOWER, :first])
    assert (scene.agents.position[FOLLOWER, -1, 0] - changed.agents.position[FOLLOWER, -1, 0]) > 5.0


def test_a_recorded_follower_would_have_run_into_the_ego() -> None:
    scene = road()
    track = braking_leader(scene, 1.0, 4.0)
    changed = drive(scene, track).tracks
    ego = scene.with_ego(changed.ego).ego.boxes
    assert boxes_overlap(ego, scene.agents.boxes[FOLLOWER]).any()


def test_an_undisturbed_careful_ego_is_the_recorded_one_to_the_bit() -> None:
    scene = road()
    undisturbed = get_undisturbed(scene, EgoDriver.CAREFUL)
    assert not undisturbed.tracks.others
    again = undisturbed.tracks.put_into(scene)
    np.testing.assert_array_equal(again.ego.position, scene.ego.position)
    np.testing.assert_array_equal(again.ego.rotation, scene.ego.rotation)


@pytest.mark.parametrize("driver", [EgoDriver.CAREFUL, EgoDriver.IDM])
def test_without_followers_the_world_drives_as_the_drivers_of_severity_do(driver: EgoDriver) -> None:
    scene = scene_on_straight_road(CARS[:1], seconds=12.0)
    track = braking_leader(scene, 1.5, 3.0)
    changed = scene.with_adversary(LEADER, slice(24, len(scene.seconds)), track)
    (expected,) = simulate_drivers(
        DrivingSituation.of(ContinuousTracks.of_scene(changed)), [ReferenceDriver(DRIVERS[driver])]
    )
    np.testing.assert_allclose(drive(scene, track, driver).station, expected.station, atol=0.1)


def test_an_ego_that_is_hit_or_has_to_brake_too_hard_is_dropped() -> None:
    scene = road()
    blocked = drive(scene, braking_leader(scene, 60.0, 0.0, start=48), start=48).find_failure(scene)
    assert blocked is not None and blocked.reason in (DiscardReason.EGO_COLLIDES, DiscardReason.EGO_HARSH)
    into = braking_leader(scene, 2.0, 2.0)
    into[12:, 0] = scene.ego.position[36, 0] + 4.0
    hit = drive(scene, into).find_failure(scene)
    assert hit is not None and hit.reason is DiscardReason.EGO_COLLIDES and hit.other == scene.agents.ids[LEADER]


@pytest.mark.parametrize(
    ("speed", "reason"),
    [
        (lambda time: np.maximum(8.0 - 7.0 * np.maximum(time - 1.0, 0.0), 0.0), "braking, m/s^2"),
        (lambda time: np.minimum(4.0 + 3.5 * time, 14.0), "acceleration, m/s^2"),
    ],
)
def test_limits_are_those_of_half_a_second(speed: object, reason: str) -> None:
    scene = road()
    times = np.arange(0.0, 6.0, 0.1)
    values = speed(times)  # type: ignore[operator]
    station = np.concatenate([[0.0], np.cumsum(0.1 * values[1:])])
    tracks = get_undisturbed(scene, EgoDriver.CAREFUL).tracks
    failure = EgoDrive(times, station, values, 0, tracks, None).find_failure(scene)
    assert failure is not None and failure.quantity == reason
    pulse = np.where(np.arange(60) < 30, 8.0, 7.3)
    short = EgoDrive(times, np.concatenate([[0.0], np.cumsum(0.1 * pulse[1:])]), pulse, 0, tracks, None)
    assert short.find_failure(scene) is None
    assert (HARDEST_M_S2, FASTEST_M_S2, ACROSS_M_S2) == (6.0, 3.0, 4.0)


def test_smoothing_keeps_steady_motion() -> None:
    steady = 3.0 * np.arange(40) * 0.1
    np.testing.assert_allclose(smooth_station(steady), steady, atol=1e-12)


def test_who_follows_drives_behind_the_ego_on_its_path() -> None:
    scene = road()
    assert find_followers(scene, DrivingSituation.of(ContinuousTracks.of_scene(scene))) == [False, True, False, False]


def test_pressure_is_of_who_does_not_react() -> None:
    scene = road()
    track = braking_leader(scene, 1.0, 4.0)
    answered = drive(scene, track).tracks.put_into(scene).with_adversary(LEADER, slice(24, len(scene.seconds)), track)
    assert measure_pressure(answered, LEADER, 24) > 0.05
    assert measure_pressure(scene, LEADER, 24) == 0.0
    assert measure_pressure(scene, FOLLOWER, 24) == 0.0


def test_the_tracks_of_a_drive_are_stored_as_they_are() -> None:
    scene = road()
    tracks = drive(scene, braking_leader(scene, 1.0, 4.0)).tracks
    again = StoredDrive.model_validate_json(StoredDrive.of(tracks).model_dump_json()).tracks
    np.testing.assert_array_equal(again.ego, tracks.ego)
    assert {name: (first, track.tolist()) for name, (first, track) in again.others.items()} == {
        name: (first, track.tolist()) for name, (first, track) in tracks.others.items()
    }


def test_an_adversary_presses_an_ego_that_survives() -> None:
    scene = scene_on_straight_road((Car(62.0, 194.75, 9.0), Car(90.0, 198.25, 8.0)), seconds=10.0)
    hyper, stages = replace(CHEAP.hyper, ego=EgoDriver.CAREFUL), {"physics": 0.0, "scoring": 0.0}
    searches = [
        PressingPlanning(
            scene, 0, 12, hyper, unchanged, hyper.motion_model(), np.random.default_rng(seed), stages
        ).run()
        for seed in range(6)
    ]
    planned, _ = run_searches(searches, DrivingPrior())
    kept = [each for each in planned if each.failure is None]
    assert kept
    for each in kept:
        assert each.driven is not None and each.pressure >= LEAST_PRESSURE
        track = slice(12, len(scene.seconds))
        made = each.driven.put_into(scene).with_adversary(0, track, each.poses)
        assert not boxes_overlap(made.ego.boxes[track], made.agents.boxes[0, track]).any()


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    cars = (Car(62.0, 194.75, 9.0), Car(95.0, 198.25, 8.0), Car(30.0, 198.25, 8.0))
    return write_source(tmp_path_factory.mktemp("recorded"), recorded("scene-9901", cars))


PRESSED = replace(CHEAP, hyper=replace(CHEAP.hyper, ego=EgoDriver.CAREFUL, tries=4))


@pytest.fixture(scope="module")
def split(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> tuple[BuildSettings, NamedSplit]:
    folder = tmp_path_factory.mktemp("pressed")
    settings = replace(PRESSED, out=folder / "out", freeze=folder / "road.json")
    build_split(source, "adv-ego-careful", settings)
    return settings, read_frozen_split(folder / "road.json")


@pytest.mark.path
def test_a_split_with_a_driven_ego_is_built_frozen_and_built_again(
    source: DataSet, split: tuple[BuildSettings, NamedSplit], tmp_path: Path
) -> None:
    settings, named = split
    data = open_data(settings.out)
    (name, *_) = data.scene_names("adv-ego-careful")
    scene, was = data.scene(name), source.scene("scene-9901")
    assert (data.provenance() or {})["ego"] == "careful"
    assert np.abs(scene.ego.position[:, 0] - was.ego.position[:, 0]).max() > 0.5
    assert named.frozen.schema_version == DRIVEN_SCHEMA and named.frozen.search.ego == "careful"
    report = build_frozen(source, named, replace(settings, out=tmp_path / "again"), as_split="adv-ego-careful")
    assert report.other_tables == ()
    again = open_data(tmp_path / "again").scene(name)
    np.testing.assert_allclose(again.ego.position, scene.ego.position, atol=0.002)
    # What the car measured is what the driven one would have measured, not what the recorded one did.
    measured = [float(np.hypot(*seen.ego.velocity)) for seen in data.observations(name)]
    way = np.hypot(*np.diff(scene.ego.position[:, :2], axis=0).T) * 12.0
    np.testing.assert_allclose(measured[2:-1], way[scene.keyframes[2:-1] - 1], atol=0.6)


def test_neither_workers_nor_a_second_run_change_a_byte(
    source: DataSet, split: tuple[BuildSettings, NamedSplit], tmp_path: Path
) -> None:
    settings, _ = split
    before = contents(settings.out)
    build_split(source, "adv-ego-careful", settings)
    assert contents(settings.out) == before
    other = replace(settings, out=tmp_path / "out", freeze=None, executor=LocalProcesses(2))
    build_split(source, "adv-ego-careful", other)
    assert contents(other.out) == before


def test_the_unchanged_side_is_the_same_driver_undisturbed(source: DataSet, tmp_path: Path) -> None:
    settings = replace(PRESSED, out=tmp_path / "out", hyper=replace(PRESSED.hyper, ego=EgoDriver.IDM))
    report = build_split(source, "val-r-ego-idm", settings)
    data = open_data(tmp_path / "out")
    assert report.written == ("scene-9901",) and (data.provenance() or {})["ego"] == "idm"
    expected = get_undisturbed(source.scene("scene-9901"), EgoDriver.IDM).tracks.ego
    np.testing.assert_allclose(data.scene("scene-9901").ego.pose[:, :2], expected[:, :2], atol=1e-6)
    with pytest.raises(InputError, match="build it as val-r-ego-idm"):
        build_split(source, "val-r", replace(settings, out=tmp_path / "other"))


def test_packaged_splits_have_recorded_egos() -> None:
    for name in list_packaged_splits():
        frozen = read_frozen_split(name).frozen
        assert frozen.schema_version == SCHEMA and frozen.search.ego is None


@pytest.mark.parametrize("preset", ["effect", "paper", "reference"])
def test_presets_that_need_the_recorded_ego_refuse_another(preset: str) -> None:
    with pytest.raises(InputError, match="needs the recorded ego"):
        build_hyper_parameters(preset, {"ego": EgoDriver.IDM})  # type: ignore[arg-type]
