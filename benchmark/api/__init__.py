"""What stands behind the public face where several packages are needed; beside `benchmark.cli` the only such place.

Everything is imported inside the functions, so that ``import benchmark`` and ``challenger-bench --help`` answer at once
and a missing extra breaks only what needs it.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from benchmark.api.driving import (
    drive_settings as drive_settings,
    looks_at_images as looks_at_images,
    require_sensor as require_sensor,
)
from benchmark.api.filming import write_drive_films as write_drive_films
from benchmark.api.over_http import require_answers as require_answers, serve_planner as serve_planner
from benchmark.api.verifying import verify as verify
from benchmark.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from adapters.registry import NamedPlanner
    from benchmark.datasets.roots import DataSet
    from benchmark.datasets.schema import FaultList
    from benchmark.machine.workers import Executor
    from benchmark.machine.workspace import Workspace
    from benchmark.records.ablation import AblationReport
    from benchmark.records.drives import DriveRecord
    from benchmark.records.quality import QualityRecord
    from benchmark.records.run import RunRecord
    from benchmark.records.scenes import Sheets
    from benchmark.sheets.writing import SheetSettings, WrittenSheets
    from benchmark.supervision.limits import Supervision
    from generation.build.surrogate import PlannerUnderTest
    from generation.render.contract import Renderer

    # What the public face hands on of other packages.
    from adapters.checkpoints.anchor_files import write_anchors as write_anchors
    from adapters.checkpoints.arrival import fetch_weights as fetch_weights, import_weights as import_weights
    from adapters.checkpoints.listing import known_weights as known_weights
    from adapters.known_planners import known_planners as known_planners
    from adapters.plan_file import plan_file_factory as plan_file_factory
    from adapters.result_files.planner import result_file_factory as result_file_factory
    from adapters.result_files.recognition import recognise as recognise
    from adapters.result_files.samples import samples_of_data as samples_of_data
    from adapters.result_files.writing.formats import write_results as write_results
    from adapters.training.ego_status import train_ego_status as train_ego_status
    from adapters.training.planners import (
        PlannerTraining as PlannerTraining,
        judge_again as judge_again,
        train_planner as train_planner,
    )
    from generation.build.ablation import ablate as ablate
    from generation.build.settings import BuildSettings as BuildSettings
    from generation.build.split import build_split as build_split
    from generation.diffusion.bank import write_bank as write_bank
    from generation.diffusion.training.card import write_model_card as write_model_card
    from generation.diffusion.training.loop import TrainingConfig as TrainingConfig, train_denoiser as train_denoiser
    from generation.render.magicdrive.command import magicdrive_renderer as magicdrive_renderer
    from generation.render.magicdrive.condition_pictures import write_condition_pictures as write_condition_pictures
    from generation.render.pictures import write_pictures as write_pictures
    from generation.search.hyperparameters import HyperParameters as HyperParameters
    from generation.search.presets import hyper_parameters as hyper_parameters, trajectory_model as trajectory_model
    from generation.sources.importing import ImportSettings as ImportSettings, import_scenarionet as import_scenarionet
    from generation.sources.mini import TownSettings as TownSettings, build_town as build_town
    from generation.splits.building import build_frozen as build_frozen
    from generation.splits.edited import edited_split as edited_split
    from generation.splits.packaged import frozen_split as frozen_split, packaged_splits as packaged_splits
    from generation.splits.packing import PackageContents as PackageContents, pack_split as pack_split
    from generation.splits.unpacking import read_split_package as read_split_package
    from leaderboard.figures.heat_map import write_heat_map as write_heat_map
    from leaderboard.films.film import FilmSettings as FilmSettings
    from leaderboard.films.filming import write_films as write_films
    from leaderboard.publishing.checking import check_publishable as check_publishable
    from leaderboard.tables.collision import run_tables as run_tables
    from leaderboard.tables.disagreement import disagreement_table as disagreement_table
    from leaderboard.tables.drives import drive_tables as drive_tables
    from leaderboard.tables.loops import loop_tables as loop_tables
    from leaderboard.tables.quality import quality_tables as quality_tables
    from leaderboard.tables.slices import slice_tables as slice_tables
    from leaderboard.tables.reproduction import reproduction_table as reproduction_table
    from leaderboard.tables.transfer import (
        agreement_table as agreement_table,
        transfer_matrices as transfer_matrices,
        transfer_table as transfer_table,
    )

OUT = Path("challenger-out")
"""Folder for everything that is made, unless another one is named."""
DEFAULT_IMAGE_SIZE = (448, 256)
"""Width and height of schematic images, pixels."""
_TOWN_TAKES = {"keyframes": "a minute", "all": "two minutes"}
"""How long the embedded data set takes to build, for people."""


def tell(sentence: str) -> None:
    """Say something to the person who waits; stdout stays free for results."""
    print(sentence, file=sys.stderr, flush=True)


_said: set[str] = set()


def say_once(sentence: str) -> None:
    """Say what holds for a whole command, however often it is found out."""
    if sentence not in _said:
        _said.add(sentence)
        tell(sentence)


def worker_count(count: int) -> int:
    """Number of processes: 0 is all processors; raises `InputError` if negative, or more than any machine has."""
    from benchmark.machine.workers import MOST_WORKERS, default_workers

    if count < 0:
        raise InputError(f"--workers must be 0 (all processors) or more, got {count}")
    if count > MOST_WORKERS:
        raise InputError(f"--workers must be at most {MOST_WORKERS:,}; 0 takes all processors")
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
) -> "DataSet":
    """Open a data set; the embedded one is built into the user's cache the first time.

    Args:
        data: ``mini`` (embedded), ``demo`` (the small town of `benchmark.demo`), or the root of a nuScenes-format data
            set.
        tables: Version folder below the root, if there are several.
        workers: Processes that build the embedded data set; 0 takes all processors.
        out: Folder below which the small town of the demo lies.
        rates: For whoever judges nothing: gets scenes whose keyframes are not half a second apart, which are refused
            if it is not given.
        sweeps: Whether the embedded data set, or the demo's town, is to have its images between samples too, for films
            at 12 Hz; they are drawn when somebody asks for them, and no table changes by it.

    Returns:
        The data set.

    Raises:
        InputError: If there is no such data set, or it is broken.
    """
    from benchmark.datasets.roots import open_data as open_root
    from benchmark.machine.workspace import DEMONSTRATED, EMBEDDED, cache_root, is_finished
    from generation.sources.mini import TownSettings, build_town

    if str(data) == DEMONSTRATED:
        town = open_root(workspace(out).demonstrated("val"), name=DEMONSTRATED)
        if sweeps:
            build_town(town.root, TownSettings(val_scenes=len(town.scene_names("val"))), workers=worker_count(workers))
        return town
    if str(data) != EMBEDDED:
        return open_root(Path(data), version=tables, rates=rates)
    settings = TownSettings(pictures="all" if sweeps else "keyframes")
    root = cache_root() / settings.folder_name(EMBEDDED)
    if not is_finished(root):
        tell(f"building the embedded data set in {root} (once, about {_TOWN_TAKES[settings.pictures]})")
    return open_root(build_town(root, settings, workers=worker_count(workers)), name=EMBEDDED)


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
    from benchmark.machine.workspace import EMBEDDED, GENERATED_SPLITS

    def build() -> Path:
        if split == "adv":
            return frozen_root(source, workers)
        from benchmark.machine.workers import LocalProcesses
        from generation.build.settings import BuildSettings
        from generation.build.split import build_split

        tell(f"rendering split {split} of the embedded data set (once, some minutes)")
        target, executor = workspace(out).split_root(source.name, split), LocalProcesses(worker_count(workers))
        timings = workspace(out).timings_of(target)
        drawing = schematic_renderer()
        settings = BuildSettings(out=target, renderer=drawing, frames=frames, executor=executor, timings=timings)
        build_split(source, split, settings)
        return target

    return workspace(out).open_split(
        source, split, build=build if source.name == EMBEDDED and split in GENERATED_SPLITS else None
    )


def frozen_root(source: "DataSet", workers: int = 0) -> Path:
    """Root of the newest frozen split of the embedded data set, in the user's cache; built where it is not finished."""
    from generation.splits.cached import cached_root

    return cached_root(source, schematic_renderer(), worker_count(workers), tell)


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
    from benchmark.machine.workspace import EMBEDDED
    from generation.splits.cached import known_scenes as known

    if str(data) != EMBEDDED or split != "adv":
        return None
    return known(EMBEDDED, split, workspace(out).split_root(EMBEDDED, split))


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


