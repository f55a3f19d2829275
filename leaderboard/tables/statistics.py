"""A data set in numbers, its manoeuvres, how close adversaries come, what the search discarded: from scene sheets."""

from collections import Counter
from collections.abc import Sequence
from functools import partial
from operator import attrgetter

from benchmark.published import ADV_NUSC, DATA_SET_SOURCE
from benchmark.records.review import review_words
from benchmark.records.scenes import AttemptFacts, SplitSheet
from benchmark.records.statistics import ManoeuvreRow, Quantiles
from benchmark.report.table import Table
from benchmark.report.words import titled
from leaderboard.frame.sheets import counts_of, origin_of
from leaderboard.frame.specification import Column, Values, numbers, places, share, tabulate, texts, under
from leaderboard.tables.published import published_rows

KEPT = "kept"
QUANTILES = tuple(Quantiles.model_fields)
_CLOSENESS = [
    *texts("split", "quantity"),
    *under("counted", numbers("adversaries")),
    *under("quantiles over adversaries", numbers(*QUANTILES)),
]
_SEARCH = [
    *texts("outcome"),
    *under("vehicles tried", numbers("vehicles"), numbers("%", digits=1)),
    *under("from", numbers("recorded scenes")),
]
PAPER_NOTE = (
    "The paper names cut-ins, sudden lane changes, tailgating, blocking and blind-spot intrusions, and junctions, "
    "roundabouts and parking areas; it counts none of them, so nothing of it stands beside."
)
_NOTE = (
    "Primary: the one manoeuvre that an adversary is named after, at the place of its closest approach. At any "
    "time: also in passing. Median gap: over the primary ones, between the bodies (docs/manoeuvres.md)."
)


def statistics_tables(data_name: str, splits: Sequence[SplitSheet]) -> list[Table | None]:
    """The paper's overview of its data set for one of ours, closeness, and the search."""
    return [_counts(data_name, splits), _closeness(data_name, splits), *(_search(data_name, each) for each in splits)]


def _counts(data_name: str, splits: Sequence[SplitSheet]) -> Table:
    rows: list[Values] = []
    for name in ADV_NUSC:
        words = name.replace("_", " ")
        ours = counts_of(splits, words, attrgetter(f"statistics.counts.{name}"))
        rows.append({"rows of": words, **ours, "paper": published_rows(name)})
    for many in sorted({many for split in splits for many in split.statistics.adversaries_per_scene}):
        label = f"scenes with {many} {'adversary' if many == 1 else 'adversaries'}"
        rows.append({"rows of": label, **counts_of(splits, "scenes", partial(_scenes_with, many))})
    columns = [
        *texts("rows of"),
        *under("here", places(split.split for split in splits)),
        *under("paper", [Column("Adv-nuSc (paper)", "paper")]),
    ]
    notes = (
        "Rows of the tables of each split. Adv-nuSc: made from the nuScenes validation split.",
        *(f"{split.split}: {review_words(split.review)}." for split in splits if split.review is not None),
    )
    title = f"{data_name}: the data set in numbers"
    return tabulate("data-set", title, columns, rows, notes, sources=(DATA_SET_SOURCE,))


def _scenes_with(adversaries: int, split: SplitSheet) -> int:
    return split.statistics.adversaries_per_scene.get(adversaries, 0)


def _closeness(data_name: str, splits: Sequence[SplitSheet]) -> Table | None:
    rows: list[Values] = []
    for split in splits:
        found, origin = split.statistics, origin_of(split)
        measured = (
            ("smallest gap between the bodies, m", "m", found.labelled, found.gap_m, 2),
            ("time to collision, s", "s", found.within_5_s, found.time_to_collision_s, 1),
        )
        for label, unit, count, quantiles, digits in measured:
            if quantiles is None:
                continue
            levels = {name: origin.cell(getattr(quantiles, name), unit, count, "adversaries") for name in QUANTILES}
            rows.append(
                {
                    "split": split.split,
                    "quantity": label,
                    "adversaries": origin.count(count, "adversaries", found.labelled),
                    **{name: level.shown(digits) for name, level in levels.items()},
                }
            )
    if not rows:
        return None
    note = "Time to collision: the least one of each adversary that comes within 5 s of one. The paper has none."
    return tabulate("closeness", f"{data_name}: how close adversaries come to the ego", _CLOSENESS, rows, (note,))


def _search(data_name: str, split: SplitSheet) -> Table | None:
    attempts = split.attempts
    if not attempts:
        return None
    outcomes = Counter(_outcome(attempt) for attempt in attempts)
    order = sorted(outcomes, key=lambda outcome: (outcome != KEPT, -outcomes[outcome], outcome))
    rows = [_tried(split, outcome, [each for each in attempts if _outcome(each) == outcome]) for outcome in order]
    title = f"{titled(data_name, split.split)}: what the search tried, and why it discarded it"
    note = "The paper names the reasons for which it discards scenes and counts none."
    return tabulate(f"search-{split.split}", title, _SEARCH, [*rows, _tried(split, "all", attempts)], (note,))


def _outcome(attempt: AttemptFacts) -> str:
    return attempt.discarded or KEPT


def _tried(split: SplitSheet, outcome: str, chosen: Sequence[AttemptFacts]) -> Values:
    origin, every = origin_of(split), len(split.attempts)
    scenes, all_scenes = ({attempt.source for attempt in some} for some in (chosen, split.attempts))
    return {
        "outcome": outcome,
        "vehicles": origin.count(len(chosen), "vehicles", every),
        "%": share(origin, len(chosen), every, "vehicles"),
        "recorded scenes": origin.count(len(scenes), "recorded scenes", len(all_scenes)),
    }


def manoeuvre_tables(data_name: str, splits: Sequence[SplitSheet]) -> list[Table]:
    """Manoeuvres of the adversaries of each split with labels: how many, where, and how close they come."""
    return [_table(data_name, split) for split in splits if split.statistics.labelled]


def _table(data_name: str, split: SplitSheet) -> Table:
    statistics, origin, adversaries = split.statistics, origin_of(split), split.statistics.labelled
    columns = [
        *texts("manoeuvre"),
        *under("adversaries", numbers("primary"), numbers("%", digits=1), numbers("at any time")),
        *under("primary ones by place", places(statistics.places)),
        *under("smallest gap in m", numbers("median gap, m", digits=2)),
    ]
    in_all = sum(row.primary for row in statistics.manoeuvres)
    every: Values = {
        "manoeuvre": "all",
        "primary": origin.count(in_all, "adversaries", adversaries),
        **{f"#{at}": origin.count(n, "adversaries", adversaries) for at, n in enumerate(statistics.places.values())},
    }
    return tabulate(
        f"manoeuvres-{split.split}",
        f"{titled(data_name, split.split)}: what adversaries do, and where",
        columns,
        [*(_values(split, row) for row in statistics.manoeuvres), every],
        (_NOTE, PAPER_NOTE),
    )


def _values(split: SplitSheet, row: ManoeuvreRow) -> Values:
    origin, adversaries = origin_of(split), split.statistics.labelled
    counts = [row.places.get(place, 0) for place in split.statistics.places]
    return {
        "manoeuvre": row.manoeuvre,
        "primary": origin.count(row.primary, "adversaries", adversaries),
        "%": share(origin, row.primary, adversaries, "adversaries"),
        "at any time": origin.count(row.occurred, "adversaries", adversaries),
        **{f"#{at}": origin.count(count, "adversaries", row.primary) for at, count in enumerate(counts)},
        "median gap, m": origin.cell(row.median_gap_m, "m", row.primary, "adversaries"),
    }
