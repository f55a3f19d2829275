"""``models``: every planner and what it needs."""

from dataclasses import dataclass

import typer

from benchmark.cli import options as shared
from benchmark.cli.output import print_json
from benchmark.cli.settings import command


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelsOptions:
    """Options of ``models``."""

    json_output: shared.Json = False


@command(ModelsOptions)
def models_command(options: ModelsOptions) -> None:
    """List every planner with what it sees and needs: weights, GPU, extra packages, and how to get what is missing."""
    from adapters.known_planners import known_planners, planners_text

    planners = known_planners()
    if options.json_output:
        print_json([planner.as_json() for planner in planners])
    else:
        typer.echo(planners_text(planners), nl=False)
