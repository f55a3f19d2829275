"""``models``: every planner and what it needs."""

import typer

from benchmark.cli.options import JsonOption, print_json


def models_command(json_output: JsonOption = False) -> None:
    """List every planner with what it sees and needs: weights, GPU, extra packages, and how to get what is missing."""
    from adapters.known_planners import known_planners, planners_text

    planners = known_planners()
    if json_output:
        print_json([planner.as_json() for planner in planners])
    else:
        typer.echo(planners_text(planners), nl=False)
