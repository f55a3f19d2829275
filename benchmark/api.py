"""What stands behind the public face where several packages are needed; beside `benchmark.cli` the only such place.

Everything is imported inside the functions, so that ``import benchmark`` and ``challenger-bench --help`` answer at once
and a missing extra breaks only what needs it.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

from benchmark.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmark.datasets.roots import DataSet
    from benchmark.machine.workspace import Workspace
    from benchmark.records.run import RunRecord
    from benchmark.sheets.writing import SheetSettings, WrittenSheets
    from generation.build.report import BuildReport
    from generation.build.settings import BuildSettings
    from generation.build.surrogate import PlannerUnderTest
    from generation.render.contract import Renderer

OUT = Path("challenger-out")
"""Folder for everything that is made, unless another one is named."""
DEFAULT_IMAGE_SIZE = (448, 256)
"""Width and height of schematic images, pixels."""


def tell(sentence: str) -> None:
    """Say something to the person who waits; stdout stays free for results."""
    print(sentence, file=sys.stderr, flush=True)


def worker_count(count: int) -> int:
    """Number of processes: 0 is all processors; raises `InputError` if negative."""
    from benchmark.machine.workers import default_workers

    if count < 0:
        raise InputError(f"--workers must be 0 (all processors) or more, got {count}")
    return count or default_workers()


def workspace(out: Path = OUT) -> "Workspace":
    """The folders below ``out``."""
    from benchmark.machine.workspace import Workspace

    return Workspace(out)


def open_data(data: str | Path = "mini", *, tables: str | None = None, workers: int = 0) -> "DataSet":
    """Open a data set; the embedded one is built into the user's cache the first time.

    Args:
        data: ``mini`` (embedded) or the root of a nuScenes-format data set.
        tables: Version folder below the root, if there are several.
        workers: Processes that build the embedded data set; 0 takes all processors.

    Returns:
        The data set.

    Raises:
        InputError: If there is no such data set, or it is broken.
    """
    from benchmark.datasets.roots import open_data as open_root
    from benchmark.machine.workspace import EMBEDDED, cache_root, is_finished

    if str(data) != EMBEDDED:
        return open_root(Path(data), version=tables)
    from generation.sources.mini import TownSettings, build_town

    settings = TownSettings()
    root = cache_root() / settings.folder_name(EMBEDDED)
    if not is_finished(root):
        tell(f"building the embedded data set in {root} (once, about two minutes)")
    return open_root(build_town(root, settings, workers=worker_count(workers)), name=EMBEDDED)


def open_split(source: "DataSet", split: str, out: Path = OUT, *, workers: int = 0, **settings: Any) -> "DataSet":
    """Open the data set that holds a split; missing splits of the embedded data are generated on the spot.

    Args:
        source: The data set that the split is of.
        split: ``val``, ``val-r``, ``adv``, or a split of the data set's own.
        out: Folder below which generated splits lie.
        workers: Processes that generate a missing split; 0 takes all processors.
        settings: Further settings of a missing split (`generation.build.split.BuildSettings`).

    Returns:
        The source itself, or the generated root that was made from it.

    Raises:
        InputError: If the split has not been generated, or was made from another version of the source.
    """
    from benchmark.machine.workspace import EMBEDDED

    def build() -> None:
        from benchmark.machine.workers import LocalProcesses
        from generation.build.settings import BuildSettings

        tell(f"generating split {split} of the embedded data set (once, some minutes)")
        target = workspace(out).split_root(source.name, split)
        executor = LocalProcesses(worker_count(workers))
        build_split(
            source, split, BuildSettings(out=target, renderer=schematic_renderer(), executor=executor, **settings)
        )

    return workspace(out).open_split(source, split, build=build if source.name == EMBEDDED else None)


def build_split(source: "DataSet", split: str, settings: "BuildSettings") -> "BuildReport":
    """Build a split, adv or val-r, from recorded scenes; work that is done already is found and kept.

    Args:
        source: The recorded scenes.
        split: ``adv`` or ``val-r``.
        settings: What to build and where.

    Returns:
        What was tried, kept and discarded, and why.

    Raises:
        InputError: If the split cannot be generated, or the settings contradict each other or the data.
    """
    from generation.build.split import build_split as build

    require_generated(split)
    return build(source, cast(Literal["adv", "val-r"], split), settings)


def require_generated(split: str) -> None:
    """Raise `InputError` for a split that cannot be generated."""
    if split not in ("adv", "val-r"):
        raise InputError(f"cannot generate split {split!r}; the splits that can be generated are val-r and adv")


def schematic_renderer(size: tuple[int, int] = DEFAULT_IMAGE_SIZE) -> "Renderer":
    """The renderer that needs no network; ``size`` is width and height in pixels."""
    from generation.render.schematic import SchematicRenderer

    return SchematicRenderer(*size)


def records_below(out: Path = OUT, folders: "Sequence[Path] | None" = None) -> "list[RunRecord]":
    """Every record below folders (by default ``<out>/runs``), each once."""
    from benchmark.records.run import find_records

    found = [record for folder in folders or [workspace(out).run_root()] for record in find_records(folder)]
    return list({record.directory.resolve(): record for record in found}.values())


def model_on(data: str | Path, name: str, checkpoint: Path | None = None) -> str:
    """The model that runs: on the embedded data a miniature, where the full one has no weights."""
    from adapters.checkpoints.loading import stand_in

    chosen = stand_in(name, checkpoint, str(data))
    if chosen != name:
        tell(f"there are no weights for {name}: {chosen} runs in its place (docs/miniatures.md)")
    return chosen


def planner_under_test(
    name: str, checkpoint: Path | None = None, *, data: str | Path = "mini", seed: int = 0, workers: int = 0
) -> "PlannerUnderTest":
    """A planner that decides about generated scenes.

    Args:
        name: Planner name or ``package.module:Class``.
        checkpoint: Its weights, if not its own.
        data: The data set that scenes are generated from.
        seed: For planners that take one.
        workers: Processes that run it; 0 takes all processors.

    Returns:
        The planner, and whether it looks at images.

    Raises:
        InputError: If the planner is unknown or cannot be built.
    """
    from adapters.models import MODELS
    from adapters.registry import planner_factory
    from generation.build.surrogate import PlannerUnderTest

    factory = planner_factory(model_on(data, name, checkpoint), checkpoint=checkpoint, seed=seed)
    return PlannerUnderTest(factory, images=name not in MODELS or not MODELS[name].blind, workers=worker_count(workers))


def write_sheets(dataset: "DataSet", split: str, root: Path, settings: "SheetSettings") -> "WrittenSheets":
    """Write the scene sheets of a split.

    Args:
        dataset: The data set that holds the split.
        split: The split.
        root: Folder of all sheets.
        settings: What the sheets show.

    Returns:
        The sheets.

    Raises:
        InputError: If the split or a scene is unknown, the data is broken, or rounds are asked for and none were kept.
    """
    from benchmark.sheets.writing import write_sheets as write
    from generation.build.profile import kept_runtime
    from generation.nuscenes_writer.plan import STATE_FOLDER

    return write(dataset, split, root, settings, runtime=kept_runtime(dataset.root / STATE_FOLDER))
