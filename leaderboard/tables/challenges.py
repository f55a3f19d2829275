"""Entries of a challenge, ranked, and which places are not told apart."""

from typing import Final

from benchmark.records.challenge_scores import ChallengeScores, EntryScore, Measured, Pair
from benchmark.report.cells import UNDEFINED, Origin, Shown
from benchmark.report.table import Brief, Table, table_of
from leaderboard.tables.rows import FEW_NOTE, FEW_SCENES, mark_notes, name_cell

CHALLENGES: Final = "challenges"
"""What these tables are shown under."""
_BRIEF: Final = (0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 17)
"""What a terminal shows of the ranking: places, rates, attributable success, fairness, gap, realism."""
_RANK_NOTE: Final = (
    "Ranked by the mean over the planners of their collision rates, the higher the better. A refused scene counts as "
    "one on which nobody collides. Places: those that the numbers leave open; of two entries the 95 % interval of "
    "their difference, in resamples of the same recordings, leaves zero out or they are not told apart."
)
_BESIDE_NOTE: Final = (
    "Attributable: contact that is the planner's fault where the careful and competent human (UN R157) survives; "
    "survives: share of scenes that this driver survives; gap: least distance of the recorded ego and the changed "
    "vehicle, mean; critical: share of scenes in which the two are ever within 1.5 s of contact; delta-v: of the ego "
    "in contacts of all plans, mean; realism: 1 less the divergence of the worst feature of motion from the "
    "recordings, the larger the better. Brackets: 95 % bootstrap interval over recordings."
)


def challenge_tables(scores: ChallengeScores) -> list[Table]:
    """Everything that is shown of a challenge.

    Args:
        scores: What ``challenge score`` wrote.

    Returns:
        The ranking, the planners on each entry, and what is not told apart where there is more than one entry.
    """
    tables = [_ranking(scores), _planners(scores)]
    return [*tables, _pairs(scores)] if scores.pairs else tables


def _origin(scores: ChallengeScores, protocol: str | None) -> Origin:
    return Origin(protocol=protocol, record=f"rules {scores.rules[:12]}, {scores.challenge}")


def _ranking(scores: ChallengeScores) -> Table:
    judged, plain = _origin(scores, scores.protocol), _origin(scores, None)
    notes = [_RANK_NOTE, _BESIDE_NOTE]
    listed = [f"{entry.entry.name} {entry.reasons[0].sentence}" for entry in scores.entries if entry.reasons]
    notes += [f"Not ranked: {'; '.join(listed)}."] if listed else []
    notes += sorted({f"Realism: not compared; {each.not_compared}." for each in scores.entries if each.not_compared})
    if any(entry.scenes < FEW_SCENES for entry in scores.entries):
        notes.append(FEW_NOTE)
    return table_of(
        f"challenge-{scores.challenge}",
        f"{scores.challenge}: entries held to {scores.base.name}",
        (
            *("place", "entry", "scenes", "refused", "collision rate (%)", "95 %", "attributable (%)", "95 %"),
            *("survives (%)", "95 %", "gap, m", "95 %", "critical (%)", "95 %", "delta-v, m/s", "95 %"),
            *("without fault (%)", "realism", "95 %", "feature"),
        ),
        [_row(entry, judged, plain) for entry in scores.entries],
        notes=tuple(notes),
        text_columns=2,
        groups=(
            ("", 4),
            (f"{scores.protocol}, {scores.horizon}, mean of {len(scores.planners)} planners", 2),
            ("severity, mean of planners", 2),
            ("severity", 8),
            ("realism", 4),
        ),
        brief=Brief("Entries, best first", _BRIEF, tuple(notes), 2),
    )


def _row(entry: EntryScore, judged: Origin, plain: Origin) -> tuple[str | Shown, ...]:
    return (
        _place(entry),
        entry.entry.name,
        plain.count(entry.scenes, "scenes").shown(),
        plain.count(len(entry.refused), "scenes", entry.scenes).shown(),
        *_percent(judged, entry.collision),
        *_percent(plain, entry.attributable),
        *_percent(plain, entry.careful_survives, "scenes"),
        *_amount(plain, entry.least_gap_m, "m", "scenes", 2),
        *_percent(plain, entry.critical, "scenes"),
        *_amount(plain, entry.delta_v_m_s, "m/s", "samples with a contact", 1),
        plain.percent(entry.without_fault, "scenes").shown(1),
        *_amount(plain, entry.realism, "realism", "samples of adversaries", 3),
        entry.realism_feature or UNDEFINED,
    )


def _place(entry: EntryScore) -> str:
    if entry.best_place is None or entry.worst_place is None:
        return UNDEFINED
    best, worst = entry.best_place, entry.worst_place
    return str(best) if best == worst else f"{best}-{worst}"


def _percent(origin: Origin, measured: Measured, of: str = "samples") -> tuple[Shown, Shown]:
    cell = origin.percent(measured, of)
    return cell.shown(1), cell.interval(1)


def _amount(origin: Origin, measured: Measured, unit: str, of: str, digits: int) -> tuple[Shown, Shown]:
    cell = origin.amount(measured, unit, of)
    return cell.shown(digits), cell.interval(digits)


def _planners(scores: ChallengeScores) -> Table:
    judged, plain = _origin(scores, scores.protocol), _origin(scores, None)
    rows = [
        (
            name_cell(planner.name, privileged=planner.privileged, miniature=planner.miniature),
            entry.entry.name,
            *_percent(judged, entry.planners[planner.name].collision),
            *_percent(plain, entry.planners[planner.name].attributable),
            plain.count(entry.planners[planner.name].failed, "samples without a plan").shown(),
        )
        for planner in scores.planners
        for entry in scores.entries
        if planner.name in entry.planners
    ]
    facts = scores.planners
    return table_of(
        f"challenge-planners-{scores.challenge}",
        f"{scores.challenge}: planners on each entry",
        ("planner", "entry", "collision rate (%)", "95 %", "attributable (%)", "95 %", "failed"),
        rows,
        notes=tuple(mark_notes(privileged=any(p.privileged for p in facts), miniature=any(p.miniature for p in facts))),
        text_columns=2,
        groups=(("", 2), (f"{scores.protocol}, {scores.horizon}", 2), ("severity", 2), ("", 1)),
    )


def _pairs(scores: ChallengeScores) -> Table:
    return table_of(
        f"challenge-pairs-{scores.challenge}",
        f"{scores.challenge}: which entries are told apart",
        ("first", "second", "difference (points)", "95 %", "told apart"),
        [_pair(pair, _origin(scores, scores.protocol)) for pair in scores.pairs],
        notes=("Each pair has its own 95 % interval; of many pairs a few are told apart by chance.",),
        text_columns=2,
        groups=(("", 2), (f"{scores.protocol}, {scores.horizon}", 3)),
    )


def _pair(pair: Pair, origin: Origin) -> tuple[str | Shown, ...]:
    found = pair.difference
    cell = origin.cell(found.value, "points", found.denominator, "resamples", low=found.low, high=found.high, scale=100)
    return pair.first, pair.second, cell.shown(1, signed=True), cell.interval(1), "yes" if pair.told_apart else "no"
