from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.datasets.scenarionet import read_scenarionet
from benchmark.errors import InputError
from benchmark.geometry import transform_matrix
from generation.extensions.magicdrive.clip import (
    build_clip,
    compute_trimmed_length,
    draw_box_latents,
    group_latent_frames,
    pad_frames,
)
from generation.extensions.magicdrive.conditions import ClipConditions, TextStates
from generation.extensions.magicdrive.encoders import pool_in_time
from generation.extensions.magicdrive.prompt import IMPORTED, PromptLook, build_prompt
from generation.extensions.magicdrive.sensor_frames import SensorFrames, compute_ego_motion
from tests.benchmark.datasets.test_scenarionet import recording, write
from tests.generation.extensions.magicdrive.busy_scenes import busy_scene

TEXT = TextStates(torch.zeros(300, 8), torch.ones(300, dtype=torch.bool))


@pytest.mark.parametrize(("frames", "latent"), [(241, 61), (240, 60), (17, 5), (16, 4), (1, 1)])
def test_frames_pool_as_in_the_model(frames: int, latent: int) -> None:
    groups = group_latent_frames(frames)
    assert len(groups) == latent
    assert sorted(frame for group in groups for frame in group) == list(range(frames))
    one_hot = torch.eye(frames, dtype=torch.float64)
    pooled = pool_in_time(pool_in_time(one_hot))
    for row, group in zip(pooled, groups):
        assert torch.nonzero(row).flatten().tolist() == list(group)
        assert row.sum() == 1.0


@given(count=st.integers(1, 400))
@settings(max_examples=25, deadline=None)
def test_lengths_are_8k_or_8k_and_one(count: int) -> None:
    trimmed, padded = compute_trimmed_length(count), pad_frames(range(count))
    assert trimmed % 8 in (0, 1) and count - 6 <= trimmed <= count
    assert len(padded) % 8 in (0, 1) and padded[:count] == tuple(range(count)) and len(padded) - count < 8
    assert set(padded[count:]) <= {count - 1}


def test_a_point_moves_from_the_first_lidar_frame_to_this_one() -> None:
    scene = busy_scene()
    frames = np.arange(17)
    turned = scene.ego.rotation.copy()
    turned[:] = np.column_stack([np.cos(frames / 40), 0 * frames, 0 * frames, np.sin(frames / 40)])
    scene = replace(scene, ego=replace(scene.ego, rotation=turned))
    sensors = SensorFrames.of(scene, frames)
    motion = compute_ego_motion(sensors)
    np.testing.assert_array_equal(motion[0], np.eye(4))
    in_world = np.array([66.0, 201.0, 0.4, 1.0])
    lidar = transform_matrix(scene.lidar.rotation, scene.lidar.translation)
    seen = [
        np.linalg.inv(transform_matrix(scene.ego.rotation[frame], scene.ego.position[frame]) @ lidar) @ in_world
        for frame in frames
    ]
    for frame in frames:
        np.testing.assert_allclose(motion[frame] @ seen[0], seen[frame], atol=1e-4)
    assert not ((motion != 0) & (np.abs(motion) < 1e-6)).any()


def test_calibration_is_that_of_full_size_images() -> None:
    scene = busy_scene(9 / 12)
    small = replace(scene, cameras=tuple(camera.resized(448, 256) for camera in reversed(scene.cameras)))
    here, there = build_clip(scene, range(9)), build_clip(small, range(9))
    np.testing.assert_allclose(here.cams, there.cams, rtol=1e-6, atol=1e-6)
    assert here.cams[1, 0, 0, 0] == 1266.0


def test_conditions_that_do_not_belong_together_are_refused() -> None:
    conditions = build_clip(busy_scene(9 / 12), range(9)).conditions(TEXT, None, latent_width=12)
    fields = {name: getattr(conditions, name) for name in ClipConditions.__dataclass_fields__}
    for name, wrong in (
        ("cams", conditions.cams[:, :8]),
        ("maps", conditions.maps[:3]),
        ("box_latent", conditions.box_latent[:2]),
        ("bboxes", conditions.bboxes.repeat(2, 1, 1, 1, 1)),
    ):
        with pytest.raises(ValueError):
            ClipConditions(**{**fields, name: wrong})


