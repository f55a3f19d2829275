"""Caveats of new records on stderr, each once."""

from collections.abc import Iterable

from benchmark import api
from benchmark.records.run_schema import RecordFacts


def warn_of_caveats(records: Iterable[RecordFacts]) -> None:
    """Print what the numbers of records needed and did not get, each sentence once with the planners it concerns.

    Args:
        records: Facts of run records or of records of drives.
    """
    planners: dict[str, list[str]] = {}
    for facts in records:
        for caveat in facts.caveats:
            planners.setdefault(caveat.sentence, []).append(facts.planner.name)
    for sentence, names in planners.items():
        api.tell(f"warning: {', '.join(dict.fromkeys(names))}: {sentence}")
