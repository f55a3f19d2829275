"""What is shown of a whole split: its scenes, its numbers, and what the search for adversaries tried."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from benchmark.datasets.statistics import statistics
from benchmark.machine.storage import content_key, write_json
from benchmark.records.attempts import ATTEMPTS_FILE, read_attempts
from benchmark.records.run_schema import DataFacts
from benchmark.records.scenes import SCHEMA, SPLIT_FILE, AttemptFacts, SplitSheet
from benchmark.records.statistics import Runtime, SplitStatistics
from benchmark.runs.units import ResultStore
from benchmark.scene_pages.making import KEY, MAKING_VERSION

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


def write_split_sheet(
    directory: Path,
    data: "DataSet",
    split: str,
    facts: DataFacts,
    runtime: Runtime | None,
    hyper: Mapping[str, Any] | None = None,
) -> SplitSheet:
    """Describe a split in ``split.json``.

    Args:
        hyper: Settings of the search, if they are known.
    """
    review = data.review(split).facts
    reviewed = [] if review is None else [review.content]
    key = content_key("split sheet", [MAKING_VERSION, SCHEMA], facts.model_dump(mode="json"), split, *reviewed)
    store: ResultStore[SplitStatistics] = ResultStore(directory, SplitStatistics)
    sheet = SplitSheet(
        schema=SCHEMA,
        data=facts,
        split=split,
        scenes=data.scene_names(split),
        # Counting the tables of all nuScenes takes minutes.
        statistics=store.get(key, KEY) or statistics(data.root, split=split, version=data.version),
        attempts=_attempts(data, split),
        runtime=runtime,
        review=review,
        hyper=dict(hyper or {}),
    )
    write_json(directory / SPLIT_FILE, sheet.model_dump(mode="json", by_alias=True), indent=None)
    store.put(key, sheet.statistics, KEY)
    return sheet


def _attempts(data: "DataSet", split: str) -> tuple[AttemptFacts, ...]:
    """Attempts of the search; none where the root was not generated for this split."""
    made = data.provenance()
    path = data.root / ATTEMPTS_FILE
    if made is None or made.get("split") != split or not path.is_file():
        return ()
    return tuple(AttemptFacts.of(attempt) for attempt in read_attempts(path))
