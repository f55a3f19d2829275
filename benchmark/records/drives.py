"""Records of drives: one directory for one planner, one split and what was measured, NeuroNCAP's table included.

``drive.json`` says what ran, ``drives.jsonl`` holds one row a drive, ``summary.json`` what the rows say together. They
are replaced together (`benchmark.records.store`); everything is the same bytes on every run.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal, TypeVar

import numpy as np

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import content_key, read_json
from benchmark.metrics.rates import Rate, compute_ratios_over_scenes
from benchmark.records.drive_schema import (
    SCHEMA,
    ClosedLoopDefinition,
    DriveFacts,
    DriveSummary,
    EpisodeRow,
    PublishedTable,
)
from benchmark.records.fault import FaultVerdict, blames_ego
from benchmark.records.neuroncap_aggregate import Metrics, NeuroncapSwitches, aggregate_runs
from benchmark.records.planner_cost import PlannerCost
from benchmark.records.run_schema import SceneFacts, find_source
from benchmark.records.store import (
    DRIVE_FILE,
    RecordFileNames,
    read_records,
    read_rows_and_summary,
    replace_files,
    validate_stored,
)
from benchmark.records.stored import Stored
from benchmark.report.terminal import html_table
from benchmark.report.words import pluralise
from benchmark.untrusted.files import RECORD

ENGINE: Final = "neuroncap@code"
"""The published code rounds; `neuroncap@paper` does not, and has no such table."""
_SCORE, _COLLISION = "ncap_score", "any_collide@0.0s"
"""Names of the published files."""


def compute_published_table(engine: str, rows: Sequence[EpisodeRow]) -> PublishedTable | None:
    """NeuroNCAP's published table of drives in its engine; ``None`` of other engines and without scenarios."""
    if engine != ENGINE or not rows or not all(row.family for row in rows):
        return None
    runs: dict[str, dict[str, dict[str, Metrics | None]]] = {}
    for row in rows:
        runs.setdefault(row.family, {}).setdefault(row.scene, {})[f"run_{row.run}"] = _metrics(row)
    aggregate = aggregate_runs(runs, NeuroncapSwitches.named(engine))
    return PublishedTable(
        nns=_read_metric(aggregate.overall, _SCORE),
        collision=_read_metric(aggregate.overall, _COLLISION),
        nns_by_family={
            family: _read_metric(family_metrics, _SCORE) for family, family_metrics in aggregate.per_type.items()
        },
        collision_by_family={
            family: _read_metric(family_metrics, _COLLISION) for family, family_metrics in aggregate.per_type.items()
        },
    )


def _metrics(row: EpisodeRow) -> Metrics | None:
    """Metrics of a run in the published code; a failed run left none, and without labels there are none."""
    if row.scores is None or row.scores.neuroncap is None or row.unlabelled:
        return None
    score = row.scores.neuroncap.score
    return {_SCORE: float("nan") if score is None else score, _COLLISION: row.contact is not None}


def _read_metric(level: dict[str, float], name: str) -> float | None:
    value = level.get(name, float("nan"))
    return None if np.isnan(value) else value


ROWS_FILE, SUMMARY_FILE = "drives.jsonl", "summary.json"
DRIVE_FILES: Final = RecordFileNames(DRIVE_FILE, ROWS_FILE, SUMMARY_FILE)
NNS, COLLISION_RATE = "nns", "collision"
ATTRIBUTABLE, BYSTANDER = "attributable", "bystander"
"""Contacts at fault where a careful human survives: with the adversary, and with anybody else."""
AT_FAULT, SHARED, UNCLEAR, AT_FAULT_NUPLAN = "at_fault", "shared_fault", "unclear_fault", "at_fault_nuplan"
"""Drives whose contacts are the ego's fault, both users' or of unclear fault, by ``fault@1``; the ego's by nuPlan."""
_OF_FAULT: Final = (AT_FAULT, SHARED, UNCLEAR, ATTRIBUTABLE, BYSTANDER)
"""Columns that nothing is known of where a contact does not say whose fault it is."""
_Read = TypeVar("_Read", bound=Stored)


@dataclass(frozen=True, slots=True)
class DriveRecord:
    """A loaded record of drives.

    Attributes:
        directory: Where it lies.
        facts: What ran.
        rows: One for each drive, by scene and run.
        summary: What they say together.
        cost: What planning took (`benchmark.records.planner_cost`); no part of what makes two records equal.
    """

    directory: Path
    facts: DriveFacts
    rows: tuple[EpisodeRow, ...]
    summary: DriveSummary
    cost: PlannerCost | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        return f"<DriveRecord: {self._what}>"

    def _repr_html_(self) -> str:
        rates = self.summary.columns.items()
        rows = [
            (name, "–" if rate.value is None else f"{rate.value:.4g}", f"{rate.denominator}") for name, rate in rates
        ]
        return html_table(self._what, ("column", "mean or rate", "drives"), rows)

    @property
    def _what(self) -> str:
        facts = self.facts
        drives = pluralise(self.summary.drives, "drive")
        return f"{self.planner} on {facts.data.name} {facts.split}, {drives}, {facts.measured.world}"

    @property
    def planner(self) -> str:
        """Name of the planner in tables."""
        return self.facts.planner.name

    @property
    def content_id(self) -> str:
        """Twelve hexadecimal digits made of the facts and the results, the same on any machine and in any folder."""
        facts = self.facts.model_dump(mode="json", by_alias=True, exclude={"environment", "config", "rescored"})
        return content_key(facts)[:12]

    @property
    def complete(self) -> bool:
        """Whether the planner failed in no drive."""
        return self.facts.status == "complete"

    @property
    def covers_split(self) -> bool:
        """Whether all scenes of the split were driven."""
        return len(self.facts.scenes) == self.facts.scenes_in_split


