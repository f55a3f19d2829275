"""A table and a page of near misses: what ``margin`` counts and ``exact`` does not."""

from collections.abc import Sequence
from html import escape

from benchmark.records.run import RunRecord
from benchmark.report.table import Table
from leaderboard.frame.results import LeaderboardResults
from leaderboard.frame.runs import DataSetRuns
from leaderboard.frame.specification import group_columns, number_columns, tabulate, text_columns


def count_near_misses(records: Sequence[RunRecord]) -> list[tuple[RunRecord, float, int]]:
    """Share of samples within 3 s that are near misses and no contacts, and the number of samples, by run."""
    found = []
    for record in records:
        protocols = record.summary.protocols
        if {"margin", "exact"} <= set(protocols):
            near, hit = (protocols[name].columns["collision"]["3s"] for name in ("margin", "exact"))
            if near.value is not None and hit.value is not None:
                found.append((record, near.value - hit.value, near.denominator))
    return found


def margin_table(frame: DataSetRuns) -> Table | None:
    """How often each run on a data set comes too close; ``None`` where nothing was judged by ``margin``."""
    rows = [
        {**row.names, "too close": row.origin.percent(row.found.columns["collision"]["3s"])}
        for row in frame.judged("margin")
    ]
    if not rows:
        return None
    columns = [
        *text_columns("planner", "split"),
        *group_columns("within 3 s, %", number_columns("too close", digits=2)),
    ]
    note = "Contacts and near misses: the plan comes within 0.3 m of anything."
    return tabulate("margins", f"{frame.data_name}: plans too close to others (%)", columns, rows, (note,))


def margin_page(results: LeaderboardResults) -> str:
    """A page of the site: near misses of every run, in words."""
    lines = [
        f"<li>{escape(record.planner)} on {escape(record.run.split)}: {share:.1%} of {count} samples</li>"
        for record, share, count in count_near_misses(results.runs)
    ]
    body = f"<ul>{''.join(lines)}</ul>" if lines else "<p>No run was judged by margin.</p>"
    return f'<!doctype html><html lang="en"><title>Near misses</title><h1>Near misses within 3 s</h1>{body}</html>\n'
