"""Run records: one directory for one planner on one split, from which everything downstream is computed.

``run.json`` says what ran, ``samples.jsonl`` holds one row a sample, ``summary.json`` holds the rates and is derived
from the rows alone. ``run.json`` names the hashes of the other two, and the three are replaced together
(`benchmark.records.store`): a directory either is a record or is not.
``timing.json`` beside them is not part of the record: everything else is the same bytes on every run.
"""

import dataclasses
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from benchmark.errors import InputError
from benchmark.machine.storage import content_key
from benchmark.metrics.rates import rates
from benchmark.protocols import PROTOCOLS, STANDARD, Outcomes
from benchmark.protocols import protocol as definition_of
from benchmark.records.driving import summarise_driving
from benchmark.records.row_schema import SampleRow
from benchmark.records.run_schema import SCHEMA, ProtocolSummary, RateRow, RunFacts, SceneFacts, Summary
from benchmark.records.store import ROWS_FILE, RUN_FILE, SUMMARY_FILE, read_each, read_files, replace_files, validated
from benchmark.records.stored import Stored

_Read = TypeVar("_Read", bound=Stored)

NATIVE = "native"
"""What the planner's own protocol is called where a protocol is asked for."""
NO_NATIVE = "exact"
"""Who judges planners that have no protocol of their own."""


@dataclass(frozen=True, slots=True)
class RunRecord:
    """A loaded run record.

    Attributes:
        directory: Where it lies.
        run: What ran.
        rows: One for each sample, by scene and time.
        summary: Rates.
        label: What tells this version of the planner from others (`benchmark.records.planner_versions`), if there
            are others.
        reproduced: Whose numbers this version of the planner gave (`benchmark.records.reproduction`), in words;
            ``None`` where nobody knows.
    """

    directory: Path
    run: RunFacts
    rows: tuple[SampleRow, ...]
    summary: Summary
    label: str | None = None
    reproduced: str | None = None

    @property
    def planner(self) -> str:
        """Name of the planner in tables."""
        return self.label or self.run.planner.name

    @property
    def content_id(self) -> str:
        """Twelve hexadecimal digits made of what ran and what came out, whatever the machine and the folder."""
        run, planner = self.run, self.run.planner
        # Settings are a stranger's: as text they may hold any number.
        settings = json.dumps(planner.settings, sort_keys=True)
        ran = [planner.name, planner.weights_sha256, planner.code_sha256, planner.seed, settings]
        on = [run.data.name, run.data.fingerprint, run.split, run.scenes]
        # As it was before there were reviews, where there is none.
        on += [] if run.review is None else [run.review.content]
        return content_key(ran, on, run.protocols, run.seed, run.files)[:12]

    @property
    def judged_content(self) -> tuple[str, str | None]:
        """What records that stand beside each other share: the data set's fingerprint and the inspectors' verdicts."""
        return self.run.data.fingerprint, None if self.run.review is None else self.run.review.content

    @property
    def complete(self) -> bool:
        """Whether every sample has a plan."""
        return self.run.status == "complete"

    @property
    def covers_split(self) -> bool:
        """Whether all scenes of the split ran."""
        return len(self.run.scenes) == self.run.scenes_in_split

    @property
    def native_protocol(self) -> str:
        """Protocol of the planner's own repository; ``exact`` where it has none."""
        return self.run.planner.native_protocol or NO_NATIVE

    @property
    def stale_protocols(self) -> tuple[str, ...]:
        """Known protocols that judged the rows in another version than the present one."""
        judged = self.run.protocols
        return tuple(name for name in PROTOCOLS if name in judged and judged[name] != PROTOCOLS[name].version)

    @property
    def missing_protocols(self) -> tuple[str, ...]:
        """Protocols that every run is judged by and that never judged the rows."""
        return tuple(name for name in STANDARD if name not in self.run.protocols)


def protocol_of(record: RunRecord, name: str) -> str:
    """The protocol that a name means for a record.

    Args:
        record: The record.
        name: A protocol, or ``native``.

    Returns:
        The name, ``native`` replaced by the record's own.
    """
    return record.native_protocol if name == NATIVE else name


def outcomes_of(rows: Sequence[SampleRow], protocol: str) -> Outcomes:
    """Verdicts of a protocol that judged the rows.

    Args:
        rows: One for each sample.
        protocol: Name of the protocol.

    Returns:
        The verdicts on the samples that have a plan, in their order.
    """
    return Outcomes.from_rows([vars(row.outcomes[protocol]) for row in rows if row.status == "ok"])


def summarise(
    rows: Sequence[SampleRow],
    versions: Mapping[str, int],
    *,
    seed: int,
    scene_facts: Mapping[str, SceneFacts] | None = None,
) -> Summary:
    """Rates of every protocol from the rows.

    Args:
        rows: One for each sample.
        versions: Protocols to summarise with the version that judged the rows.
        seed: Seed of the intervals.
        scene_facts: What each scene was made from: intervals draw recorded scenes with all that was made from them,
            because ten variants of one recording are not ten recordings. Scenes without facts stand for themselves.

    Returns:
        The summary.
    """
    planned = [row for row in rows if row.status == "ok"]
    known = scene_facts or {}
    scenes = [known[row.scene].source if row.scene in known else row.scene for row in planned]
    told = all(row.scene in known and known[row.scene].adversaries is not None for row in planned)
    protocols = {}
    for name, version in versions.items():
        outcomes = outcomes_of(rows, name)
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
            mask_removed_steps=_removed_by_mask(outcomes),
            mask_removed_for_adversary=_removed_by_mask(outcomes, "recorded_adversary") if told else None,
        )
    return Summary(
        schema=SCHEMA,
        samples=len(rows),
        failed=len(rows) - len(planned),
        coverage=len(planned) / len(rows) if rows else 0.0,
        protocols=protocols,
        driving=summarise_driving(planned, scenes, seed=seed),
    )