def test_latents_come_from_the_stream_of_the_published_scripts() -> None:
    state = torch.random.get_rng_state()
    torch.manual_seed(1024)
    official = torch.randn(7, 33)
    torch.random.set_rng_state(state)
    assert torch.equal(draw_box_latents(7, 33, 1024), official)
    assert not torch.equal(draw_box_latents(7, 33, 1025), official)


def test_part_of_a_scene_is_the_part_of_its_conditions() -> None:
    scene = busy_scene()
    whole, part = build_clip(scene, range(17)), build_clip(scene, range(4, 12))
    np.testing.assert_array_equal(whole.boxes.corners[4:12], part.boxes.corners)
    np.testing.assert_array_equal(whole.maps[4:12], part.maps)
    np.testing.assert_array_equal(part.rel_pos[0], np.eye(4))


@pytest.mark.parametrize("frames", [[], [0, 1], [3, 2, 1, 0, 4, 5, 6, 7], [-1], [17], list(range(10, 20))])
def test_frames_that_cannot_be_drawn_are_refused(frames: list[int]) -> None:
    with pytest.raises(InputError, match="scene-9901"):
        build_clip(busy_scene(), frames)


def test_a_missing_or_broken_camera_is_named() -> None:
    scene = busy_scene(9 / 12)
    with pytest.raises(InputError, match=r"no camera CAM_FRONT_LEFT \(it has none\)"):
        build_clip(replace(scene, cameras=()), range(9))
    with pytest.raises(InputError, match="no camera CAM_BACK "):
        build_clip(replace(scene, cameras=tuple(c for c in scene.cameras if c.name != "CAM_BACK")), range(9))
    broken = replace(scene.cameras[0], intrinsic=np.zeros((3, 3)))
    with pytest.raises(InputError, match="camera CAM_FRONT of scene-9901 has no positive focal lengths"):
        build_clip(replace(scene, cameras=(broken, *scene.cameras[1:])), range(9))


def test_numbers_that_are_none_are_refused() -> None:
    scene = busy_scene(9 / 12)
    for field, word in (("agents", "annotations"), ("ego", "ego poses")):
        part = getattr(scene, field)
        position = part.position.copy()
        position[..., 3, 0] = np.nan
        changed = replace(part, position=position)
        broken = replace(scene, agents=changed) if field == "agents" else replace(scene, ego=changed)
        with pytest.raises(InputError, match=f"{word} of scene-9901|annotations of scene-9901"):
            build_clip(broken, range(9))


def test_the_prompt_says_where_and_what() -> None:
    scene = replace(busy_scene(9 / 12), description="Night, heavy rain, pedestrian with Umbrella, train on bridge")
    assert build_prompt(scene).positive == (
        "A driving scene image at boston-seaport. Night, heavy rain, pedestrian with Umbrella, train on bridge."
    )
    assert build_prompt(scene).negative is None
    day = build_prompt(scene, PromptLook.DAYTIME)
    assert day.positive == "Daytime. a driving scene image at singapore-onenorth. heavy sunny, train on bridge."
    assert day.negative == "Rain, Night, water reflections, umbrella"
    assert build_prompt(replace(scene, description="")).positive == "A driving scene image at boston-seaport."
    # No look asks for what it forbids.
    for look, words in (
        (PromptLook.RAINY, "Rainy. a driving scene image at boston-seaport. left turn, rain."),
        (PromptLook.NIGHT, "Night. a driving scene image at singapore-hollandvillage. left turn, night."),
    ):
        prompt = build_prompt(replace(scene, description="Left turn, day"), look)
        assert prompt.positive == words and prompt.negative is not None


def test_the_description_of_an_imported_recording_is_its_prompt(tmp_path: Path) -> None:
    scene = read_scenarionet(write(tmp_path, recording()))
    prompt = build_prompt(scene).positive
    assert prompt == f"A driving scene image at {scene.road_map.location}. {scene.description}."
    # Of recordings that were imported before.
    assert build_prompt(replace(scene, description=IMPORTED)).positive == prompt
