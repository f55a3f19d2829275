"""Shards on the command line: what one did, and ``merge``, which judges runs and says how far all other shards are."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from benchmark import api
from benchmark.cli.options import (
    CategoriesOption,
    DataOption,
    JsonOption,
    OutOption,
    TablesOption,
    WideOption,
    WorkersOption,
    print_json,
)
from benchmark.cli.what_next import say_next
from benchmark.errors import InputError
from benchmark.report.words import counted

if TYPE_CHECKING:
    from benchmark.runs.kept_shards import Division, FinishedShard
    from benchmark.runs.shards import Shard


def say_shard(
    shard: "Shard", found: "Sequence[FinishedShard]", did: str, step: tuple[str, str], *, json_output: bool
) -> None:
    """Say what a shard did and what is left to do.

    Args:
        shard: Which.
        found: What it did, for each record or data set.
        did: What it did with its scenes: ``driven``, ``scored``, ``searched``, ``drawn``.
        step: The command that comes next, and what it is for.
        json_output: Whether a program reads.
    """
    if json_output:
        print_json([{"directory": str(each.directory), did: each.done, "scenes": each.scenes} for each in found])
    for each in found:
        typer.echo(
            f"{each.directory}: shard {shard}, {each.done} of {counted(each.scenes, 'scene')} {did}", err=json_output
        )
    say_next(f"shard {shard} is {did}", step, json_output=json_output)


def merge_command(
    data: DataOption = "mini",
    out: OutOption = api.OUT,
    tables: TablesOption = None,
    categories: CategoriesOption = None,
    workers: WorkersOption = 0,
    wide: WideOption = False,
    json_output: JsonOption = False,
) -> None:
    """Judge runs that were planned in shards (`eval --shard`), and say what other shards are missing."""
    from benchmark.cli.preflight_data_sets import require_root
    from benchmark.runs.sharded import merge_shards
    from benchmark.runs.shards import sharded_runs
    from leaderboard.tables.collision import run_tables

    space = api.workspace(out)
    root = space.run_root()
    count = api.worker_count(workers)
    require_root(data, tables, out)
    others = unfinished_shards(out)
    if not others and not root.is_dir():
        raise InputError(f"there are no runs at {root}; plan shards first with: challenger-bench eval --shard 1/2")
    for division in others:
        typer.echo(division.sentence(), err=True)
    records = []
    if not others or sharded_runs(root):
        source = api.open_data(data, tables=tables, workers=workers, out=out, categories=categories)
        opener = partial(api.open_split, source, out=out, workers=workers)
        records = list(merge_shards(root, opener, source.name, workers=count, timings=space.timings_of(root)))
    if json_output:
        print_json(
            [
                {"directory": str(each.directory), "status": each.run.status, "samples": len(each.rows)}
                for each in records
            ]
        )
    for table in () if json_output or not records else run_tables(source.name, records, None, allow_partial=True):
        typer.echo(table.plain(wide=wide))
    if any(division.missing for division in others):
        raise typer.Exit(1)


def unfinished_shards(out: Path) -> "list[Division]":
    """Shards that no `merge` but the same command without ``--shard`` finishes.

    Args:
        out: What ``--out`` says.

    Returns:
        How far those of each record and data set are, by path.

    Raises:
        InputError: If notes of shards are damaged.
    """
    from benchmark.runs.kept_shards import DRAWING, DRIVES, SCORES, SEARCH, waiting
    from generation.nuscenes_writer.plan import DRAWING_FOLDER, SEARCH_FOLDER

    space = api.workspace(out)
    return [
        *waiting(space.out / "data", SEARCH, f"*/*/{SEARCH_FOLDER}"),
        *waiting(space.out / "data", DRAWING, f"*/*/{DRAWING_FOLDER}"),
        *waiting(space.drive_root(), DRIVES, "*/*/*/*"),
        *waiting(space.quality_root(), SCORES, "*/*/*"),
    ]
