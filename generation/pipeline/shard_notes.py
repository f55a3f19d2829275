"""What shards of a build leave behind: which of them searched, which drew, and whether they did the same work."""

import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from benchmark.datasets.roots import DataSet
from benchmark.machine.storage import content_key, writing_to
from benchmark.runs.kept_shards import DRAWING, require_shards
from generation.nuscenes_writer import DataSetPlan
from generation.nuscenes_writer.plan import DRAWING_FOLDER, SEARCH_FOLDER, digest
from generation.pipeline.settings import BuildSettings
from generation.pipeline.writing import WritingJob
from generation.search.adversary import ALGORITHM_VERSION
from generation.search.definition import Search


def search_work(search: Search, names: Sequence[str], settings: BuildSettings) -> str:
    """Content key of what the shards of a search do together.

    Args:
        search: What decides the attempts.
        names: All recorded scenes.
        settings: How many adversaries, and whether rounds are kept.

    Returns:
        64 hexadecimal digits.
    """
    decides = (search.fingerprint, search.seed, search.hyper.fingerprint, search.prior_fingerprint)
    asked = [kind.value for kind in search.asked]
    return content_key(
        "searched", ALGORITHM_VERSION, *decides, asked, list(names), settings.adversaries, settings.keep_rounds
    )


def drawing_work(source: DataSet, plan: DataSetPlan, scenes: Sequence[Sequence[Any]], first: str) -> str:
    """Content key of what the shards that draw a data set do together.

    Args:
        source: The recordings.
        plan: The data set.
        scenes: What tells each of its scenes from others, as JSON values.
        first: Name of a recorded scene, whose cameras say what size is drawn.

    Returns:
        64 hexadecimal digits.
    """
    drawn = None
    if plan.renderer is not None:
        cameras = digest(plan.renderer.cameras(source.scene(first)))
        drawn = [plan.renderer.name, plan.renderer.version, cameras, plan.jpeg_quality, plan.lossless]
    made = [plan.split, plan.version, plan.layout, plan.frames, None if plan.frozen is None else list(plan.frozen)]
    return content_key("drawn", source.fingerprint(), made, drawn, [list(each) for each in scenes])


def work_of_jobs(source: DataSet, plan: DataSetPlan, jobs: Sequence[WritingJob]) -> str:
    """`drawing_work` of scenes that are written by jobs; empty where there are none."""
    if not jobs:
        return ""
    scenes = [
        [job.name, job.written_as, job.variant, None if job.last_attempt is None else list(job.last_attempt)]
        for job in jobs
    ]
    return drawing_work(source, plan, scenes, jobs[0].source_scene)


def search_folder(root: Path) -> Path:
    """Where shards of a search leave their notes."""
    return root / SEARCH_FOLDER


def drawing_folder(root: Path) -> Path:
    """Where shards that draw leave their notes."""
    return root / DRAWING_FOLDER


def require_drawn(root: Path, work: Callable[[], str]) -> None:
    """Refuse to finish what some shards drew and others did not.

    Args:
        root: Root of the build.
        work: Content key of what they should have done; asked for where there are shards.

    Raises:
        InputError: If one is missing, which is named, or did other work.
    """
    if drawing_folder(root).is_dir():
        require_shards(drawing_folder(root), DRAWING, work())


def forget_notes(root: Path) -> None:
    """Remove what shards left, of which all are done: what they made stays under its keys.

    Raises:
        InputError: If it cannot be removed.
    """
    for folder in (search_folder(root), drawing_folder(root)):
        if folder.is_dir():
            with writing_to(folder):
                shutil.rmtree(folder)
