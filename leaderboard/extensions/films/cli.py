"""Command that films scenes and drives: ``film``; of drives it puts engine, renderer and films together."""

import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.options import parse_name_list
from benchmark.cli.output import print_json, print_next_steps, suggest_leaderboard
from benchmark.cli.settings import Option, command
from benchmark.cli.splits import say_default_split
from benchmark.errors import InputError, did_you_mean
from benchmark.report.words import format_options

if TYPE_CHECKING:
    from benchmark.closed_loop.observation_builder import Sensor
    from benchmark.records.drive_schema import EpisodeRow
    from benchmark.records.drives import DriveRecord
    from benchmark.report.canvas import Picture
    from leaderboard.extensions.films.film import FilmSettings
    from leaderboard.extensions.films.filming import FrameProgress


@dataclass(frozen=True, slots=True, kw_only=True)
class FilmOptions:
    """Options of ``film``."""

    to: Annotated[Path, Option("Folder to write to.", "Output")]
    scenes: shared.Scenes = None
    limit: shared.Limit = None
    model: Annotated[tuple[str, ...] | None, Option("Planner to show; may be repeated.", "Planner")] = None
    data: shared.Data = "mini"
    split: shared.Split = "adv"
    out: shared.Out = api.OUT
    records: shared.Records = None
    layout: shared.FilmLayout = "both"
    form: shared.FilmFormat = "webm"
    begin_s: Annotated[float, Option("First moment, seconds.", names="--from")] = 0.0
    end_s: Annotated[float | None, Option("Last moment, seconds.", names="--until")] = None
    fps: Annotated[
        float | None,
        Option("Frames a second, 12 of scenes and 10 of drives; the film is as fast as the scene.", "Output"),
    ] = None
    width: Annotated[int, Option("Width of the frames in pixels, which are 16:9.", "Output")] = 1280
    extent: Annotated[float, Option("Half the width of what is seen from above, metres.", "Output")] = 24.0
    north_up: Annotated[bool, Option("North points up, not the ego's heading.", "Output")] = False
    candidates: Annotated[
        bool, Option("Whether to draw what the search chose from.", "Search", names="--candidates/--no-candidates")
    ] = True
    protocol: Annotated[str, Option("Whose verdicts are shown; native: of each planner's own.", "Output")] = "exact"
    drives: Annotated[
        bool, Option("Film drives in closed loop, of all planners unless --model names some.", "Input")
    ] = False
    tables: shared.Tables = None
    json_output: shared.Json = False


@command(FilmOptions, panel="Results")
def film_command(options: FilmOptions) -> None:
    """Film scenes from their sheets, or drives: cameras, view from above, plans and verdicts (docs/extensions/films.md)."""  # noqa: E501
    from benchmark.constants import FRAME_HZ
    from benchmark.machine.path_checks import require_folder, require_place
    from benchmark.machine.progress import CountedUnits, track_progress
    from benchmark.protocols import find_protocol as known_protocol
    from leaderboard.extensions.films.drive_film import DRIVE_FPS
    from leaderboard.extensions.films.film import FilmLayout, FilmSettings
    from leaderboard.extensions.films.filming import FilmFormat, find_planner_folder, write_films

    judge = options.protocol if options.protocol == "native" else known_protocol(options.protocol).name
    film_layout, space = FilmLayout(options.layout), api.workspace(options.out)
    for place in options.records or ():
        require_folder(place, "--records")
    require_place(options.to, "--to")
    frame_rate = (DRIVE_FPS if options.drives else float(FRAME_HZ)) if options.fps is None else options.fps
    settings = FilmSettings(
        film_layout,
        judge,
        options.begin_s,
        options.end_s,
        frame_rate,
        options.width,
        options.extent,
        not options.north_up,
        options.candidates,
    )

    def watch(frames: "Iterable[Picture]", total: int, label: str) -> "Iterable[Picture]":
        return track_progress(frames, total=total, label=label, count=CountedUnits("frame"))

    say_default_split(options.split)
    named = api.DataSource.of(options).name_scenes(parse_name_list(options.scenes), options.split)
    if options.drives:
        written = write_drive_films(
            options.split,
            options.to,
            options.model or (),
            data=options.data,
            out=options.out,
            tables=options.tables,
            records=options.records,
            scenes=named,
            limit=options.limit,
            form=options.form,
            settings=settings,
            watch=watch,
        )
    else:
        runs = space.run_root()
        written = write_films(
            space.sheet_root(),
            options.records or runs,
            options.data,
            options.split,
            options.to,
            resolve_planner_names(
                options.model or (), options.records or [find_planner_folder(runs, options.data, options.split)], runs
            ),
            scenes=named,
            limit=options.limit,
            form=FilmFormat(options.form),
            settings=settings,
            watch=watch,
        )
    films = []
    for film in written:
        films.append(str(film))
        typer.echo(films[-1], err=options.json_output)
    if options.json_output:
        print_json({"films": films})
    print_next_steps(
        f"films: {options.to}",
        suggest_leaderboard(options.out),
        json_output=options.json_output,
    )


