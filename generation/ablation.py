"""The paper's ablation study: the search with and without multi-round refinement (MTR) and trajectory scoring (TS).

Each row is a build of its own with the same vehicles, and a planner is run on what survives. The paper reports "the
percentage of samples that Challenger could successfully generate while the model failed to navigate safely": samples of
discarded attempts count below the line and never above it.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.evaluate import EvalSettings, evaluate
from benchmark.protocols import protocol
from benchmark.rates import Rate, ratios_over_scenes
from benchmark.record_schema import DataFacts, PlannerFacts, RateRow
from benchmark.records import RunRecord
from benchmark.storage import read_json, read_json_lines, write_json
from generation.build import BuildSettings, NothingSurvivedError, build_split, source_scenes
from generation.build_report import BuildReport
from generation.surrogate import PROTOCOL, PlannerUnderTest, require_all_planned

SCHEMA: Final = 1
RECORD: Final = "ablation.json"


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
        paper_rate: Quoted from the paper, which had another set-up.
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
    paper_rate: float


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


def ablate(source: DataSet, planner: PlannerUnderTest, settings: BuildSettings) -> AblationReport:
    """Run the study; the same call resumes.

    Args:
        source: Recorded scenes.
        planner: Who drives.
        settings: The full search. Its ``out`` is the folder of the study, which holds one build for each row; limits on
            what is kept, several adversaries and a surrogate do not apply.

    Returns:
        The study, which is also in ``ablation.json``.

    Raises:
        InputError: As `generation.build.build_split`, or if the planner fails on samples.
    """
    names = source_scenes(source, settings)
    samples = {name: sum(truth.complete for truth in source.truth(name)) for name in names}
    rows = tuple(_row(source, planner, settings, variant, samples) for variant in VARIANTS)
    if len({row.attempted for row in rows}) > 1:
        raise ValueError("rows of one study tried different vehicles")
    report = AblationReport(
        schema=SCHEMA,
        data=DataFacts(name=source.name, version=source.version, fingerprint=source.fingerprint()),
        scenes=names,
        planner=planner.factory.facts,
        protocol=(PROTOCOL, protocol(PROTOCOL).version),
        seed=settings.seed,
        hyper=asdict(settings.hyper),
        prior_fingerprint=settings.prior().fingerprint,
        rows=rows,
    )
    write_json(settings.out / RECORD, report.model_dump(mode="json", by_alias=True))
    return report


def ablation_estimate(source: DataSet, planner: PlannerUnderTest, settings: BuildSettings) -> str:
    """How much work a study is, one line for each row; nothing is written.

    Args:
        source: As in `ablate`.
        planner: As in `ablate`.
        settings: As in `ablate`.

    Returns:
        Text for people.

    Raises:
        InputError: As `ablate`.
    """
    dry = replace(settings, dry_run=True)
    reports = [build_split(source, "adv", _settings_of(variant, dry, planner)) for variant in VARIANTS]
    return "\n".join(f"{variant.label}: {said.sentence()}" for variant, said in zip(VARIANTS, reports, strict=True))


def _settings_of(variant: Variant, settings: BuildSettings, planner: PlannerUnderTest) -> BuildSettings:
    return replace(
        settings,
        out=settings.out / variant.name,
        hyper=replace(settings.hyper, multi_round=variant.multi_round, scored=variant.scored),
        adversaries=1,
        surrogate=None,
        per_scene=None,
        total=None,
        layout="suffixed",
        renderer=settings.renderer if planner.images else None,
    )


def _row(
    source: DataSet,
    planner: PlannerUnderTest,
    settings: BuildSettings,
    variant: Variant,
    samples: dict[str, int],
) -> AblationRow:
    """Build and judge one variant; ``samples`` are those that count, by recorded scene."""
    row = _settings_of(variant, settings, planner)
    record: RunRecord | None = None
    try:
        report = build_split(source, "adv", row)
    except NothingSurvivedError as nothing:
        report = nothing.report
    else:
        record = _evaluated(source, planner, row, settings.out / "runs" / variant.name)
    return _counted(variant, report, read_json_lines(row.out / "attempts.jsonl"), record, samples, settings.seed)


def _evaluated(source: DataSet, planner: PlannerUnderTest, row: BuildSettings, runs: Path) -> RunRecord:
    data = open_data(row.out, version=row.version, name=source.name)
    settings = EvalSettings(protocols=(PROTOCOL,), workers=planner.workers, seed=row.seed)
    record = evaluate(data, "adv", planner.factory, runs, settings)
    require_all_planned(record)
    return record


def _counted(
    variant: Variant,
    report: BuildReport,
    attempts: Sequence[dict[str, Any]],
    record: RunRecord | None,
    samples: dict[str, int],
    seed: int,
) -> AblationRow:
    """Numbers of one variant, by recorded scene first: variants of one recording are resampled together."""
    scene_of = {row["written"]: row["scene"] for row in attempts if row["written"] is not None}
    colliding: Counter[str] = Counter()
    judged: Counter[str] = Counter()
    for row in () if record is None else record.rows:
        outcome = row.outcomes[PROTOCOL]
        if outcome.counted:
            judged[scene_of[row.scene]] += 1
            colliding[scene_of[row.scene]] += any(outcome.collision)
    tried = Counter(row["scene"] for row in attempts)
    scenes = sorted(samples)
    above = np.array([[float(colliding[scene])] * 2 for scene in scenes]).reshape(-1, 2)
    below = np.array([[float(tried[scene] * samples[scene]), float(judged[scene])] for scene in scenes]).reshape(-1, 2)
    of_tried, of_kept = ratios_over_scenes(above, below, scenes, seed=seed)
    gaps = [row["closest_approach"]["gap_m"] for row in attempts if row["kept"]]
    return AblationRow(
        name=variant.name,
        attempted=report.tried,
        kept=report.survived,
        discarded=dict(sorted(report.discarded.items())),
        samples_attempted=int(below[:, 0].sum()),
        samples_kept=int(below[:, 1].sum()),
        colliding_samples=sum(colliding.values()),
        rate_attempted=_rate_row(of_tried),
        rate_kept=_rate_row(of_kept),
        mean_gap_m=float(np.mean(gaps)) if gaps else None,
        paper_rate=variant.paper_rate,
    )


def _rate_row(rate: Rate) -> RateRow:
    return RateRow(**asdict(rate))


def _cells(row: AblationRow) -> tuple[str, ...]:
    label = next(variant.label for variant in VARIANTS if variant.name == row.name)
    share = f"{100 * sum(row.discarded.values()) / row.attempted:.0f} %" if row.attempted else "-"
    return (
        label,
        str(row.attempted),
        str(row.kept),
        share,
        f"{row.colliding_samples} of {row.samples_kept}",
        _percent(row.rate_attempted),
        _percent(row.rate_kept),
        "-" if row.mean_gap_m is None else f"{row.mean_gap_m:.2f}",
        f"{100 * row.paper_rate:.2f}",
    )


def _percent(rate: RateRow) -> str:
    if rate.value is None:
        return "-"
    interval = "" if rate.low is None or rate.high is None else f" [{100 * rate.low:.2f}, {100 * rate.high:.2f}]"
    return f"{100 * rate.value:.2f}{interval}"
