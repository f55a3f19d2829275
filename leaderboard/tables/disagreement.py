"""What each protocol misses and invents, measured by ``exact`` on the same plans."""

from collections.abc import Sequence

from benchmark.metrics.confusion import Confusion, ProtocolComparison, comparisons
from benchmark.metrics.disagreement import CAUSES, EXACT, OTHER_INSTANTS, RUNGS
from benchmark.records.run import RunRecord
from benchmark.report.cells import Cell, Origin, Shown, number, record_name
from benchmark.report.table import Brief, Table, table_of
from benchmark.report.words import titled
from leaderboard.tables.rows import (
    STALE_MARK,
    completeness_notes,
    in_table_order,
    notes_of_marks,
    row_name,
    stale_notes,
)

_SHORT = dict(
    zip(
        (*RUNGS, OTHER_INSTANTS),
        ("between", "class", "later", "range", "points", "heading", "raster", "mask", "instants"),
        strict=True,
    )
)
"""Column heads."""


_Found = tuple[RunRecord, str, ProtocolComparison]
"""A run, a protocol, and how the two compare."""


def disagreement_table(data_name: str, split: str, records: Sequence[RunRecord]) -> Table:
    """False alarms and misses of every protocol with their causes, from rows alone.

    Args:
        data_name: Name of the data set, for the title.
        split: The split.
        records: Run records; those of other data sets or splits, or not judged by ``exact``, are left out.

    Returns:
        One row for each planner and protocol but ``exact``; causes that nobody shows have no column.
    """
    runs = [
        record
        for record in in_table_order(records)
        if record.run.data.name == data_name and record.run.split == split and EXACT in record.run.protocols
    ]
    found = [(record, protocol, one) for record in runs for protocol, one in comparisons(record).items()]
    shown = [cause for cause in CAUSES if any(one.causes is not None and one.causes[cause] for _, _, one in found)]
    title = f"{titled(data_name, split)}: what each protocol misses and invents, measured by exact"
    notes = _notes(runs, found)
    return table_of(
        f"disagreement-{split}",
        title,
        (
            "planner",
            "protocol",
            "samples",
            "exact +",
            "official +",
            "misses",
            "false alarms",
            *(_short(cause) for cause in shown),
            "mask took",
            "step misses",
            "step false alarms",
        ),
        [_row(record, protocol, one, shown) for record, protocol, one in found],
        notes=notes,
        brief=Brief(title, (0, 1, 2, 5, 6, 7 + len(shown)), notes, text_columns=2),
        text_columns=2,
        groups=(
            ("", 2),
            ("samples, exact and the row's protocol", 5),
            ("causes, the row's protocol against exact", len(shown)),
            ("steps, exact and the row's protocol", 3),
        ),
    )


def _row(record: RunRecord, protocol: str, one: ProtocolComparison, shown: Sequence[str]) -> tuple[str | Shown, ...]:
    origin = Origin(f"{protocol} against {EXACT}", record_name(record))
    samples, steps, causes = one.samples, one.steps, one.causes
    compared = samples.compared

    def among(count: int | None) -> Cell:
        return origin.count(count, "samples", compared)

    removed = origin.count(one.mask_removed_steps, "steps", steps.compared)
    return (
        row_name(record, EXACT),
        f"{protocol} {STALE_MARK}" if protocol in record.stale_protocols else protocol,
        *(among(count).shown() for count in (compared, samples.exact, samples.official)),
        *_wrong(origin, samples, "samples"),
        *(among(None if causes is None else causes[cause]).shown() for cause in shown),
        removed.shown(after=f" ({one.samples_with_removed_steps})"),
        *_wrong(origin, steps, "steps"),
    )


def _wrong(origin: Origin, found: Confusion, of: str) -> tuple[Shown, Shown]:
    """Misses and false alarms with their shares."""
    missed = origin.count(found.missed, of, found.exact)
    false_alarms = origin.count(found.false_alarms, of, found.official)
    return missed.shown(after=_share(found.missed_share)), false_alarms.shown(after=_share(found.false_share))


def _share(share: float | None) -> str:
    return f" ({number(None if share is None else 100 * share, 1)})"


def _short(cause: str) -> str:
    kind, _, rung = cause.partition(": ")
    return f"{kind.partition(' ')[0]}: {_SHORT[rung]}"


def _notes(runs: Sequence[RunRecord], found: Sequence[_Found]) -> tuple[str, ...]:
    notes = [
        "A sample is positive if the plan collides at any time within 3 s; exact looks at all objects all the time, "
        "the official verdict is the one after the protocol's mask. Only samples count that both count. Brackets: % of "
        "exact + for misses, of official + for false alarms.",
        f"Causes (docs/footguns.md): {', '.join(f'{_SHORT[rung]} = {rung}' for rung in RUNGS[:5])}.",
        "Mask took: steps (and samples with such steps) that a protocol drops because, in its eyes, the recorded ego "
        "collides there too. Steps: the verdicts at the six waypoints, where exact looks at the waypoint alone.",
    ]
    unknown = sorted({f"{record.planner} ({protocol})" for record, protocol, one in found if one.causes is None})
    if unknown:
        notes.append(
            f"No causes in the records of {', '.join(unknown)}; challenger-bench rescore finds them with the data set."
        )
    notes += notes_of_marks(runs)
    for record in runs:
        notes += stale_notes(record, sorted(record.run.protocols))
    return (*notes, *completeness_notes(runs))
