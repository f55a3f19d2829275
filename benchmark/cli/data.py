"""Commands on data sets: ``data info|stats|show|check|import|build``; extensions add to ``export`` and ``import``."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.help import FullSummaryGroup
from benchmark.cli.options import parse_image_size, parse_name_list
from benchmark.cli.output import print_json, print_result
from benchmark.cli.settings import Option, command
from benchmark.report.words import pluralise

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.records.statistics import SplitAssessment, TrafficStatistics

app = typer.Typer(
    cls=FullSummaryGroup,
    help="Look at, check, import, build and export data sets.",
    no_args_is_help=True,
    rich_help_panel="Data",
)
export_app = typer.Typer(cls=FullSummaryGroup, help="Write a data set for the code of others.", no_args_is_help=True)
import_app = typer.Typer(cls=FullSummaryGroup, help="Bring recordings into nuScenes format.", no_args_is_help=True)
app.add_typer(export_app, name="export")
app.add_typer(import_app, name="import")


@dataclass(frozen=True, slots=True, kw_only=True)
class DataInfoOptions:
    """Options of ``data info``."""

    root: Annotated[str, Option("mini, demo or the root of a data set.", "Input", names="")] = "mini"
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(DataInfoOptions, app, "info")
def data_info_command(options: DataInfoOptions) -> None:
    """Say what a data set holds: splits, scenes, samples, annotations, fingerprint."""
    from benchmark.datasets.contents import contents, format_contents

    data = api.DataSource.of(options)
    data.require()
    counts = contents(_open_for_reading(data))
    print_result(counts, format_contents(counts), json_output=options.json_output)


def _open_for_reading(data: api.DataSource) -> "DataSet":
    """Open a data set that may have another keyframe rate; a warning says so."""
    from benchmark.datasets.schema import FaultList

    rates = FaultList()
    dataset = data.open(rates=rates)
    for fault in rates.told():
        api.notify(f"warning: {fault.sentence}")
    return dataset


@dataclass(frozen=True, slots=True, kw_only=True)
class DataStatsOptions:
    """Options of ``data stats``."""

    root: shared.Root = "mini"
    split: Annotated[str | None, Option("Only this split; every row of the tables if not given.", "Input")] = None
    recordings: Annotated[
        str | None, Option("What the scenes were made from: adversaries are compared with it.", "Input")
    ] = None
    judge: Annotated[
        bool | None,
        Option(
            "Judge recordings, too, or nothing; by default scenes with adversaries.",
            "Output",
            names="--judge/--no-judge",
        ),
    ] = None
    traffic: Annotated[
        bool, Option("Measure headways, motion, road users, and in what planners without images collide.", "Output")
    ] = False
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(DataStatsOptions, app, "stats")
def data_stats_command(options: DataStatsOptions) -> None:
    """Print the data-set table; what adversaries do where, who could avoid it, how severe and how real it is."""
    from benchmark.datasets.statistics import statistics

    data = api.DataSource.of(options)
    if options.split is not None:
        data.require_split(options.split) if data.is_embedded else data.require_source(options.split)
    recordings = None
    if options.recordings is not None:
        recordings = api.DataSource.of(options, data=options.recordings, tables=None)
        recordings.require()
    root = Path(options.root)
    if data.is_embedded:
        root = (data.open() if options.split is None else data.open_split(options.split)).root
    numbers = statistics(root, split=options.split, version=options.tables)
    judged = None if options.judge is False else _assess_scenes(root, options, recordings)
    traffic = _measure_traffic(root, options, recordings) if options.traffic else None
    # A generated split lies in a folder of its data set's name.
    names = {data.name, Path(options.root).resolve().parent.name}
    difficulties = api.find_in_extension("statistics", "abilities", options.out, names, options.split)
    if options.json_output:
        parts = {"judgement": judged, "traffic": traffic}
        dumped = {name: None if part is None else part.model_dump(mode="json") for name, part in parts.items()}
        fitted = {"difficulty": [table.as_json() for table in difficulties]} if difficulties else {}
        print_json({**numbers.as_json(), **dumped, **fitted})
        return
    from benchmark.fairness.assessment_tables import format_assessment, format_traffic

    typer.echo(numbers.plain())
    if judged is not None:
        typer.echo("\n" + format_assessment(judged), nl=False)
    if traffic is not None:
        typer.echo("\n" + format_traffic(traffic), nl=False)
    for table in difficulties:
        typer.echo("\n" + table.plain(), nl=False)


def _assess_scenes(
    root: Path, options: DataStatsOptions, recordings: api.DataSource | None
) -> "SplitAssessment | None":
    """Judgements of the scenes of a root; nothing where there is none to judge."""
    from benchmark.datasets.roots import open_data
    from benchmark.fairness.split_assessment import find_adversarial_names, judge_split
    from benchmark.machine.workers import LocalProcesses

    data = open_data(root, version=options.tables)
    known = data.scene_names(options.split)
    names = known if options.judge else find_adversarial_names(data, known)
    if not names:
        return None
    base = None if recordings is None else recordings.open()
    return judge_split(data, names, LocalProcesses(api.worker_count(options.workers)), base)


def _measure_traffic(root: Path, options: DataStatsOptions, recordings: api.DataSource | None) -> "TrafficStatistics":
    from benchmark.datasets.roots import open_data
    from benchmark.datasets.schema import FaultList

    data = open_data(root, version=options.tables, rates=FaultList())
    base = None if recordings is None else recordings.open()
    return api.measure_traffic(data, options.split, recordings=base, workers=options.workers)


@dataclass(frozen=True, slots=True, kw_only=True)
class DataShowOptions:
    """Options of ``data show``."""

    root: shared.Root
    to: Annotated[Path, Option("Folder for the pictures.", "Output")]
    conditions: Annotated[bool, Option("Draw what MagicDriveDiT would be told.", "Output")] = False
    contact: Annotated[
        Path | None,
        Option("Record of runs or drives: draw the worst contact of each scene and whose fault it is.", "Input"),
    ] = None
    driving_side: shared.DrivingSide = None
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    workers: shared.Workers = 0


@command(DataShowOptions, app, "show")
def data_show_command(options: DataShowOptions) -> None:
    """Draw each scene: from above over time, and the camera that sees the adversary best."""
    from benchmark.machine.path_checks import require_place

    data, scenes = api.DataSource.of(options), parse_name_list(options.scenes)
    data.require(scenes)
    require_place(options.to, "--to")
    if options.contact is not None:
        _draw_contacts(options, data, scenes)
        return
    from benchmark.datasets.scene_names import resolve_names
    from benchmark.machine.extension import import_from_extension
    from generation.render.pictures import write_pictures
    from generation.render.schematic import SchematicRenderer

    dataset = _open_for_reading(data)
    names = (resolve_names(dataset.provenance(), scenes or ()) or dataset.scene_names(None))[: options.limit]
    write = import_from_extension("pictures", "conditions") if options.conditions else write_pictures
    written = write(dataset, names, options.to, SchematicRenderer())
    typer.echo(f"{pluralise(len(written), 'picture')} in {options.to}")


def _draw_contacts(options: DataShowOptions, data: api.DataSource, scenes: tuple[str, ...] | None) -> None:
    """A picture of the worst contact of each scene of a record, with both ways and when each came into the other's."""
    from itertools import islice

    from benchmark.fairness.contact_fault import judge_contact, load_roads
    from benchmark.machine.storage import sanitise_file_name
    from benchmark.report.contact_pictures import write_contact_picture
    from benchmark.runs.contact_tracing import open_with_data, trace_worst_contacts

    assert options.contact is not None
    record, opened = open_with_data(options.contact, data.open_split)
    count = 0
    for contact in islice(trace_worst_contacts(record, opened, scenes), options.limit):
        name = sanitise_file_name(f"{contact.scene.name}-{contact.planner}-{contact.index}")
        title = f"{contact.planner} on {contact.scene.name}, {contact.moment}"
        fault = judge_contact(contact.scene, contact.tracks)
        write_contact_picture(options.to / f"{name}.png", contact.tracks, load_roads(contact.scene), fault, title)
        count += 1
    typer.echo(f"{pluralise(count, 'picture')} in {options.to}")


