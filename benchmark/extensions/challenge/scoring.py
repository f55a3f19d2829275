"""``challenge score``: entries checked, planned on and ranked.

The score is the mean over the planners of how often they first touch a changed vehicle, the higher the better; under
another protocol than ``exact``, of their collision rates, as in the WACV 2026 challenge. Refused scenes count as scenes
without a collision. Contacts with any road user, attributable success, severity and realism do not rank.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from benchmark.constants import PLAN_STEPS, VERSION
from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.extensions.challenge.checking import check_entry
from benchmark.extensions.challenge.entries import SPLIT, CheckedEntry
from benchmark.extensions.challenge.rules import ChallengeRules
from benchmark.fairness.severity_series import CRITICAL_S
from benchmark.fairness.split_assessment import measure_split_realism
from benchmark.geometry import Floats
from benchmark.machine.storage import sanitise_file_name
from benchmark.machine.workers import LocalProcesses
from benchmark.metrics.attacks import select_counted_rows
from benchmark.metrics.challenge_entries import (
    RefusedScene,
    average_planners,
    average_recordings,
    compare_entries,
    measure_rate,
    rank_entries,
    sum_adversary_contacts,
    sum_attributable_contacts,
    sum_collisions,
)
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import knows_contact_partners
from benchmark.metrics.rates import HORIZONS
from benchmark.protocols import STANDARD
from benchmark.records.challenge import (
    ChallengeScores,
    ComparedData,
    EntryScore,
    EntryVerdict,
    PlannerEntryScore,
    Rank,
    RefusalReason,
    ScoredQuantity,
    write_verdict,
)
from benchmark.records.run import NATIVE, RunRecord
from benchmark.records.scene_assessment import AssessmentSummary, SplitRealism
from benchmark.runs.plan_rows import PlannerFactory

_NOTHING: Final = ScoredQuantity()


@dataclass(frozen=True, slots=True)
class ScoreSettings:
    """How entries are scored.

    Attributes:
        out: Folder of verdicts and of the planners' records, a folder for each entry.
        rules: Of the challenge.
        protocol: Protocol that scores the plans.
        horizon: One of `benchmark.metrics.rates.HORIZONS`.
        seed: Of the intervals.
        workers: Processes that check; nothing depends on it.
    """

    out: Path
    rules: ChallengeRules = field(default_factory=ChallengeRules)
    protocol: str = EXACT
    horizon: str = "avg"
    seed: int = 0
    workers: int = 1


@dataclass(frozen=True, slots=True)
class _ScoredEntry:
    """An entry with what its score is made of."""

    name: str
    verdict: EntryVerdict
    refused: tuple[RefusedScene, ...]
    records: tuple[RunRecord, ...]
    judged: Mapping[str, AssessmentSummary]
    realism: SplitRealism | None

    @property
    def reasons(self) -> tuple[RefusalReason, ...]:
        if self.verdict.reasons or self.records:
            return self.verdict.reasons
        return (RefusalReason(rule="scenes.required", sentence="has no accepted scenes"),)

    @property
    def sources(self) -> dict[str, str]:
        return {scene.scene: scene.recording for scene in self.verdict.scenes}


def score_entries(
    entries: Mapping[str, DataSet], base: DataSet, planners: Sequence[PlannerFactory], settings: ScoreSettings
) -> ChallengeScores:
    """Check, plan and rank.

    Args:
        entries: Data sets of strangers, by the name that is shown.
        base: The recordings that all were made from.
        planners: Planners to run on them.
        settings: The rules, and how it is counted.

    Returns:
        The scores; verdicts and records of the planners lie below ``settings.out``.

    Raises:
        InputError: If an entry is bad input, two are the same data, or there is no entry or planner.
    """
    _require_some(entries, planners, settings)
    scored_entries = [_score_entry(name, data, base, planners, settings) for name, data in entries.items()]
    recordings = sorted({source for scored in scored_entries for source in scored.sources.values()})
    # Older records may lack the objects touched; all entries are ranked by the same quantity.
    knows_contacts = all(knows_contact_partners(record) for scored in scored_entries for record in scored.records)
    by: Rank = "adversary" if knows_contacts and settings.protocol == EXACT else "collision"
    scores = [_compute_entry_score(scored, recordings, settings, by, told=knows_contacts) for scored in scored_entries]
    ranked = sorted((scored for scored in scores if not scored[0].reasons), key=lambda each: _sort_key(each[0], by))
    names = [score.entry.name for score, _ in ranked]
    compared = [(name, _rank_value(score, by), draws) for name, (score, draws) in zip(names, ranked, strict=True)]
    pairs = compare_entries(compared, enough=len(recordings) > 1)
    places = rank_entries(names, pairs)
    placed = [
        score.model_copy(update=dict(zip(("best_place", "worst_place"), places[score.entry.name], strict=True)))
        for score, _ in ranked
    ]
    return ChallengeScores(
        version=VERSION,
        challenge=settings.rules.name,
        rules=settings.rules.fingerprint,
        base=ComparedData(name=base.name, fingerprint=base.fingerprint()),
        protocol=settings.protocol,
        horizon=settings.horizon,
        ranks=by,
        planners=tuple(factory.facts for factory in planners),
        entries=(*placed, *(score for score, _ in scores if score.reasons)),
        pairs=pairs,
    )


def _require_some(entries: Mapping[str, DataSet], planners: Sequence[PlannerFactory], settings: ScoreSettings) -> None:
    if not entries or not planners:
        raise InputError("there is nothing to score: name at least one entry, and a planner with --model")
    if settings.horizon not in HORIZONS:
        raise InputError(f"the horizon must be one of {', '.join(HORIZONS)}, got {settings.horizon!r}")
    names = [factory.facts.name for factory in planners]
    if settings.protocol == NATIVE:
        for factory in planners:
            if factory.facts.native_protocol is None:
                raise InputError(f"{factory.facts.name} has no native protocol; name one with --protocol")
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise InputError(f"{twice} is named twice; name each planner once")
    names_by_fingerprint: dict[str, str] = {}
    for name, data in entries.items():
        earlier = names_by_fingerprint.setdefault(data.fingerprint(), name)
        if earlier != name:
            raise InputError(f"the entries {earlier} and {name} are the same data; leave one out")


def _score_entry(
    name: str, data: DataSet, base: DataSet, planners: Sequence[PlannerFactory], settings: ScoreSettings
) -> _ScoredEntry:
    """Check an entry, and let all planners plan on its accepted scenes."""
    verdict = check_entry(data, base, settings.rules, executor=LocalProcesses(settings.workers))
    verdict = verdict.model_copy(update={"entry": ComparedData(name=name, fingerprint=verdict.entry.fingerprint)})
    folder = settings.out / sanitise_file_name(name)
    write_verdict(folder, verdict)
    refused = tuple(
        RefusedScene(scene.recording, max(len(base.scene(scene.recording).keyframes) - PLAN_STEPS, 0))
        for scene in verdict.refused
    )
    if verdict.reasons or len(refused) == len(verdict.scenes):
        return _ScoredEntry(name, verdict, refused, (), {}, None)
    entry = CheckedEntry.of(data, name, folder, verdict)
    records = tuple(
        evaluate(entry, SPLIT, planner, folder / "runs", _build_eval_settings(planner, settings))
        for planner in planners
    )
    judged = {scene: AssessmentSummary.of(judgements) for scene, judgements in entry.judgements.items() if judgements}
    return _ScoredEntry(name, verdict, refused, records, judged, measure_split_realism(entry, entry.judgements, base))


def _build_eval_settings(planner: PlannerFactory, settings: ScoreSettings) -> EvalSettings:
    """Settings that judge by all standard protocols, and by the one that the challenge asks for."""
    own = planner.facts.native_protocol if settings.protocol == NATIVE else settings.protocol
    judges = dict.fromkeys([*STANDARD, *([] if own is None else [own])])
    return EvalSettings(protocols=tuple(judges), seed=settings.seed)


def _compute_entry_score(
    scored: _ScoredEntry, recordings: Sequence[str], settings: ScoreSettings, by: Rank, *, told: bool
) -> tuple[EntryScore, Floats]:
    """The score of an entry, and what ranks it in resamples."""
    about = {
        "entry": scored.verdict.entry,
        "scenes": len(scored.verdict.scenes),
        "refused": tuple(scene.scene for scene in scored.verdict.refused),
        "reasons": scored.reasons,
    }
    if scored.reasons:
        names = ("collision", "attributable", "careful_survives", "least_gap_m", "critical", "delta_v_m_s")
        nothing = dict.fromkeys((*names, "without_fault", "realism"), _NOTHING)
        return EntryScore.model_validate({**about, **nothing}), np.zeros(0)
    seed = settings.seed
    collisions = [
        sum_collisions(record, settings.protocol, settings.horizon, scored.refused) for record in scored.records
    ]
    attributables = [sum_attributable_contacts(record, scored.refused) for record in scored.records]
    sums = {"collision": collisions, "attributable": attributables}
    if told:
        sums["adversary"] = [
            sum_adversary_contacts(record, settings.horizon, scored.refused) for record in scored.records
        ]
    # Shown with the interval of its own recordings; compared in resamples over all recordings.
    own = sorted(set(scored.sources.values()))
    means = {name: average_planners(of_planners, own, seed)[0] for name, of_planners in sums.items()}
    _, draws = average_planners(sums[by], recordings, seed)
    planners = {
        record.planner: PlannerEntryScore.model_validate(
            {name: measure_rate(of_planners[place], seed) for name, of_planners in sums.items()}
            | {"failed": record.summary.failed}
        )
        for place, record in enumerate(scored.records)
    }
    measured = {**means, "planners": planners, **_severity(scored, seed), **_realism_values(scored.realism)}
    return EntryScore.model_validate({**about, **measured}), draws


def _severity(scored: _ScoredEntry, seed: int) -> dict[str, ScoredQuantity]:
    """How severe the encounters of the accepted scenes are, and the contacts of all plans with changed vehicles."""
    sources, judged = scored.sources, scored.judged

    def mean(values: Iterable[tuple[str, float | bool | None]]) -> ScoredQuantity:
        by_recording: dict[str, list[float]] = {}
        for scene, value in values:
            if value is not None:
                by_recording.setdefault(sources[scene], []).append(float(value))
        return average_recordings(by_recording, seed)

    contacts = [
        (row.scene, row.severity.contact.delta_v_ego_m_s)
        for record in scored.records
        for row in select_counted_rows(record)
        if row.severity is not None and row.severity.contact is not None and row.severity.contact.adversary
    ]
    return {
        "careful_survives": mean((scene, summary.survives.get("cc")) for scene, summary in judged.items()),
        "least_gap_m": mean((scene, summary.least_gap_m) for scene, summary in judged.items()),
        "critical": mean((scene, _is_critical(summary)) for scene, summary in judged.items()),
        "delta_v_m_s": mean(contacts),
        "without_fault": mean((scene, not summary.faults) for scene, summary in judged.items()),
    }


def _is_critical(summary: AssessmentSummary) -> bool | None:
    """Whether ego and changed vehicle are ever nearly in contact; unknown if not measured."""
    if summary.least_gap_m is None:
        return None
    return summary.least_ttc_s is not None and summary.least_ttc_s < CRITICAL_S


def _realism_values(realism: SplitRealism | None) -> dict[str, object]:
    worst = None if realism is None else realism.headline
    if worst is None or realism is None:
        return {"realism": _NOTHING, "not_compared": None if realism is None else realism.not_compared}
    low, high = worst.interval or (None, None)
    counted = realism.samples[0] if realism.samples else 0
    value = ScoredQuantity(value=worst.realism, low=low, high=high, denominator=counted)
    return {"realism": value, "realism_feature": worst.name}


def _rank_value(score: EntryScore, by: Rank) -> float:
    value = (score.adversary if by == "adversary" else score.collision).value
    return 0.0 if value is None else value


def _sort_key(score: EntryScore, by: Rank) -> tuple[float, str]:
    return -_rank_value(score, by), score.entry.name
