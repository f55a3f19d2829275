"""What is shown of a whole split: its scenes, its numbers, and what the search for adversaries tried."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from pydantic import BaseModel, ConfigDict, ValidationError

from benchmark.datasets.scene_facts import labels_in
from benchmark.datasets.statistics import statistics
from benchmark.errors import InputError
from benchmark.machine.storage import content_key, read_json_lines, read_kept_json, write_json
from benchmark.records.run_schema import DataFacts
from benchmark.records.scenes import SCHEMA, SPLIT_FILE, AttemptFacts, SplitSheet
from benchmark.sheets.making import KEY_FILE, MAKING_VERSION

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

ATTEMPTS_FILE: Final = "attempts.jsonl"


class _StoredAttempt(BaseModel):
    """What is needed of a row of ``attempts.jsonl``.

    Attributes:
        scene: Recorded scene.
        agent: Instance identifier.
        discard: Why the attempt failed.
        dropped: Why a sound attempt was not used.
        written: Scene that it became.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    scene: str
    agent: str
    discard: str | None = None
    dropped: str | None = None
    written: str | None = None


def write_split_sheet(
    directory: Path, data: "DataSet", split: str, facts: DataFacts, runtime: dict[str, Any] | None
) -> SplitSheet:
    """Describe a split in ``split.json``.

    Args:
        directory: Where.
        data: The data set.
        split: One of its splits.
        facts: Of the data set.
        runtime: Seconds of each stage of generation, if they are known.

    Returns:
        What was written.

    Raises:
        InputError: If there is no such split, a table or ``attempts.jsonl`` is broken, or nothing can be written.
    """
    key = content_key("split sheet", [MAKING_VERSION, SCHEMA], facts.model_dump(mode="json"), split)
    sheet = SplitSheet(
        schema=SCHEMA,
        data=facts,
        split=split,
        scenes=data.scene_names(split),
        statistics=_kept_statistics(directory, key) or _statistics(data, split),
        attempts=_attempts(data, split),
        runtime=runtime,
    )
    write_json(directory / SPLIT_FILE, sheet.model_dump(mode="json", by_alias=True), indent=None)
    write_json(directory / KEY_FILE, {"key": key})
    return sheet


def _statistics(data: "DataSet", split: str) -> dict[str, Any]:
    counted = statistics(data.root, split=split, version=data.version).as_json()
    return {name: value for name, value in counted.items() if name != "root"}


def _kept_statistics(directory: Path, key: str) -> dict[str, Any] | None:
    """Numbers that were counted before; counting the tables of all nuScenes takes minutes."""
    if read_kept_json(directory / KEY_FILE) != {"key": key}:
        return None
    try:
        return SplitSheet.model_validate(read_kept_json(directory / SPLIT_FILE)).statistics
    except ValidationError:
        return None


def _attempts(data: "DataSet", split: str) -> tuple[AttemptFacts, ...]:
    """What the search tried; nothing where the root was not generated for this split."""
    made = data.provenance()
    path = data.root / ATTEMPTS_FILE
    if made is None or made.get("split") != split or not path.is_file():
        return ()
    return tuple(_attempt(row, path, number) for number, row in enumerate(read_json_lines(path), start=1))


def _attempt(row: Any, path: Path, number: int) -> AttemptFacts:
    try:
        stored = _StoredAttempt.model_validate(row)
    except ValidationError as error:
        where = ".".join(map(str, error.errors()[0]["loc"]))
        raise InputError(
            f"{path} line {number} lacks a proper {where or 'object'}; generate the split again"
        ) from error
    named = (found.get("manoeuvre") for found in labels_in(row) if isinstance(found, dict))
    return AttemptFacts(
        source=stored.scene,
        agent=stored.agent,
        scene=stored.written,
        discarded=stored.discard or stored.dropped,
        manoeuvre=next((name for name in named if isinstance(name, str)), None),
    )
