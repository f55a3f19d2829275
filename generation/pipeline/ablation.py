"""The paper's ablation study: the search with and without multi-round refinement (MTR) and trajectory scoring (TS).

Each row is a build of its own with the same vehicles, and a planner is run on what survives. The paper reports "the
percentage of samples that Challenger could successfully generate while the model failed to navigate safely": samples of
discarded attempts count below the line and never above it. Failures count whose first contact is with the adversary.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from benchmark.datasets.roots import DataSet, open_data
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.geometry import Floats
from benchmark.machine.storage import write_json
from benchmark.metrics.effect import find_attributed_collisions
from benchmark.metrics.rates import compute_paired_difference, compute_ratios_over_scenes
from benchmark.protocols import find_protocol
from benchmark.records.ablation import RECORD, SCHEMA, VARIANTS, AblationReport, AblationRow, AblationVariant
from benchmark.records.attempts import ATTEMPTS_FILE, Attempt, read_attempts
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import DataFacts
from generation.pipeline.recordings import list_source_scenes
from generation.pipeline.report import BuildReport, estimate_build
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import NothingSurvivedError, build_split
from generation.pipeline.surrogate import PROTOCOL, PlannerUnderTest, require_all_planned


def run_ablation(source: DataSet, planner: PlannerUnderTest, settings: BuildSettings) -> AblationReport:
    """Run the study; the same call resumes.

    Args:
        source: Recorded scenes.
        planner: Planner that is evaluated.
        settings: The full search. Its ``out`` is the folder of the study, which holds one build for each row; limits on
            what is kept, several adversaries and a surrogate do not apply.

    Returns:
        The study, which is also in ``ablation.json``.

    Raises:
        InputError: As `generation.pipeline.split.build_split`, or if the planner fails on samples.
    """
    names = list_source_scenes(source, settings)
    samples = {name: sum(truth.by_clock.complete for truth in source.truth(name)) for name in names}
    results = [_run_variant(source, planner, settings, variant, samples) for variant in VARIANTS]
    if len({result.row.attempted for result in results}) > 1:
        raise ValueError("rows of one study tried different vehicles")
    rows = tuple(result.beside(results[0]) for result in results)
    report = AblationReport(
        schema=SCHEMA,
        data=DataFacts(name=source.name, version=source.version, fingerprint=source.fingerprint()),
        scenes=names,
        planner=planner.factory.facts,
        protocol=(PROTOCOL, find_protocol(PROTOCOL).version),
        seed=settings.seed,
        hyper=asdict(settings.hyper),
        prior_fingerprint=settings.prior().fingerprint,
        rows=rows,
    )
    write_json(settings.out / RECORD, report.model_dump(mode="json", by_alias=True))
    return report


def estimate_ablation(source: DataSet, planner: PlannerUnderTest, settings: BuildSettings) -> str:
    """Text for people on the work that a study is, one line for each row; nothing is written."""
    reports = [
        estimate_build(source, "adv", _build_variant_settings(variant, settings, planner)) for variant in VARIANTS
    ]
    return "\n".join(f"{variant.label}: {report.sentence()}" for variant, report in zip(VARIANTS, reports, strict=True))


def _build_variant_settings(
    variant: AblationVariant, settings: BuildSettings, planner: PlannerUnderTest
) -> BuildSettings:
    return replace(
        settings,
        out=settings.out / variant.name,
        timings=settings.timing / variant.name,
        hyper=replace(settings.hyper, multi_round=variant.multi_round, scored=variant.scored),
        adversaries=1,
        surrogate=None,
        per_scene=None,
        total=None,
        layout="suffixed",
        renderer=settings.renderer if planner.images else None,
    )


@dataclass(frozen=True, slots=True)
class _VariantResult:
    """One row, and by recorded scene its colliding samples and the samples of all tried vehicles, (N,) each."""

    row: AblationRow
    colliding: Floats
    tried: Floats

    def beside(self, full: Self) -> AblationRow:
        """The row with its difference to the full search's."""
        if self is full:
            return self.row
        judged = self.tried > 0
        difference = compute_paired_difference((full.colliding - self.colliding)[judged], self.tried[judged])
        return self.row.model_copy(update={"full_minus": difference})


def _run_variant(
    source: DataSet,
    planner: PlannerUnderTest,
    settings: BuildSettings,
    variant: AblationVariant,
    samples: dict[str, int],
) -> _VariantResult:
    """Build and judge one variant; ``samples`` are those that count, by recorded scene."""
    row = _build_variant_settings(variant, settings, planner)
    record: RunRecord | None = None
    try:
        report = build_split(source, "adv", row)
    except NothingSurvivedError as nothing:
        report = nothing.report
    else:
        record = _evaluate_variant(source, planner, row, settings.out / "runs" / variant.name)
    return _compute_row(variant, report, read_attempts(row.out / ATTEMPTS_FILE), record, samples, settings.seed)


def _evaluate_variant(source: DataSet, planner: PlannerUnderTest, row: BuildSettings, runs: Path) -> RunRecord:
    data = open_data(row.out, version=row.version, name=source.name)
    settings = EvalSettings(protocols=(PROTOCOL,), workers=planner.workers, seed=row.seed)
    record = evaluate(data, "adv", planner.factory, runs, settings)
    require_all_planned(record)
    return record


def _compute_row(
    variant: AblationVariant,
    report: BuildReport,
    attempts: Sequence[Attempt],
    record: RunRecord | None,
    samples: dict[str, int],
    seed: int,
) -> _VariantResult:
    """Numbers of one variant, by recorded scene first: variants of one recording are resampled together."""
    scene_of = {attempt.written: attempt.scene for attempt in attempts if attempt.written is not None}
    colliding: Counter[str] = Counter()
    judged: Counter[str] = Counter()
    if record is not None:
        failed = find_attributed_collisions(record)
        for row, failure in zip(record.rows, failed, strict=True):
            outcome = row.outcomes[PROTOCOL]
            if outcome.counted and outcome.collision is not None and not outcome.cut_short:
                judged[scene_of[row.scene]] += 1
                colliding[scene_of[row.scene]] += bool(failure)
    attempt_counts = Counter(attempt.scene for attempt in attempts)
    scenes = sorted(samples)
    above = np.array([[float(colliding[scene])] * 2 for scene in scenes]).reshape(-1, 2)
    below = np.array(
        [[float(attempt_counts[scene] * samples[scene]), float(judged[scene])] for scene in scenes]
    ).reshape(-1, 2)
    of_tried, of_kept = compute_ratios_over_scenes(above, below, scenes, seed=seed)
    gaps = [
        attempt.closest_approach.gap_m for attempt in attempts if attempt.kept and attempt.closest_approach is not None
    ]
    row_of_variant = AblationRow(
        name=variant.name,
        attempted=report.tried,
        kept=report.survived,
        discarded=dict(sorted(report.discarded.items())),
        samples_attempted=int(below[:, 0].sum()),
        samples_kept=int(below[:, 1].sum()),
        colliding_samples=sum(colliding.values()),
        rate_attempted=of_tried,
        rate_kept=of_kept,
        mean_gap_m=float(np.mean(gaps)) if gaps else None,
    )
    return _VariantResult(row_of_variant, above[:, 0], below[:, 0])
