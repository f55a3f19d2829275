"""Commands on data sets: ``data info|stats|show|check|import|build``; extensions add ``data export``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli.options import (
    CategoriesOption,
    Frames,
    FramesOption,
    JsonOption,
    LimitOption,
    OutOption,
    QuickRendererName,
    ScenesOption,
    SeedOption,
    SizeOption,
    TablesOption,
    WorkersOption,
    image_size,
    name_list,
    print_json,
)
from benchmark.cli.whole_help import WholeSummaries
from benchmark.errors import InputError
from benchmark.report.words import counted

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.records.judged_splits import SplitJudgement

app = typer.Typer(cls=WholeSummaries, help="Look at, check, import, build and export data sets.", no_args_is_help=True)
export_app = typer.Typer(cls=WholeSummaries, help="Write a data set for the code of others.", no_args_is_help=True)
app.add_typer(export_app, name="export")


@app.command("info")
def data_info_command(
    root: Annotated[str, typer.Argument(help="mini, demo or the root of a data set.")] = "mini",
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Say what a data set holds: splits, scenes, samples, annotations, fingerprint."""
    from benchmark.cli.preflight_data_sets import require_root
    from benchmark.datasets.contents import contents, contents_text

    api.worker_count(workers)
    require_root(root, tables, out)
    found = contents(_open_to_look(root, tables, workers, out))
    if json_output:
        print_json(found)
    else:
        typer.echo(contents_text(found), nl=False)


def _open_to_look(root: str, tables: str | None, workers: int, out: Path) -> "DataSet":
    """Open a data set that may have another keyframe rate; a warning says so."""
    from benchmark.datasets.schema import FaultList

    rates = FaultList()
    dataset = api.open_data(root, tables=tables, workers=workers, out=out, rates=rates)
    for fault in rates.told():
        api.tell(f"warning: {fault.sentence}")
    return dataset


