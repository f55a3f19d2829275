"""Entries of a challenge, ranked, and which places are not told apart."""

from collections.abc import Iterator, Sequence
from typing import Final

from benchmark.metrics.disagreement import EXACT
from benchmark.records.challenge_scores import ChallengeScores, EntryScore, Measured, Pair, PlannerOnEntry, Rank
from benchmark.report.cells import UNDEFINED, Origin, Shown
from benchmark.report.table import Brief, Table, escape_markdown, table_of
from leaderboard.frame.rows import FEW_NOTE, FEW_SCENES, marks_of, name_cell
from leaderboard.page.sections import Section

CHALLENGES: Final = "challenges"
"""What these tables are shown under."""
_BRIEF: Final = (0, 1, 2, 3, 4, 5, 6, 8, 9, 10, 12, 19)
"""What a terminal shows of the ranking: places, rates, attributable success, fairness, gap, realism."""
_RANKED_BY: Final[dict[Rank, str]] = {
    "adversary": "of how often their plans touch a changed vehicle before anything else, the higher the better; any "
    "contact, bystanders with it, stands beside it",
    "collision": "of their collision rates, the higher the better; first contacts with a changed vehicle stand beside "
    "them, a dash where the scores do not say whom contacts are with",
}
_RANK_NOTE: Final = (
    "Ranked by the mean over the planners {}. A refused scene counts as one on which nobody collides. Places: those "
    "that the numbers leave open; of two entries the 95 % interval of their difference, in resamples of the same "
    "recordings, leaves zero out or they are not told apart."
)
_HEADS: Final[dict[Rank, tuple[str, ...]]] = {
    "adversary": ("adversary (%)", "95 %", "any contact (%)", "95 %"),
    "collision": ("collision rate (%)", "95 %", "adversary (%)", "95 %"),
}
"""The rate that ranks comes first."""
_BESIDE_NOTE: Final = (
    "Attributable: contact that is the planner's fault where the careful and competent human (UN R157) survives; "
    "survives: share of scenes that this driver survives; gap: least distance of the recorded ego and the changed "
    "vehicle, mean; critical: share of scenes in which the two are ever within 1.5 s of contact; delta-v: of the ego "
    "where a plan first touches a changed vehicle (of any contact in older files), mean; realism: 1 less the "
    "divergence of the worst feature of motion from the recordings, the larger the better. Brackets: 95 % bootstrap "
    "interval over recordings."
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


def _rates(scores: ChallengeScores, of: EntryScore | PlannerOnEntry) -> tuple[Shown, ...]:
    """First contacts with a changed vehicle, and contacts under the protocol, each with its interval."""
    cells = {
        "adversary": _percent(_origin(scores, EXACT), of.adversary),
        "collision": _percent(_origin(scores, scores.protocol), of.collision),
    }
    return *cells.pop(scores.ranks), *(shown for pair in cells.values() for shown in pair)


def _rate_groups(scores: ChallengeScores, after: str = "") -> tuple[tuple[str, int], ...]:
    whole = f"{scores.protocol}, {scores.horizon}{after}"
    if scores.protocol == EXACT:
        return ((whole, 4),)
    return (whole, 2), (f"{EXACT}, {scores.horizon}{after}", 2)


def _ranking(scores: ChallengeScores) -> Table:
    plain = _origin(scores, None)
    notes = [_RANK_NOTE.format(_RANKED_BY[scores.ranks]), _BESIDE_NOTE]
    listed = [f"{entry.entry.name} {entry.reasons[0].sentence}" for entry in scores.entries if entry.reasons]
    notes += [f"Not ranked: {'; '.join(listed)}."] if listed else []
    notes += sorted({f"Realism: not compared; {each.not_compared}." for each in scores.entries if each.not_compared})
    if any(entry.scenes < FEW_SCENES for entry in scores.entries):
        notes.append(FEW_NOTE)
    return table_of(
        f"challenge-{scores.challenge}",
        f"{scores.challenge}: entries held to {scores.base.name}",
        (
            *("place", "entry", "scenes", "refused", *_HEADS[scores.ranks], "attributable (%)", "95 %"),
            *("survives (%)", "95 %", "gap, m", "95 %", "critical (%)", "95 %", "delta-v, m/s", "95 %"),
            *("without fault (%)", "realism", "95 %", "feature"),
        ),
        [_row(scores, entry, plain) for entry in scores.entries],
        notes=tuple(notes),
        text_columns=2,
        groups=(
            ("", 4),
            *_rate_groups(scores, f", mean of {len(scores.planners)} planners"),
            ("severity, mean of planners", 2),
            ("severity", 8),
            ("realism", 4),
        ),
        brief=Brief("Entries, best first", _BRIEF, tuple(notes), 2),
    )


def _row(scores: ChallengeScores, entry: EntryScore, plain: Origin) -> tuple[str | Shown, ...]:
    return (
        _place(entry),
        entry.entry.name,
        plain.count(entry.scenes, "scenes").shown(),
        plain.count(len(entry.refused), "scenes", entry.scenes).shown(),
        *_rates(scores, entry),
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
    plain = _origin(scores, None)
    rows: list[tuple[str | Shown, ...]] = [
        (
            name_cell(planner.name, planner),
            entry.entry.name,
            *_rates(scores, entry.planners[planner.name]),
            *_percent(plain, entry.planners[planner.name].attributable),
            plain.count(entry.planners[planner.name].failed, "samples without a plan").shown(),
        )
        for planner in scores.planners
        for entry in scores.entries
        if planner.name in entry.planners
    ]
    return table_of(
        f"challenge-planners-{scores.challenge}",
        f"{scores.challenge}: planners on each entry",
        ("planner", "entry", *_HEADS[scores.ranks], "attributable (%)", "95 %", "failed"),
        rows,
        notes=marks_of(scores.planners),
        text_columns=2,
        groups=(("", 2), *_rate_groups(scores), ("severity", 2), ("", 1)),
    )


def _pairs(scores: ChallengeScores) -> Table:
    return table_of(
        f"challenge-pairs-{scores.challenge}",
        f"{scores.challenge}: which entries are told apart",
        ("first", "second", "difference (points)", "95 %", "told apart"),
        [_pair(pair, _origin(scores, scores.protocol)) for pair in scores.pairs],
        notes=("Each pair has its own 95 % interval; of many pairs a few are told apart by chance.",),
        text_columns=2,
        groups=(("", 2), (f"{_HEADS[scores.ranks][0].removesuffix(' (%)')}, {scores.protocol}, {scores.horizon}", 3)),
    )


def _pair(pair: Pair, origin: Origin) -> tuple[str | Shown, ...]:
    found = pair.difference
    cell = origin.cell(found.value, "points", found.denominator, "resamples", low=found.low, high=found.high, scale=100)
    return pair.first, pair.second, cell.shown(1, signed=True), cell.interval(1), "yes" if pair.told_apart else "no"


def sections(challenges: Sequence[ChallengeScores]) -> Iterator[Section]:
    """The tables of challenges, beside those of the planners on the same recordings."""
    for scores in challenges:
        heading = f"{escape_markdown(scores.base.name)}: challenge {escape_markdown(scores.challenge)}"
        yield Section.of_tables(scores.base.name, CHALLENGES, heading, challenge_tables(scores))