def _removed_by_mask(outcomes: Outcomes, touching: str = "recorded") -> int | None:
    """Steps that collide before the exclusion and not after it, among those that enter the rates or would without it.

    ``touching`` is the column of what the recorded ego touches there.
    """
    if not {"before_mask", touching} <= set(outcomes.steps):
        return None
    removed = outcomes.steps["before_mask"] & outcomes.steps[touching]
    # Some protocols leave out whole samples.
    enters = outcomes.counted | np.array(outcomes.facts.get("left_out", False), np.bool_)
    return int((removed & outcomes.valid & enters[:, None]).sum())


def scene_failures(rows: Sequence[SampleRow], protocol: str) -> dict[str, bool | None]:
    """Which scenes a planner fails: those with a counted sample that collides at any step.

    Args:
        rows: One for each sample.
        protocol: Name of the protocol that judges.

    Returns:
        Scene name to verdict, by name; ``None`` where no verdict is possible: no counted sample, or no contact but the
        planner raised on a sample that could have shown one.

    Raises:
        InputError: If the protocol is unknown or did not judge the rows.
    """
    counts_incomplete = definition_of(protocol).counts_incomplete
    by_scene: dict[str, list[SampleRow]] = {}
    for row in rows:
        if row.status == "ok" and protocol not in row.outcomes:
            raise InputError(f"scene {row.scene} was not judged by protocol {protocol!r}; run challenger-bench rescore")
        by_scene.setdefault(row.scene, []).append(row)
    return {scene: _fails(by_scene[scene], protocol, counts_incomplete) for scene in sorted(by_scene)}


def _fails(rows: Sequence[SampleRow], protocol: str, counts_incomplete: bool) -> bool | None:
    counted = [row.outcomes[protocol] for row in rows if row.status == "ok" and row.outcomes[protocol].counted]
    if any(any(outcome.collision) for outcome in counted):
        return True
    unknown = any(
        row.status == "failed" and (row.complete or (counts_incomplete and any(row.recorded_future))) for row in rows
    )
    return None if unknown or not counted else False


def write_record(
    directory: Path, facts: Mapping[str, Any], rows: Sequence[SampleRow], versions: Mapping[str, int], *, seed: int
) -> RunRecord:
    """Write a record in place of the one that is there, if any.

    Args:
        directory: Run directory; nobody else may write to it (`benchmark.machine.storage.only_writer`).
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
    summary = summarise(rows, versions, seed=seed, scene_facts=facts.get("scene_facts"))
    run = RunFacts(
        schema=SCHEMA,
        status="complete" if summary.failed == 0 else "partial",
        protocols=dict(versions),
        seed=seed,
        files={},
        **facts,
    )

    def run_naming(files: dict[str, str]) -> dict[str, Any]:
        return {**run.model_dump(mode="json", by_alias=True), "files": files}

    written = replace_files(
        directory,
        run_naming,
        [row.model_dump(mode="json") for row in rows],
        summary.model_dump(mode="json", by_alias=True),
    )
    return RunRecord(directory, run.model_copy(update={"files": written}), tuple(rows), summary)


def load_record(directory: Path) -> RunRecord:
    """Read a record, of this or an earlier schema, judged by present or earlier protocols.

    Args:
        directory: Run directory.

    Returns:
        The record.

    Raises:
        InputError: If a file is absent, damaged, does not belong to the others, or comes from a newer version.
    """

    def read(model: type[_Read], file: str, stored: Any) -> _Read:
        return validated(
            model.model_validate,
            stored,
            lambda where, why: f"{directory / file} is not that of a valid run record: {where or 'the whole'}: {why}",
        )

    raw_run, raw_rows, raw_summary = read_files(directory)
    run = read(RunFacts, RUN_FILE, raw_run)
    rows = tuple(read(SampleRow, ROWS_FILE, row) for row in raw_rows)
    if list(dict.fromkeys(row.scene for row in rows)) != run.scenes:
        raise InputError(f"{directory / RUN_FILE} names other scenes than {ROWS_FILE} has rows of")
    return RunRecord(directory, run, rows, read(Summary, SUMMARY_FILE, raw_summary))


def find_records(*roots: Path) -> list[RunRecord]:
    """Every record below folders, each once.

    Args:
        roots: Where to look.

    Returns:
        Records by the order of the folders, then by their path.

    Raises:
        InputError: If a folder does not exist or a record in it is damaged.
    """
    found: dict[Path, RunRecord] = {}
    for root in roots:
        if not root.is_dir():
            raise InputError(
                f"there is no folder {root}; run challenger-bench eval first, or name the right one with --out"
            )
        places = (path.parent for path in sorted(root.rglob(RUN_FILE)))
        for record in read_each(places, load_record, instead=" to do without this record"):
            found[record.directory.resolve()] = record
    return list(found.values())
