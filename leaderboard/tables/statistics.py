"""A data set in numbers, its manoeuvres, how close adversaries come, what the search discarded: from scene sheets.

How far the collision rate of one planner moves with its seed alone.
"""

import json
from collections import Counter
from collections.abc import Sequence
from functools import partial
from operator import attrgetter

import numpy as np

from benchmark.errors import InputError
from benchmark.metrics.scores import require_current
from benchmark.published import ADV_NUSC, DATA_SET_SOURCE
from benchmark.records.review import review_words
from benchmark.records.run import RunRecord, protocol_of
from benchmark.records.scenes import AttemptFacts, SplitSheet
from benchmark.records.statistics import ManoeuvreRow, Quantiles
from benchmark.report.cells import Origin, record_name
from benchmark.report.table import Table
from benchmark.report.words import titled
from leaderboard.frame.rows import judges, name_cell, notes_of_marks
from leaderboard.frame.runs import Frame, whose
from leaderboard.frame.specification import (
    Column,
    Values,
    counts_of,
    numbers,
    origin_of,
    places,
    share,
    tabulate,
    texts,
    under,
)
from leaderboard.tables.published import published_rows

_RULE = (
    "Runs of one planner on one split that differ in the seed and in nothing else that a record names. Deviation: of "
    "the runs' rates around their mean (n − 1). It is what drawing the noise again does, and no interval over scenes."
)


def seed_spread_table(frame: Frame, protocol: str) -> Table | None:
    """Spread of the average collision rate over the seeds of each planner on each split.

    A row for each that ran with at least two seeds; ``None`` where there is none. ``native`` is the protocol of the
    planner's own repository. Runs of a part of their split, with failed samples, or judged by another version of the
    protocol are named below the table.
    """
    notes = [_RULE]
    rows, first = [], []
    for runs in _versions(frame.runs):
        if len(runs) < 2:
            continue
        refused = [_refusal(run, protocol) for run in runs]
        notes += [f"Left out: {reason}." for reason in refused if reason is not None]
        rows.append(_seed_values(runs[0], protocol, [run for run, reason in zip(runs, refused) if reason is None]))
        first.append(runs[0])
    if not rows:
        return None
    columns = [
        *texts("planner", "split", "protocol"),
        *under(
            f"average collision rate in %, {whose(protocol)}",
            numbers("seeds"),
            numbers("mean", "lowest", "highest", "deviation", digits=3),
        ),
    ]
    title = f"{frame.data_name}: average collision rate (%) over the seeds of a planner, {judges(protocol)}"
    return tabulate(f"seeds-{protocol}", title, columns, rows, (*notes, *notes_of_marks(first)))


def _versions(records: Sequence[RunRecord]) -> list[list[RunRecord]]:
    """Records of one planner with one set of weights and settings on one split, at most one a seed, by seed."""
    runs_by_version: dict[str, dict[int, RunRecord]] = {}
    for record in records:
        planner = record.run.planner
        facts = [planner.name, planner.weights_sha256, planner.settings, record.run.split]
        runs_by_version.setdefault(json.dumps(facts, sort_keys=True), {}).setdefault(planner.seed, record)
    return [[runs[seed] for seed in sorted(runs)] for runs in runs_by_version.values()]


def _refusal(record: RunRecord, protocol: str) -> str | None:
    """Reason why a run is not comparable with those of other seeds."""
    if not (record.covers_split and record.complete):
        return f"{record.planner} on {record.run.split} has no plan for some samples of the split"
    try:
        require_current(record, protocol_of(record, protocol))
    except InputError as refusal:
        return str(refusal)
    return None


def _seed_values(first: RunRecord, protocol: str, runs: Sequence[RunRecord]) -> Values:
    """One planner; ``runs`` are those that count."""
    planner, judge = first.run.planner, protocol_of(first, protocol)
    found = [run.summary.protocols[judge].columns["collision"]["avg"].value for run in runs]
    rates = [rate for rate in found if rate is not None]
    origin = Origin(judge, record_name(*runs) or None)
    of_seeds = {
        "mean": float(np.mean(rates)) if rates else None,
        "lowest": min(rates, default=None),
        "highest": max(rates, default=None),
        "deviation": float(np.std(rates, ddof=1)) if len(rates) > 1 else None,
    }
    return {
        "planner": name_cell(planner.name, planner),
        "split": first.run.split,
        "protocol": judge,
        "seeds": origin.count(len(rates), "seeds"),
        **{name: origin.cell(value, "%", len(rates), "seeds", scale=100.0) for name, value in of_seeds.items()},
    }


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
    return [_counts(data_name, splits), _closeness(data_name, splits), *(_search(data_name, split) for split in splits)]


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
        statistics, origin = split.statistics, origin_of(split)
        measured = (
            ("smallest gap between the bodies, m", "m", statistics.labelled, statistics.gap_m, 2),
            ("time to collision, s", "s", statistics.within_5_s, statistics.time_to_collision_s, 1),
        )
        for label, unit, count, quantiles, digits in measured:
            if quantiles is None:
                continue
            levels = {name: origin.cell(getattr(quantiles, name), unit, count, "adversaries") for name in QUANTILES}
            rows.append(
                {
                    "split": split.split,
                    "quantity": label,
                    "adversaries": origin.count(count, "adversaries", statistics.labelled),
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
    rows = [
        _tried(split, outcome, [attempt_facts for attempt_facts in attempts if _outcome(attempt_facts) == outcome])
        for outcome in order
    ]
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
