"""Run records: one directory for one planner on one split, from which everything downstream is computed.

``run.json`` says what ran, ``samples.jsonl`` holds one row a sample, ``summary.json`` holds the rates and is derived
from the rows alone. ``run.json`` is written last and names the hashes of the other two: a directory either is a record
or is not.
``timing.json`` beside them is not part of the record: everything else is the same bytes on every run.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from benchmark.errors import InputError
from benchmark.protocols import PROTOCOLS, Outcomes
from benchmark.rates import rates
from benchmark.record_schema import (
    SCHEMA,
    DataFacts,
    OutcomeRow,
    PlannerFacts,
    PlanRow,
    ProtocolSummary,
    RateRow,
    RunFacts,
    SampleRow,
    Summary,
)
from benchmark.storage import file_sha256, read_json, read_json_lines, write_json, write_json_lines

__all__ = [
    "SCHEMA",
    "DataFacts",
    "OutcomeRow",
    "PlanRow",
    "PlannerFacts",
    "ProtocolSummary",
    "RateRow",
    "RunFacts",
    "RunRecord",
    "SampleRow",
    "Summary",
    "find_records",
    "load_record",
    "scene_failures",
    "summarise",
    "write_record",
]

RUN_FILE, ROWS_FILE, SUMMARY_FILE = "run.json", "samples.jsonl", "summary.json"


@dataclass(frozen=True, slots=True)
class RunRecord:
    """A loaded run record.

    Attributes:
        directory: Where it lies.
        run: What ran.
        rows: One for each sample, by scene and time.
        summary: Rates.
    """

    directory: Path
    run: RunFacts
    rows: tuple[SampleRow, ...]
    summary: Summary

    @property
    def planner(self) -> str:
        """Name of the planner."""
        return self.run.planner.name

    @property
    def complete(self) -> bool:
        """Whether every sample has a plan."""
        return self.run.status == "complete"

    @property
    def covers_split(self) -> bool:
        """Whether all scenes of the split ran."""
        return len(self.run.scenes) == self.run.scenes_in_split


def summarise(rows: Sequence[SampleRow], versions: Mapping[str, int], *, seed: int) -> Summary:
    """Rates of every protocol from the rows.

    Args:
        rows: One for each sample.
        versions: Protocols to summarise with the version that judged the rows.
        seed: Seed of the intervals.

    Returns:
        The summary.
    """
    planned = [row for row in rows if row.status == "ok"]
    scenes = [row.scene for row in planned]
    protocols = {}
    for name, version in versions.items():
        outcomes = Outcomes.from_rows([row.outcomes[name].model_dump() for row in planned])
        found = rates(PROTOCOLS[name], outcomes, scenes, seed=seed)
        decided = [failed for failed in scene_failures(rows, name).values() if failed is not None]
        protocols[name] = ProtocolSummary(
            version=version,
            columns={
                column: {horizon: RateRow(**dataclasses.asdict(rate)) for horizon, rate in by_horizon.items()}
                for column, by_horizon in found.items()
            },
            counted=int(outcomes.counted.sum()),
            incomplete=int((~outcomes.counted).sum()),
            scenes_failed=sum(decided),
            scenes_decided=len(decided),
        )
    return Summary(
        schema=SCHEMA,
        samples=len(rows),
        failed=len(rows) - len(planned),
        coverage=len(planned) / len(rows) if rows else 0.0,
        protocols=protocols,
    )


def scene_failures(rows: Sequence[SampleRow], protocol: str) -> dict[str, bool | None]:
    """Which scenes a planner fails: those with a counted sample that collides at any step.

    Args:
        rows: One for each sample.
        protocol: Name of the protocol that judges.

    Returns:
        Scene name to verdict, by name; ``None`` where no verdict is possible: no counted sample, or no contact but the
        planner raised on a sample that could have shown one.
    """
    by_scene: dict[str, list[SampleRow]] = {}
    for row in rows:
        by_scene.setdefault(row.scene, []).append(row)
    return {scene: _fails(by_scene[scene], protocol) for scene in sorted(by_scene)}


def _fails(rows: Sequence[SampleRow], protocol: str) -> bool | None:
    counted = [row.outcomes[protocol] for row in rows if row.status == "ok" and row.outcomes[protocol].counted]
    if any(any(outcome.collision) for outcome in counted):
        return True
    unknown = any(row.status == "failed" and row.complete for row in rows)
    return None if unknown or not counted else False


def write_record(
    directory: Path, facts: Mapping[str, Any], rows: Sequence[SampleRow], versions: Mapping[str, int], *, seed: int
) -> RunRecord:
    """Write a record, ``run.json`` last.

    Args:
        directory: Run directory.
        facts: `RunFacts` less status, protocols, seed and files.
        rows: One for each sample.
        versions: Protocol versions by name.
        seed: Seed of the intervals.

    Returns:
        The record as it reads back.

    Raises:
        InputError: If there are no rows or they cannot be written.
    """
    if not rows:
        raise InputError(f"there are no samples to write to {directory}: the chosen scenes have none")
    summary = summarise(rows, versions, seed=seed)
    write_json_lines(directory / ROWS_FILE, [row.model_dump(mode="json") for row in rows])
    write_json(directory / SUMMARY_FILE, summary.model_dump(mode="json", by_alias=True))
    run = RunFacts(
        schema=SCHEMA,
        status="complete" if summary.failed == 0 else "partial",
        protocols=dict(versions),
        seed=seed,
        files={name: file_sha256(directory / name) for name in (ROWS_FILE, SUMMARY_FILE)},
        **facts,
    )
    write_json(directory / RUN_FILE, run.model_dump(mode="json", by_alias=True))
    return RunRecord(directory, run, tuple(rows), summary)


def load_record(directory: Path) -> RunRecord:
    """Read a record, of this or an earlier schema.

    Args:
        directory: Run directory.

    Returns:
        The record.

    Raises:
        InputError: If a file is absent, damaged, does not belong to the others, or comes from a newer version.
    """
    facts = read_json(directory / RUN_FILE)
    if not isinstance(facts, dict) or type(facts.get("schema")) is not int or not isinstance(facts.get("files"), dict):
        raise InputError(f"{directory / RUN_FILE} is not a run record: it has no schema number or no hashes of files")
    if facts["schema"] > SCHEMA:
        raise InputError(
            f"{directory} has record schema {facts['schema']}, this version reads up to {SCHEMA}; upgrade "
            "challenger-bench"
        )
    if facts["schema"] not in {SCHEMA, *UPGRADES}:
        raise InputError(f"{directory} has record schema {facts['schema']}, which never existed; run eval again")
    raw_rows, raw_summary = read_json_lines(directory / ROWS_FILE), read_json(directory / SUMMARY_FILE)
    for name in (ROWS_FILE, SUMMARY_FILE):
        if file_sha256(directory / name) != facts["files"].get(name):
            raise InputError(
                f"{directory / name} does not belong to the {RUN_FILE} beside it (an interrupted or edited run); run "
                "the same eval command again"
            )
    for schema in range(facts["schema"], SCHEMA):
        facts, raw_rows, raw_summary = UPGRADES[schema](facts, raw_rows, raw_summary)
    try:
        run = RunFacts.model_validate(facts)
        rows = tuple(SampleRow.model_validate(row) for row in raw_rows)
        summary = Summary.model_validate(raw_summary)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"])
        raise InputError(f"{directory} is not a valid run record: {error.title} {place}: {first['msg']}") from error
    return RunRecord(directory, run, rows, summary)


Upgrade = Callable[[dict[str, Any], list[Any], dict[str, Any]], tuple[dict[str, Any], list[Any], dict[str, Any]]]


def _from_schema_1(
    run: dict[str, Any], rows: list[Any], summary: dict[str, Any]
) -> tuple[dict[str, Any], list[Any], dict[str, Any]]:
    """Schema 2 only adds fields, and those have defaults that say "unknown"."""
    return {**run, "schema": 2}, rows, {**summary, "schema": 2}


UPGRADES: dict[int, Upgrade] = {1: _from_schema_1}
"""From a schema to the next one: run, rows and summary in, the same out. Old records load for ever."""


def find_records(root: Path) -> list[RunRecord]:
    """Every record below a folder.

    Args:
        root: Where to look.

    Returns:
        Records by their path.

    Raises:
        InputError: If the folder does not exist or a record in it is damaged.
    """
    if not root.is_dir():
        raise InputError(
            f"there is no folder {root}; run challenger-bench eval first, or name the right one with --out"
        )
    return [load_record(path.parent) for path in sorted(root.rglob(RUN_FILE))]