@dataclass(frozen=True, slots=True, kw_only=True)
class DataCheckOptions:
    """Options of ``data check``."""

    root: Annotated[Path, Option("Root of a data set.", "Input", names="")]
    tables: shared.Tables = None
    categories: shared.Categories = None
    cameras: shared.Cameras = None
    json_output: shared.Json = False


@command(DataCheckOptions, app, "check")
def data_check_command(options: DataCheckOptions) -> None:
    """Look for faults in the tables and files of a data set."""
    from benchmark.datasets.categories import read_names
    from benchmark.datasets.schema.check import check_tables

    named = read_names(options.categories, options.cameras)
    faults = check_tables(options.root, version=options.tables, categories=named)
    errors = sum(fault.severity == "error" for fault in faults)
    if options.json_output:
        rows = [{"severity": f.severity, "table": f.table, "token": f.token, "says": f.sentence} for f in faults]
        print_json({"errors": errors, "faults": rows})
    else:
        for fault in faults:
            typer.echo(f"{fault.severity}: {fault.table}: {fault.sentence}")
        typer.echo(f"{pluralise(errors, 'error')}, {pluralise(len(faults) - errors, 'warning')} in {options.root}")
    raise typer.Exit(1 if errors else 0)


@dataclass(frozen=True, slots=True, kw_only=True)
class DataImportOptions:
    """Options of ``data import scenarionet``."""

    source: Annotated[Path, Option("A file or a folder of recordings.", "Input", names="")]
    out: Annotated[Path, Option("Root of the data set to write.", "Output")]
    renderer: Annotated[
        Literal["schematic", "none"], Option("Who draws the images (these recordings have none).", "Output")
    ] = "schematic"
    size: shared.Size = "448x256"
    frames: shared.Frames = "all"
    split: Annotated[str, Option("Name of the split; adv for adversarial scenes.", "Input")] = "val"
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(DataImportOptions, import_app, "scenarionet")
def data_import_command(options: DataImportOptions) -> None:
    """Import ScenarioNet files: tracks and maps of Waymo, nuPlan, Argoverse 2 and others, without images."""
    from benchmark.machine.path_checks import require_place
    from generation.sources.importing import ImportSettings, import_scenarionet

    require_place(options.out, "--out")
    width, height = parse_image_size(options.size)
    images = options.renderer != "none"
    settings = ImportSettings(width, height, options.frames, images=images, split=options.split)
    names = import_scenarionet(options.source, options.out, settings, workers=api.worker_count(options.workers))
    text = f"{pluralise(len(names), 'scene')} in {options.out}: {', '.join(names)}"
    print_result({"root": str(options.out), "scenes": names}, text, json_output=options.json_output)