def load_planner(
    name: str,
    checkpoint: Path | None = None,
    *,
    data: str | Path = "mini",
    seed: int = 0,
    device: str | None = None,
    precision: str | None = None,
    as_published: "Sequence[str]" = (),
    over_http: "Mapping[str, Any] | None" = None,
    supervision: "Supervision | None" = None,
) -> "NamedPlanner":
    """A planner by name, for `benchmark.evaluate`.

    Args:
        name: Planner name, ``package.module:Class``, or the address of a model server (docs/model-servers.md).
        checkpoint: Its weights, if not its own.
        data: What it will drive on: on ``mini`` a miniature runs where the full model has no weights, and says so.
        seed: For planners that take one.
        device: Where a network runs: cpu, cuda, cuda:1; the first GPU by default, if there is one.
        precision: Of a network: float32 or bfloat16.
        as_published: What a network does as in its published runs: ``memory``, ``can-once``, ``can-after``, or ``all``
            that it knows of these (docs/models.md).
        over_http: How a model server is asked: ``image_format``, ``deadline_s``.
        supervision: Limits of a planner of another package, which runs in a process of its own (docs/planners.md).

    Returns:
        What builds it in any process.

    Raises:
        InputError: If the planner is unknown or cannot be built.
    """
    from adapters.registry import planner_factory

    chosen = model_that_runs(name, checkpoint, data=data)
    if chosen != name:
        say_once(f"there are no weights for {name}: {chosen} runs in its place (docs/miniatures.md)")
    return planner_factory(
        chosen,
        checkpoint=checkpoint,
        seed=seed,
        device=device,
        precision=precision,
        as_published=as_published,
        over_http=over_http,
        supervision=supervision,
    )


