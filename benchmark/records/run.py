"""Run records: one directory for one planner on one split, from which everything downstream is computed.

``run.json`` says what ran, ``samples.jsonl`` holds one row a sample, ``summary.json`` holds the rates and is derived
from the rows alone. ``run.json`` names the hashes of the other two, and the three are replaced together
(`benchmark.records.store`): a directory either is a record or is not.
Every run gives the same bytes; how long it took is noted elsewhere (``<out>/timings``).
"""

import contextlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from pydantic import ValidationError

from benchmark.errors import InputError
from benchmark.machine.storage import content_key, read_json, write_json
from benchmark.metrics.rates import rates
from benchmark.protocols import PROTOCOLS, STANDARD, ProtocolOutcomes, counts_at_all_horizons
from benchmark.records.driving import summarise_score_columns
from benchmark.records.planner_cost import PlannerCost
from benchmark.records.row_schema import SampleRow
from benchmark.records.rows import (
    SampleRows,
    cache_in_parallel,
    cache_rows,
    find_scene_failures,
    get_columns,
    read_cached_rows,
)
from benchmark.records.run_schema import SCHEMA, ProtocolSummary, RunFacts, RunSummary, SceneFacts, find_source
from benchmark.records.store import (
    ROWS_FILE,
    RUN_FILE,
    SUMMARY_FILE,
    read_files,
    read_records,
    replace_files,
    require_matching_hashes,
    stored_head,
    validate_stored,
)
from benchmark.records.stored import Stored
from benchmark.report.terminal import html_table, percent
from benchmark.report.words import pluralise
from benchmark.untrusted.files import RECORD
from benchmark.untrusted.text_files import is_plain, parse_line

if TYPE_CHECKING:
    from benchmark.records.columns import RowColumns

_Read = TypeVar("_Read", bound=Stored)

NATIVE = "native"
"""Name of the planner's own protocol in ``--protocol``."""
NO_NATIVE = "exact"
"""Protocol for planners without a protocol of their own."""
_CONTENT_ID = "content id"


@dataclass(frozen=True, slots=True)
class RunRecord:
    """A loaded run record.

    Attributes:
        directory: Where it lies.
        run: What ran.
        rows: One for each sample, by scene and time; kept compressed, so that going through them takes time
            (`columns` does not).
        summary: Rates.
        label: Words that tell this version of the planner from others (`benchmark.records.planner_versions`), if there
            are others.
        reproduced: Whose numbers this version of the planner gave (`benchmark.records.reproduction`), in words;
            ``None`` where that is not known.
        cost: Cost of planning (`benchmark.records.planner_cost`); no part of what makes two records equal.
    """

    directory: Path
    run: RunFacts
    rows: Sequence[SampleRow]
    summary: RunSummary
    label: str | None = None
    reproduced: str | None = None
    cost: PlannerCost | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        """Keep the rows compressed, also where they are given as a list."""
        object.__setattr__(self, "rows", SampleRows.of(self.rows))

    def __repr__(self) -> str:
        return f"<RunRecord: {self._what}>"

    def _repr_html_(self) -> str:
        rates = {name: protocol.columns["collision"] for name, protocol in self.summary.protocols.items()}
        horizons = list(dict.fromkeys(horizon for rates_by_horizon in rates.values() for horizon in rates_by_horizon))
        rows = [
            (
                name,
                *(percent(rates_by_horizon[column].value) if column in rates_by_horizon else "" for column in horizons),
            )
            for name, rates_by_horizon in rates.items()
        ]
        return html_table(f"{self._what}: collisions", ("protocol", *horizons), rows)

    @property
    def _what(self) -> str:
        run, summary = self.run, self.summary
        failed = f", {pluralise(summary.failed, 'failed sample')}" if summary.failed else ""
        return f"{self.planner} on {run.data.name} {run.split}, {pluralise(summary.samples, 'sample')}{failed}"

    @property
    def planner(self) -> str:
        """Name of the planner in tables."""
        return self.label or self.run.planner.name

    @property
    def columns(self) -> "RowColumns":
        """Columns of the rows, which tables read."""
        return get_columns(self.rows)

    def rows_of(self, scene: str) -> list[SampleRow]:
        """Rows of one scene."""
        return SampleRows.of(self.rows).of_scene(scene)

    @property
    def content_id(self) -> str:
        """Twelve hexadecimal digits made of the facts and the results, the same on any machine and in any folder."""
        kept = self.columns.kept
        # Tables read it for every number.
        if (known := kept.get(_CONTENT_ID)) is None or known[0] is not self.run:
            known = kept[_CONTENT_ID] = self.run, self._content_id()
        return str(known[1])

    def _content_id(self) -> str:
        run, planner = self.run, self.run.planner
        # Settings are third-party data: as JSON text they may hold any number.
        settings = json.dumps(planner.settings, sort_keys=True)
        ran = [planner.name, planner.weights_sha256, planner.code_sha256, planner.seed, settings]
        on = [run.data.name, run.data.fingerprint, run.split, run.scenes]
        # Without a review the identifier is that of versions before reviews existed.
        on += [] if run.review is None else [run.review.content]
        return content_key(ran, on, run.protocols, run.seed, run.files)[:12]

    @property
    def judged_content(self) -> tuple[str, str | None]:
        """The data set's fingerprint and the inspectors' verdicts, which records that stand beside each other share."""
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


