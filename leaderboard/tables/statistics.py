"""A data set in numbers, how close adversaries come, and what the search discarded and why: from scene sheets."""

from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence

from benchmark.published import ADV_NUSC, DATA_SET_SOURCE
from benchmark.records.review import review_words
from benchmark.records.scenes import AttemptFacts, Sheets, SplitSheet
from benchmark.records.statistics import Quantiles
from benchmark.report.cells import PERCENT, UNDEFINED, Origin, Shown, named_record
from benchmark.report.table import Table, table_of
from benchmark.report.words import titled
from leaderboard.frame.rows import split_place
from leaderboard.tables.published import published_rows

KEPT = "kept"
QUANTILES = tuple(Quantiles.model_fields)


def by_data_set(
    sheets: Sheets, tables: Callable[[str, list[SplitSheet]], Iterable[Table | None]]
) -> dict[str, tuple[Table, ...]]:
    """Tables of the splits of each data set, the paper's three first.

    Args:
        sheets: All of them.
        tables: Makes those of a data set, by its name; ``None`` where there is nothing to show.

    Returns:
        By the data set's name, in the order of the names; data sets without tables are left out.
    """
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
    """Where the numbers of a split come from: the data set's fingerprint stands for a record."""
    return Origin(record=named_record(sheet.data.fingerprint[:12], sheet.data.name, sheet.split))


def statistics_tables(sheets: Sheets) -> dict[str, tuple[Table, ...]]:
    """The paper's overview of its data set for each data set of ours, closeness, and the search.

    Args:
        sheets: Sheets of any splits.

    Returns:
        Tables by name of the data set.
    """

    def tables(name: str, splits: Sequence[SplitSheet]) -> list[Table | None]:
        return [_counts(name, splits), _closeness(name, splits), *(_search(name, split) for split in splits)]

    return by_data_set(sheets, tables)


def _counts(data_name: str, splits: Sequence[SplitSheet]) -> Table:
    rows: list[tuple[str | Shown, ...]] = []
    for name in ADV_NUSC:
        ours = [_rows(split, name.replace("_", " "), getattr(split.statistics.counts, name)) for split in splits]
        rows.append((name.replace("_", " "), *ours, published_rows(name)))
    for many in sorted({many for split in splits for many in split.statistics.adversaries_per_scene}):
        label = f"scenes with {many} {'adversary' if many == 1 else 'adversaries'}"
        ours = [_rows(split, "scenes", split.statistics.adversaries_per_scene.get(many, 0)) for split in splits]
        rows.append((label, *ours, UNDEFINED))
    return table_of(
        "data-set",
        f"{data_name}: the data set in numbers",
        ("rows of", *(split.split for split in splits), "Adv-nuSc (paper)"),
        rows,
        notes=(
            "Rows of the tables of each split. Adv-nuSc: made from the nuScenes validation split.",
            *(f"{split.split}: {review_words(split.review)}." for split in splits if split.review is not None),
        ),
        groups=(("", 1), ("here", len(splits)), ("paper", 1)),
        sources=(DATA_SET_SOURCE,),
    )


def _rows(split: SplitSheet, of: str, count: int) -> Shown:
    return Shown(f"{count:,}", origin_of(split).count(count, of))


def _closeness(data_name: str, splits: Sequence[SplitSheet]) -> Table | None:
    rows: list[tuple[str | Shown, ...]] = []
    for split in splits:
        found = split.statistics
        measured = (
            ("smallest gap between the bodies, m", "m", found.labelled, found.gap_m, 2),
            ("time to collision, s", "s", found.within_5_s, found.time_to_collision_s, 1),
        )
        for label, unit, count, quantiles, digits in measured:
            if quantiles is None:
                continue
            levels = [origin_of(split).cell(getattr(quantiles, name), unit, count, "adversaries") for name in QUANTILES]
            adversaries = origin_of(split).count(count, "adversaries", found.labelled).shown()
            rows.append((split.split, label, adversaries, *(level.shown(digits) for level in levels)))
    if not rows:
        return None
    return table_of(
        "closeness",
        f"{data_name}: how close adversaries come to the ego",
        ("split", "quantity", "adversaries", *QUANTILES),
        rows,
        notes=("Time to collision: the least one of each adversary that comes within 5 s of one. The paper has none.",),
        text_columns=2,
        groups=(("", 2), ("counted", 1), ("quantiles over adversaries", len(QUANTILES))),
    )


def _search(data_name: str, split: SplitSheet) -> Table | None:
    attempts = split.attempts
    if not attempts:
        return None
    outcomes = Counter(_outcome(attempt) for attempt in attempts)
    order = sorted(outcomes, key=lambda outcome: (outcome != KEPT, -outcomes[outcome], outcome))
    rows: list[tuple[str | Shown, ...]] = [(outcome, *_tried(split, attempts, outcome)) for outcome in order]
    rows.append(("all", *_tried(split, attempts, None)))
    return table_of(
        f"search-{split.split}",
        f"{titled(data_name, split.split)}: what the search tried, and why it discarded it",
        ("outcome", "vehicles", "%", "recorded scenes"),
        rows,
        notes=("The paper names the reasons for which it discards scenes and counts none.",),
        groups=(("", 1), ("vehicles tried", 2), ("from", 1)),
    )


def _outcome(attempt: AttemptFacts) -> str:
    return attempt.discarded or KEPT


def _tried(split: SplitSheet, attempts: Sequence[AttemptFacts], outcome: str | None) -> tuple[Shown, ...]:
    chosen = [attempt for attempt in attempts if outcome in (None, _outcome(attempt))]
    every, share = len(attempts), len(chosen) / len(attempts)
    scenes = {attempt.source for attempt in chosen}
    return (
        origin_of(split).count(len(chosen), "vehicles", every).shown(),
        origin_of(split).cell(share, PERCENT, every, "vehicles", scale=100.0).shown(1),
        origin_of(split).count(len(scenes), "recorded scenes", len({attempt.source for attempt in attempts})).shown(),
    )