def model_that_runs(name: str, checkpoint: Path | None = None, *, data: str | Path = "mini") -> str:
    """What `load_planner` builds: a miniature on embedded data where the full model has no weights.

    Args:
        name: Planner name or ``package.module:Class``.
        checkpoint: Its weights, if not its own.
        data: What it will drive on.

    Returns:
        The planner's name.

    Raises:
        InputError: If there is no such planner, or it is a network that has no weights; nothing is loaded.
    """
    from adapters.checkpoints.stand_in import require_weights, stand_in
    from adapters.registry import require_known

    require_known(name)
    chosen = stand_in(name, checkpoint, str(data))
    require_weights(chosen, checkpoint)
    return chosen


def planner_under_test(
    name: str,
    checkpoint: Path | None = None,
    *,
    data: str | Path = "mini",
    seed: int = 0,
    workers: int = 0,
    supervision: "Supervision | None" = None,
) -> "PlannerUnderTest":
    """A planner that decides about generated scenes: the surrogate of a build, or who drives in an ablation.

    Args:
        name: Planner name or ``package.module:Class``.
        checkpoint: Its weights, if not its own.
        data: The data set that scenes are generated from.
        seed: For planners that take one.
        workers: Processes that run it; 0 takes all processors.
        supervision: As in `load_planner`.

    Returns:
        The planner, and whether it looks at images.

    Raises:
        InputError: If the planner is unknown or cannot be built.
    """
    from generation.build.surrogate import PlannerUnderTest

    factory = load_planner(name, checkpoint, data=data, seed=seed, supervision=supervision)
    return PlannerUnderTest(factory, images=looks_at_images(name) is not False, workers=worker_count(workers))


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
    from benchmark.machine.workspace import is_generated
    from benchmark.sheets.writing import write_sheets as write
    from generation.build.profile import kept_runtime
    from generation.build.said_settings import said_settings
    from generation.nuscenes_writer.plan import STATE_FOLDER

    hyper = said_settings(dataset.root, dataset.provenance()) if is_generated(split) else {}
    runtime = kept_runtime(dataset.root / STATE_FOLDER, workspace(root.parent).timings_of(dataset.root))
    return write(dataset, split, root, settings, runtime=runtime, hyper=hyper)


