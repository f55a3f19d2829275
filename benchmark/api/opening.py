"""Data sets and their splits, opened, or made where the embedded ones are not there yet, saying so to the user."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from benchmark.errors import InputError

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.datasets.schema import FaultList
    from benchmark.machine.workspace import Workspace
    from generation.render.contract import Renderer


def notify(sentence: str) -> None:
    """Say something to the person who waits; stdout stays free for results."""
    print(sentence, file=sys.stderr, flush=True)


_notified: set[str] = set()


def notify_once(sentence: str) -> None:
    """Say what holds for a whole command, however often it is found out."""
    if sentence not in _notified:
        _notified.add(sentence)
        notify(sentence)


OUT = Path("challenger-out")
"""Folder for everything that is made, unless another one is named."""
DEFAULT_IMAGE_SIZE = (448, 256)
"""Width and height of schematic images, pixels."""


def worker_count(count: int) -> int:
    """Number of processes: 0 is all processors; raises `InputError` if negative, or more than any machine has."""
    from benchmark.machine.workers import MOST_WORKERS, default_workers

    if count < 0:
        raise InputError(f"--workers must be 0 (all processors) or more, got {count}")
    if count > MOST_WORKERS:
        raise InputError(f"--workers must be at most {MOST_WORKERS:,}; 0 uses all processors")
    return count or default_workers()


def workspace(out: Path = OUT) -> "Workspace":
    """The folders below ``out``."""
    from benchmark.machine.workspace import Workspace

    return Workspace(out)


def open_data(
    data: str | Path = "mini",
    *,
    tables: str | None = None,
    workers: int = 0,
    out: Path = OUT,
    rates: "FaultList | None" = None,
    sweeps: bool = False,
    categories: str | Path | None = None,
    cameras: str | Path | None = None,
) -> "DataSet":
    """Open a data set; the embedded one is built into the user's cache the first time.

    Args:
        data: ``mini`` (embedded; ``mini@1`` is its first version), ``demo`` (the small town of `benchmark.demo`), or
            the root of a nuScenes-format data set.
        tables: Version folder below the root, if there are several.
        workers: Processes that build the embedded data set; 0 takes all processors.
        out: Folder below which the small town of the demo lies.
        rates: Gets scenes whose keyframes are not half a second apart: `evaluate` takes them, a drive and the search
            refuse them.
        sweeps: Whether the embedded data set, or the demo's town, is to have its images between samples too, for films
            at 12 Hz; they are drawn when they are asked for, and no table changes by it.
        categories: What categories mean that are not nuScenes': ``short``, ``lyft``, ``t4``, ``argoverse2``, or a JSON
            file ``{"name": "nuscenes.category"}`` (docs/data.md).
        cameras: Which camera is which view: a rig's name or a JSON file (docs/extensions/own_recordings.md).

    Returns:
        The data set.

    Raises:
        InputError: If there is no such data set, or it is broken; if there is no such map of categories or rig.
    """
    from benchmark.datasets.categories import read_names
    from benchmark.datasets.roots import open_data as open_root
    from benchmark.machine.workspace import DEMONSTRATED, cache_root, is_finished, read_embedded_version

    if str(data) == DEMONSTRATED:
        from generation.sources.mini import TownSettings, build_town_data_set

        town = open_root(workspace(out).demonstrated("val"), name=DEMONSTRATED)
        if sweeps:
            build_town_data_set(
                town.root, TownSettings(val_scenes=len(town.scene_names("val"))), workers=worker_count(workers)
            )
        return town
    if read_embedded_version(str(data)) is None:
        named = read_names(*(None if name is None else str(name) for name in (categories, cameras)))
        return open_root(Path(data), version=tables, rates=rates, categories=named)
    from generation.sources.embedded import find_town

    embedded = find_town(str(data))
    pictures: Literal["all", "keyframes"] = "all" if sweeps else "keyframes"
    root = cache_root() / embedded.folder_name()
    if not is_finished(root):
        notify(f"building the embedded data set in {root} (once, about {embedded.takes[pictures]})")
    return open_root(embedded.build(root, pictures, worker_count(workers)), name=embedded.name)


def open_split(
    source: "DataSet", split: str, out: Path = OUT, *, workers: int = 0, frames: Literal["all", "keyframes"] = "all"
) -> "DataSet":
    """Open the data set that holds a split.

    Of the embedded data set, ``adv`` is what was generated below ``out``, else the newest frozen split, which is built
    into the user's cache without a search; a missing ``val-r`` is rendered on the spot.

    Args:
        source: The data set that the split is of.
        split: ``val``, ``val-r``, ``adv``, or a split of the data set's own.
        out: Folder below which generated splits lie.
        workers: Processes that build a missing split; 0 takes all processors.
        frames: Which frames of a missing ``val-r`` get images.

    Returns:
        The source itself, or the root that was made from it.

    Raises:
        InputError: If the split has not been generated, or was made from another version of the source.
    """
    from benchmark.machine.workspace import GENERATED_SPLITS, read_embedded_version

    def build() -> Path:
        if split == "adv":
            return build_frozen_root(source, workers)
        from benchmark.machine.workers import LocalProcesses
        from generation.pipeline.settings import BuildSettings
        from generation.pipeline.split import build_split

        notify(f"rendering split {split} of the embedded data set (once, takes a few minutes)")
        target, executor = workspace(out).split_root(source.name, split), LocalProcesses(worker_count(workers))
        timings = workspace(out).timings_of(target)
        drawing = schematic_renderer()
        settings = BuildSettings(out=target, renderer=drawing, frames=frames, executor=executor, timings=timings)
        build_split(source, split, settings)
        return target

    is_town = read_embedded_version(source.name) is not None
    return workspace(out).open_split(source, split, build=build if is_town and split in GENERATED_SPLITS else None)


def build_frozen_root(source: "DataSet", workers: int = 0) -> Path:
    """Root of the newest frozen split of the embedded data set, in the user's cache; built where it is not finished."""
    from generation.splits.cached import build_cached_root

    return build_cached_root(source, schematic_renderer(), worker_count(workers), notify)


def known_scenes(data: str | Path, split: str, out: Path = OUT) -> "tuple[str, ...] | None":
    """Names of a split's scenes, as far as they are known without building or opening anything large.

    Args:
        data: ``mini`` or the root of a data set.
        split: The split.
        out: Folder below which generated splits lie.

    Returns:
        The names that `open_split` would find in split ``adv`` of the embedded data set; ``None`` of anything else.

    Raises:
        InputError: If what was generated cannot be read.
    """
    from benchmark.machine.workspace import read_embedded_version

    if read_embedded_version(str(data)) is None or split != "adv":
        return None
    from generation.sources.embedded import find_town
    from generation.splits.cached import list_scene_names as known

    name = find_town(str(data)).name
    return known(name, split, workspace(out).split_root(name, split))


def schematic_renderer(size: tuple[int, int] = DEFAULT_IMAGE_SIZE) -> "Renderer":
    """The renderer of generated splits that needs no network: schematic pictures in the second style.

    Args:
        size: Width and height in pixels.

    Returns:
        It. The embedded data set and imported recordings are drawn in the first style
        (`generation.render.schematic.styles`), so that ``val`` and ``val-r`` differ as two renderers do.
    """
    from generation.render.schematic import SECOND, SchematicRenderer

    return SchematicRenderer(*size, style=SECOND)