@dataclass(frozen=True, slots=True, kw_only=True)
class DataBuildOptions:
    """Options of ``data build``."""

    root: Annotated[Path | None, Option("Where to; the user's cache if not given.", "Input")] = None
    town_scenes: Annotated[int, Option("Evaluation scenes.")] = 10
    train_scenes: Annotated[int, Option("Training scenes.")] = 0
    off_path: Annotated[bool, Option("The ego of training scenes gets off its path and comes back.")] = False
    driven: Annotated[
        Path | None,
        Option("Folder with a record of drives through training scenes: their ego goes where it was driven."),
    ] = None
    crossing: Annotated[
        int, Option("Most pedestrians more who cross the ego's way in each training scene when it comes.")
    ] = 0
    size: shared.Size = "448x256"
    frames: shared.Frames = "all"
    renderer: shared.QuickRenderer = "schematic"
    seed: shared.Seed = 0
    workers: shared.Workers = 0


@command(DataBuildOptions, app, "build")
def data_build_command(options: DataBuildOptions) -> None:
    """Build the embedded town, with any number of scenes; the same command resumes."""
    from benchmark.machine.path_checks import require_folder, require_place
    from benchmark.machine.workspace import EMBEDDED, cache_root
    from generation.sources.mini import TownSettings, build_town_data_set

    width, height = parse_image_size(options.size)
    images = options.renderer != "none"
    require_folder(options.driven, "--driven")
    settings = TownSettings(
        options.town_scenes,
        options.train_scenes,
        options.seed,
        width,
        height,
        options.frames,
        images,
        options.off_path,
        options.driven,
        crossing=options.crossing,
    )
    target = options.root or cache_root() / settings.folder_name(EMBEDDED)
    require_place(target, "--root")
    typer.echo(str(build_town_data_set(target, settings, workers=api.worker_count(options.workers))))
