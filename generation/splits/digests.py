"""Hashes by which a rebuilt scene is compared with the one that was frozen: of its tables, and of its images."""

import hashlib
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Final

from benchmark.machine.storage import content_key, file_sha256
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan
from generation.nuscenes_writer.plan import SceneNames
from generation.nuscenes_writer.rows import channels_of, scene_tables
from generation.nuscenes_writer.scenes import jpeg_bytes
from generation.nuscenes_writer.vocabulary import Vocabulary
from generation.render.contract import LongRenderer
from generation.splits.format import FrozenScene, ImageFacts
from generation.splits.tracks import rounded_numbers

_NANOMETRE_DIGITS: Final = 9
"""Recordings are interpolated and turned with sines, whose last bits are the processor's own."""


def tables_digest(plan: DataSetPlan, scene: Scene, frozen: FrozenScene) -> str:
    """Hash of a scene's tables at its key frames, without cameras: the same in any layout, with any frames.

    64 hexadecimal digits, made of numbers rounded to a nanometre.
    """
    like = replace(plan, split="adv", layout="suffixed", renderer=None, frames="keyframes")
    names = SceneNames.of(
        like, scene, name=frozen.name, variant=0, source_scene=frozen.source, identity=frozen.identity
    )
    tables = scene_tables(names, Vocabulary.of(plan.source), scene, channels_of((), {}), scene.keyframes.tolist())
    return content_key(rounded_numbers(tables, _NANOMETRE_DIGITS))


def image_facts(plan: DataSetPlan, scene: Scene) -> ImageFacts | None:
    """Which images hashes would be of; ``None`` where there are none, or they take too long to be drawn once more."""
    if plan.renderer is None or isinstance(plan.renderer, LongRenderer):
        return None
    cameras = plan.renderer.cameras(scene)
    if not cameras:
        return None
    row = {"name": plan.renderer.name, "version": plan.renderer.version}
    return facts_of_row(row | {"width": cameras[0].width, "height": cameras[0].height}, plan.jpeg_quality)


def facts_of_row(row: dict[str, Any], jpeg_quality: int) -> ImageFacts:
    """The same from what the writer says of its renderer."""
    return ImageFacts(
        renderer=row["name"],
        version=row["version"],
        width=row["width"],
        height=row["height"],
        jpeg_quality=jpeg_quality,
    )


def drawn_digest(plan: DataSetPlan, scene: Scene) -> str:
    """Hash of a scene's key frames' images, drawn for it."""
    assert plan.renderer is not None
    drawn = plan.renderer.render(scene, scene.keyframes.tolist())
    return _together(
        hashlib.sha256(jpeg_bytes(image, plan.jpeg_quality)).hexdigest()
        for images in drawn
        for image in images.values()
    )


def written_digest(plan: DataSetPlan, fragment: dict[str, Any]) -> str:
    """Hash of a written scene's key frames' images, read from the disk."""
    root = plan.data_root(fragment["variant"])
    paths = [path for path in fragment["files"] if path.startswith("samples/") and path.endswith(".jpg")]
    return _together(file_sha256(root / path) for path in paths)


def _together(hashes: Iterable[str]) -> str:
    # Sorted: names of files differ between layouts, and with them their order.
    return content_key(sorted(hashes))
