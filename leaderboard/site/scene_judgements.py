"""What the site's index says of who survives a scene, and of how severe each planner's plans are in it."""

from collections.abc import Sequence
from typing import Any, Final

from benchmark.metrics.attacks import SceneAttack, scene_attacks
from benchmark.metrics.effect import attributes
from benchmark.records.judgement import DRIVER_NAMES, JudgementSummary
from benchmark.records.row_schema import BriefRow
from benchmark.records.run import RunRecord

_DIGITS: Final = 3


def judgement_entry(judgement: JudgementSummary | None) -> dict[str, Any] | None:
    """What was said of a scene.

    Args:
        judgement: It, or ``None`` where nobody judged the scene.

    Returns:
        ``survives`` (names of drivers), ``unsolvable``, ``margin``, ``gap``, ``ttc``, ``tet``, ``pet``, ``btn`` of the
        recorded ego, ``faults`` (words), ``unknown`` (words), ``map``; null where there is nothing to say.
    """
    if judgement is None:
        return None
    return {
        "survives": [name for name in DRIVER_NAMES if judgement.survives.get(name)],
        "unsolvable": judgement.unsolvable is True,
        "margin": _short(judgement.margin_s),
        "gap": _short(judgement.least_gap_m),
        "ttc": _short(judgement.least_ttc_s),
        "tet": _short(judgement.tet_s),
        "pet": _short(judgement.pet_s),
        "btn": _short(judgement.max_btn),
        "faults": [name.replace("_", " ") for name in judgement.faults],
        "unknown": [name.replace("_", " ") for name in judgement.unknown_faults],
        "map": judgement.has_map,
    }


def severity_entries(record: RunRecord) -> dict[str, dict[str, Any]]:
    """How severe a planner's plans are, by scene; only of scenes with something to say.

    Args:
        record: Of one planner on one split.

    Returns:
        ``contacts`` (samples whose first contact is with an adversary, with anybody on a split without them),
        ``bystanders`` (samples whose first contact is with somebody else; null on a split without adversaries),
        ``atFault`` and ``attributable`` (verdicts on the scene, null where nobody can tell), of the most severe of
        ``contacts`` its ``kind``, ``speed``, ``deltaV`` and ``fatal``, and of samples without contact ``ttc`` and
        ``gap``.
    """
    attacks, rows_of, adversarial = scene_attacks(record), _rows_of(record), attributes(record)
    return {
        scene: _entry(rows, attacks[scene], adversarial)
        for scene, rows in rows_of.items()
        if any(row.severity is not None and (row.severity.contact or row.severity.near) for row in rows)
    }


def _rows_of(record: RunRecord) -> dict[str, list[BriefRow]]:
    found: dict[str, list[BriefRow]] = {}
    for row in record.columns.brief:
        if row.status == "ok" and row.complete and row.severity is not None:
            found.setdefault(row.scene, []).append(row)
    return found


def _entry(rows: Sequence[BriefRow], attack: SceneAttack, adversarial: bool) -> dict[str, Any]:
    said = [row.severity for row in rows if row.severity is not None]
    touched = [each.contact for each in said if each.contact is not None]
    contacts = [each for each in touched if each.adversary or not adversarial]
    near = [each.near for each in said if each.near is not None]
    worst = max(contacts, key=lambda contact: (contact.delta_v_ego_m_s, contact.impact_speed_m_s), default=None)
    return {
        "contacts": len(contacts),
        "bystanders": len(touched) - len(contacts) if adversarial else None,
        "atFault": attack.verdicts["at_fault"],
        "attributable": attack.verdicts["attributable"],
        "kind": None if worst is None else worst.kind.replace("_", " "),
        "speed": None if worst is None else _short(worst.impact_speed_m_s),
        "deltaV": None if worst is None else _short(worst.delta_v_ego_m_s),
        "fatal": None if worst is None else float(f"{worst.fatal_probability:.3g}"),
        "ttc": _short(min((each.least_ttc_s for each in near if each.least_ttc_s is not None), default=None)),
        "gap": _short(min((each.least_gap_m for each in near), default=None)),
    }


def _short(value: float | None) -> float | None:
    return None if value is None else round(value, _DIGITS)
