"""Commands that show results: ``sheets`` and ``leaderboard``."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli.options import (
    ByOption,
    CategoriesOption,
    DataOption,
    DryRunOption,
    JsonOption,
    LimitOption,
    OutOption,
    RecordsOption,
    ScenesOption,
    SheetPictures,
    SplitOption,
    TablesOption,
    WideOption,
    WorkersOption,
    name_list,
    print_json,
    say_plan,
)
from benchmark.cli.what_next import same_place, say_next
from benchmark.cli.whole_help import WholeSummaries
from benchmark.errors import InputError
from benchmark.report.words import counted

if TYPE_CHECKING:
    pass

leaderboard_app = typer.Typer(
    cls=WholeSummaries,
    help="Write tables (Markdown, LaTeX, CSV, JSON), figures and site from run records; check submissions.",
)


def sheets_command(
    split: SplitOption = "val",
    data: DataOption = "mini",
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    categories: CategoriesOption = None,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    pictures: Annotated[
        SheetPictures, typer.Option(help="Pictures of all cameras at 2 Hz keyframes, at all 12 Hz frames, or none.")
    ] = SheetPictures.KEYFRAMES,
    cell_width: Annotated[int, typer.Option(help="Width of one camera in them, pixels; never enlarged.")] = 480,
    rounds: Annotated[
        bool, typer.Option("--rounds", help="Also the rounds of refinement that generate --keep-rounds kept.")
    ] = False,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """Write scene sheets: what films, pictures and the site show of a split; the same command goes on."""
    from benchmark.cli.preflight_data_sets import require_data
    from benchmark.cli.preflight_places import require_place
    from benchmark.scene_pages.writing import SheetSettings, plan_of

    settings = SheetSettings(pictures.value, cell_width, name_list(scenes), limit, api.worker_count(workers), rounds)
    if rounds and split in ("val", "val-r"):
        raise InputError(f"--rounds shows what generate --split adv --keep-rounds kept; split {split} has none")
    ahead = require_data(data, tables, split, out, scenes=settings.scenes, limit=limit)
    require_place(out, "--out")
    if dry_run and ahead.builds:
        say_plan(ahead.plan(f"write sheets of {ahead.counted()} of {split}"), json_output=json_output)
        return
    between = pictures is SheetPictures.ALL and split == "val" and not dry_run
    source = api.open_data(data, tables=tables, workers=workers, out=out, sweeps=between, categories=categories)
    root = api.workspace(out).sheet_root()
    dataset = api.open_split(source, split, out, workers=workers)
    if dry_run:
        say_plan([plan_of(dataset, split, root, settings)], json_output=json_output)
        return
    written = api.write_sheets(dataset, split, root, settings)
    if json_output:
        print_json(written.as_json())
    else:
        typer.echo(written.sentence())
    again = same_place(data, out)
    say_next(
        f"sheets: {written.directory}",
        (f"film --split {split} --limit 1 --to films{again}", "a film of a scene; --model shows planners that ran"),
        (f"leaderboard{same_place('mini', out)}", "tables and a site that plays all scenes"),
        json_output=json_output,
    )


@leaderboard_app.callback(invoke_without_command=True)
def leaderboard_command(
    context: typer.Context,
    out: OutOption = api.OUT,
    records: RecordsOption = None,
    to: Annotated[Path | None, typer.Option(help="Folder of the tables, if not <out>/leaderboard.")] = None,
    site: Annotated[bool, typer.Option("--site/--no-site", help="Whether to write the site too.")] = True,
    check: Annotated[bool, typer.Option("--check", help="Only say whether the written tables are current.")] = False,
    publish_check: Annotated[
        Path | None,
        typer.Option(
            "--publish-check",
            help="Only say what of a site, a leaderboard or an --out should not leave the house, or needs a server.",
        ),
    ] = None,
    may_show: Annotated[
        list[str] | None,
        typer.Option(
            "--may-show",
            metavar="<str>",
            help="Data set whose licence allows to show its pictures, for --publish-check; may be repeated.",
        ),
    ] = None,
    json_output: JsonOption = False,
) -> None:
    """Write tables (Markdown, LaTeX, CSV, JSON), figures and site from run records, scene sheets and studies."""
    if context.invoked_subcommand is not None:
        return
    from benchmark.cli.preflight_places import require_folder, require_place

    if publish_check is not None:
        if check:
            raise InputError("--check and --publish-check are two questions; ask them one after the other")
        raise typer.Exit(_say_publishable(publish_check, may_show or (), json_output=json_output))
    if may_show:
        raise InputError("--may-show belongs to --publish-check; add it or leave it out")
    folder = to or out / "leaderboard"
    for place in records or ():
        require_folder(place, "--records")
    if check:
        stale = api.stale_leaderboard(out, folder, records, site=site)
        if json_output:
            print_json({"stale": stale})
        else:
            typer.echo("\n".join(stale) or f"{folder} is current")
        raise typer.Exit(1 if stale else 0)
    require_place(folder, "--to" if to else "--out")
    written = api.write_leaderboard(out, folder, records, site=site)
    if json_output:
        print_json({"files": [str(path) for path in written]})
    else:
        typer.echo(
            f"{counted(len(written), 'file')} in {folder}; start with "
            f"{folder / ('site/index.html' if site else 'README.md')}"
        )
    page = f", {folder / 'site/index.html'} in any browser" if site else ""
    say_next(
        f"to read: {folder / 'README.md'}{page}",
        (f"leaderboard --check{same_place('mini', out)}", "whether it is current, after further runs"),
        json_output=json_output,
    )


def _say_publishable(folder: Path, may_show: "Sequence[str]", *, json_output: bool) -> int:
    """Say what of a folder should not be published; the exit code."""
    from benchmark.machine.extension import from_extension

    root, found = from_extension("check", "publishing")(folder, may_show=may_show)
    if json_output:
        print_json({"folder": str(root), "findings": [each.as_json() for each in found]})
    else:
        for each in found:
            typer.echo(each.sentence())
        said = (
            counted(len(found), "finding")
            if found
            else "nothing that tells of this machine, nothing that needs a server"
        )
        typer.echo(f"{root}: {said}")
    return 1 if found else 0


@leaderboard_app.command("slices")
def slices_command(
    by: ByOption = None,
    protocol: Annotated[
        list[str] | None,
        typer.Option(metavar="<str>", help="Whose numbers: a protocol, native, pdm or diagnosis; may be repeated."),
    ] = None,
    out: OutOption = api.OUT,
    records: RecordsOption = None,
    split: Annotated[str | None, typer.Option("--split", help="Only records of this split.")] = None,
    data: Annotated[str | None, typer.Option("--data", help="Only records of the data set of this name.")] = None,
    wide: WideOption = False,
    json_output: JsonOption = False,
) -> None:
    """Print every rate by place, light, manoeuvre of the adversary, speed and command, from run records."""
    from benchmark.metrics.slices import KINDS, kinds_named
    from benchmark.protocols import protocol as known_protocol
    from benchmark.records.driving import PDM
    from benchmark.records.inventory import recorded, said_of
    from benchmark.records.run import NATIVE, find_records
    from leaderboard.selection import one_run_each
    from leaderboard.tables.slices import DIAGNOSIS, slice_tables

    asked = tuple(dict.fromkeys(protocol or ["exact"]))
    for name in asked:
        if name not in (NATIVE, PDM, DIAGNOSIS):
            known_protocol(name)
    folders = records or [api.workspace(out).run_root()]
    chosen = [
        record
        for record in one_run_each(find_records(*folders))
        if split in (None, record.run.split) and data in (None, record.run.data.name)
    ]
    if not chosen:
        raise InputError(
            f"there are no such run records below {', '.join(map(str, folders))}; {said_of(recorded(folders))}; name "
            "one of these or run challenger-bench eval first"
        )
    kinds = kinds_named(by or KINDS)
    names = sorted({record.run.data.name for record in chosen})
    tables = [
        table
        for name in names
        for table in slice_tables(name, [one for one in chosen if one.run.data.name == name], asked, kinds)
    ]
    if json_output:
        print_json([table.as_json() for table in tables])
        return
    for table in tables:
        typer.echo(table.plain(wide=wide))