@app.command("stats")
def data_stats_command(
    root: Annotated[
        str, typer.Argument(help="mini, demo or the root of a data set, generated ones included.")
    ] = "mini",
    split: Annotated[str | None, typer.Option(help="Only this split; every row of the tables if not given.")] = None,
    recordings: Annotated[
        str | None, typer.Option(help="What the scenes were made from: adversaries are compared with it.")
    ] = None,
    judge: Annotated[
        bool | None,
        typer.Option(
            "--judge/--no-judge", help="Judge recordings, too, or nothing; by default scenes with adversaries."
        ),
    ] = None,
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Print the data-set table; what adversaries do where, who could avoid it, how severe and how real it is."""
    from benchmark.cli.preflight_data_sets import require_data, require_root, require_source
    from benchmark.datasets.statistics import statistics
    from benchmark.machine.workspace import EMBEDDED_NAMES

    processes = api.worker_count(workers)
    known = root in EMBEDDED_NAMES
    if split is not None and known:
        require_data(root, tables, split, out)
    elif split is not None:
        require_source(root, tables, split, out, scenes=None, limit=None)
    if recordings is not None:
        require_root(recordings, None, out)
    folder = Path(root)
    if known:
        source = api.open_data(root, tables=tables, workers=workers, out=out)
        folder = (source if split is None else api.open_split(source, split, out, workers=workers)).root
    found = statistics(folder, split=split, version=tables)
    judged = None
    if judge is not False:
        judged = _judged(folder, split, tables, recordings, processes, out, everything=judge is True)
    if json_output:
        said = None if judged is None else judged.model_dump(mode="json")
        print_json({**found.as_json(), "judgement": said})
        return
    typer.echo(found.plain())
    if judged is not None:
        from benchmark.fairness.tables import judgement_text

        typer.echo("\n" + judgement_text(judged), nl=False)


def _judged(
    root: Path,
    split: str | None,
    tables: str | None,
    recordings: str | None,
    workers: int,
    out: Path,
    *,
    everything: bool,
) -> "SplitJudgement | None":
    """What is said of the scenes of a root; nothing where there is none to judge."""
    from benchmark.datasets.roots import open_data
    from benchmark.fairness.splits import adversarial_names, judge_split
    from benchmark.machine.workers import LocalProcesses

    data = open_data(root, version=tables)
    known = data.scene_names(split)
    names = known if everything else adversarial_names(data, known)
    if not names:
        return None
    base = None if recordings is None else api.open_data(recordings, workers=workers, out=out)
    return judge_split(data, names, LocalProcesses(workers), base)


@app.command("show")
def data_show_command(
    root: Annotated[str, typer.Argument(help="mini, demo or the root of a data set, generated ones included.")],
    to: Annotated[Path, typer.Option(help="Folder for the pictures.")],
    conditions: Annotated[bool, typer.Option("--conditions", help="Draw what MagicDriveDiT would be told.")] = False,
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    workers: WorkersOption = 0,
) -> None:
    """Draw each scene: from above over time, and the camera that sees the adversary best."""
    from benchmark.cli.preflight_data_sets import require_root
    from benchmark.cli.preflight_places import require_place

    api.worker_count(workers)
    require_root(root, tables, out, name_list(scenes))
    require_place(to, "--to")
    from benchmark.machine.extension import from_extension
    from generation.render.pictures import write_pictures
    from generation.render.schematic import SchematicRenderer

    dataset = _open_to_look(root, tables, workers, out)
    names = (name_list(scenes) or dataset.scene_names(None))[:limit]
    write = from_extension("pictures", "conditions") if conditions else write_pictures
    written = write(dataset, names, to, SchematicRenderer())
    typer.echo(f"{counted(len(written), 'picture')} in {to}")


@app.command("check")
def data_check_command(
    root: Annotated[Path, typer.Argument(help="Root of a data set.")],
    tables: TablesOption = None,
    categories: CategoriesOption = None,
    json_output: JsonOption = False,
) -> None:
    """Look for faults in the tables and files of a data set."""
    from benchmark.datasets.categories import read_categories
    from benchmark.datasets.schema.check import check_tables

    named = None if categories is None else read_categories(categories)
    faults = check_tables(root, version=tables, categories=named)
    errors = sum(fault.severity == "error" for fault in faults)
    if json_output:
        rows = [{"severity": f.severity, "table": f.table, "token": f.token, "says": f.sentence} for f in faults]
        print_json({"errors": errors, "faults": rows})
    else:
        for fault in faults:
            typer.echo(f"{fault.severity}: {fault.table}: {fault.sentence}")
        typer.echo(f"{counted(errors, 'error')}, {counted(len(faults) - errors, 'warning')} in {root}")
    raise typer.Exit(1 if errors else 0)


@app.command("import")
def data_import_command(
    form: Annotated[str, typer.Argument(help="Form of the recordings: scenarionet.")],
    source: Annotated[Path, typer.Argument(help="A file or a folder of recordings.")],
    out: Annotated[Path, typer.Option("--out", help="Root of the data set to write.")],
    renderer: Annotated[QuickRendererName, typer.Option(help="Who draws the images (these recordings have none).")] = (
        QuickRendererName.SCHEMATIC
    ),
    size: SizeOption = "448x256",
    frames: FramesOption = Frames.ALL,
    split: Annotated[str, typer.Option(help="Name of the split; adv for adversarial scenes.")] = "val",
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Bring recordings of another form into nuScenes format."""
    from benchmark.cli.preflight_places import require_place
    from generation.sources.importing import ImportSettings, import_scenarionet

    if form != "scenarionet":
        raise InputError(f"cannot import {form!r}; the form that can be imported is scenarionet")
    require_place(out, "--out")
    width, height = image_size(size)
    images = renderer is not QuickRendererName.NONE
    settings = ImportSettings(width, height, frames.value, images=images, split=split)
    names = import_scenarionet(source, out, settings, workers=api.worker_count(workers))
    if json_output:
        print_json({"root": str(out), "scenes": names})
    else:
        typer.echo(f"{counted(len(names), 'scene')} in {out}: {', '.join(names)}")


@app.command("build")
def data_build_command(
    root: Annotated[Path | None, typer.Option(help="Where to; the user's cache if not given.")] = None,
    town_scenes: Annotated[int, typer.Option(help="Evaluation scenes.")] = 10,
    train_scenes: Annotated[int, typer.Option(help="Training scenes.")] = 0,
    off_path: Annotated[
        bool, typer.Option("--off-path", help="The ego of training scenes gets off its path and comes back.")
    ] = False,
    driven: Annotated[
        Path | None,
        typer.Option(
            help="Folder with a record of drives through training scenes: their ego goes where it was driven."
        ),
    ] = None,
    crossing: Annotated[
        int, typer.Option(help="Most pedestrians more who cross the ego's way in each training scene when it comes.")
    ] = 0,
    size: SizeOption = "448x256",
    frames: FramesOption = Frames.ALL,
    renderer: Annotated[QuickRendererName, typer.Option(help="Who draws the images.")] = QuickRendererName.SCHEMATIC,
    seed: SeedOption = 0,
    workers: WorkersOption = 0,
) -> None:
    """Build the embedded town, with any number of scenes; the same command resumes."""
    from benchmark.cli.preflight_places import require_folder, require_place
    from benchmark.machine.workspace import EMBEDDED, cache_root
    from generation.sources.mini import TownSettings, build_town

    width, height = image_size(size)
    images = renderer is not QuickRendererName.NONE
    require_folder(driven, "--driven")
    settings = TownSettings(
        town_scenes, train_scenes, seed, width, height, frames.value, images, off_path, driven, crossing=crossing
    )
    target = root or cache_root() / settings.folder_name(EMBEDDED)
    require_place(target, "--root")
    typer.echo(str(build_town(target, settings, workers=api.worker_count(workers))))
