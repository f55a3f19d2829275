"""Attack success on a planner from its record, in three readings: of samples, and of scenes.

``docs/severity.md``, "Attack success in three readings". Of a scene one sample is enough; of what is unknown nothing is
counted.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from benchmark.metrics.rates import Rate, ratios_over_scenes
from benchmark.metrics.scores import source_of_scenes
from benchmark.records.columns import BriefRow
from benchmark.records.run import RunRecord
from benchmark.records.seed_splits import is_adversarial
from benchmark.severity.attack import READINGS, Attack, Reading, any_known

__all__ = [
    "READINGS",
    "AttackRates",
    "Reading",
    "SceneAttack",
    "attack_facts",
    "attack_rates",
    "counted_rows",
    "has_adversaries",
    "says_severity",
    "scene_attacks",
]
# The leaderboard reads records: what it says of attacks, it has from here.


@dataclass(frozen=True, slots=True)
class SceneAttack:
    """Attack success in one scene.

    Attributes:
        samples: Of each sample that counts.
        verdicts: On the scene, by reading; ``None`` where nobody can tell.
    """

    samples: tuple[Attack, ...]
    verdicts: dict[Reading, bool | None]


@dataclass(frozen=True, slots=True)
class AttackRates:
    """Attack success on one planner.

    Attributes:
        samples: Rate of samples by reading.
        scenes: Rate of scenes by reading.
        judged: Scenes of which somebody said whether the careful human survives them.
        spared: Scenes among them that the careful human survives.
        unknown_blame: Samples with a contact of which nobody can tell whose fault it is.
    """

    samples: dict[Reading, Rate]
    scenes: dict[Reading, Rate]
    judged: int
    spared: int
    unknown_blame: int


def has_adversaries(record: RunRecord) -> bool:
    """Whether a record is of a split with adversaries."""
    facts = record.run.scene_facts.values()
    return is_adversarial(record.run.split) or any(fact.adversaries for fact in facts)


def says_severity(record: RunRecord) -> bool:
    """Whether a record says of its plans how severe they are; older ones do not."""
    said = record.columns.values("severity")
    return any(said[place] is not None for place in record.columns.planned.tolist())


def counted_rows(record: RunRecord) -> list[BriefRow]:
    """Samples that have a plan, whose recording goes on for 3 s, and whose surroundings are annotated."""
    return [row for row in record.columns.brief if row.status == "ok" and row.complete and row.severity is not None]


def careful_survives(record: RunRecord, scene: str) -> bool | None:
    """Whether the careful and competent human survives a scene; ``None`` where nobody judged it."""
    facts = record.run.scene_facts.get(scene)
    return None if facts is None or facts.judgement is None else facts.judgement.survives.get("cc")


def scene_attacks(record: RunRecord) -> dict[str, SceneAttack]:
    """Attack success in every scene of a record.

    Args:
        record: The record; it must say how severe its plans are (`says_severity`).

    Returns:
        By scene, in the record's order.
    """
    by_scene: dict[str, list[Attack]] = {scene: [] for scene in record.run.scenes}
    survivors = {scene: careful_survives(record, scene) for scene in by_scene}
    for row in counted_rows(record):
        by_scene[row.scene].append(_attack(row, survivors[row.scene]))
    columns = record.columns
    lost = np.flatnonzero(columns.failed & columns.flags("complete")).tolist()
    missing = {columns.values("scene")[place] for place in lost}
    return {
        scene: SceneAttack(
            tuple(found),
            {reading: _of_scene(found, reading, scene in missing, survivors[scene]) for reading in READINGS},
        )
        for scene, found in by_scene.items()
    }


def attack_rates(record: RunRecord) -> AttackRates:
    """Attack success on the planner of a record.

    Args:
        record: The record; it must say how severe its plans are (`says_severity`).

    Returns:
        The rates, with intervals over recorded scenes.
    """
    found = scene_attacks(record)
    samples = [(scene, each) for scene, attack in found.items() for each in attack.samples]
    known = [survives for scene in found if (survives := careful_survives(record, scene)) is not None]
    return AttackRates(
        samples=_rates(record, [(scene, [getattr(each, name) for name in READINGS]) for scene, each in samples]),
        scenes=_rates(record, [(scene, list(attack.verdicts.values())) for scene, attack in found.items()]),
        judged=len(known),
        spared=sum(known),
        unknown_blame=sum(attack.contact and attack.at_fault is None for _, attack in samples),
    )


def attack_facts(record: RunRecord) -> dict[str, Any]:
    """Attack success as JSON values, for machines that read what a command prints.

    Args:
        record: The record.

    Returns:
        ``attack_success``: rates by reading, of ``samples`` and of ``scenes``; nothing of a split without adversaries,
        or where the record does not say how severe its plans are.
    """
    if not (has_adversaries(record) and says_severity(record)):
        return {}
    found = attack_rates(record)
    parts = {"samples": found.samples, "scenes": found.scenes}
    return {
        "attack_success": {part: {name: asdict(rate) for name, rate in rates.items()} for part, rates in parts.items()}
    }


def _attack(row: BriefRow, survives: bool | None) -> Attack:
    contact = None if row.severity is None else row.severity.contact
    return Attack.of(contact is not None, None if contact is None else contact.at_fault, survives)


def _of_scene(attacks: Iterable[Attack], reading: Reading, missing: bool, survives: bool | None) -> bool | None:
    verdicts = [getattr(attack, reading) for attack in attacks]
    if reading == "attributable" and survives is False:
        # Whatever a failed sample would have shown, nothing of this scene is attributed to anybody.
        return False if verdicts else None
    # A sample on which the planner failed could have shown anything.
    return any_known([*verdicts, *([None] if missing or not verdicts else [])])


def _rates(record: RunRecord, verdicts: Sequence[tuple[str, Sequence[bool | None]]]) -> dict[Reading, Rate]:
    sources = source_of_scenes(record)
    said = np.array([[np.nan if one is None else one for one in each] for _, each in verdicts], np.float64)
    said = said.reshape(-1, len(READINGS))
    names = [sources[scene] for scene, _ in verdicts]
    known = ~np.isnan(said)
    found = ratios_over_scenes(np.where(known, said, 0.0), known.astype(np.float64), names, seed=record.run.seed)
    return dict(zip(READINGS, found, strict=True))
