"""What an importer knows of samples: as the protocols know it where roads are level, in space where they are not."""

import dataclasses

import numpy as np

from adapters.result_files.samples import read_recorded_samples
from adapters.result_files.synthetic import make_synthetic_samples
from benchmark.geometry import rotation_matrix
from benchmark.planning import Command
from tests.benchmark.fake_data import FakeData, town_of_two


def test_samples_are_those_of_the_protocols() -> None:
    data = town_of_two()
    samples = read_recorded_samples(data, "val")
    truths = [truth for scene in data.scene_names("val") for truth in data.truth(scene)]
    assert samples.tokens == tuple(truth.sample_token for truth in truths)
    for row, truth in enumerate(truths):
        assert samples.valid[row].tolist() == truth.ego_future_valid.tolist()
        valid = truth.ego_future_valid
        assert np.allclose(samples.future[row][valid], truth.ego_future[valid, :2], atol=1e-9)
        assert not samples.future[row][~valid].any() and samples.commands[row] == truth.command
        assert samples.complete[row] == truth.complete


def test_infos_are_sorted_by_time_over_all_scenes_and_by_scene_where_they_are_not() -> None:
    samples = read_recorded_samples(town_of_two(), "val")
    times = samples.timestamps_us[samples.by_time]
    assert (np.diff(times) >= 0).all()
    # Both scenes begin at the same time: they take turns, the first by name first.
    assert [samples.scenes[row] for row in samples.by_time[:4]] == ["scene-9901", "scene-9902"] * 2
    assert [samples.scenes[row] for row in samples.by_table] == sorted(samples.scenes)
    some = samples.of_scenes(("scene-9902",))
    assert {some.scenes[row] for row in (*some.by_time, *some.by_table)} == {"scene-9902"}


def test_on_a_slope_the_way_is_that_of_the_lidar_in_space() -> None:
    data = town_of_two()
    scene = data.scenes["scene-9901"]
    slope = 0.1
    half = 0.5 * np.arctan(slope)
    up = np.array([np.cos(half), 0.0, -np.sin(half), 0.0])
    position = scene.ego.position.copy()
    position[:, 2] = slope * position[:, 0]
    ego = dataclasses.replace(scene.ego, position=position, rotation=np.tile(up, (len(position), 1)))
    assert np.allclose(rotation_matrix(up)[:, 0], np.array([1.0, 0.0, slope]) / np.hypot(1.0, slope))
    samples = read_recorded_samples(FakeData({scene.name: dataclasses.replace(scene, ego=ego)}), "val")
    level = read_recorded_samples(FakeData({scene.name: scene}), "val")
    assert np.allclose(samples.future[0, :, 1], level.future[0, :, 1] * np.hypot(1.0, slope))
    assert np.allclose(samples.future[0, :, 0], level.future[0, :, 0])


def test_near_the_border_of_commands_either_may_have_been_stored() -> None:
    samples = make_synthetic_samples()
    future = np.zeros_like(samples.future)
    future[:4, -1, 0] = (1.97, 2.03, -1.97, 1.9)
    samples = dataclasses.replace(samples, future=future, valid=np.ones_like(samples.valid))
    right, left, straight = Command.RIGHT, Command.LEFT, Command.STRAIGHT
    allowed = [{each for each in Command if samples.may_have_command(row, each)} for row in range(5)]
    assert allowed == [{right, straight}, {right, straight}, {left, straight}, {straight}, {straight}]
