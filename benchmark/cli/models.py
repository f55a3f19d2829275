"""``models``: every planner and what it needs."""

from dataclasses import dataclass

from benchmark.cli import options as shared
from benchmark.cli.output import print_result
from benchmark.cli.settings import command


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelsOptions:
    """Options of ``models``."""

    json_output: shared.Json = False


@command(ModelsOptions, panel="Run")
def models_command(options: ModelsOptions) -> None:
    """List every planner with what it sees and needs: weights, GPU, extra packages, and how to get what is missing."""
    from adapters.planner_listing import known_planners, planners_text

    planners = known_planners()
    planners_json = [planner.as_json() for planner in planners]
    print_result(planners_json, planners_text(planners), json_output=options.json_output)
