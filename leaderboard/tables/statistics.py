"""Statistics of a data set from scene sheets, and how far a planner's collision rate moves with its seed alone."""

import json
from collections import Counter
from collections.abc import Sequence
from functools import partial
from operator import attrgetter

import numpy as np

from benchmark.errors import InputError
from benchmark.metrics.scores import require_current
from benchmark.published import ADV_NUSC, DATA_SET_SOURCE
from benchmark.records.review import describe_review
from benchmark.records.run import RunRecord, resolve_protocol
from benchmark.records.scene_pages import AttemptFacts, SplitPage
from benchmark.records.statistics import ManoeuvreRow, Quantiles
from benchmark.report.cells import ValueSource, join_record_names
from benchmark.report.table import Table
from benchmark.report.words import format_title
from leaderboard.frame.rows import list_run_marks, name_cell, name_judge
from leaderboard.frame.runs import DataSetRuns, name_judges
from leaderboard.frame.specification import (
    TableColumn,
    Values,
    build_count_cells,
    find_origin,
    group_columns,
    number_columns,
    numbered_columns,
    share_cell,
    tabulate,
    text_columns,
)
from leaderboard.tables.published import quote_rows

_RULE = (
    "Runs of one planner on one split that differ only in the seed, as far as recorded. Deviation: of the runs' rates "
    "around their mean (n − 1). It measures the planner's random noise, and is not an interval over scenes."
)


def seed_spread_table(frame: DataSetRuns, protocol: str) -> Table | None:
    """Spread of the average collision rate over the seeds of each planner on each split; ``None`` without two seeds.

    ``native`` is the planner's own protocol. Runs of a part of their split, with failed samples, or judged by another
    version of the protocol are named below the table.
    """
    notes = [_RULE]
    rows, first = [], []
    for runs in _group_versions(frame.runs):
        if len(runs) < 2:
            continue
        refused = [_explain_refusal(run, protocol) for run in runs]
        notes += [f"Left out: {reason}." for reason in refused if reason is not None]
        rows.append(_seed_values(runs[0], protocol, [run for run, reason in zip(runs, refused) if reason is None]))
        first.append(runs[0])
    if not rows:
        return None
    columns = [
        *text_columns("planner", "split", "protocol"),
        *group_columns(
            f"average collision rate in %, {name_judges(protocol)}",
            number_columns("seeds"),
            number_columns("mean", "lowest", "highest", "deviation", digits=3),
        ),
    ]
    title = f"{frame.data_name}: average collision rate (%) over the seeds of a planner, {name_judge(protocol)}"
    return tabulate(f"seeds-{protocol}", title, columns, rows, (*notes, *list_run_marks(first)))


def _group_versions(records: Sequence[RunRecord]) -> list[list[RunRecord]]:
    """Records of one planner with one set of weights and settings on one split, at most one a seed, by seed."""
    runs_by_version: dict[str, dict[int, RunRecord]] = {}
    for record in records:
        planner = record.run.planner
        facts = [planner.name, planner.weights_sha256, planner.settings, record.run.split]
        runs_by_version.setdefault(json.dumps(facts, sort_keys=True), {}).setdefault(planner.seed, record)
    return [[runs[seed] for seed in sorted(runs)] for runs in runs_by_version.values()]


def _explain_refusal(record: RunRecord, protocol: str) -> str | None:
    """Reason why a run is not comparable with those of other seeds."""
    if not (record.covers_split and record.complete):
        return f"{record.planner} on {record.run.split} has no plan for some samples of the split"
    try:
        require_current(record, resolve_protocol(record, protocol))
    except InputError as refusal:
        return str(refusal)
    return None


def _seed_values(first: RunRecord, protocol: str, runs: Sequence[RunRecord]) -> Values:
    """Values of one planner; ``runs`` are those that count."""
    planner, judge = first.run.planner, resolve_protocol(first, protocol)
    found = [run.summary.protocols[judge].columns["collision"]["avg"].value for run in runs]
    rates = [rate for rate in found if rate is not None]
    origin = ValueSource(judge, join_record_names(*runs) or None)
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


KEPT_OUTCOME = "kept"
QUANTILES = tuple(Quantiles.model_fields)
_CLOSENESS = [
    *text_columns("split", "quantity"),
    *group_columns("counted", number_columns("adversaries")),
    *group_columns("quantiles over adversaries", number_columns(*QUANTILES)),
]
_SEARCH = [
    *text_columns("outcome"),
    *group_columns("vehicles tried", number_columns("vehicles"), number_columns("%", digits=1)),
    *group_columns("from", number_columns("recorded scenes")),
]
PAPER_NOTE = (
    "The paper names cut-ins, sudden lane changes, tailgating, blocking and blind-spot intrusions, and junctions, "
    "roundabouts and parking areas; it gives no counts, so there is no column for it."
)
_NOTE = (
    "Primary: the one manoeuvre that an adversary is named after, at the place of its closest approach. At any "
    "time: also in passing. Median gap: over the primary ones, between the bodies (docs/manoeuvres.md)."
)


def statistics_tables(data_name: str, splits: Sequence[SplitPage]) -> list[Table | None]:
    """The paper's overview of its data set for one of ours, closeness, and the search."""
    return [
        _count_table(data_name, splits),
        _closeness_table(data_name, splits),
        *(_search_table(data_name, split) for split in splits),
    ]


