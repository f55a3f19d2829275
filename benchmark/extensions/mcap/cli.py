"""The command that writes scenes for viewers of robots' logs: ``data export mcap``."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.options import parse_name_list
from benchmark.cli.output import print_result
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError, did_you_mean
from benchmark.report.words import pluralise

if TYPE_CHECKING:
    from benchmark.records.drives import DriveRecord
    from benchmark.records.run import RunRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class McapOptions:
    """Options of ``data export mcap``."""

    root: shared.Root
    to: Annotated[Path, Option("Folder for the files, one a scene, and a layout.", "Output")]
    split: Annotated[str | None, Option("Only this split; all scenes, without plans, if not given.", "Input")] = None
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    models: Annotated[
        str | None, Option("Planners whose plans go along, by commas; all that have a record of the split.", "Input")
    ] = None
    drives: Annotated[Path | None, Option("Folder of records of drives that go along.", "Input")] = None
    recordings: Annotated[
        str | None,
        Option("What the scenes were made from, where ROOT lacks it: for adversaries' recorded tracks.", "Input"),
    ] = None
    images: Annotated[Literal["keyframes", "all", "none"], Option("Which images of cameras go along.", "Output")] = (
        "keyframes"
    )
    image_quality: Annotated[
        int | None,
        Option("Encode images anew as WebP of this quality; else the files as they are.", "Output", min=1, max=100),
    ] = None
    out: shared.Out = api.OUT
    tables: shared.Tables = None
    workers: shared.Workers = 0
    json_output: shared.Json = False
    dry_run: shared.DryRun = False


@command(McapOptions)
def export_mcap_command(options: McapOptions) -> None:
    """Write scenes, plans and drives as MCAP files, which Foxglove and Lichtblick play."""
    from benchmark.extensions.mcap.timeline import NEEDS_A_PACKAGE
    from benchmark.machine.extension import require_package
    from benchmark.machine.path_checks import require_folder, require_place

    require_package("foxglove", NEEDS_A_PACKAGE)
    data, named, split = api.DataSource.of(options), parse_name_list(options.scenes), options.split
    preview = data.require(named) if split is None else data.require_split(split, named, options.limit)
    require_place(options.to, "--to")
    require_folder(options.drives, "--drives")
    recordings = None
    if options.recordings is not None:
        recordings = api.DataSource.of(options, data=options.recordings, tables=None)
        recordings.require()
    if options.dry_run and preview is not None and preview.builds:
        text = f"split {split} would be built first; its files have no size yet"
        print_result({"files": None}, text, json_output=options.json_output)
        return
    records, drives = _read_plans(options), _read_drives(options)
    from benchmark.extensions.mcap.exporting import McapContents, estimate_bytes, export_mcap

    source = data.open()
    dataset = source if split is None else data.open_split(split, source)
    names = [name for name in dataset.scene_names(split) if named is None or name in named][: options.limit]
    drives = [drive for drive in drives if drive.facts.data.fingerprint == dataset.fingerprint()]
    if options.drives is not None and not drives:
        raise InputError(f"--drives {options.drives} holds no drives of these scenes; drive them, or leave it out")
    made_from = source if recordings is None else recordings.open()
    contents = McapContents(
        tuple(records), tuple(drives), options.images, split, made_from, image_quality=options.image_quality
    )
    if options.dry_run:
        sizes = {name: estimate_bytes(dataset, name, contents) for name in names}
        total = f"{pluralise(len(sizes), 'file')} of about {sum(sizes.values()) / 1e6:.1f} MB"
        lines = [f"{name}  {size / 1e6:.2f} MB" for name, size in sizes.items()]
        print_result({"files": sizes}, "\n".join([*lines, total]), json_output=options.json_output)
        return
    files = export_mcap(dataset, names, options.to, contents, workers=api.worker_count(options.workers))
    written = [
        {"scene": file.scene, "file": str(file.path), "bytes": file.size, "messages": file.messages} for file in files
    ]
    said = f"plans of {pluralise(len(records), 'planner')}" if records else "no plans"
    size = sum(file.size for file in files) / 1e6
    text = f"{pluralise(len(files), 'scene')} in {options.to}, {size:.1f} MB, with {said}"
    text += f" and {pluralise(len(drives), 'record')} of drives" if drives else ""
    print_result({"folder": str(options.to), "files": written}, text, json_output=options.json_output)


def _read_plans(options: McapOptions) -> "list[RunRecord]":
    """The record that stands for each planner on the split."""
    from benchmark.machine.storage import sanitise_file_name
    from benchmark.records.run import load_record
    from benchmark.records.store import list_record_places
    from leaderboard.results import select_runs

    named = parse_name_list(options.models)
    if options.split is None:
        if named is not None:
            raise InputError("--models needs --split, because plans are recorded by split; name one")
        return []
    folder = api.workspace(options.out).run_root() / sanitise_file_name(api.DataSource.of(options).name)
    places = list_record_places([folder / sanitise_file_name(options.split)])
    runs = select_runs([load_record(place) for _, place in places])
    known = {record.planner for record in runs} | {record.run.planner.name for record in runs}
    for name in named or ():
        if name not in known:
            raise InputError(
                f"there is no record of {name!r} on {options.split} below {options.out}; {did_you_mean(name, known)}"
                "run challenger-bench eval first"
            )
    return [record for record in runs if named is None or {record.planner, record.run.planner.name} & {*named}]


def _read_drives(options: McapOptions) -> "list[DriveRecord]":
    from benchmark.records.drives import find_drives

    return [] if options.drives is None else find_drives(options.drives)
