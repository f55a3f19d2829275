"""Entries of a challenge, ranked, and which places are not told apart."""

from collections.abc import Iterator, Sequence
from typing import Final

from benchmark.metrics.disagreement import EXACT
from benchmark.records.challenge import ChallengeScores, EntryScore, PlannerEntryScore, Rank, ScoredQuantity
from benchmark.report.cells import UNDEFINED, CellSource, ValueSource
from benchmark.report.table import Table, escape_markdown
from leaderboard.frame.rows import FEW_NOTE, FEW_SCENES, list_planner_marks, name_cell
from leaderboard.frame.specification import (
    Columns,
    Values,
    estimate_columns,
    group_columns,
    number_columns,
    tabulate,
    text_columns,
)
from leaderboard.page.sections import Section

CHALLENGES: Final = "challenges"
"""Heading above these tables."""
_ATTRIBUTABLE: Final = "attributable (%)"
_RANKED_BY: Final[dict[Rank, str]] = {
    "adversary": "of how often their plans touch a changed vehicle before anything else, higher is better; any "
    "contact, bystanders included, is shown beside it",
    "collision": "of their collision rates, higher is better; first contacts with a changed vehicle are shown beside "
    "them, a dash if the scores do not record the objects touched",
}
_RANK_NOTE: Final = (
    "Ranked by the mean over the planners {}. A refused scene counts as one without a collision. Places: ranges "
    "that the numbers allow; two entries are separated if the 95 % interval of their difference, in resamples of the "
    "same recordings, excludes zero."
)
_ADVERSARY: Final = "adversary (%)"
_HEADS: Final[dict[Rank, tuple[str, ...]]] = {
    "adversary": (_ADVERSARY, "any contact (%)"),
    "collision": ("collision rate (%)", _ADVERSARY),
}
"""The rate that ranks comes first."""
_BESIDE_NOTE: Final = (
    "Attributable: contact that is the planner's fault where the careful and competent human (UN R157) survives; "
    "survives: share of scenes that this driver survives; gap: least distance of the recorded ego and the changed "
    "vehicle, mean; critical: share of scenes in which the two are ever within 1.5 s of contact; delta-v: of the ego "
    "where a plan first touches a changed vehicle (of any contact in older files), mean; realism: 1 minus the "
    "divergence of the worst feature of motion from the recordings, higher is better. Brackets: 95 % bootstrap "
    "interval over recordings."
)


def challenge_tables(scores: ChallengeScores) -> list[Table]:
    """The ranking, the planners on each entry, and what is not told apart where there is more than one entry."""
    tables = [_ranking(scores), _planners(scores)]
    return [*tables, _pairs(scores)] if scores.pairs else tables


def _find_origin(scores: ChallengeScores, protocol: str | None) -> ValueSource:
    return ValueSource(protocol=protocol, record=f"rules {scores.rules[:12]}, {scores.challenge}")


def _rates(scores: ChallengeScores, of: EntryScore | PlannerEntryScore) -> Values:
    """First contacts with a changed vehicle, and contacts under the protocol; what is the planner's fault."""
    any_contact = _find_origin(scores, scores.protocol).percent(of.collision)
    return {
        **dict.fromkeys(_HEADS[scores.ranks], any_contact),
        _ADVERSARY: _find_origin(scores, EXACT).percent(of.adversary),
        _ATTRIBUTABLE: _find_origin(scores, None).percent(of.attributable),
    }


def _rate_columns(scores: ChallengeScores, after: str = "") -> Columns:
    groups = (f"{protocol}, {scores.horizon}{after}" for protocol in (scores.protocol, EXACT))
    first, other = map(group_columns, groups, map(_estimates, _HEADS[scores.ranks]))
    return [*first, *other]


def _estimates(*heads: str, digits: int = 1) -> Columns:
    return estimate_columns(*heads, digits=digits, ends=digits, beside="95 %")


