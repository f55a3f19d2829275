"""Attack success on a planner from its record, in three readings: of samples, and of scenes.

``docs/severity.md``, "Attack success in three readings". All three ask for contacts with an adversary: a sample counts
by whom its plan touches first, and contacts with bystanders have a rate of their own. Of a scene one sample is enough;
of what is unknown nothing is counted.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmark.fairness.attack import READINGS, Attack, Reading, any_or_unknown
from benchmark.metrics.rates import NO_RATE, Rate, compute_ratios_over_scenes
from benchmark.metrics.scores import map_scenes_to_sources
from benchmark.records.fault import FaultVerdict, blames_ego
from benchmark.records.row_schema import BriefRow
from benchmark.records.run import RunRecord
from benchmark.records.seed_splits import is_adversarial

__all__ = [
    "READINGS",
    "AttackRates",
    "Reading",
    "SceneAttack",
    "attack_rates_to_json",
    "can_count_attacks",
    "collect_scene_attacks",
    "compute_attack_rates",
    "has_adversaries",
    "has_severity",
    "knows_adversaries",
    "select_counted_rows",
]
# Imported by the leaderboard for its text on attacks.


@dataclass(frozen=True, slots=True)
class SceneAttack:
    """Attack success in one scene: of each sample that counts, and by reading, ``None`` where it cannot be told.

    ``bystanders`` tells of each sample whether its first contact is with another than an adversary, ``faults`` whose
    fault (``fault@1``) one with an adversary is.
    """

    samples: tuple[Attack, ...]
    verdicts: dict[Reading, bool | None]
    bystanders: tuple[bool, ...]
    faults: tuple[FaultVerdict | None, ...] = ()

    @property
    def bystander(self) -> bool | None:
        """Whether a sample of the scene touches a bystander first; ``None`` where no sample counts."""
        return any(self.bystanders) if self.bystanders else None


@dataclass(frozen=True, slots=True)
class AttackRates:
    """Attack success on one planner.

    ``judged`` are scenes of which it is known whether the careful human survives them, ``spared`` those that it
    survives; ``unknown_fault`` are samples with a contact that does not say whose fault it is, as in older records:
    then there is no rate of fault. ``shared`` and ``unclear`` are of samples whose contact is both users' fault, or
    unclear whose. Bystander rates are of samples whose first contact is with another than an adversary, and of
    scenes with such a sample.
    """

    samples: dict[Reading, Rate]
    scenes: dict[Reading, Rate]
    judged: int
    spared: int
    unknown_fault: int
    bystander_samples: Rate
    bystander_scenes: Rate
    shared: Rate
    unclear: Rate


def has_adversaries(record: RunRecord) -> bool:
    """Whether a record is of a split with adversaries."""
    facts = record.run.scene_facts.values()
    return is_adversarial(record.run.split) or any(fact.adversaries for fact in facts)


def has_severity(record: RunRecord) -> bool:
    """Whether a record says of its plans how severe they are; older ones do not."""
    severities = record.columns.values("severity")
    return any(severities[place] is not None for place in record.columns.planned.tolist())


def knows_adversaries(record: RunRecord) -> bool:
    """Whether it is known which road users of a record's scenes are adversaries; of strangers' data it is not."""
    facts = [record.run.scene_facts.get(scene) for scene in record.run.scenes]
    return all(fact is not None and fact.adversaries is not None for fact in facts)


def can_count_attacks(record: RunRecord) -> bool:
    """Whether it is known who the adversaries are and how severe plans are.

    Where the adversary is not known, every contact would be a bystander's, and success 0 %.
    """
    return has_adversaries(record) and knows_adversaries(record) and has_severity(record)


def select_counted_rows(record: RunRecord) -> list[BriefRow]:
    """Samples that have a plan, whose recording goes on for 3 s, and whose surroundings are annotated."""
    return [row for row in record.columns.brief if row.status == "ok" and row.complete and row.severity is not None]


def careful_survives(record: RunRecord, scene: str) -> bool | None:
    """Whether the careful and competent human survives a scene; ``None`` where it was not judged."""
    facts = record.run.scene_facts.get(scene)
    return None if facts is None or facts.judgement is None else facts.judgement.survives.get("cc")


def collect_scene_attacks(record: RunRecord) -> dict[str, SceneAttack]:
    """Attack success by scene, in the record's order; the record must say how severe its plans are (`has_severity`)."""
    by_scene: dict[str, list[Attack]] = {scene: [] for scene in record.run.scenes}
    bystanders: dict[str, list[bool]] = {scene: [] for scene in by_scene}
    faults: dict[str, list[FaultVerdict | None]] = {scene: [] for scene in by_scene}
    survivors = {scene: careful_survives(record, scene) for scene in by_scene}
    for row in select_counted_rows(record):
        by_scene[row.scene].append(_to_attack(row, survivors[row.scene]))
        contact = None if row.severity is None else row.severity.contact
        bystanders[row.scene].append(contact is not None and not contact.adversary)
        fault = contact.fault if contact is not None and contact.adversary else None
        faults[row.scene].append(None if fault is None else fault.verdict)
    columns = record.columns
    lost = np.flatnonzero(columns.failed & columns.flags("complete")).tolist()
    missing = {columns.values("scene")[place] for place in lost}
    return {
        scene: SceneAttack(
            tuple(attacks),
            {reading: _combine_scene(attacks, reading, scene in missing, survivors[scene]) for reading in READINGS},
            tuple(bystanders[scene]),
            tuple(faults[scene]),
        )
        for scene, attacks in by_scene.items()
    }


