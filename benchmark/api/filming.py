"""What stands behind ``film --drives``, which puts engine, renderer and films together."""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from benchmark.api.opening import OUT, open_data, open_split, workspace
from benchmark.errors import InputError, did_you_mean

if TYPE_CHECKING:
    from benchmark.closed_loop.sensors import Sensor
    from benchmark.records.drive_schema import DriveRow
    from benchmark.records.drives import DriveRecord
    from leaderboard.extensions.films.film import FilmSettings
    from leaderboard.extensions.films.filming import Watch


@dataclass(frozen=True, slots=True)
class _Asked:
    """Which drives are filmed; see `write_drive_films`."""

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
    watch: "Watch | None" = None,
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
        What was written.

    Raises:
        InputError: If there is no such drive, the data set is another one, or a film cannot be written.
    """
    from benchmark.closed_loop.engines import rides_as
    from benchmark.runs.drive_sheets import driven_sheet
    from benchmark.runs.rescoring import replaced_categories
    from leaderboard.extensions.films.drive_film import DRIVE_FPS
    from leaderboard.extensions.films.encoding import require_webm
    from leaderboard.extensions.films.film import FilmSettings
    from leaderboard.extensions.films.filming import FilmFormat, write_drive_film

    if form not in {each.value for each in FilmFormat}:
        raise InputError(f"there are no films of {form!r}; there are {', '.join(each.value for each in FilmFormat)}")
    if form == FilmFormat.WEBM:
        require_webm()
    out = out or OUT
    chosen = _chosen(_Asked(data, split, out, records, models, scenes, limit))
    driven_on = open_split(open_data(data, tables=tables, out=out), split, out)
    how, watched = settings or FilmSettings(fps=DRIVE_FPS), {} if watch is None else {"watch": watch}
    for record, name, rows in chosen:
        measured = record.facts.measured
        maker = rides_as(measured)
        own = driven_on.with_categories(replaced_categories(record.facts))
        for row in rows:
            with tempfile.TemporaryDirectory() as folder:
                driven = driven_sheet(Path(folder), own, record, row, maker, _sensor(record))
                yield write_drive_film(driven, record, name, to, FilmFormat(form), how, **watched)


def _sensor(record: "DriveRecord") -> "Sensor | None":
    """What drew for the planner; ``None`` where nothing did, or another version of it than there is now."""
    from generation.render.sensor import SCHEMATIC, SchematicSensor

    measured = record.facts.measured
    style = measured.sensor_facts.get("style")
    if measured.sensor != SCHEMATIC or not isinstance(style, str):
        return None
    sensor = SchematicSensor(style=style)
    return sensor if dict(sensor.facts) == measured.sensor_facts else None


def _chosen(asked: _Asked) -> "list[tuple[DriveRecord, str, list[DriveRow]]]":
    """Records, names of their planners and drives."""
    from benchmark.records.drives import find_drives
    from benchmark.records.planner_versions import labels
    from leaderboard.extensions.films.filming import data_set_name

    root = workspace(asked.out).drive_root()
    again = f"make some with: challenger-bench drive --data {asked.data} --split {asked.split} --out {asked.out}"
    if asked.records is None and not root.is_dir():
        raise InputError(f"there are no records of drives below {root}; {again}")
    data = data_set_name(asked.data)
    here = [
        record
        for record in find_drives(*(asked.records or [root]))
        if (record.facts.data.name, record.facts.split) == (data, asked.split)
    ]
    if not here:
        raise InputError(f"there are no records of drives of {data} {asked.split}; {again}")
    found = labels([(record.facts.planner, data, asked.split) for record in here])
    named = [(record, label or record.planner) for record, label in zip(here, found, strict=True)]
    known = sorted({name for _, name in named} | {record.planner for record in here})
    for name in asked.models:
        if name not in known:
            hint = did_you_mean(name, known)
            raise InputError(f"no record of drives is of {name}; {hint}there are {', '.join(known)}")
    kept = [each for each in named if not asked.models or {each[1], each[0].planner} & set(asked.models)]
    driven = sorted({row.scene for record, _ in kept for row in record.rows})
    for scene in asked.scenes or ():
        if scene not in driven:
            hint = did_you_mean(scene, driven)
            raise InputError(f"scene {scene} was not driven; {hint}there are {', '.join(driven)}")
    wanted = set(driven if asked.scenes is None else asked.scenes)
    rows = [(record, name, [row for row in record.rows if row.scene in wanted][: asked.limit]) for record, name in kept]
    return [each for each in rows if each[2]]
