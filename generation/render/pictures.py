"""Pictures of whole scenes for people: what to look at before a generated scene is trusted."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ
from benchmark.datasets.roots import DataSet
from benchmark.machine.storage import file_name, write_bytes
from benchmark.scene import Scene
from generation.labels.labelling import closest_approach
from generation.render.birdseye import birdseye_strip
from generation.render.contract import Renderer

PANELS = 6
"""Moments in a strip."""


def moments(scene: Scene, *, count: int = PANELS, step_s: float = 1.0) -> list[int]:
    """Frames around the first adversary's closest approach, or spread over a scene without one.

    Args:
        scene: The scene.
        count: How many.
        step_s: Time between them.

    Returns:
        Frame indices in order; the closest approach is a little behind the middle.
    """
    last = len(scene.timestamps_us) - 1
    if not scene.adversaries:
        return [round(frame) for frame in np.linspace(0, last, count)]
    agent = scene.agents.ids.index(scene.adversaries[0])
    start = int(np.flatnonzero(scene.agents.valid[agent])[0])
    middle = closest_approach(scene, agent, start).frame
    step = round(step_s * FRAME_HZ)
    # As many panels before it as planned, more near the end of the scene, fewer near its start.
    before = max(count // 2 + 1, count - 1 - (last - middle) // step)
    first = middle - step * min(before, middle // step)
    return [min(first + index * step, last) for index in range(count)]


def scene_strip(scene: Scene, renderer: Renderer) -> NDArray[np.uint8]:
    """The decisive seconds of a scene from above, and through the camera that sees the adversary best.

    Args:
        scene: The scene.
        renderer: Draws the camera pictures.

    Returns:
        (height, width, 3) uint8 RGB.
    """
    return birdseye_strip(scene, moments(scene), renderer)


def write_pictures(data: DataSet, names: Sequence[str], folder: Path, renderer: Renderer) -> list[Path]:
    """Write one picture a scene.

    Args:
        data: The data set.
        names: Scenes.
        folder: Where to.
        renderer: Draws the camera pictures.

    Returns:
        The PNG files.

    Raises:
        InputError: If a scene is unknown or the files cannot be written.
    """
    written = []
    for name in names:
        image = scene_strip(data.scene(name), renderer)
        _, encoded = cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))
        path = folder / f"{file_name(name)}.png"
        write_bytes(path, encoded.tobytes())
        written.append(path)
    return written
