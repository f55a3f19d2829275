"""Records of ablation studies: the search with and without multi-round refinement (MTR) and trajectory scoring (TS)."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import Field, model_validator

from benchmark.errors import InputError
from benchmark.machine.storage import content_key, read_json
from benchmark.metrics.rates import PairedDifference, Rate
from benchmark.published import ABLATION
from benchmark.records.run_schema import DataFacts, PlannerFacts
from benchmark.records.store import read_records, validate_stored
from benchmark.records.stored import Stored
from benchmark.report.cells import RANKS_NOTHING
from benchmark.report.table import Table, TableExcerpt, build_table
from benchmark.report.words import pluralise

SCHEMA: Final = 2
RECORD: Final = "ablation.json"
_COUNTS: Final = ("search", "tried", "kept", "discarded", "collisions")


@dataclass(frozen=True, slots=True)
class AblationVariant:
    """One row of the ablation study; ``label`` is the paper's name of it."""

    name: str
    label: str
    multi_round: bool
    scored: bool

    @property
    def published(self) -> str:
        """The paper's number in per cent, as printed."""
        return f"{100 * ABLATION[self.name]:.2f}"


VARIANTS: Final = (
    AblationVariant("full", "Challenger", True, True),
    AblationVariant("no-mtr", "- MTR", False, True),
    AblationVariant("no-ts", "- TS", True, False),
    AblationVariant("no-mtr-no-ts", "- MTR - TS", False, False),
)


class AblationRow(Stored):
    """Results of one variant; the counts are of vehicles tried, and of their samples that count.

    A colliding sample is one of a kept attempt in which the planner touches the adversary first, within three seconds;
    in schema 1, in which it touches anybody. Intervals of rates are over recorded scenes; ``mean_gap_m`` is the mean
    over kept attempts of the smallest gap between adversary and ego.

    Attributes:
        name: Of the variant.
        attempted: Vehicles that were tried.
        kept: Attempts that passed verification.
        discarded: The others, by reason.
        samples_attempted: Samples of the scenes of all tried vehicles.
        samples_kept: Samples of the kept scenes.
        colliding_samples: Those in which the planner collides with the adversary.
        rate_attempted: Colliding samples over those of all tried.
        rate_kept: Colliding samples over those of kept scenes.
        full_minus: Rate of tried of the full search minus this row's, by recorded scene; null for the full search, and
            in schema 1.
    """

    name: str
    attempted: int
    kept: int
    discarded: dict[str, int]
    samples_attempted: int
    samples_kept: int
    colliding_samples: int
    rate_attempted: Rate
    rate_kept: Rate
    mean_gap_m: float | None
    full_minus: PairedDifference | None = None

    @model_validator(mode="before")
    @classmethod
    def _without_the_papers_number(cls, value: Any) -> Any:
        """Earlier records quote the paper in each row."""
        return (
            {name: member for name, member in value.items() if name != "paper_rate"}
            if isinstance(value, dict)
            else value
        )


class AblationReport(Stored):
    """``ablation.json``; ``hyper`` are the settings of the full search, ``rows`` in the order of the paper's table.

    ``seed`` is that of vehicles, search and intervals.

    Attributes:
        schema_version: Version of the format.
        data: Data set.
        scenes: Recorded scenes.
        planner: Planner that judges.
        protocol: Name and version.
        prior_fingerprint: Hash of the trajectory model.
    """

    schema_version: int = Field(alias="schema")
    data: DataFacts
    scenes: tuple[str, ...]
    planner: PlannerFacts
    protocol: tuple[str, int]
    seed: int
    hyper: dict[str, Any]
    prior_fingerprint: str
    rows: tuple[AblationRow, ...]

    @property
    def whom(self) -> str:
        """Who is touched in a colliding sample."""
        return "anybody" if self.schema_version == 1 else "the adversary"

    @property
    def content_id(self) -> str:
        """Twelve hexadecimal digits made of the study's content, less the paper's numbers that it may quote."""
        content = self.model_dump(mode="json", exclude={"planner": {"published_as", "miniature", "wants"}})
        for row in content["rows"]:
            row |= {"paper_rate": ABLATION[row["name"]]} if row["name"] in ABLATION else {}
            if self.schema_version == 1:
                del row["full_minus"]
        return content_key(json.dumps(content, sort_keys=True))[:12]

    def table(self) -> Table:
        """The study for a terminal."""
        title = (
            f"{self.planner.name} on {pluralise(len(self.scenes), 'scene')} of {self.data.name}, protocol "
            f"{self.protocol[0]}, 95 % intervals over scenes"
        )
        notes = (
            f"collisions: samples whose plan touches {self.whom} within 3 s; of tried: over the samples of all tried "
            "vehicles, as in the paper; of kept: over those of scenes that passed verification; full minus: the first "
            "row's of tried minus this one's, in points; paper: quoted, UniAD on 20 nuScenes scenes rendered by "
            "MagicDriveDiT; MTR: multi-round refinement, TS: scoring.",
            *([f"{self.planner.name} is a miniature: it {RANKS_NOTHING}."] if self.planner.miniature else []),
        )
        return build_table(
            "ablation",
            title,
            (*_COUNTS, "of tried, %", "of kept, %", "full minus", "gap, m", "paper, %"),
            [_cells(row) for row in self.rows],
            notes=notes,
            brief=TableExcerpt(title, (0, 2, 5, 6, 7, 9), notes, text_columns=1),
        )


def read_ablation(path: Path) -> AblationReport:
    """The study in an ``ablation.json``."""
    value = read_json(path)
    schema = value.get("schema") if isinstance(value, dict) else None
    if isinstance(schema, int) and schema > SCHEMA:
        raise InputError(f"{path} has schema {schema}, this version reads up to {SCHEMA}; upgrade challenger-bench")
    return validate_stored(
        AblationReport.model_validate,
        value,
        lambda where, why: f"{path} is not an ablation record ({where}: {why}); run ablate again",
    )


def find_ablations(folder: Path) -> list[AblationReport]:
    """Every study below a folder, which need not exist, in the order of their paths."""
    return read_records(sorted(folder.rglob(RECORD)), read_ablation)


def _cells(row: AblationRow) -> tuple[str, ...]:
    variant = next((variant for variant in VARIANTS if variant.name == row.name), None)
    share = f"{100 * sum(row.discarded.values()) / row.attempted:.0f} %" if row.attempted else "-"
    return (
        row.name if variant is None else variant.label,
        str(row.attempted),
        str(row.kept),
        share,
        f"{row.colliding_samples} of {row.samples_kept}",
        _percent(row.rate_attempted),
        _percent(row.rate_kept),
        "-" if row.full_minus is None else _percent(row.full_minus),
        "-" if row.mean_gap_m is None else f"{row.mean_gap_m:.2f}",
        "-" if variant is None else variant.published,
    )


def _percent(rate: Rate | PairedDifference) -> str:
    if rate.value is None:
        return "-"
    interval = "" if rate.low is None or rate.high is None else f" [{100 * rate.low:.2f}, {100 * rate.high:.2f}]"
    return f"{100 * rate.value:.2f}{interval}"
