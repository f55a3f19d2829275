"""Which planner of this program a record's planner is, by the hash of its code: what a submission cannot make up."""

from functools import cache

from adapters.models import MODELS, baselines
from adapters.registry import planner_factory
from benchmark.records.run_schema import PlannerFacts


def own_planner_like(planner: PlannerFacts) -> PlannerFacts | None:
    """The planner of this program that one is.

    Args:
        planner: What a record says of its planner.

    Returns:
        What is true of the one that has its code, whatever it is called; else of the one that it is called like; else
        ``None``. Networks are looked at only if they are named and their weights come with this package.
    """
    model = MODELS.get(planner.name)
    called = None
    if model is not None and (model.network is None or model.packaged.is_file()):
        called = _facts(planner.name)
    if planner.code_sha256 is None or (called is not None and called.code_sha256 == planner.code_sha256):
        return called
    same_code = (facts for facts in map(_facts, baselines()) if facts.code_sha256 == planner.code_sha256)
    return next(same_code, called)


@cache
def _facts(name: str) -> PlannerFacts:
    return planner_factory(name).facts