def write_leaderboard(
    out: Path = OUT, to: Path | None = None, records: "Sequence[Path] | None" = None, *, site: bool = True
) -> list[Path]:
    """Write tables, figures and site from everything that an output folder holds.

    Args:
        out: The output folder: run records, records of drives, scene sheets, video quality, ablation studies, scores
            of challenges.
        to: Folder of the leaderboard; ``<out>/leaderboard`` by default.
        records: Folders of run records and of records of drives, if not ``<out>/runs`` and ``<out>/drives``.
        site: Whether to write the site too.

    Returns:
        The files.

    Raises:
        InputError: If there is nothing to show, records cannot stand in one table, or files cannot be written.
    """
    from benchmark.records.challenge_scores import find_scores
    from leaderboard.build import write_leaderboard as write

    found, quality, sheets, ablations, drives = _shown(out, records)
    challenges = find_scores(workspace(out).challenge_root())
    return write(found, to or out / "leaderboard", quality, sheets, ablations, drives, challenges=challenges, site=site)


def stale_leaderboard(
    out: Path = OUT, to: Path | None = None, records: "Sequence[Path] | None" = None, *, site: bool = True
) -> list[str]:
    """What of a written leaderboard is not what `write_leaderboard` would write now, as paths below it."""
    from benchmark.records.challenge_scores import find_scores
    from leaderboard.build import stale_files

    found, quality, sheets, ablations, drives = _shown(out, records)
    challenges = find_scores(workspace(out).challenge_root())
    return stale_files(
        found, to or out / "leaderboard", quality, sheets, ablations, drives, challenges=challenges, site=site
    )


def _shown(
    out: Path, folders: "Sequence[Path] | None"
) -> "tuple[list[RunRecord], list[QualityRecord], Sheets, list[AblationReport], list[DriveRecord]]":
    """What a leaderboard is made from; without run records it may be made from the rest."""
    from benchmark.records.ablation import find_ablations
    from benchmark.records.drives import find_drives
    from benchmark.records.record_costs import with_cost, with_drive_cost
    from benchmark.records.quality import find_quality
    from benchmark.records.reproduction import find_reproductions, with_reproductions
    from benchmark.records.run import find_records
    from benchmark.records.scenes import find_sheets

    space = workspace(out)
    quality, sheets = find_quality(space.quality_root()), find_sheets(space.sheet_root())
    ablations = find_ablations(space.ablation_root())
    own = [space.drive_root()] if space.drive_root().is_dir() else []
    drives = [with_drive_cost(each, folders or own, space.timings_of) for each in find_drives(*(folders or own))]
    scored = any(space.challenge_root().glob("scores-*.json"))
    others = bool(quality or sheets.splits or ablations or drives or scored)
    no_runs = others and folders is None and not space.run_root().exists()
    roots = folders or [space.run_root()]
    records = [] if no_runs else with_reproductions(find_records(*roots), find_reproductions(roots))
    records = [with_cost(record, roots, space.timings_of) for record in records]
    return records, quality, sheets, ablations, drives
