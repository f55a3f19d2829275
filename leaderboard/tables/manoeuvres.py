"""What adversaries do, and where: from scene sheets."""

from benchmark.records.scenes import Sheets, SplitSheet
from benchmark.records.statistics import ManoeuvreRow
from benchmark.report.cells import PERCENT, UNDEFINED, Shown
from benchmark.report.table import Table, table_of
from benchmark.report.words import titled
from leaderboard.tables.statistics import by_data_set, origin_of

PAPER_NOTE = (
    "The paper names cut-ins, sudden lane changes, tailgating, blocking and blind-spot intrusions, and junctions, "
    "roundabouts and parking areas; it counts none of them, so nothing of it stands beside."
)


def manoeuvre_tables(sheets: Sheets) -> dict[str, tuple[Table, ...]]:
    """How many adversaries of each split do what, where, and how close they come.

    Args:
        sheets: Sheets of any splits; those without labels have no table.

    Returns:
        Tables by name of the data set.
    """
    return by_data_set(
        sheets, lambda name, splits: [_table(name, split) for split in splits if split.statistics.labelled]
    )


def _table(data_name: str, split: SplitSheet) -> Table:
    statistics, origin = split.statistics, origin_of(split)
    places = tuple(statistics.places)
    adversaries = statistics.labelled
    rows: list[tuple[str | Shown, ...]] = [
        (row.manoeuvre, *_cells(split, row, places)) for row in statistics.manoeuvres
    ]
    in_all: tuple[str | Shown, ...] = (
        origin.count(sum(row.primary for row in statistics.manoeuvres), "adversaries", adversaries).shown(),
        UNDEFINED,
        UNDEFINED,
        *(origin.count(statistics.places[place], "adversaries", adversaries).shown() for place in places),
        UNDEFINED,
    )
    return table_of(
        f"manoeuvres-{split.split}",
        f"{titled(data_name, split.split)}: what adversaries do, and where",
        ("manoeuvre", "primary", "%", "at any time", *places, "median gap, m"),
        [*rows, ("all", *in_all)],
        notes=(
            "Primary: the one manoeuvre that an adversary is named after, at the place of its closest approach. At any "
            "time: also in passing. Median gap: over the primary ones, between the bodies (docs/manoeuvres.md).",
            PAPER_NOTE,
        ),
        groups=(
            ("", 1),
            ("adversaries", 3),
            ("primary ones by place", len(places)),
            ("smallest gap in m", 1),
        ),
    )


def _cells(split: SplitSheet, row: ManoeuvreRow, places: tuple[str, ...]) -> tuple[Shown, ...]:
    origin, adversaries = origin_of(split), split.statistics.labelled
    return (
        origin.count(row.primary, "adversaries", adversaries).shown(),
        origin.cell(row.primary / adversaries, PERCENT, adversaries, "adversaries", scale=100.0).shown(1),
        origin.count(row.occurred, "adversaries", adversaries).shown(),
        *(origin.count(row.places.get(place, 0), "adversaries", row.primary).shown() for place in places),
        origin.cell(row.median_gap_m, "m", row.primary, "adversaries").shown(2),
    )
