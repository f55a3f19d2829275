"""Small nuScenes-format roots with one camera and painted cars, and pictures whose quality is known."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmark.datasets.nuscenes import NuScenesData
from benchmark.extensions.quality.masks import find_visible_parts, project_boxes
from benchmark.machine.storage import content_seed
from benchmark.scene import Scene
from tests.benchmark.datasets.nuscenes_tables import TinyRoot
from tests.hand_made import Car, scene_on_straight_road

SIZE = (320, 180)
Picture = NDArray[np.uint8]
Paint = Callable[[str, int], Picture]
"""Texture of an instance at a keyframe."""

STANDING = (Car(64.0, 198.25), Car(62.0, 202.5), Car(72.0, 193.0))
"""Three cars ahead of a standing ego; none hides another much."""


def texture(seed: str) -> Picture:
    """Coloured blobs that are the same for the same seed."""
    rng = np.random.default_rng(content_seed("texture", seed))
    coarse = rng.integers(0, 256, (6, 6, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, (96, 96), interpolation=cv2.INTER_CUBIC))


def as_seeded(instance: str, keyframe: int) -> Picture:
    """Each car has its own texture, always."""
    return texture(instance)


def standing_scene(name: str = "scene-9901", *, seconds: float = 2.0, cars: tuple[Car, ...] = STANDING) -> Scene:
    return scene_on_straight_road(cars, ego_speed=0.0, seconds=seconds, name=name)


def write_root(root: Path, scenes: list[Scene], paint: Paint = as_seeded, *, sweeps: bool = False) -> Path:
    """A root whose images show the cars where their boxes are, over a grey gradient."""
    made = TinyRoot.of(root, scenes, sweeps=sweeps)
    made.write()
    made.write_images(SIZE)
    for scene in NuScenesData.open(root).scene_names():
        paint_scene(root, scene, paint, sweeps=sweeps)
    return root


def paint_scene(root: Path, name: str, paint: Paint, *, sweeps: bool = False) -> None:
    data = NuScenesData.open(root)
    scene = data.scene(name)
    for views in data.videos(name, sweeps=sweeps).values():
        for frame, view in enumerate(views):
            keyframe = frame // 6 if sweeps else frame
            boxes = project_boxes(scene, view, SIZE, ("vehicle.car",), 0.5)
            ramp = np.linspace(60, 180, SIZE[0] * SIZE[1]).reshape(SIZE[1], SIZE[0], 1)
            image = np.repeat(ramp, 3, axis=2).astype(np.uint8)
            for box in boxes:
                part = find_visible_parts(boxes, SIZE[1], SIZE[0])[box.instance]
                left, top, right, bottom = (round(side) for side in box.bounds)
                rows, columns = np.nonzero(part)
                side = paint(box.instance.split("-")[-1], keyframe)
                down = np.clip((rows - top) * 96 // max(bottom - top, 1), 0, 95)
                across = np.clip((columns - left) * 96 // max(right - left, 1), 0, 95)
                image[rows, columns] = side[down, across]
            view.path.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(image).save(view.path)


def strip(seed: int, height: int = 24, width: int = 256) -> Picture:
    """A sharp picture: overlapping rectangles and discs of plain colours."""
    rng = np.random.default_rng(content_seed("strip", seed))
    image = np.full((height, width, 3), rng.integers(0, 256, 3), np.uint8)
    for _ in range(30):
        colour = tuple(int(value) for value in rng.integers(0, 256, 3))
        x, y, size = int(rng.integers(width)), int(rng.integers(height)), int(rng.integers(3, 14))
        if rng.random() < 0.5:
            cv2.circle(image, (x, y), size, colour, -1)
        else:
            cv2.rectangle(image, (x, y), (x + 2 * size, y + size), colour, -1)
    return image


def blurred(image: Picture, sigma_px: float = 2.5) -> Picture:
    return np.asarray(cv2.GaussianBlur(image, (0, 0), sigma_px))


def noisy(image: Picture, deviation: float = 40.0, seed: int = 0) -> Picture:
    rng = np.random.default_rng(content_seed("noise", seed))
    return np.clip(image + rng.normal(0.0, deviation, image.shape), 0, 255).astype(np.uint8)
