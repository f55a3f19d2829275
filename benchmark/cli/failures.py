"""``failures``: the worst scenes and samples of a planner, from its record, with the command that films each."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from shlex import quote
from typing import TYPE_CHECKING, Annotated, Any

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.output import print_json, repeat_data_options, repeat_out_option
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet
    from benchmark.metrics.failures import Failure, Failures
    from benchmark.records.drives import DriveRecord
    from benchmark.records.run import RunRecord
    from benchmark.records.store import RecordIdentity


@dataclass(frozen=True, slots=True, kw_only=True)
class FailuresOptions:
    """Options of ``failures``."""

    model: Annotated[str | None, Option("Planner, as tables name it.", "Planner")] = None
    split: shared.Split = "adv"
    data: shared.Data = "mini"
    tables: shared.Tables = None
    categories: shared.Categories = None
    cameras: shared.Cameras = None
    out: shared.Out = api.OUT
    drives: Annotated[bool, Option("Failures of its drives in closed loop instead.", "Input")] = False
    limit: Annotated[int, Option("Only the first so many scenes.", "Output", min=1)] = 10
    json_output: shared.Json = False


@command(FailuresOptions, panel="Results")
def failures_command(options: FailuresOptions) -> None:
    """List the worst scenes and samples of a planner (exact, 3 s) from its record: what it hits, when, at whose fault.

    The worst come first, contacts with the adversary before others; --limit is of scenes, samples and crashes alike.
    """
    records = _load_records(options)
    from benchmark.metrics.failures import find_failures
    from benchmark.runs.units import FAILURES_FILE
    from leaderboard.tables.failures import describe_failures, failure_tables

    data = None if options.drives else _open_if_there(options)
    several = len(records) > 1
    listed = [find_failures(record, data, options.limit) for record in records]
    if options.json_output:
        print_json([_as_json(failures, options, several=several) for failures in listed])
        return
    for failures in listed:
        typer.echo(describe_failures(failures))
        for table in failure_tables(failures, options.limit):
            typer.echo(table.plain())
        if failures.crashes and not options.drives:
            typer.echo(f"all tracebacks: {failures.record.directory / FAILURES_FILE}\n")
        if failures.scenes:
            typer.echo("to see each scene:")
        for scene in failures.scenes[: options.limit]:
            typer.echo(f"  {' && '.join(_list_film_commands(scene.scene, failures.record, options, several))}")


def _load_records(options: FailuresOptions) -> "Sequence[RunRecord | DriveRecord]":
    """The run record of the planner on the split, or all its records of drives there."""
    from benchmark.machine.storage import sanitise_file_name
    from benchmark.records.store import DRIVE_FILE, RUN_FILE, list_record_places

    space = api.workspace(options.out)
    root, head = (space.drive_root(), DRIVE_FILE) if options.drives else (space.run_root(), RUN_FILE)
    data = api.DataSource.of(options).name
    places = list_record_places([root / sanitise_file_name(data) / sanitise_file_name(options.split)], head)
    name = _find_recorded_name(options, [identity.planner for identity, _ in places])
    if name is None:
        raise _no_record_error(options, data, [identity for identity, _ in list_record_places([root], head)])
    of_planner = [place for identity, place in places if identity.planner == name.partition(" (")[0]]
    # Slow to import, and a refusal needs none of it.
    from benchmark.records.drives import load_drives
    from benchmark.records.run import load_record
    from leaderboard.results import select_runs

    if options.drives:
        return [load_drives(place) for place in of_planner]
    runs = select_runs([load_record(place) for place in of_planner])
    chosen = [record for record in runs if record.planner == name] or runs
    if len(chosen) > 1:
        versions = ", ".join(repr(record.planner) for record in chosen)
        raise InputError(f"{name} ran in {len(chosen)} versions; name one with --model: {versions}")
    return chosen


def _find_recorded_name(options: FailuresOptions, here: Sequence[str]) -> str | None:
    """Name of the planner in its records; ``None`` where it has none here."""
    from adapters.checkpoints.stand_in import find_recorded_name

    if options.model is None:
        return None
    base = options.model.partition(" (")[0]
    found = find_recorded_name(base, here)
    if found is not None and found != base:
        api.notify_once(f"{base} ran as {found}")
    return options.model if found == base else found


def _no_record_error(options: FailuresOptions, data: str, recorded: "Sequence[RecordIdentity]") -> InputError:
    """Refusal that names the command that makes the record."""
    from adapters.models import MODELS
    from adapters.planners.names import installed_planners
    from benchmark.records.store import describe_recorded

    name, found = options.model, describe_recorded(recorded)
    if name is None:
        return InputError(f"name a planner with --model; {found}")
    runnable = {*MODELS, *installed_planners()}
    known = {*runnable, *(identity.planner for identity in recorded)}
    if name.partition(" (")[0] not in known and ":" not in name:
        return InputError(f"there is no planner {name!r}; {did_you_mean(name, known)}{found}")
    made_by = f"--model {quote(name)}" if name in runnable or ":" in name else "--plans or --results with its file"
    sensor = " --sensor schematic" if options.drives and api.uses_images(name) else ""
    line = f"{'drive' if options.drives else 'eval'} {made_by} --split {options.split}{sensor}"
    what = "record of drives" if options.drives else "run record"
    return InputError(
        f"there is no {what} of {name} on {data} {options.split} ({found}); make it with: challenger-bench {line}"
        f"{repeat_data_options(options)}"
    )


def _open_if_there(options: FailuresOptions) -> "DataSet | None":
    """The data set of the split, which says what objects are; nothing is built for that."""
    data = api.DataSource.of(options)
    try:
        return None if data.require_split(options.split).builds else data.open_split(options.split)
    except InputError as error:
        api.notify_once(f"categories are not shown: {error}")
        return None


def _list_film_commands(
    scene: str, record: "RunRecord | DriveRecord", options: FailuresOptions, several: bool
) -> list[str]:
    """Command lines that show the planner in a scene, one after the other: a sheet is drawn first if there is none."""
    from benchmark.machine.extension import AbsentExtensionError, import_from_extension

    drawn = options.drives or _has_sheet(scene, record, options)
    first = [] if drawn else [f"challenger-bench sheets {_name_scene(scene, options)}"]
    try:
        import_from_extension("command", "film")
    except AbsentExtensionError:
        # The site plays it.
        return [*first, f"challenger-bench leaderboard{repeat_out_option(options.out)}"]
    again = _name_scene(scene, replace(options, categories=None, cameras=None))
    film = f"challenger-bench film{' --drives' if options.drives else ''} {again} --model {quote(record.planner)}"
    film += f" --records {quote(str(record.directory))}" if several else ""
    # Without PyAV an animated WebP, with frames for a minute at most.
    film += "" if find_spec("av") else " --format webp --fps 6"
    return [*first, f"{film} --to films"]


def _name_scene(scene: str, options: FailuresOptions) -> str:
    """Options that name a scene of the split."""
    return f"--split {options.split}{repeat_data_options(options)} --scenes {quote(scene)}"


def _has_sheet(scene: str, record: "RunRecord | DriveRecord", options: FailuresOptions) -> bool:
    """Whether the scene has a sheet that shows the content that the planner ran on."""
    from benchmark.machine.storage import read_cached_json
    from benchmark.records.run import RunRecord
    from benchmark.records.scene_pages import SHEET_FILE, SPLIT_FILE, scene_folder, split_folder

    assert isinstance(record, RunRecord)
    root, data, split = api.workspace(options.out).sheet_root(), record.run.data, options.split
    page = read_cached_json(split_folder(root, data.name, split) / SPLIT_FILE)
    shows = isinstance(page, dict) and page.get("data", {}).get("fingerprint") == data.fingerprint
    return shows and (scene_folder(root, data.name, split, scene) / SHEET_FILE).is_file()


def _describe(failure: "Failure") -> dict[str, Any]:
    fault = failure.fault
    return {**asdict(failure), "fault": None if fault is None else fault.model_dump(mode="json")}


def _as_json(failures: "Failures", options: FailuresOptions, *, several: bool) -> dict[str, Any]:
    record, limit = failures.record, options.limit
    return {
        "directory": str(record.directory),
        "planner": record.planner,
        "split": options.split,
        "unit": failures.unit,
        "counted": failures.counted,
        "failed": len(failures.worst),
        "scenes_counted": failures.scenes_counted,
        "scenes_failed": len(failures.scenes),
        "without_plan": len(failures.crashes),
        "scenes": [
            {
                "scene": scene.scene,
                "counted": scene.counted,
                "failed": len(scene.failures),
                "worst": _describe(scene.failures[0]),
                "film": _list_film_commands(scene.scene, record, options, several),
            }
            for scene in failures.scenes[:limit]
        ],
        "worst": [_describe(failure) for failure in failures.worst[:limit]],
        "crashes": [asdict(crash) for crash in failures.crashes[:limit]],
    }