def resolve_planner_names(names: Sequence[str], records: Sequence[Path], everywhere: Path) -> list[str]:
    """Planners as records name them: a miniature that ran for a full model, or the full name for a short one.

    A name stays where the records have none of it; `everywhere` holds all run records, to say what there is instead.
    """
    from adapters.checkpoints.stand_in import find_recorded_name
    from adapters.models import MODELS
    from benchmark.records.store import describe_recorded, list_recorded

    records_found = list_recorded(records)
    ran, shown_names = {planner_name.planner for planner_name in records_found}, []
    for name in names:
        recorded = find_recorded_name(name, ran)
        own = MODELS[name].name if name in MODELS else name
        if recorded not in (None, name, own):
            api.notify_once(
                f"there are no records of {own}; showing {recorded}, which ran in its place (docs/miniatures.md)"
            )
        known = {*ran, *MODELS}
        # Tables may show a planner with a suffix that distinguishes its versions: "vad-base (seed 1)".
        if name.partition(" (")[0] not in known and ":" not in name:
            raise InputError(
                f"there is no planner {name!r}; {did_you_mean(name, known)}{describe_recorded(records_found)}"
            )
        shown_names.append(recorded or name)
    if names and not records_found:
        raise InputError(
            f"there are no run records at {', '.join(map(str, records))}; "
            f"{describe_recorded(list_recorded([everywhere]))}; name "
            "these with --data and --split, or run challenger-bench eval first"
        )
    return shown_names


@dataclass(frozen=True, slots=True)
class _DriveSelection:
    """Drives that are filmed; see `write_drive_films`."""

    data: str
    split: str
    out: Path
    records: Sequence[Path] | None
    models: Sequence[str]
    scenes: Sequence[str] | None
    limit: int | None


