"""``demo``: the whole story on the embedded data."""

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.demonstration import RESULTS, demo, full_demo, stale_demo
from benchmark.cli.output import print_json, print_result, same_out, say_next
from benchmark.cli.settings import Option, command
from benchmark.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class DemoOptions:
    """Options of ``demo``."""

    out: shared.Out = api.OUT
    town_scenes: Annotated[int, Option("Scenes of the embedded town.", min=1)] = 4
    full: Annotated[bool, Option("All splits of mini, all built-in planners, the ablation; write --to.", "Output")] = (
        False
    )
    check: Annotated[bool, Option("With --full: only say whether --to is current.", "Output")] = False
    to: Annotated[Path, Option("With --full: folder of the page and its numbers.", "Output")] = RESULTS
    workers: shared.Workers = 0
    wide: shared.Wide = False
    json_output: shared.Json = False


@command(DemoOptions)
def demo_command(options: DemoOptions) -> None:
    """Tell the whole story on the embedded data: generate, evaluate, transfer, tables, site."""
    from benchmark.machine.places import require_place, require_room

    if options.check and not options.full:
        raise InputError("--check belongs to demo --full, whose results it looks at")
    if options.check:
        stale = stale_demo(options.to)
        said = "\n".join(stale) or f"{options.to} is current"
        print_result({"stale": stale}, said, json_output=options.json_output)
        raise typer.Exit(1 if stale else 0)
    api.worker_count(options.workers)
    require_place(options.out, "--out")
    require_room(options.out, api.town_bytes(2 * options.town_scenes, frames="keyframes"), "the demo", "--out")
    if options.full:
        files = [str(path) for path in full_demo(options.out, options.to, workers=options.workers)]
        print_result({"files": files}, "\n".join(files), json_output=options.json_output)
        return
    from leaderboard.frame.runs import Frame
    from leaderboard.tables.collision import run_tables
    from leaderboard.tables.effect import effect_table
    from leaderboard.tables.transfer import transfer_matrices, transfer_table

    tell = partial(typer.echo, err=options.json_output)
    report, records = demo(options.out, town_scenes=options.town_scenes, workers=options.workers, say=tell)
    if options.json_output:
        print_json({"leaderboard": str(options.out / "leaderboard"), "generated": report.as_json()})
        return
    tell("")
    caused = effect_table(Frame("demo", records))
    for table in (*(() if caused is None else (caused,)), *run_tables("demo", records, ("exact",), allow_partial=True)):
        tell(table.plain(wide=options.wide))
    for name, matrix in transfer_matrices(records, "adv").items():
        tell(transfer_table(name, matrix).plain(wide=options.wide))
    leaderboard = options.out / "leaderboard"
    tell(f"site: {leaderboard / 'site' / 'index.html'}   tables: {leaderboard / 'README.md'}")
    again = f" --data demo{same_out(options.out)}"
    say_next(
        f"scenes: {options.out / 'data' / 'demo' / 'adv'}",
        (f"film --limit 1 --model uniad --model idm --to films{again}", "a scene as a film"),
        (f"eval --split adv --model my_package.planner:MyPlanner{again}", "your own planner: docs/planners.md"),
        json_output=options.json_output,
    )