def _count_table(data_name: str, splits: Sequence[SplitPage]) -> Table:
    rows: list[Values] = []
    for name in ADV_NUSC:
        words = name.replace("_", " ")
        ours = build_count_cells(splits, words, attrgetter(f"statistics.counts.{name}"))
        rows.append({"rows of": words, **ours, "paper": quote_rows(name)})
    for many in sorted({many for split in splits for many in split.statistics.adversaries_per_scene}):
        label = f"scenes with {many} {'adversary' if many == 1 else 'adversaries'}"
        rows.append({"rows of": label, **build_count_cells(splits, "scenes", partial(_count_scenes, many))})
    columns = [
        *text_columns("rows of"),
        *group_columns("here", numbered_columns(split.split for split in splits)),
        *group_columns("paper", [TableColumn("Adv-nuSc (paper)", "paper")]),
    ]
    notes = (
        "Rows of the tables of each split. Adv-nuSc: made from the nuScenes validation split.",
        *(f"{split.split}: {describe_review(split.review)}." for split in splits if split.review is not None),
    )
    title = f"{data_name}: the data set in numbers"
    return tabulate("data-set", title, columns, rows, notes, sources=(DATA_SET_SOURCE,))


def _count_scenes(adversaries: int, split: SplitPage) -> int:
    return split.statistics.adversaries_per_scene.get(adversaries, 0)


def _closeness_table(data_name: str, splits: Sequence[SplitPage]) -> Table | None:
    rows: list[Values] = []
    for split in splits:
        statistics, origin = split.statistics, find_origin(split)
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
    note = "Time to collision: the least of each adversary with one below 5 s. The paper gives none."
    return tabulate("closeness", f"{data_name}: distance of adversaries to the ego", _CLOSENESS, rows, (note,))


def _search_table(data_name: str, split: SplitPage) -> Table | None:
    attempts = split.attempts
    if not attempts:
        return None
    outcomes = Counter(_find_outcome(attempt) for attempt in attempts)
    order = sorted(outcomes, key=lambda outcome: (outcome != KEPT_OUTCOME, -outcomes[outcome], outcome))
    rows = [
        _attempt_values(
            split, outcome, [attempt_facts for attempt_facts in attempts if _find_outcome(attempt_facts) == outcome]
        )
        for outcome in order
    ]
    title = f"{format_title(data_name, split.split)}: vehicles tried by the search, and reasons to discard them"
    note = "The paper names its reasons to discard scenes, but gives no counts."
    return tabulate(f"search-{split.split}", title, _SEARCH, [*rows, _attempt_values(split, "all", attempts)], (note,))


def _find_outcome(attempt: AttemptFacts) -> str:
    return attempt.discarded or KEPT_OUTCOME


def _attempt_values(split: SplitPage, outcome: str, chosen: Sequence[AttemptFacts]) -> Values:
    origin, every = find_origin(split), len(split.attempts)
    scenes, all_scenes = ({attempt.source for attempt in some} for some in (chosen, split.attempts))
    return {
        "outcome": outcome,
        "vehicles": origin.count(len(chosen), "vehicles", every),
        "%": share_cell(origin, len(chosen), every, "vehicles"),
        "recorded scenes": origin.count(len(scenes), "recorded scenes", len(all_scenes)),
    }


def manoeuvre_tables(data_name: str, splits: Sequence[SplitPage]) -> list[Table]:
    """Manoeuvres of the adversaries of each split with labels: how many, where, and how close they come."""
    return [_table(data_name, split) for split in splits if split.statistics.labelled]


def _table(data_name: str, split: SplitPage) -> Table:
    statistics, origin, adversaries = split.statistics, find_origin(split), split.statistics.labelled
    columns = [
        *text_columns("manoeuvre"),
        *group_columns(
            "adversaries", number_columns("primary"), number_columns("%", digits=1), number_columns("at any time")
        ),
        *group_columns("primary ones by place", numbered_columns(statistics.places)),
        *group_columns("smallest gap in m", number_columns("median gap, m", digits=2)),
    ]
    in_all = sum(row.primary for row in statistics.manoeuvres)
    every: Values = {
        "manoeuvre": "all",
        "primary": origin.count(in_all, "adversaries", adversaries),
        **{f"#{at}": origin.count(n, "adversaries", adversaries) for at, n in enumerate(statistics.places.values())},
    }
    return tabulate(
        f"manoeuvres-{split.split}",
        f"{format_title(data_name, split.split)}: manoeuvres of adversaries, and their places",
        columns,
        [*(_values(split, row) for row in statistics.manoeuvres), every],
        (_NOTE, PAPER_NOTE),
    )


def _values(split: SplitPage, row: ManoeuvreRow) -> Values:
    origin, adversaries = find_origin(split), split.statistics.labelled
    counts = [row.places.get(place, 0) for place in split.statistics.places]
    return {
        "manoeuvre": row.manoeuvre,
        "primary": origin.count(row.primary, "adversaries", adversaries),
        "%": share_cell(origin, row.primary, adversaries, "adversaries"),
        "at any time": origin.count(row.occurred, "adversaries", adversaries),
        **{f"#{at}": origin.count(count, "adversaries", row.primary) for at, count in enumerate(counts)},
        "median gap, m": origin.cell(row.median_gap_m, "m", row.primary, "adversaries"),
    }