def resolve_protocol(record: RunRecord, name: str) -> str:
    """Name of a protocol, ``native`` replaced by the record's own."""
    return record.native_protocol if name == NATIVE else name


def collect_outcomes(rows: Sequence[SampleRow], protocol: str) -> ProtocolOutcomes:
    """Verdicts of a protocol that judged the rows, on the samples that have a plan, in their order."""
    return get_columns(rows).outcomes(protocol)


def summarise_rows(
    rows: Sequence[SampleRow],
    versions: Mapping[str, int],
    *,
    seed: int,
    scene_facts: Mapping[str, SceneFacts] | None = None,
) -> RunSummary:
    """Rates of every protocol from the rows; ``versions`` of the protocols are those that judged them.

    Intervals draw recorded scenes with all that was made from them (``scene_facts``), because ten variants of one
    recording are not ten recordings. Scenes without facts stand for themselves.
    """
    columns = get_columns(rows)
    planned, known = columns.planned_scenes, scene_facts or {}
    scenes = [find_source(scene, known) for scene in planned]
    driven = [scene for scene, scored in zip(scenes, columns.flags("driven")[columns.planned].tolist()) if scored]
    adversaries_known = all(scene in known and known[scene].adversaries is not None for scene in set(planned))
    protocols = {}
    for name, version in versions.items():
        outcomes = columns.outcomes(name)
        rates_of_columns = rates(PROTOCOLS[name], outcomes, scenes, seed=seed)
        decided = [failed for failed in find_scene_failures(columns, name).values() if failed is not None]
        protocols[name] = ProtocolSummary(
            version=version,
            columns=rates_of_columns,
            counted=(counted := int(counts_at_all_horizons(PROTOCOLS[name], outcomes).sum())),
            incomplete=len(outcomes) - counted,
            scenes_failed=sum(decided),
            scenes_decided=len(decided),
            mask_removed_steps=_removed_by_mask(outcomes),
            mask_removed_for_adversary=_removed_by_mask(outcomes, "recorded_adversary") if adversaries_known else None,
        )
    return RunSummary(
        schema=SCHEMA,
        samples=len(rows),
        failed=len(rows) - len(planned),
        coverage=len(planned) / len(rows) if rows else 0.0,
        protocols=protocols,
        driving=None
        if columns.driving is None
        else summarise_score_columns(columns.driving, driven, len(planned), seed=seed),
    )


def _removed_by_mask(outcomes: ProtocolOutcomes, touching: str = "recorded") -> int | None:
    """Steps that collide before the exclusion and not after it, among those that enter the rates or would without it.

    ``touching`` is the column of what the recorded ego touches there.
    """
    if not {"before_mask", touching} <= set(outcomes.steps):
        return None
    removed = outcomes.steps["before_mask"] & outcomes.steps[touching]
    # Some protocols leave out whole samples.
    enters = outcomes.counted | np.array(outcomes.facts.get("left_out", False), np.bool_)
    if outcomes.known is not None:
        if not outcomes.known.any():
            return None
        enters = enters & outcomes.known
    return int((removed & outcomes.valid & enters[:, None]).sum())