def _ranking(scores: ChallengeScores) -> Table:
    notes = [_RANK_NOTE.format(_RANKED_BY[scores.ranks]), _BESIDE_NOTE]
    listed = [f"{entry.entry.name} {entry.reasons[0].sentence}" for entry in scores.entries if entry.reasons]
    notes += [f"Not ranked: {'; '.join(listed)}."] if listed else []
    notes += sorted(
        {
            f"Realism: not compared; {entry_score.not_compared}."
            for entry_score in scores.entries
            if entry_score.not_compared
        }
    )
    if any(entry.scenes < FEW_SCENES for entry in scores.entries):
        notes.append(FEW_NOTE)
    first, other = _HEADS[scores.ranks]
    return tabulate(
        f"challenge-{scores.challenge}",
        f"{scores.challenge}: entries on {scores.base.name}",
        [
            *text_columns("place", "entry"),
            *number_columns("scenes", "refused"),
            *_rate_columns(scores, f", mean of {len(scores.planners)} planners"),
            *group_columns("severity, mean of planners", _estimates(_ATTRIBUTABLE)),
            *group_columns(
                "severity",
                *(_estimates("survives (%)"), _estimates("gap, m", digits=2)),
                *(_estimates("critical (%)"), _estimates("delta-v, m/s")),
            ),
            *group_columns("realism", number_columns("without fault (%)", digits=1), _estimates("realism", digits=3)),
            *group_columns("realism", number_columns("feature")),
        ],
        [_row(scores, entry) for entry in scores.entries],
        notes,
        brief=(
            *("place", "entry", "scenes", "refused", first, f"95 % of {first}", other),
            *(_ATTRIBUTABLE, f"95 % of {_ATTRIBUTABLE}", "survives (%)", "gap, m", "realism"),
        ),
        brief_title="Entries, best first",
    )


def _row(scores: ChallengeScores, entry: EntryScore) -> Values:
    plain = _find_origin(scores, None)
    return {
        "place": _place(entry),
        "entry": entry.entry.name,
        "scenes": plain.count(entry.scenes, "scenes"),
        "refused": plain.count(len(entry.refused), "scenes", entry.scenes),
        **_rates(scores, entry),
        "survives (%)": plain.percent(entry.careful_survives, "scenes"),
        "gap, m": plain.amount(entry.least_gap_m, "m", "scenes"),
        "critical (%)": plain.percent(entry.critical, "scenes"),
        "delta-v, m/s": plain.amount(entry.delta_v_m_s, "m/s", "samples with a contact"),
        "without fault (%)": plain.percent(entry.without_fault, "scenes"),
        "realism": plain.amount(entry.realism, "realism", "samples of adversaries"),
        "feature": entry.realism_feature or None,
    }


def _place(entry: EntryScore) -> str:
    if entry.best_place is None or entry.worst_place is None:
        return UNDEFINED
    best, worst = entry.best_place, entry.worst_place
    return str(best) if best == worst else f"{best}-{worst}"


def _planners(scores: ChallengeScores) -> Table:
    plain = _find_origin(scores, None)
    rows = [
        {
            "planner": name_cell(planner.name, planner),
            "entry": entry.entry.name,
            **_rates(scores, entry.planners[planner.name]),
            "failed": plain.count(entry.planners[planner.name].failed, "samples without a plan"),
        }
        for planner in scores.planners
        for entry in scores.entries
        if planner.name in entry.planners
    ]
    return tabulate(
        f"challenge-planners-{scores.challenge}",
        f"{scores.challenge}: planners on each entry",
        [
            *text_columns("planner", "entry"),
            *_rate_columns(scores),
            *group_columns("severity", _estimates(_ATTRIBUTABLE)),
            *number_columns("failed"),
        ],
        rows,
        list_planner_marks(scores.planners),
    )


def _pairs(scores: ChallengeScores) -> Table:
    label = f"{_HEADS[scores.ranks][0].removesuffix(' (%)')}, {scores.protocol}, {scores.horizon}"
    difference = "difference (points)"
    return tabulate(
        f"challenge-pairs-{scores.challenge}",
        f"{scores.challenge}: separated entries",
        [
            *text_columns("first", "second"),
            *group_columns(
                label, estimate_columns(difference, beside="95 %", signed=True), number_columns("told apart")
            ),
        ],
        [
            {
                "first": pair.first,
                "second": pair.second,
                difference: _difference_cell(pair.difference, _find_origin(scores, scores.protocol)),
                "told apart": "yes" if pair.told_apart else "no",
            }
            for pair in scores.pairs
        ],
        ["Each pair has its own 95 % interval; of many pairs, a few are separated by chance."],
    )


def _difference_cell(measured: ScoredQuantity, origin: ValueSource) -> CellSource:
    return origin.cell(
        measured.value, "points", measured.denominator, "resamples", low=measured.low, high=measured.high, scale=100
    )


def build_sections(challenges: Sequence[ChallengeScores]) -> Iterator[Section]:
    """The tables of challenges, beside those of the planners on the same recordings."""
    for scores in challenges:
        heading = f"{escape_markdown(scores.base.name)}: challenge {escape_markdown(scores.challenge)}"
        yield Section.of_tables(scores.base.name, CHALLENGES, heading, challenge_tables(scores))
