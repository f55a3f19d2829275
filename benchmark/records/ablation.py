"""Records of ablation studies: the search with and without multi-round refinement (MTR) and trajectory scoring (TS).

`generation.build.ablation` makes them; tables are made from them alone.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field, SerializerFunctionWrapHandler, ValidationError, model_serializer

from benchmark.errors import InputError
from benchmark.machine.storage import content_key, read_json
from benchmark.published import PAPER
from benchmark.records.run_schema import DataFacts, PlannerFacts, RateRow

SCHEMA: Final = 1
RECORD: Final = "ablation.json"
SOURCE: Final = f'{PAPER}, section "Ablation Study"'


@dataclass(frozen=True, slots=True)
class Variant:
    """One row of the study.

    Attributes:
        name: Folder and key.
        label: As the paper calls it.
        multi_round: Whether trajectories are refined in several rounds.
        scored: Whether trajectories are scored.
        paper_rate: The paper's number: UniAD on 20 scenes of the nuScenes validation set, rendered by MagicDriveDiT.
    """

    name: str
    label: str
    multi_round: bool
    scored: bool
    paper_rate: float


VARIANTS: Final = (
    Variant("full", "Challenger", True, True, 0.0617),
    Variant("no-mtr", "- MTR", False, True, 0.0349),
    Variant("no-ts", "- TS", True, False, 0.0013),
    Variant("no-mtr-no-ts", "- MTR - TS", False, False, 0.0080),
)


class _Stored(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class AblationRow(_Stored):
    """What one variant gave.

    Attributes:
        name: Of the variant.
        attempted: Vehicles tried.
        kept: Attempts that passed verification.
        discarded: The others, by reason.
        samples_attempted: Samples that count, over all attempts.
        samples_kept: Samples that count, over kept attempts.
        colliding_samples: Samples of kept attempts in which the planner collides within three seconds.
        rate_attempted: Colliding samples over ``samples_attempted``, with its interval over recorded scenes.
        rate_kept: Colliding samples over ``samples_kept``.
        mean_gap_m: Mean over kept attempts of the smallest gap between adversary and ego.
        paper_rate: The paper's, which older studies quote; `VARIANTS` has it.
    """

    name: str
    attempted: int
    kept: int
    discarded: dict[str, int]
    samples_attempted: int
    samples_kept: int
    colliding_samples: int
    rate_attempted: RateRow
    rate_kept: RateRow
    mean_gap_m: float | None
    paper_rate: float | None = None

    @model_serializer(mode="wrap")
    def _as_it_was_read(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        stored: dict[str, Any] = handler(self)
        return {name: value for name, value in stored.items() if name != "paper_rate" or value is not None}


class AblationReport(_Stored):
    """``ablation.json``.

    Attributes:
        schema_version: Version of the format.
        data: The recorded scenes.
        scenes: Their names.
        planner: Who was run.
        protocol: Who says what a collision is, with its version.
        seed: Of vehicles, search and intervals.
        hyper: Settings of the full search.
        prior_fingerprint: Of the diffusion model.
        rows: In the order of the paper's table.
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
    def content_id(self) -> str:
        """Twelve hexadecimal digits made of the study's content."""
        return content_key(json.dumps(self.model_dump(mode="json"), sort_keys=True))[:12]

    def plain(self) -> str:
        """The table as text."""
        head = ("", "tried", "kept", "discarded", "collisions", "of tried, %", "of kept, %", "gap, m", "paper, %")
        cells = [head, *(_cells(row) for row in self.rows)]
        widths = [max(len(row[column]) for row in cells) for column in range(len(head))]
        lines = [
            f"{self.planner.name} on {len(self.scenes)} scenes of {self.data.name}, protocol {self.protocol[0]}, 95 % "
            "intervals over scenes"
        ]
        for first, *others in cells:
            lines.append("  ".join([first.ljust(widths[0]), *map(str.rjust, others, widths[1:])]))
        lines.append(
            "of tried: colliding samples over the samples of all tried vehicles, the paper's reading; paper: quoted, "
            "UniAD on 20 nuScenes scenes rendered by MagicDriveDiT"
        )
        return "\n".join(lines)


def read_ablation(path: Path) -> AblationReport:
    """Read a study.

    Args:
        path: An ``ablation.json``.

    Returns:
        The study.

    Raises:
        InputError: If it is absent, damaged, or of a newer version.
    """
    value = read_json(path)
    schema = value.get("schema") if isinstance(value, dict) else None
    if isinstance(schema, int) and schema > SCHEMA:
        raise InputError(f"{path} has schema {schema}, this version reads up to {SCHEMA}; upgrade challenger-bench")
    try:
        return AblationReport.model_validate(value)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise InputError(f"{path} is not an ablation record ({place}: {first['msg']}); run ablate again") from error


def find_ablations(folder: Path) -> list[AblationReport]:
    """Every study below a folder.

    Args:
        folder: Where to look; it need not exist.

    Returns:
        Studies in the order of their paths.

    Raises:
        InputError: If one of them is damaged.
    """
    found = []
    for path in sorted(folder.rglob(RECORD)):
        try:
            found.append(read_ablation(path))
        except InputError as damage:
            raise InputError(f"{damage}; or delete or move {path}") from damage
    return found


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
        "-" if row.mean_gap_m is None else f"{row.mean_gap_m:.2f}",
        "-" if variant is None else f"{100 * variant.paper_rate:.2f}",
    )


def _percent(rate: RateRow) -> str:
    if rate.value is None:
        return "-"
    interval = "" if rate.low is None or rate.high is None else f" [{100 * rate.low:.2f}, {100 * rate.high:.2f}]"
    return f"{100 * rate.value:.2f}{interval}"