def compute_attack_rates(record: RunRecord) -> AttackRates:
    """Attack success on the planner of a record that `has_severity`, with intervals over recorded scenes."""
    attacks = collect_scene_attacks(record)
    samples = [(scene, sample) for scene, attack in attacks.items() for sample in attack.samples]
    known = [survives for scene in attacks if (survives := careful_survives(record, scene)) is not None]
    others = [(scene, sample) for scene, attack in attacks.items() for sample in attack.bystanders]
    unknown_fault = sum(attack.contact and attack.at_fault is None for _, attack in samples)
    of_samples = _compute_rates(
        record, [(scene, [getattr(sample, name) for name in READINGS]) for scene, sample in samples]
    )
    of_scenes = _compute_rates(record, [(scene, list(attack.verdicts.values())) for scene, attack in attacks.items()])

    def share(verdict: FaultVerdict) -> Rate:
        told = [(scene, fault is verdict) for scene, attack in attacks.items() for fault in attack.faults]
        return NO_RATE if unknown_fault else _compute_rate(record, told)

    if unknown_fault:
        # The rest would be a rate of samples without contact.
        of_samples |= dict.fromkeys(READINGS[1:], NO_RATE)
        of_scenes |= dict.fromkeys(READINGS[1:], NO_RATE)
    return AttackRates(
        bystander_samples=_compute_rate(record, others),
        bystander_scenes=_compute_rate(record, [(scene, attack.bystander) for scene, attack in attacks.items()]),
        samples=of_samples,
        scenes=of_scenes,
        judged=len(known),
        spared=sum(known),
        unknown_fault=unknown_fault,
        shared=share(FaultVerdict.SHARED),
        unclear=share(FaultVerdict.UNCLEAR),
    )


def attack_rates_to_json(record: RunRecord) -> dict[str, Any]:
    """``attack_success`` as JSON values: rates by reading and of bystander contacts, of ``samples`` and of ``scenes``.

    Nothing where that cannot be told (`can_count_attacks`).
    """
    if not can_count_attacks(record):
        return {}
    success = compute_attack_rates(record)
    of_samples: dict[str, Rate] = {name: success.samples[name] for name in READINGS}
    of_scenes: dict[str, Rate] = {name: success.scenes[name] for name in READINGS}
    parts = {
        "samples": of_samples
        | {"bystander": success.bystander_samples, "shared": success.shared, "unclear": success.unclear},
        "scenes": of_scenes | {"bystander": success.bystander_scenes},
    }
    return {
        "attack_success": {part: {name: asdict(rate) for name, rate in rates.items()} for part, rates in parts.items()}
    }


def _to_attack(row: BriefRow, survives: bool | None) -> Attack:
    contact = None if row.severity is None else row.severity.contact
    if contact is None or not contact.adversary:
        return Attack.of(False, None, survives)
    return Attack.of(True, blames_ego(contact.fault), survives)


def _combine_scene(attacks: Iterable[Attack], reading: Reading, missing: bool, survives: bool | None) -> bool | None:
    verdicts = [getattr(attack, reading) for attack in attacks]
    if reading == "attributable" and survives is False:
        # Contacts of this scene are never attributed, so a failed sample changes nothing.
        return False if verdicts else None
    # A sample on which the planner failed could have shown anything.
    return any_or_unknown([*verdicts, *([None] if missing or not verdicts else [])])


def _compute_rate(record: RunRecord, verdicts: Sequence[tuple[str, bool | None]]) -> Rate:
    sources = map_scenes_to_sources(record)
    known_verdicts = [(sources[scene], float(verdict)) for scene, verdict in verdicts if verdict is not None]
    values = np.array([value for _, value in known_verdicts]).reshape(-1, 1)
    (rate,) = compute_ratios_over_scenes(
        values, np.ones_like(values), [name for name, _ in known_verdicts], seed=record.run.seed
    )
    return rate


def _compute_rates(record: RunRecord, verdicts: Sequence[tuple[str, Sequence[bool | None]]]) -> dict[Reading, Rate]:
    sources = map_scenes_to_sources(record)
    values = np.array([[np.nan if one is None else one for one in readings] for _, readings in verdicts], np.float64)
    values = values.reshape(-1, len(READINGS))
    names = [sources[scene] for scene, _ in verdicts]
    known = ~np.isnan(values)
    rates = compute_ratios_over_scenes(
        np.where(known, values, 0.0), known.astype(np.float64), names, seed=record.run.seed
    )
    return dict(zip(READINGS, rates, strict=True))
