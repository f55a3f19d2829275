"""Published numbers beside those of a run: which there are, how far apart they are, and the verdict on each."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, Literal

from pydantic import Field

from benchmark.errors import InputError, did_you_mean
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine.storage import read_json, write_json
from benchmark.metrics.rates import HORIZONS
from benchmark.planning import Planner
from benchmark.protocols import PROTOCOLS, STANDARD
from benchmark.published import CHECKPOINTS, PLANNING_ALLOWED, VAL_SAMPLES, find_published_results
from benchmark.records.reproduction import ComparedNumber, Reproduction, write_reproduction
from benchmark.records.run import RunRecord
from benchmark.records.store import validate_stored
from benchmark.records.stored import Stored
from benchmark.runs.plan_rows import PlannerFactory

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

PUBLISHED: Final = "the published numbers"
_COLUMNS: Final[tuple[Literal["collision", "l2"], ...]] = ("collision", "l2")
_SCALE: Final = {"collision": 100.0, "l2": 1.0}
_DIGITS: Final = 6
"""Decimals of stored values, per cent and metres."""

Finite = Annotated[float, Field(allow_inf_nan=False)]


class ExpectedValues(Stored):
    """A file of ``--expected``: per cent of ``collision`` and metres of ``l2`` by horizon that a run should give.

    `allowed` is the largest difference, by the same names; `source` says in words where the numbers come from.
    """

    model: str
    protocol: str
    split: str
    source: str
    values: dict[Literal["collision", "l2"], dict[Literal["1s", "2s", "3s", "avg"], Finite]]
    allowed: dict[Literal["collision", "l2"], Annotated[float, Field(ge=0)]]
    samples: int


@dataclass(frozen=True, slots=True)
class _PublishedNumber:
    """One number with where it is printed."""

    column: Literal["collision", "l2", "samples"]
    horizon: str
    values: tuple[tuple[float, str], ...]
    allowed: float


@dataclass(frozen=True, slots=True)
class ExpectedNumbers:
    """Numbers that a run should give, judged by one protocol; ``of`` says in words whose numbers they are."""

    of: str
    protocol: str
    numbers: tuple[_PublishedNumber, ...]


def published_numbers(model: str, protocol: str) -> ExpectedNumbers:
    """The published numbers of a model on the official validation split.

    Args:
        model: Its name.
        protocol: Its own protocol.

    Returns:
        The numbers.

    Raises:
        InputError: If none are known.
    """
    rows = find_published_results(model, protocol)
    if model not in CHECKPOINTS or not rows:
        known = CHECKPOINTS
        raise InputError(
            f"there are no published numbers for {model}; {did_you_mean(model, known)}use one of {', '.join(known)}, "
            "or give your own with --expected FILE"
        )
    numbers = []
    for column in _COLUMNS:
        for place, horizon in enumerate(HORIZONS):
            printed = [(row.values[place], row.source) for row in rows if row.column == column]
            values = tuple((float(text), source) for text, source in printed if text)
            numbers.append(_PublishedNumber(column, horizon, values, PLANNING_ALLOWED[column]))
    counted = (float(VAL_SAMPLES[protocol]), "samples of the nuScenes validation split that the protocol counts")
    return ExpectedNumbers(PUBLISHED, protocol, (*numbers, _PublishedNumber("samples", "", (counted,), 0.0)))


def expected_file(path: Path, model: str, split: str) -> ExpectedNumbers:
    """Numbers that a file names.

    Args:
        path: A file as `store_expected` writes it.
        model: Model to run.
        split: On what.

    Returns:
        The numbers.

    Raises:
        InputError: If it is no such file, or is of another model or split.
    """
    stored = validate_stored(
        ExpectedValues.model_validate,
        read_json(path),
        lambda where, why: (
            f"{path} is not a file of expected values: {where or 'the whole file'}: {why}; "
            "see docs/extensions/reproduce.md"
        ),
    )
    if stored.model != model or stored.split != split:
        raise InputError(
            f"{path} is for {stored.model} on {stored.split}, not for {model} on {split}; name another file"
        )
    if stored.protocol not in PROTOCOLS:
        raise InputError(f"{path} names the unknown protocol {stored.protocol!r}; use one of {', '.join(PROTOCOLS)}")
    missing = sorted(set(stored.values) - set(stored.allowed))
    if missing or not any(stored.values.values()):
        lacks = f"gives no tolerance for {missing[0]}" if missing else "has no values"
        raise InputError(f"{path} {lacks}; add it (docs/extensions/reproduce.md)")
    numbers = [
        _PublishedNumber(column, horizon, ((value, stored.source),), stored.allowed[column])
        for column, by_horizon in stored.values.items()
        for horizon, value in by_horizon.items()
    ]
    return ExpectedNumbers(
        stored.source,
        stored.protocol,
        (*numbers, _PublishedNumber("samples", "", ((stored.samples, stored.source),), 0)),
    )


def reproduce(
    data: "DataSet",
    split: str,
    planner: Planner | PlannerFactory,
    out: Path,
    expected: ExpectedNumbers,
    *,
    workers: int = 1,
    seed: int = 0,
) -> tuple[RunRecord, Reproduction]:
    """Run a planner on a split, compare it with what it should give, and note the verdict beside the record.

    Args:
        data: The data set.
        split: The split of the numbers.
        planner: The planner, or what builds it.
        out: Folder of run directories.
        expected: The numbers (`published_numbers`, `expected_file`).
        workers: Number of processes.
        seed: Seed of the intervals.

    Returns:
        The record, and every number beside ours.

    Raises:
        InputError: As `benchmark.evaluation.evaluate`, or if the planner failed on samples.
    """
    judges = tuple(dict.fromkeys((*STANDARD, expected.protocol)))
    record = evaluate(data, split, planner, out, EvalSettings(judges, workers=workers, seed=seed))
    reproduction = compare_run(record, expected)
    write_reproduction(record.directory, reproduction)
    return record, reproduction


def compare_run(record: RunRecord, expected: ExpectedNumbers) -> Reproduction:
    """A whole run, judged by the protocol of the numbers that it should give, beside them."""
    require_whole_split(record)
    summary = record.summary.protocols[expected.protocol]
    numbers = []
    for number in expected.numbers:
        ours = (
            float(summary.counted) if number.column == "samples" else _find_measured(record, expected.protocol, number)
        )
        values: Sequence[tuple[float, str]] = number.values
        value, source = min(values, key=lambda known: abs(known[0] - (known[0] if ours is None else ours)))
        numbers.append(
            ComparedNumber(
                column=number.column,
                horizon=number.horizon,
                published=value,
                ours=ours,
                allowed=number.allowed,
                source=source,
            )
        )
    run = record.run
    return Reproduction(
        planner=run.planner,
        data=run.data,
        split=run.split,
        protocol=expected.protocol,
        version=summary.version,
        record=record.content_id,
        of=expected.of,
        numbers=numbers,
    )


def require_whole_split(record: RunRecord) -> None:
    """Refuse a run that is not of the whole split or failed on samples: its rates are of something else."""
    if not record.complete:
        raise InputError(
            f"{record.planner} failed on {record.summary.failed} of {record.summary.samples} samples, so no comparison "
            f"is possible; the tracebacks are in {record.directory}"
        )
    if not record.covers_split:
        raise InputError(f"{record.directory} covers part of the split; published numbers are for all of it")


def store_expected(path: Path, record: RunRecord, protocol: str) -> None:
    """Write what a run gave as a file of expected values.

    Args:
        path: The file.
        record: The run.
        protocol: Protocol that scores the plans.

    Raises:
        InputError: If the run is not whole, or the file cannot be written.
    """
    require_whole_split(record)
    summary, run = record.summary.protocols[protocol], record.run
    values = {
        column: {
            horizon: round(_SCALE[column] * rate.value, _DIGITS)
            for horizon, rate in summary.columns[column].items()
            if rate.value is not None
        }
        for column in _COLUMNS
        if column in summary.columns
    }
    write_json(
        path,
        {
            "model": run.planner.name,
            "protocol": protocol,
            "split": run.split,
            "source": f"a run of {run.planner.name} on {run.data.name} (record {record.content_id})",
            "values": values,
            "allowed": {column: PLANNING_ALLOWED[column] for column in values},
            "samples": summary.counted,
        },
    )


def _find_measured(record: RunRecord, protocol: str, number: _PublishedNumber) -> float | None:
    rate = record.summary.protocols[protocol].columns.get(number.column, {}).get(number.horizon)
    return None if rate is None or rate.value is None else _SCALE[number.column] * rate.value
