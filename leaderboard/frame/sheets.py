"""Scene sheets: the splits of each data set, and the cells of their numbers."""

from collections.abc import Callable, Iterable, Mapping, Sequence

from benchmark.records.scenes import Sheets, SplitSheet
from benchmark.report.cells import Origin, Shown, named_record
from benchmark.report.table import Table
from leaderboard.frame.rows import split_place
from leaderboard.frame.specification import Value

OfSplits = Callable[[str, Sequence[SplitSheet]], Iterable[Table | None]]
"""Tables of the splits of one data set, by its name; ``None`` where there is nothing to show."""


def by_data_set(sheets: Sheets, tables: OfSplits) -> dict[str, tuple[Table, ...]]:
    """Tables by name of the data set, in the order of the names; the paper's three splits come first."""
    splits: dict[str, list[SplitSheet]] = {}
    for sheet in sorted(sheets.splits.values(), key=lambda sheet: (sheet.data.name, split_place(sheet.split))):
        splits.setdefault(sheet.data.name, []).append(sheet)
    found = {name: tuple(table for table in tables(name, own) if table is not None) for name, own in splits.items()}
    return {name: made for name, made in found.items() if made}


def by_name(parts: Iterable[Mapping[str, Sequence[Table]]]) -> dict[str, tuple[Table, ...]]:
    """Tables of several kinds by name of the data set, in the order of the names."""
    found = list(parts)
    names = sorted({name for part in found for name in part})
    return {name: tuple(table for part in found for table in part.get(name, ())) for name in names}


def origin_of(sheet: SplitSheet) -> Origin:
    """Origin of the numbers of a split: the data set's fingerprint stands for a record."""
    return Origin(record=named_record(sheet.data.fingerprint[:12], sheet.data.name, sheet.split))


def counts_of(splits: Sequence[SplitSheet], of: str, count: Callable[[SplitSheet], int]) -> dict[str, Value]:
    """A count of each split, for `leaderboard.frame.specification.places`."""
    counts = [(split, count(split)) for split in splits]
    return {f"#{at}": Shown(f"{n:,}", origin_of(split).count(n, of)) for at, (split, n) in enumerate(counts)}
