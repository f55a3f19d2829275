"""Commands that show results: ``sheets`` and ``leaderboard``."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.help import FullSummaryGroup
from benchmark.cli.options import parse_name_list
from benchmark.cli.output import (
    print_json,
    print_next_steps,
    print_plan,
    print_result,
    print_tables,
    repeat_data_options,
    suggest_leaderboard,
)
from benchmark.cli.settings import Option, command, repeat_command
from benchmark.cli.splits import choose_splits
from benchmark.errors import InputError
from benchmark.report.words import format_options, pluralise

leaderboard_app = typer.Typer(
    cls=FullSummaryGroup,
    help="Write tables (Markdown, LaTeX, CSV, JSON) and site from run records; check submissions.",
    rich_help_panel="Results",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetsOptions:
    """Options of ``sheets``."""

    split: shared.Split = "adv"
    data: shared.Data = "mini"
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    categories: shared.Categories = None
    cameras: shared.Cameras = None
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    pictures: Annotated[
        Literal["keyframes", "all", "none"],
        Option("Pictures of all cameras at 2 Hz keyframes, at all 12 Hz frames, or none.", "Output"),
    ] = "keyframes"
    cell_width: Annotated[int, Option("Width of one camera in them, pixels; never enlarged.", "Output")] = 480
    rounds: Annotated[bool, Option("Also the rounds of refinement that generate --keep-rounds kept.", "Search")] = False
    workers: shared.Workers = 0
    json_output: shared.Json = False
    dry_run: shared.DryRun = False


@command(SheetsOptions, panel="Results")
def sheets_command(options: SheetsOptions) -> None:
    """Write scene sheets: what films, pictures and the site show of a split; the same command goes on."""
    from benchmark.machine.path_checks import require_place
    from benchmark.records.scene_pages import SPLIT_FILE
    from benchmark.scene_pages.writing import SheetSettings, describe_plan

    settings = SheetSettings(
        options.pictures,
        options.cell_width,
        parse_name_list(options.scenes),
        options.limit,
        api.worker_count(options.workers),
        options.rounds,
    )
    data = api.DataSource.of(options)
    taken = choose_splits(data, [options.split], settings.scenes, options.limit)
    ((split, ahead),) = taken.ahead.items()
    unsearched = data.is_embedded and not api.workspace(options.out).split_root(data.name, split).exists()
    if options.rounds and (split in ("val", "val-r") or unsearched):
        raise InputError(f"--rounds needs a split built with generate --keep-rounds; {split} has no rounds")
    require_place(options.out, "--out")
    taken.say()
    if options.dry_run and ahead.builds:
        print_plan(ahead.plan(f"write sheets of {ahead.counted()} of {split}"), json_output=options.json_output)
        return
    between = options.pictures == "all" and split == "val" and not options.dry_run
    source = data.open(sweeps=between)
    root = api.workspace(options.out).sheet_root()
    dataset = data.open_split(split, source)
    if options.dry_run:
        print_plan([describe_plan(dataset, split, root, settings)], json_output=options.json_output)
        return
    written = api.write_sheets(dataset, split, root, settings)
    print_result(written.as_json(), written.sentence(), json_output=options.json_output)
    films = Path("films")
    film = format_options(split=split, limit=1, to=films) + repeat_data_options(
        replace(options, categories=None, cameras=None)
    )
    print_next_steps(
        f"sheets: {written.directory}",
        None if films.exists() else (f"film{film}", "film a scene; --model adds plans of evaluated planners"),
        suggest_leaderboard(options.out, *(written.directory / SPLIT_FILE for page in written.scenes if page.made)),
        json_output=options.json_output,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class LeaderboardOptions:
    """Options of ``leaderboard``."""

    out: shared.Out = api.OUT
    records: shared.Records = None
    to: Annotated[Path | None, Option("Folder of the tables, if not <out>/leaderboard.", "Output")] = None
    site: Annotated[bool, Option("Whether to write the site too.", "Output", names="--site/--no-site")] = True
    figures: Annotated[bool, Option("Also every figure as PNG and SVG, which the site has anyway.", "Output")] = False
    check: Annotated[bool, Option("Only say whether the written tables are current.", "Output")] = False
    publish_check: Annotated[
        Path | None,
        Option(
            "Only say what of a site, a leaderboard or an --out should not leave the house, or needs a server.",
            "Output",
        ),
    ] = None
    may_show: Annotated[
        tuple[str, ...] | None,
        Option("Data set whose licence allows to show its pictures, for --publish-check; may be repeated.", "Output"),
    ] = None
    json_output: shared.Json = False


@leaderboard_app.callback(invoke_without_command=True)
@command(LeaderboardOptions)
def leaderboard_command(options: LeaderboardOptions) -> None:
    """Write tables (Markdown, LaTeX, CSV, JSON) and site from run records, scene sheets and studies."""
    from benchmark.machine.path_checks import require_folder, require_place

    if options.publish_check is not None:
        if options.check:
            raise InputError("--check and --publish-check exclude each other; run them one after the other")
        raise typer.Exit(
            _print_unpublishable(options.publish_check, options.may_show or (), json_output=options.json_output)
        )
    if options.may_show:
        raise InputError("--may-show needs --publish-check; add it or leave --may-show out")
    folder = options.to or options.out / "leaderboard"
    for place in options.records or ():
        require_folder(place, "--records")
    if options.check:
        stale = api.stale_leaderboard(options.out, folder, options.records, site=options.site, figures=options.figures)
        print_result({"stale": stale}, "\n".join(stale) or f"{folder} is current", json_output=options.json_output)
        raise typer.Exit(1 if stale else 0)
    require_place(folder, "--to" if options.to else "--out")
    written = api.write_leaderboard(options.out, folder, options.records, site=options.site, figures=options.figures)
    first = folder / ("site/index.html" if options.site else "README.md")
    beside = sum(not path.is_relative_to(folder / "site") for path in written)
    text = f"{pluralise(beside, 'file')}{' and a site' * options.site} in {folder}; start with {first}"
    print_result({"files": [str(path) for path in written]}, text, json_output=options.json_output)
    page = f", or open {folder / 'site/index.html'} in a browser" if options.site else ""
    print_next_steps(
        f"to read: {folder / 'README.md'}{page}",
        (f"{repeat_command()} --check", "check that it is current, after further runs"),
        json_output=options.json_output,
    )


def _print_unpublishable(folder: Path, may_show: "Sequence[str]", *, json_output: bool) -> int:
    """Say what of a folder should not be published; the exit code."""
    from benchmark.machine.extension import import_from_extension

    root, findings = import_from_extension("check", "publishing")(folder, may_show=may_show)
    if json_output:
        print_json({"folder": str(root), "findings": [finding.as_json() for finding in findings]})
    else:
        for finding in findings:
            typer.echo(finding.sentence())
        summary_text = (
            pluralise(len(findings), "finding") if findings else "nothing reveals this machine, nothing needs a server"
        )
        typer.echo(f"{root}: {summary_text}")
    return 1 if findings else 0


@dataclass(frozen=True, slots=True, kw_only=True)
class SlicesOptions:
    """Options of ``leaderboard slices``."""

    by: shared.By = None
    protocol: Annotated[
        tuple[str, ...] | None,
        Option("Whose numbers: a protocol, native, pdm or diagnosis; may be repeated.", "Output"),
    ] = None
    out: shared.Out = api.OUT
    records: shared.Records = None
    split: Annotated[str | None, Option("Only records of this split.", "Input")] = None
    data: Annotated[str | None, Option("Only records of the data set of this name.", "Input")] = None
    wide: shared.Wide = False
    verbose: shared.Verbose = False
    json_output: shared.Json = False


@command(SlicesOptions, leaderboard_app, "slices")
def slices_command(options: SlicesOptions) -> None:
    """Print every rate by place, light, manoeuvre of the adversary, speed and command, from run records."""
    from benchmark.metrics.slices import KINDS, select_kinds
    from benchmark.protocols import find_protocol as known_protocol
    from benchmark.records.driving import PDM
    from benchmark.records.run import NATIVE, find_records
    from benchmark.records.store import describe_recorded, list_recorded
    from leaderboard.results import select_runs
    from leaderboard.tables.slices import DIAGNOSIS, slice_tables

    protocols = tuple(dict.fromkeys(options.protocol or ["exact"]))
    for name in protocols:
        if name not in (NATIVE, PDM, DIAGNOSIS):
            known_protocol(name)
    folders = options.records or [api.workspace(options.out).run_root()]
    chosen = [
        record
        for record in select_runs(find_records(*folders))
        if options.split in (None, record.run.split) and options.data in (None, record.run.data.name)
    ]
    if not chosen:
        raise InputError(
            f"no matching run records below {', '.join(map(str, folders))}; "
            f"{describe_recorded(list_recorded(folders))}; name one of these or run challenger-bench eval first"
        )
    kinds = select_kinds(options.by or KINDS)
    names = sorted({record.run.data.name for record in chosen})
    tables = [
        table
        for name in names
        for table in slice_tables(
            name, [run_record for run_record in chosen if run_record.run.data.name == name], protocols, kinds
        )
    ]
    if options.json_output:
        print_json([table.as_json() for table in tables])
        return
    print_tables(tables, wide=options.wide, verbose=options.verbose)
