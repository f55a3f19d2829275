"""How far consecutive plans of each planner disagree about the same place and time."""

from benchmark.metrics.consistency import INSTANTS, MEAN, Consistency, consistency
from benchmark.report.table import Table
from leaderboard.frame.runs import Frame, Row, row_notes
from leaderboard.frame.specification import Values, estimates, numbers, tabulate, texts, under

_AFTER = {instant: f"after {instant}" for instant in INSTANTS}
_COLUMNS = [
    *texts("planner", "split"),
    *under("distance in m", estimates(MEAN, digits=2), numbers(*_AFTER.values(), digits=2)),
    *under("counted", numbers("pairs")),
]
_NOTE = (
    "Two plans half a second apart, the recorded motion between them taken out: distance at the same instants, by "
    "seconds after the later one. Brackets: 95 % bootstrap interval over recorded scenes. 0: one fixed path is "
    "followed. Who changes a plan for a good reason is not told from who dithers."
)


def consistency_table(frame: Frame) -> Table | None:
    """Distances between consecutive plans; ``None`` where no two consecutive samples have plans."""
    rows = [row for row in frame.rows("", consistency) if row.found.pairs]
    if not rows:
        return None
    title = f"{frame.data_name}: how far consecutive plans disagree about the same place and time (m)"
    without = [(row.who, row.found.without) for row in rows if row.found.without]
    told = [f"{who}: {count} pairs are left out because a plan is missing." for who, count in without]
    brief = ("planner", "split", MEAN, f"95 % of {MEAN}", "pairs")
    return tabulate("consistency", title, _COLUMNS, map(_values, rows), (_NOTE, *row_notes(rows, told)), brief=brief)


def _values(row: Row[Consistency]) -> Values:
    found, origin = row.found, row.origin
    return {
        "planner": row.planner,
        "split": row.split,
        **{_AFTER.get(at, at): origin.amount(rate, "m", "pairs") for at, rate in found.distances.items()},
        "pairs": origin.count(found.pairs, "pairs", found.pairs + found.without),
    }
