"""What adversaries do, and where: from scene sheets."""

from collections.abc import Sequence

from benchmark.records.scenes import SplitSheet
from benchmark.records.statistics import ManoeuvreRow
from benchmark.report.table import Table
from benchmark.report.words import titled
from leaderboard.frame.sheets import origin_of
from leaderboard.frame.specification import Values, numbers, places, share, tabulate, texts, under

PAPER_NOTE = (
    "The paper names cut-ins, sudden lane changes, tailgating, blocking and blind-spot intrusions, and junctions, "
    "roundabouts and parking areas; it counts none of them, so nothing of it stands beside."
)
_NOTE = (
    "Primary: the one manoeuvre that an adversary is named after, at the place of its closest approach. At any "
    "time: also in passing. Median gap: over the primary ones, between the bodies (docs/manoeuvres.md)."
)


def manoeuvre_tables(data_name: str, splits: Sequence[SplitSheet]) -> list[Table]:
    """How many adversaries of each split with labels do what, where, and how close they come."""
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
