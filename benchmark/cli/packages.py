"""Commands on packages of splits: ``data pack`` and ``data unpack``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.options import parse_image_size, parse_name_list
from benchmark.cli.output import print_json
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError
from benchmark.report.words import pluralise


@dataclass(frozen=True, slots=True, kw_only=True)
class DataPackOptions:
    """Options of ``data pack``."""

    splits: Annotated[tuple[str, ...], Option("Frozen splits: files, or names such as mini-adv-3.", "Input", names="")]
    to: Annotated[Path, Option("The package to write, a .zip file.", "Output")]
    root: Annotated[
        str | None,
        Option("Data set that was built from them (or mini): its verdicts and statistics go along.", "Input"),
    ] = None
    drives: Annotated[
        tuple[Path, ...] | None,
        Option("Folder of records of drives, whose settings go along; may be repeated.", "Input"),
    ] = None
    rules: Annotated[Path | None, Option("File of rules (TOML) that goes along.", "Input")] = None
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    workers: shared.Workers = 0
    json_output: shared.Json = False


@command(DataPackOptions)
def data_pack_command(options: DataPackOptions) -> None:
    """Put a frozen split and what belongs to it into one file to publish; no recording is in it."""
    from benchmark.machine.path_checks import require_file, require_output_file

    processes = api.worker_count(options.workers)
    require_output_file(options.to, "--to", (".zip",))
    require_file(options.rules, "--rules")
    source = None if options.root is None else api.DataSource.of(options)
    if source is not None:
        source.require_split("adv") if source.is_embedded else source.require()
    from benchmark.machine.workers import LocalProcesses
    from benchmark.records.drives import find_drives
    from generation.splits.packaged import read_frozen_split
    from generation.splits.packing import PackageContents, pack_split

    named = tuple(map(read_frozen_split, options.splits))
    records = find_drives(*(options.drives or ()))
    if options.drives and not records:
        raise InputError(f"--drives {options.drives[0]} holds no record of drives; run challenger-bench drive first")
    data = None
    if source is not None:
        data = source.open_split("adv") if source.is_embedded else source.open()
    contents = PackageContents(named, data, tuple(records), options.rules)
    packed = pack_split(options.to, contents, LocalProcesses(processes))
    manifest = packed.manifest
    if options.json_output:
        manifest_json = manifest.model_dump(mode="json", by_alias=True)
        print_json({"file": str(options.to), "sha256": packed.sha256, "manifest": manifest_json})
        return
    names = ", ".join(f"{split.name} ({pluralise(split.scenes, 'scene')})" for split in manifest.splits)
    kinds = [file.kind for file in manifest.files.values()]
    companion_files = [str(kind) for kind in kinds if kind in ("verdicts", "statistics", "rules")]
    companion_files += [f"settings of {pluralise(kinds.count('drive'), 'drive record')}"] if "drive" in kinds else []
    typer.echo(
        f"{options.to}: {names}{'; ' + ', '.join(companion_files) if companion_files else ''}\n  SHA-256 "
        f"{packed.sha256}"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class DataUnpackOptions:
    """Options of ``data unpack``."""

    package: Annotated[Path, Option("A package that data pack wrote.", "Input", names="")]
    to: Annotated[Path, Option("Folder for its files.", "Output")]
    data: Annotated[str | None, Option("The recordings: mini or a root; the split is built from them.", "Input")] = None
    split: Annotated[str | None, Option("Which frozen split is built, if there are several.", "Input")] = None
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    renderer: shared.QuickRenderer = "schematic"
    size: shared.Size = "448x256"
    frames: shared.Frames = "all"
    workers: shared.Workers = 0
    json_output: shared.Json = False
    dry_run: shared.DryRun = False


@command(DataUnpackOptions)
def data_unpack_command(options: DataUnpackOptions) -> None:
    """Check a package, write its files, and build its split from the recordings with --data."""
    from benchmark.machine.path_checks import require_place

    processes = api.worker_count(options.workers)
    require_place(options.to, "--to")
    require_place(options.out, "--out")
    width, height = parse_image_size(options.size)
    from generation.splits.packaged import require_town
    from generation.splits.unpacking import read_split_package, write_package_files

    package = read_split_package(options.package)
    for sentence in package.left_out:
        api.notify(sentence)
    chosen = None
    if options.data is not None:
        chosen = package.split(options.split)
        named = chosen.chosen(parse_name_list(options.scenes), options.limit)
        recordings = api.DataSource.of(options)
        require_town(chosen, recordings.name)
        recordings.require_source("val", tuple({scene.source for scene, _ in named}))
    elif options.split is not None:
        raise InputError("--split chooses what is built from recordings; add --data, or leave --split out")
    files = () if options.dry_run else write_package_files(package, options.to)
    package_json = {"files": [str(path) for path in files], "splits": [split.name for split in package.splits]}
    if not options.json_output:
        typer.echo(
            f"{options.package} is intact: {pluralise(len(package.files), 'file')}"
            + (f" in {options.to}" if files else "")
        )
    if chosen is None or options.data is None:
        if options.json_output:
            print_json({**package_json, "built": None})
        else:
            for split in package.splits:
                typer.echo(
                    f"  {split.name}: generate --from {options.to / 'splits' / split.name}.json --data RECORDINGS"
                )
        return
    from benchmark.machine.workers import LocalProcesses
    from generation.pipeline.settings import BuildSettings
    from generation.splits.rebuilding import rebuild

    source = recordings.open()
    root = api.workspace(options.out).split_root(source.name, "adv")
    settings = BuildSettings(
        out=root,
        timings=api.workspace(options.out).timings_of(root),
        scenes=parse_name_list(options.scenes),
        limit=options.limit,
        renderer=None if options.renderer == "none" else api.schematic_renderer((width, height)),
        frames=options.frames,
        executor=LocalProcesses(processes),
        dry_run=options.dry_run,
    )
    report = rebuild(source, package, chosen, settings)
    if options.json_output:
        print_json({**package_json, "built": {"root": str(settings.out), **report.as_json()}})
    else:
        typer.echo(f"{report.summary()}\n  data set: {settings.out}")
