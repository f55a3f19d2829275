"""What a shard says when it is done."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import typer

from benchmark.cli.options import print_json
from benchmark.cli.what_next import say_next
from benchmark.report.words import counted

if TYPE_CHECKING:
    from benchmark.runs.shards import FinishedShard, Shard


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
