"""What tables have to say of runs whose plans come from the result files of a repository."""

from collections.abc import Iterable

from benchmark.records.run import RunRecord
from benchmark.records.run_schema import PlansFrom


def file_notes(records: Iterable[RunRecord]) -> list[str]:
    """One sentence for each run whose plans come from a file: how it is known which sample each belongs to."""
    return [
        f"{record.planner} on {record.run.split}: plans from a file ({found.format}), samples {order_words(found)}."
        for record in records
        if (found := record.run.plans_from) is not None
    ]


def order_words(found: PlansFrom) -> str:
    """Words on how the samples of a file are known, to stand behind "samples"."""
    known = "named by the file" if found.order == "tokens" else f"in an order that is {found.order}"
    return f"{known} ({found.shown_by})"
