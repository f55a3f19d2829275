"""Commands on packages of splits: ``data pack`` and ``data unpack``."""

from pathlib import Path
from typing import Annotated

import typer

from benchmark import api
from benchmark.cli.options import (
    DryRunOption,
    Frames,
    FramesOption,
    JsonOption,
    LimitOption,
    OutOption,
    QuickRendererName,
    ScenesOption,
    SizeOption,
    TablesOption,
    WorkersOption,
    image_size,
    name_list,
    print_json,
)
from benchmark.errors import InputError
from benchmark.report.words import counted


def data_pack_command(
    splits: Annotated[list[str], typer.Argument(help="Frozen splits: files, or names such as mini-adv-3.")],
    to: Annotated[Path, typer.Option("--to", help="The package to write, a .zip file.")],
    root: Annotated[
        str | None,
        typer.Option(help="Data set that was built from them (or mini): its verdicts and statistics go along."),
    ] = None,
    drives: Annotated[
        list[Path] | None,
        typer.Option(help="Folder of records of drives, whose settings go along; may be repeated."),
    ] = None,
    rules: Annotated[Path | None, typer.Option(help="File of rules (TOML) that goes along.")] = None,
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
) -> None:
    """Put a frozen split and what belongs to it into one file to publish; no recording is in it."""
    from benchmark.cli.preflight_data_sets import require_data, require_root
    from benchmark.cli.preflight_places import require_file, require_output_file
    from benchmark.machine.workspace import EMBEDDED_NAMES

    processes = api.worker_count(workers)
    require_output_file(to, "--to", (".zip",))
    require_file(rules, "--rules")
    known = root in EMBEDDED_NAMES
    if root is not None:
        if known:
            require_data(root, tables, "adv", out)
        else:
            require_root(root, tables, out)
    from benchmark.machine.workers import LocalProcesses
    from benchmark.records.drives import find_drives
    from generation.splits.packaged import frozen_split
    from generation.splits.packing import PackageContents, pack_split

    named = tuple(map(frozen_split, splits))
    records = find_drives(*(drives or ()))
    if drives and not records:
        raise InputError(f"--drives {drives[0]} holds no record of drives; run challenger-bench drive first")
    data = None
    if root is not None:
        data = api.open_data(root, tables=tables, workers=workers, out=out)
        data = api.open_split(data, "adv", out, workers=workers) if known else data
    contents = PackageContents(named, data, tuple(records), rules)
    packed = pack_split(to, contents, LocalProcesses(processes))
    manifest = packed.manifest
    if json_output:
        said = manifest.model_dump(mode="json", by_alias=True)
        print_json({"file": str(to), "sha256": packed.sha256, "manifest": said})
        return
    names = ", ".join(f"{each.name} ({counted(each.scenes, 'scene')})" for each in manifest.splits)
    kinds = [file.kind for file in manifest.files.values()]
    beside = [str(kind) for kind in kinds if kind in ("verdicts", "statistics", "rules")]
    beside += [f"settings of {counted(kinds.count('drive'), 'drive record')}"] if "drive" in kinds else []
    typer.echo(f"{to}: {names}{'; ' + ', '.join(beside) if beside else ''}\n  SHA-256 {packed.sha256}")


def data_unpack_command(
    package: Annotated[Path, typer.Argument(help="A package that data pack wrote.")],
    to: Annotated[Path, typer.Option("--to", help="Folder for its files.")],
    data: Annotated[
        str | None, typer.Option("--data", help="The recordings: mini or a root; the split is built from them.")
    ] = None,
    split: Annotated[str | None, typer.Option(help="Which frozen split is built, if there are several.")] = None,
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    renderer: Annotated[QuickRendererName, typer.Option(help="Who draws the images.")] = QuickRendererName.SCHEMATIC,
    size: SizeOption = "448x256",
    frames: FramesOption = Frames.ALL,
    workers: WorkersOption = 0,
    json_output: JsonOption = False,
    dry_run: DryRunOption = False,
) -> None:
    """Check a package, write its files, and build its split from the recordings with --data."""
    from benchmark.cli.preflight_data_sets import require_source
    from benchmark.cli.preflight_places import require_place

    processes = api.worker_count(workers)
    require_place(to, "--to")
    require_place(out, "--out")
    width, height = image_size(size)
    from generation.splits.unpacking import read_split_package, write_files

    found = read_split_package(package)
    for sentence in found.left_out:
        api.tell(sentence)
    chosen = None
    if data is not None:
        chosen = found.split(split)
        named = chosen.chosen(name_list(scenes), limit)
        require_source(data, tables, "val", out, scenes=tuple({scene.source for scene, _ in named}), limit=None)
    elif split is not None:
        raise InputError("--split says what is built from recordings; add --data, or leave it out")
    files = () if dry_run else write_files(found, to)
    said = {"files": [str(path) for path in files], "splits": [each.name for each in found.splits]}
    if not json_output:
        typer.echo(f"{package} is whole: {counted(len(found.files), 'file')}" + (f" in {to}" if files else ""))
    if chosen is None or data is None:
        if json_output:
            print_json({**said, "built": None})
        else:
            for each in found.splits:
                typer.echo(f"  {each.name}: generate --from {to / 'splits' / each.name}.json --data RECORDINGS")
        return
    from benchmark.machine.workers import LocalProcesses
    from generation.pipeline.dry_run import estimate_frozen
    from generation.pipeline.settings import BuildSettings
    from generation.splits.rebuilding import rebuild

    source = api.open_data(data, tables=tables, workers=workers, out=out)
    root = api.workspace(out).split_root(source.name, "adv")
    settings = BuildSettings(
        out=root,
        timings=api.workspace(out).timings_of(root),
        scenes=name_list(scenes),
        limit=limit,
        renderer=None if renderer is QuickRendererName.NONE else api.schematic_renderer((width, height)),
        frames=frames.value,
        executor=LocalProcesses(processes),
    )
    report = estimate_frozen(source, chosen, settings) if dry_run else rebuild(source, found, chosen, settings)
    if json_output:
        print_json({**said, "built": {"root": str(settings.out), **report.as_json()}})
    else:
        typer.echo(f"{report.summary()}\n  data set: {settings.out}")