_WITHOUT_OTHERS: Final = ("route", "progress_m", "comfortable", "off_road", "nuplan_dac", "nuplan_ddc", "nuplan_c")
"""Columns for which it does not matter who is around."""


def compute_column_values(row: EpisodeRow) -> dict[str, float | None]:
    """Values that a drive that did not fail adds to each column; ``None`` where it says nothing there.

    Columns of the two engines have different names. A scene that is not labelled throughout says nothing of others.
    """
    values = _compute_values(row)
    if not row.says_fault:
        values |= {name: None for name in _OF_FAULT if name in values}
    if not row.unlabelled:
        return values
    return {name: value if name in _WITHOUT_OTHERS else None for name, value in values.items()}


def _compute_values(row: EpisodeRow) -> dict[str, float | None]:
    scores, contact, first, touches = row.scores, row.contact, row.first_contact, row.touches
    assert scores is not None, "a failed drive has no value in any column"
    common: dict[str, float | None] = {
        "route": scores.route_share,
        "progress_m": scores.progress_m,
        "comfortable": scores.comfortable,
        "seconds": _seconds(row),
    }
    if scores.neuroncap is not None:
        outcome = scores.neuroncap
        speed = outcome.impact_speed if contact is not None else None
        hit = float(contact is not None)
        both = {NNS: outcome.score, COLLISION_RATE: hit}
        families = {f"{name}_{row.family}": value for name, value in both.items()} if row.family else {}
        return {**both, "impact_speed": speed, **common, **families}
    values: dict[str, float | None] = {
        "contact": float(first is not None),
        AT_FAULT: float(row.fault is FaultVerdict.EGO),
        SHARED: float(row.fault is FaultVerdict.SHARED),
        UNCLEAR: float(row.fault is FaultVerdict.UNCLEAR),
        AT_FAULT_NUPLAN: float(any(touch.at_fault for touch in touches)),
        "with_adversary": float(any(touch.adversary for touch in touches)),
        "impact_speed": None if first is None else first.impact_speed,
        "delta_v": None if first is None else first.delta_v_ego,
        **common,
    }
    if row.window is not None:
        values["with_bystander"] = float(any(not touch.adversary for touch in touches))
    if row.ladder is not None:
        values |= {f"survives_{name}": float(outcome.survives) for name, outcome in row.ladder.items()}
    if row.fair is not None:
        blamed = [touch for touch in touches if row.fair and blames_ego(touch.fault)]
        pursued = any(touch.adversary for touch in blamed)
        values |= {ATTRIBUTABLE: float(pursued), BYSTANDER: float(bool(blamed) and not pursued)}
    terms, hd = scores.nuplan, scores.hd
    values["off_road"] = None if terms is None else 1.0 - terms.dac
    for name in ("score", "nc", "dac", "mp", "ddc", "p", "ttc", "c"):
        values[f"nuplan_{name}"] = None if terms is None else getattr(terms, name)
    for name in ("score", "plans", "completed"):
        values[f"hd_{name}"] = None if hd is None else getattr(hd, name)
    return values | {name: parts.get("score") for name, parts in scores.further.items()}


def summarise_episodes(
    rows: Sequence[EpisodeRow], scene_facts: Mapping[str, SceneFacts], *, seed: int, engine: str = "default"
) -> DriveSummary:
    """Summary of drives; failed ones are counted and in no column.

    Intervals draw recorded scenes with all that was made from them, by ``scene_facts``. NeuroNCAP's engine has a table
    of its own.
    """
    driven = [row for row in rows if row.status == "ok"]
    columns: dict[str, Rate] = {}
    if driven:
        values = [compute_column_values(row) for row in driven]
        if not all(row.says_fault for row in driven):
            # A rate over the drives without contact would be none.
            values = [one | {name: None for name in _OF_FAULT if name in one} for one in values]
        names = list(dict.fromkeys(name for row_values in values for name in row_values))
        table = np.array([[row_values.get(name) for name in names] for row_values in values], np.float64)
        known = ~np.isnan(table)
        weights: Floats = np.where(known, _compute_family_weights(driven)[:, None], 0.0)
        scenes = [find_source(row.scene, scene_facts) for row in driven]
        ratios = compute_ratios_over_scenes(np.where(known, table, 0.0) * weights, weights, scenes, seed=seed)
        columns = dict(zip(names, ratios, strict=True))
    reasons = Counter(row.failure.reason for row in rows if row.failure is not None)
    return DriveSummary(
        schema=SCHEMA,
        drives=len(rows),
        failed=len(rows) - len(driven),
        reasons=dict(sorted(reasons.items())),
        coverage=len(driven) / len(rows) if rows else 0.0,
        columns=columns,
        published=compute_published_table(engine, rows),
    )