def write_drive_films(
    split: str,
    to: Path,
    models: Sequence[str] = (),
    *,
    data: str = "mini",
    out: Path | None = None,
    tables: str | None = None,
    records: Sequence[Path] | None = None,
    scenes: Sequence[str] | None = None,
    limit: int | None = None,
    form: str = "webm",
    settings: "FilmSettings | None" = None,
    watch: "FrameProgress | None" = None,
) -> Iterator[Path]:
    """Film drives one after the other (docs/extensions/films.md).

    Args:
        split: The split.
        to: Folder to write to.
        models: Planners; all by default.
        data: Name or root of the data set.
        out: Output folder; ``challenger-out`` by default.
        tables: Folder of tables of the data set.
        records: Folders of records, if not all drives of the output folder.
        scenes: Scenes; all by default.
        limit: Only so many drives of each record.
        form: ``webm``, ``webp`` or ``png``.
        settings: How films are made; ten frames a second by default.
        watch: Shows how far the work is.

    Yields:
        The written files.

    Raises:
        InputError: If there is no such drive, the data set is another one, or a film cannot be written.
    """
    from benchmark.closed_loop.engines import restore_backend
    from benchmark.runs.episode_pages import write_episode_page
    from benchmark.runs.rescoring import read_replaced_categories
    from leaderboard.extensions.films.drive_film import DRIVE_FPS
    from leaderboard.extensions.films.film import FilmSettings
    from leaderboard.extensions.films.filming import FilmFormat, require_webm, write_drive_film

    if form not in {film_format.value for film_format in FilmFormat}:
        raise InputError(
            f"unknown film format {form!r}; use one of {', '.join(film_format.value for film_format in FilmFormat)}"
        )
    if form == FilmFormat.WEBM:
        require_webm()
    out = out or api.OUT
    chosen = _select_drives(_DriveSelection(data, split, out, records, models, scenes, limit))
    driven_on = api.open_split(api.open_data(data, tables=tables, out=out), split, out)
    how, watched = settings or FilmSettings(fps=DRIVE_FPS), {} if watch is None else {"watch": watch}
    for record, name, rows in chosen:
        measured = record.facts.measured
        maker = restore_backend(measured)
        own = driven_on.with_categories(read_replaced_categories(record.facts))
        for row in rows:
            with tempfile.TemporaryDirectory() as folder:
                driven = write_episode_page(Path(folder), own, record, row, maker, _find_sensor(record))
                yield write_drive_film(driven, record, name, to, FilmFormat(form), how, **watched)


def _find_sensor(record: "DriveRecord") -> "Sensor | None":
    """Sensor that drew for the planner; ``None`` where none did, or another version of it than there is now."""
    from generation.render.sensor import SCHEMATIC, SchematicSensor

    measured = record.facts.measured
    style = measured.sensor_facts.get("style")
    if measured.sensor != SCHEMATIC or not isinstance(style, str):
        return None
    sensor = SchematicSensor(style=style)
    return sensor if dict(sensor.facts) == measured.sensor_facts else None


def _select_drives(selection: _DriveSelection) -> "list[tuple[DriveRecord, str, list[EpisodeRow]]]":
    """Records, names of their planners and drives."""
    from benchmark.records.drives import find_drives
    from benchmark.records.planner_versions import compute_version_labels
    from leaderboard.extensions.films.filming import find_data_set_name

    root = api.workspace(selection.out).drive_root()
    options = format_options(data=selection.data, split=selection.split, out=selection.out)
    again = f"make some with: challenger-bench drive{options}"
    if selection.records is None and not root.is_dir():
        raise InputError(f"there are no records of drives below {root}; {again}")
    data = find_data_set_name(selection.data)
    here = [
        record
        for record in find_drives(*(selection.records or [root]))
        if (record.facts.data.name, record.facts.split) == (data, selection.split)
    ]
    if not here:
        raise InputError(f"there are no records of drives on {data} {selection.split}; {again}")
    record_labels = compute_version_labels([(record.facts.planner, data, selection.split) for record in here])
    named = [(record, label or record.planner) for record, label in zip(here, record_labels, strict=True)]
    known = sorted({name for _, name in named} | {record.planner for record in here})
    for name in selection.models:
        if name not in known:
            hint = did_you_mean(name, known)
            raise InputError(f"there are no drives of {name}; {hint}choose one of {', '.join(known)}")
    selected = [
        named_record
        for named_record in named
        if not selection.models or {named_record[1], named_record[0].planner} & set(selection.models)
    ]
    driven = sorted({row.scene for record, _ in selected for row in record.rows})
    for scene in selection.scenes or ():
        if scene not in driven:
            hint = did_you_mean(scene, driven)
            raise InputError(f"scene {scene} was not driven; {hint}choose one of {', '.join(driven)}")
    wanted = set(driven if selection.scenes is None else selection.scenes)
    rows = [
        (record, name, [row for row in record.rows if row.scene in wanted][: selection.limit])
        for record, name in selected
    ]
    return [named_record for named_record in rows if named_record[2]]