def write_record(
    directory: Path, facts: Mapping[str, Any], rows: Sequence[SampleRow], versions: Mapping[str, int], *, seed: int
) -> RunRecord:
    """Write a record in place of the one that is there, if any, and read it back.

    No other process may write to the run directory (`benchmark.machine.storage.lock_folder`). ``facts`` are `RunFacts`
    less status, protocols, seed and files.
    """
    if not rows:
        raise InputError(f"no samples to write to {directory}: the selected scenes have none; choose other scenes")
    rows = SampleRows.of(rows)
    summary = summarise_rows(rows, versions, seed=seed, scene_facts=facts.get("scene_facts"))
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
        "".join(f"{line}\n" for line in rows.lines()).encode(),
        summary.model_dump(mode="json", by_alias=True),
    )
    # Later readers of the record, above all the leaderboard, need not parse the rows again.
    rows = cache_rows(directory / ROWS_FILE, written[ROWS_FILE], rows)
    return RunRecord(directory, run.model_copy(update={"files": written}), rows, summary)


def with_facts(record: RunRecord, **facts: Any) -> RunRecord:
    """Write other facts, fields of `RunFacts`, of a record; its rows and its summary stay.

    No other process may write to its directory (`benchmark.machine.storage.lock_folder`).
    """
    run = record.run.model_copy(update=facts)
    if run != record.run:
        write_json(record.directory / RUN_FILE, run.model_dump(mode="json", by_alias=True))
    return replace(record, run=run)


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
        return validate_stored(model.model_validate, stored, partial(_format_damage, directory / file))

    head = stored_head(directory)
    if head["schema"] == SCHEMA:
        cached = read_cached_rows(directory / ROWS_FILE, str(head["files"].get(ROWS_FILE)))
        rows = SampleRows.read(directory / ROWS_FILE, partial(_rows, directory, head)) if cached is None else cached
        raw_run, raw_summary = head, read_json(directory / SUMMARY_FILE, RECORD)
        require_matching_hashes(directory, head, known=() if cached is None else (ROWS_FILE,))
    else:
        raw_run, raw_rows, raw_summary = read_files(directory)
        cached = rows = SampleRows.of([read(SampleRow, ROWS_FILE, row) for row in raw_rows])
    run = read(RunFacts, RUN_FILE, raw_run)
    if list(rows.columns.places_of_scenes) != run.scenes:
        raise InputError(f"{directory / RUN_FILE} lists other scenes than {ROWS_FILE}")
    summary = read(RunSummary, SUMMARY_FILE, raw_summary)
    if cached is None:
        rows = cache_rows(directory / ROWS_FILE, run.files[ROWS_FILE], rows)
    return RunRecord(directory, run, rows, summary)


def _rows(directory: Path, head: dict[str, Any], lines: Sequence[tuple[int, str]]) -> list[SampleRow]:
    """Lines of ``samples.jsonl``, by the faster parser where they are sure to be sound."""
    # One check of all lines together covers each line.
    plain = is_plain("\n".join(line for _, line in lines).encode(), RECORD)
    return [_row(directory, head, number, line, plain=plain) for number, line in lines]


def _row(directory: Path, head: dict[str, Any], number: int, line: str, *, plain: bool) -> SampleRow:
    if plain or is_plain(line.encode(), RECORD):
        try:
            return SampleRow.model_validate_json(line)
        except ValidationError:
            # The slower path reports errors in its own words and order.
            pass
    path = directory / ROWS_FILE
    value = parse_line(path, number, line, RECORD)
    require_matching_hashes(directory, head)
    validate_stored(RunFacts.model_validate, head, partial(_format_damage, directory / RUN_FILE))
    return validate_stored(SampleRow.model_validate, value, partial(_format_damage, path))


def _format_damage(path: Path, where: str, why: str) -> str:
    return f"{path} is not part of a valid run record: {where or 'the whole'}: {why}"


def _named_rows(directory: Path) -> tuple[Path, str] | None:
    """Path of a record's rows and the hash that it names, if its schema is the present one."""
    with contextlib.suppress(InputError):
        head = stored_head(directory)
        if head["schema"] == SCHEMA:
            return directory / ROWS_FILE, str(head["files"].get(ROWS_FILE))
    return None


def find_records(*roots: Path) -> list[RunRecord]:
    """Every record below folders, each once.

    Args:
        roots: Where to look.

    Returns:
        Records by the order of the folders, then by their path.

    Raises:
        InputError: If a folder does not exist or a record in it is damaged.
    """
    records: dict[Path, RunRecord] = {}
    for root in roots:
        if not root.is_dir():
            raise InputError(
                f"{root} does not exist; run challenger-bench eval first, or give the right folder with --out"
            )
        places = [path.parent for path in sorted(root.rglob(RUN_FILE))]
        cache_in_parallel(dict(filter(None, map(_named_rows, places))), load_record)
        for record in read_records(places, load_record, instead=" to do without this record"):
            records[record.directory.resolve()] = record
    return list(records.values())
