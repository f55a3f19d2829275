"""Command that films scenes and drives: ``film``."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final

import typer

from benchmark import api
from benchmark.cli.extensions import Groups
from benchmark.cli.options import (
    DataOption,
    FilmFormatName,
    FilmFormatOption,
    FilmLayoutName,
    FilmLayoutOption,
    JsonOption,
    LimitOption,
    OutOption,
    RecordsOption,
    ScenesOption,
    SplitOption,
    TablesOption,
    name_list,
    print_json,
)
from benchmark.cli.what_next import same_place, say_next

if TYPE_CHECKING:
    from benchmark.report.lettering import Picture

_HELP: Final = (
    "Film scenes from their sheets, or drives: cameras, view from above, plans and verdicts (docs/extensions/films.md)."
)


def film_command(
    to: Annotated[Path, typer.Option(help="Folder to write to.")],
    scenes: ScenesOption = None,
    limit: LimitOption = None,
    model: Annotated[
        list[str] | None, typer.Option("--model", metavar="<str>", help="Planner to show; may be repeated.")
    ] = None,
    data: DataOption = "mini",
    split: SplitOption = "adv",
    out: OutOption = api.OUT,
    records: RecordsOption = None,
    layout: FilmLayoutOption = FilmLayoutName.BOTH,
    form: FilmFormatOption = FilmFormatName.WEBM,
    begin_s: Annotated[float, typer.Option("--from", help="First moment, seconds.")] = 0.0,
    end_s: Annotated[float | None, typer.Option("--until", help="Last moment, seconds.")] = None,
    fps: Annotated[
        float | None,
        typer.Option(help="Frames a second, 12 of scenes and 10 of drives; the film is as fast as the scene."),
    ] = None,
    width: Annotated[int, typer.Option(help="Width of the frames in pixels, which are 16:9.")] = 1280,
    extent: Annotated[float, typer.Option(help="Half the width of what is seen from above, metres.")] = 24.0,
    north_up: Annotated[bool, typer.Option("--north-up", help="North points up, not the ego's heading.")] = False,
    candidates: Annotated[bool, typer.Option(help="Whether to draw what the search chose from.")] = True,
    protocol: Annotated[str, typer.Option(help="Whose verdicts are shown; native: of each planner's own.")] = "exact",
    drives: Annotated[
        bool, typer.Option("--drives", help="Film drives in closed loop, of all planners unless --model names some.")
    ] = False,
    tables: TablesOption = None,
    json_output: JsonOption = False,
) -> None:
    """Film scenes from their sheets, or drives."""
    from benchmark.cli.preflight_names import planners_shown
    from benchmark.cli.preflight_places import require_folder, require_place
    from benchmark.constants import FRAME_HZ
    from benchmark.machine.progress import Count, progress
    from benchmark.protocols import protocol as known_protocol
    from leaderboard.extensions.films.drive_film import DRIVE_FPS
    from leaderboard.extensions.films.film import FilmLayout, FilmSettings
    from leaderboard.extensions.films.filming import FilmFormat, planner_folder, write_films

    judge = protocol if protocol == "native" else known_protocol(protocol).name
    shown, space = FilmLayout(layout.value), api.workspace(out)
    for place in records or ():
        require_folder(place, "--records")
    require_place(to, "--to")
    frame_rate = (DRIVE_FPS if drives else float(FRAME_HZ)) if fps is None else fps
    settings = FilmSettings(shown, judge, begin_s, end_s, frame_rate, width, extent, not north_up, candidates)

    def watch(frames: "Iterable[Picture]", total: int, label: str) -> "Iterable[Picture]":
        return progress(frames, total=total, label=label, count=Count("frame"))

    if drives:
        written = api.write_drive_films(
            split,
            to,
            model or (),
            data=data,
            out=out,
            tables=tables,
            records=records,
            scenes=name_list(scenes),
            limit=limit,
            form=form.value,
            settings=settings,
            watch=watch,
        )
    else:
        runs = space.run_root()
        written = write_films(
            space.sheet_root(),
            records or runs,
            data,
            split,
            to,
            planners_shown(model or (), records or [planner_folder(runs, data, split)], runs),
            scenes=name_list(scenes),
            limit=limit,
            form=FilmFormat(form.value),
            settings=settings,
            watch=watch,
        )
    films = []
    for film in written:
        films.append(str(film))
        typer.echo(films[-1], err=json_output)
    if json_output:
        print_json({"films": films})
    say_next(
        f"films: {to}",
        (f"leaderboard{same_place('mini', out)}", "a site that plays all scenes"),
        json_output=json_output,
    )


def add_commands(groups: Groups) -> None:
    """``film``."""
    groups[""].command("film", help=_HELP)(film_command)
