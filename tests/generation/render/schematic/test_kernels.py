"""Fast ways to draw against slow, obvious ones: the same bytes."""

import functools

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from generation.render.schematic import FIRST, SECOND, SchematicRenderer
from generation.render.schematic import solids as standing
from generation.render.schematic.ground import _STEP_M, PaintedGround
from generation.render.schematic.painting import paint
from generation.render.schematic.styles import (
    _NOISE_TILE,
    CameraPipeline,
    DrawingStyle,
    _build_tables,
    build_grain_tile,
    develop,
)
from generation.render.schematic.view import PlacedCamera
from tests.hand_made import Car, scene_on_straight_road

Picture = NDArray[np.uint8]
assert SECOND.pipeline is not None
PIPELINE: CameraPipeline = SECOND.pipeline


@functools.cache
def noise_tile() -> NDArray[np.float32]:
    from benchmark.machine.storage import content_seed

    random = np.random.default_rng(content_seed("sensor noise"))
    return random.standard_normal((_NOISE_TILE, _NOISE_TILE, 3), dtype=np.float32)


def slowly_developed(image: Picture, pipeline: CameraPipeline, seed: int) -> Picture:
    """Every step as it is said, one after the other."""
    height, width = image.shape[:2]
    curve, deviation = _build_tables(pipeline)
    y, x = np.mgrid[:height, :width]
    radius = np.hypot((2 * x + 1 - width) / width, (2 * y + 1 - height) / height) / np.sqrt(2.0)
    blurred = np.asarray(cv2.GaussianBlur(image, (0, 0), pipeline.blur * width))
    light = np.stack([curve[blurred[..., channel], 0, channel] for channel in range(3)], axis=-1)
    light = light * (1.0 - pipeline.vignette * radius**3).astype(np.float32)[..., None]
    down, right = np.random.default_rng(seed).integers(0, _NOISE_TILE, 2)
    rows, columns = (np.arange(height) + down) % _NOISE_TILE, (np.arange(width) + right) % _NOISE_TILE
    light += deviation[np.clip(light, 0.0, 255.0).astype(np.uint8)] * noise_tile()[rows[:, None], columns]
    exposed = np.clip(np.rint(light), 0.0, 255.0).astype(np.uint8)
    options = [cv2.IMWRITE_JPEG_QUALITY, pipeline.jpeg_quality]
    stored = cv2.imencode(".jpg", np.ascontiguousarray(exposed[..., ::-1]), options)[1]
    return np.asarray(cv2.imdecode(stored, cv2.IMREAD_COLOR)[..., ::-1], np.uint8)


@pytest.mark.parametrize("size", [(1, 1), (64, 112), (77, 333), (700, 600)])
def test_a_picture_is_developed_as_step_after_step(size: tuple[int, int]) -> None:
    for seed in range(3):
        image = np.random.default_rng(seed).integers(0, 256, (*size, 3)).astype(np.uint8)
        assert np.array_equal(develop(image, PIPELINE, seed), slowly_developed(image, PIPELINE, seed))


@pytest.mark.parametrize("style", [FIRST, SECOND], ids=["first", "second"])
def test_grain_is_added_as_numbers_that_are_cut_at_black_and_white(style: DrawingStyle) -> None:
    scene = scene_on_straight_road(seconds=0.5)
    stage = SchematicRenderer(64, 36, style).stage(scene)
    ground: PaintedGround = stage.ground
    for plan in ground.around(scene.ego.position[0, :2])[::2]:
        pixels = np.full_like(plan.pixels, np.round(ground.base).astype(np.uint8))
        paint(pixels, ground.polygons, plan.world_to_pixel, ground.colours)
        tile = build_grain_tile(round(_STEP_M / plan.resolution_m), plan.resolution_m, style)
        repeats = -(-len(pixels) // len(tile))
        around = np.tile(tile, (repeats, repeats, 1))[: len(pixels), : len(pixels)]
        assert np.array_equal(plan.pixels, np.clip(pixels.astype(int) + around - 128, 0, 255))


def test_shadows_darken_what_they_would_if_the_whole_picture_were_looked_at(monkeypatch: pytest.MonkeyPatch) -> None:
    cars = tuple(Car(40.0 + 7.0 * place, 195.0 + 2.5 * (place % 4), 8.0) for place in range(12))
    scene = scene_on_straight_road(cars, seconds=1.0)

    def drawn() -> list[Picture]:
        stage = SchematicRenderer(224, 128).stage(scene)
        grey, found = np.full((128, 224, 3), 160, np.uint8), []
        for camera in stage.cameras:
            picture = grey.copy()
            view = PlacedCamera.of(camera, scene.ego.position[5], scene.ego.rotation[5])
            standing.draw_shadows(picture, view, stage._find_shadow_casters(5), stage.air)
            found.append(picture)
        return found

    in_part = drawn()
    monkeypatch.setattr(standing, "_compute_image_window", lambda polygons, margin, shape: (slice(None), slice(None)))
    assert all(np.array_equal(*pair) for pair in zip(in_part, drawn(), strict=True))
    assert sum(bool((picture != 160).any()) for picture in in_part) >= 2