def compute_columns(record: DriveRecord) -> Mapping[str, Rate]:
    """The columns of a record's summary as they are defined now.

    Older summaries have fault by nuPlan's rule as ``at_fault``, of contacts that do not say whose fault they are by
    ``fault@1`` until they are rescored.
    """
    stored, facts = record.summary.columns, record.facts
    if AT_FAULT_NUPLAN in stored or AT_FAULT not in stored:
        return stored
    columns = summarise_episodes(record.rows, facts.scene_facts, seed=facts.seed, engine=facts.measured.engine).columns
    return {**stored, **{name: columns[name] for name in (*_OF_FAULT, AT_FAULT_NUPLAN) if name in columns}}


def write_drives(directory: Path, facts: Mapping[str, Any], rows: Sequence[EpisodeRow], *, seed: int) -> DriveRecord:
    """Write a record in place of the one that is there and read it back; ``facts`` lack schema, status, seed and files.

    No other process may write to the directory (`benchmark.machine.storage.lock_folder`).
    """
    if not rows:
        raise InputError(f"no drives to write to {directory}: no scene was selected; select at least one")
    measured = ClosedLoopDefinition.model_validate(facts["measured"])
    summary = summarise_episodes(rows, facts.get("scene_facts") or {}, seed=seed, engine=measured.engine)
    status: Literal["complete", "partial"] = "complete" if summary.failed == 0 else "partial"
    run = DriveFacts(schema=SCHEMA, status=status, seed=seed, files={}, **facts)

    def naming(files: dict[str, str]) -> dict[str, Any]:
        return {**run.model_dump(mode="json", by_alias=True), "files": files}

    written = replace_files(
        directory,
        naming,
        [row.model_dump(mode="json") for row in rows],
        summary.model_dump(mode="json", by_alias=True),
        DRIVE_FILES,
    )
    return DriveRecord(directory, run.model_copy(update={"files": written}), tuple(rows), summary)


def load_drives(directory: Path) -> DriveRecord:
    """Read a record of drives.

    Args:
        directory: Its directory.

    Returns:
        The record.

    Raises:
        InputError: If a file is absent, damaged, does not belong to the others, or comes from a newer version.
    """
    head = read_json(directory / DRIVE_FILE, RECORD)
    if not isinstance(head, dict) or type(head.get("schema")) is not int or not isinstance(head.get("files"), dict):
        raise InputError(f"{directory / DRIVE_FILE} is no record of drives: it has no schema number or no hashes")
    if head["schema"] != SCHEMA:
        raise InputError(
            f"{directory} has schema {head['schema']} of drives, this version reads {SCHEMA}; upgrade challenger-bench "
            "or run the same drive command again"
        )
    rows, summary = read_rows_and_summary(directory, head, DRIVE_FILES, "drive")
    facts = _checked(DriveFacts, head, directory / DRIVE_FILE)
    read = tuple(_checked(EpisodeRow, row, directory / ROWS_FILE) for row in rows)
    return DriveRecord(directory, facts, read, _checked(DriveSummary, summary, directory / SUMMARY_FILE))


def find_drives(*roots: Path) -> list[DriveRecord]:
    """Every record of drives below folders, by their path.

    Raises:
        InputError: If a folder does not exist or a record in it is damaged.
    """
    records = []
    for root in roots:
        if not root.is_dir():
            raise InputError(f"{root} does not exist; run challenger-bench drive first, or correct --out")
        places = (path.parent for path in sorted(root.rglob(DRIVE_FILE)))
        records += read_records(places, load_drives, instead=" to do without this record")
    return records


def _compute_family_weights(rows: Sequence[EpisodeRow]) -> Floats:
    """(S,) weights with which families of scenarios count alike, however many drives each has; they sum to S."""
    drives = Counter(row.family for row in rows)
    return np.array([len(rows) / (len(drives) * drives[row.family]) for row in rows])


def _checked(model: type[_Read], stored: Any, path: Path) -> _Read:
    return validate_stored(
        model.model_validate,
        stored,
        lambda where, wrong: f"{path} is damaged ({where or 'as a whole'}: {wrong}); run the same drive command again",
    )


def _seconds(row: EpisodeRow) -> float | None:
    """Time that the ego drove, to the contact where one ended it."""
    if row.contact is not None:
        return row.contact.seconds
    times = row.ticks.time_us
    return (times[-1] - times[row.primed - 1]) * 1e-6 if len(times) >= row.primed else None
