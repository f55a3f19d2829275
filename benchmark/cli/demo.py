"""``demo``: the whole story on the embedded data."""

from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from benchmark import api
from benchmark.cli.demonstration import RESULTS, demo, full_demo, stale_demo
from benchmark.cli.options import JsonOption, OutOption, WideOption, WorkersOption, print_json
from benchmark.cli.what_next import same_place, say_next
from benchmark.errors import InputError


def demo_command(
    out: OutOption = api.OUT,
    town_scenes: Annotated[int, typer.Option(min=1, help="Scenes of the embedded town.")] = 4,
    full: Annotated[
        bool, typer.Option("--full", help="All splits of mini, all built-in planners, the ablation; write --to.")
    ] = False,
    check: Annotated[bool, typer.Option("--check", help="With --full: only say whether --to is current.")] = False,
    to: Annotated[Path, typer.Option(help="With --full: folder of the page and its numbers.")] = RESULTS,
    workers: WorkersOption = 0,
    wide: WideOption = False,
    json_output: JsonOption = False,
) -> None:
    """Tell the whole story on the embedded data: generate, evaluate, transfer, tables, site."""
    from benchmark.cli.preflight_data_sets import town_bytes
    from benchmark.cli.preflight_places import require_place, require_room

    if check and not full:
        raise InputError("--check belongs to demo --full, whose results it looks at")
    if check:
        stale = stale_demo(to)
        print_json({"stale": stale}) if json_output else typer.echo("\n".join(stale) or f"{to} is current")
        raise typer.Exit(1 if stale else 0)
    api.worker_count(workers)
    require_place(out, "--out")
    require_room(out, town_bytes(2 * town_scenes, frames="keyframes"), "the demo", "--out")
    if full:
        files = [str(path) for path in full_demo(out, to, workers=workers)]
        print_json({"files": files}) if json_output else typer.echo("\n".join(files))
        return
    from leaderboard.frame.runs import Frame
    from leaderboard.tables.collision import run_tables
    from leaderboard.tables.effect import effect_table
    from leaderboard.tables.transfer import transfer_matrices, transfer_table

    tell = partial(typer.echo, err=json_output)
    report, records = demo(out, town_scenes=town_scenes, workers=workers, say=tell)
    if json_output:
        print_json({"leaderboard": str(out / "leaderboard"), "generated": report.as_json()})
        return
    tell("")
    caused = effect_table(Frame("demo", records))
    for table in (*(() if caused is None else (caused,)), *run_tables("demo", records, ("exact",), allow_partial=True)):
        tell(table.plain(wide=wide))
    for name, matrix in transfer_matrices(records, "adv").items():
        tell(transfer_table(name, matrix).plain(wide=wide))
    tell(f"site: {out / 'leaderboard' / 'site' / 'index.html'}   tables: {out / 'leaderboard' / 'README.md'}")
    again = same_place("demo", out)
    say_next(
        f"scenes: {out / 'data' / 'demo' / 'adv'}",
        (f"film --limit 1 --model uniad --model idm --to films{again}", "a scene as a film"),
        (f"eval --split adv --model my_package.planner:MyPlanner{again}", "your own planner: docs/planners.md"),
        json_output=json_output,
    )
