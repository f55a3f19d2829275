"""The main table: what adversaries do to each planner, beside the same recordings unchanged."""

from collections.abc import Sequence
from typing import Final

from benchmark.errors import InputError
from benchmark.metrics.attacks import has_adversaries, knows_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import AT_3_S, AdversaryEffect, PairedEffect, compute_effect, knows_contact_partners
from benchmark.metrics.ranks import sum_faults_by_scene
from benchmark.metrics.rates import PairedDifference
from benchmark.metrics.scores import map_scenes_to_sources
from benchmark.metrics.unchanged_records import find_unchanged_record, sees_images
from benchmark.records.run import RunRecord
from benchmark.report.cells import PERCENT, CellSource, ValueSource, join_record_names, make_value_source
from benchmark.report.table import Table
from benchmark.report.words import pluralise
from leaderboard.frame.rows import FEW_NOTE, list_run_marks, row_name, run_notes
from leaderboard.frame.runs import DataSetRuns
from leaderboard.frame.specification import (
    Values,
    estimate_columns,
    group_columns,
    number_columns,
    tabulate,
    text_columns,
)
from leaderboard.tables.attacks import UNKNOWN_FAULT
from leaderboard.tables.ranks import RANK, RANK_NOTE, Contestant, rank_cells

_NOTE: Final = (
    "Adversary: samples whose plan touches the adversary before anything else within 3 s (avg: mean of 1, 2 and 3 s); "
    "at fault: those that are the planner's fault by fault@1 (docs/fault.md); shared, unclear: those that are both "
    "users', and of which the map does not tell. Any: contact with anything within 3 s, on the adversarial scenes "
    "and on the same recordings unchanged, sample by sample. Difference in percentage points, with 95 % interval over "
    "recordings. Each recording has the same weight, with any number of variants (docs/metrics.md)."
)
_SHORT_NOTE: Final = (
    "Adversary: samples whose plan touches the adversary first within 3 s; at fault: by the planner's fault. "
    "Difference: any contact, in percentage points above the same recordings unchanged."
)
_OTHERS_NOTE: Final = (
    "New others: contacts with other objects that the planner does not have on the unchanged recording; "
    "lost others: the reverse."
)
_FEW_DIFFER_NOTE: Final = "A dash for an interval: too few recordings differ from the unchanged ones."
_COLUMNS: Final = [
    *text_columns("planner", "split"),
    *group_columns(
        f"touches the adversary first, in %, {EXACT}",
        number_columns("adversary avg", "adversary 3s", "at fault avg", "at fault 3s", digits=1),
        number_columns("shared 3s", "unclear 3s", digits=1),
    ),
    *group_columns(
        f"paired with the unchanged recordings, {EXACT}",
        number_columns("any, adv", "any, unchanged", digits=1),
        estimate_columns("difference", signed=True),
        number_columns("ratio", digits=1, after=" times"),
        number_columns("new others", "lost others", digits=1),
    ),
    *group_columns(f"counted, {EXACT}", number_columns("pairs", "recordings", "differing", "compared with")),
    *group_columns(f"by at fault 3s, {EXACT}", number_columns(RANK)),
]
_BRIEF: Final = (
    "planner",
    "split",
    "adversary 3s",
    "at fault 3s",
    "any, unchanged",
    "difference",
    "95 % of difference",
    RANK,
)


def effect_table(frame: DataSetRuns) -> Table | None:
    """Effect of adversaries: a row for each planner and split with adversaries; ``None`` without any."""
    runs = [record for record in frame.runs if has_adversaries(record)]
    if not runs:
        return None
    rows: list[Values] = []
    effects: list[AdversaryEffect] = []
    refused: dict[str, None] = {}
    for record in runs:
        effect = None
        try:
            effect = compute_effect(record, find_unchanged_record(record, (*frame.against, *frame.given)))
        except InputError as refusal:
            refused[f"Left out: {refusal}."] = None
        effects += [] if effect is None else [effect]
        rows.append({"planner": row_name(record, EXACT), "split": record.run.split, **_values(effect)})
    # Whom contacts are with must be known, and a record of older verdicts has no effect.
    told_of = [effect.record for effect in effects if effect.touched is not None]
    rank_notes = _add_ranks(rows, told_of, runs)
    lacking, few = (*_list_missing(runs, effects), *refused), _list_too_few(effects)
    # A note for intervals of other tables: this one's hold over few recordings, or are omitted.
    run_sentences = [note for note in run_notes(runs, ()) if note != FEW_NOTE]
    return tabulate(
        "effect",
        f"{frame.data_name}: effect of the adversary (%, samples), protocol {EXACT}",
        _COLUMNS,
        rows,
        (_NOTE, _OTHERS_NOTE, *rank_notes, *lacking, *few, *run_sentences),
        brief=_BRIEF,
        # The other notes on the runs are below the rates already.
        brief_notes=(
            _SHORT_NOTE,
            *rank_notes[1:],
            *lacking,
            *([_FEW_DIFFER_NOTE] if few else []),
            *list_run_marks(runs),
        ),
    )


def _add_ranks(rows: list[Values], known: Sequence[RunRecord], runs: Sequence[RunRecord]) -> list[str]:
    """Add to the rows of the runs the ranks of those that say whom contacts are with, by split; notes on them."""
    notes = [RANK_NOTE.format("at fault 3s, lowest first", "sample")] if known else []
    for split in dict.fromkeys(record.run.split for record in known):
        faults = [(record, sum_faults_by_scene(record)) for record in known if record.run.split == split]
        told_of = [(record, totals) for record, totals in faults if totals is not None]
        contestants = [
            Contestant(
                record.planner,
                record.run.planner,
                totals,
                map_scenes_to_sources(record),
                make_value_source(record, EXACT),
            )
            for record, totals in told_of
        ]
        cells, told = rank_cells(contestants, lower_is_better=True, unit=PERCENT)
        notes += [f"{split}: {note}" for note in told]
        for (record, _), cell in zip(told_of, cells, strict=True):
            place = runs.index(record)
            rows[place] = {**rows[place], RANK: cell}
    return notes


def _values(effect: AdversaryEffect | None) -> Values:
    if effect is None:
        return {}
    paired, unchanged = effect.paired, effect.unchanged
    origin = ValueSource(EXACT, join_record_names(*(run for run in (effect.record, unchanged) if run is not None)))

    def percent(value: float | None, count: int) -> CellSource:
        return origin.cell(value, PERCENT, count, scale=100.0)

    touched = {
        f"{head} {horizon}": percent(None if rates is None else rates[place], effect.samples)
        for head, rates in (("adversary", effect.touched), ("at fault", effect.at_fault))
        for horizon, place in (("avg", AT_3_S + 1), ("3s", AT_3_S))
    } | {
        f"{head} 3s": percent(None if rates is None else rates[AT_3_S], effect.samples)
        for head, rates in (("shared", effect.shared_fault), ("unclear", effect.unclear_fault))
    }
    if paired is None or unchanged is None:
        return touched
    difference = paired.difference
    rates = {
        "any, adv": paired.adversarial,
        "any, unchanged": paired.unchanged,
        "new others": paired.new_others,
        "lost others": paired.lost_others,
    }
    return {
        **touched,
        **{name: percent(rate, paired.pairs) for name, rate in rates.items()},
        "difference": origin.cell(
            difference.value,
            "points",
            difference.recordings,
            "recordings",
            low=difference.low,
            high=difference.high,
            scale=100.0,
        ),
        "ratio": origin.cell(paired.ratio, "times", paired.pairs),
        "pairs": origin.count(paired.pairs, "samples"),
        "recordings": origin.count(difference.recordings, "recordings"),
        "differing": origin.count(difference.differing, "recordings", difference.recordings),
        "compared with": unchanged.run.split,
    }


def _list_missing(runs: Sequence[RunRecord], effects: Sequence[AdversaryEffect]) -> list[str]:
    """Sentences on missing comparisons and their remedies, each once."""
    notes: dict[str, None] = {}
    for record in runs:
        if not knows_contact_partners(record):
            notes[explain_unknown_contacts(record)] = None
    for effect in effects:
        record, paired = effect.record, effect.paired
        split = record.run.split
        if effect.unknown_fault:
            notes[f"{record.planner} on {split}: {UNKNOWN_FAULT}"] = None
        if paired is None:
            notes[
                f"{split}: not run by the same planner on the unchanged recordings: {_name_planners(effects, split)}; "
                f"{_describe_remedy(record)}."
            ] = None
            continue
        notes |= dict.fromkeys(_list_pair_notes(record, paired))
        if effect.unchanged is not None and effect.unchanged.run.split == "val" and sees_images(record.run.planner):
            notes[
                "Compared with val: planners that see images also react to how adv was rendered; val-r is free of it."
            ] = None
    return list(notes)


def _describe_remedy(record: RunRecord) -> str:
    if knows_adversaries(record):
        return "challenger-bench eval --split val --split adv runs both"
    return "run challenger-bench eval --split val on the data set that has them, and name it here with --unchanged"


def _name_planners(effects: Sequence[AdversaryEffect], split: str) -> str:
    return ", ".join(
        effect.record.planner for effect in effects if effect.paired is None and effect.record.run.split == split
    )


def explain_unknown_contacts(record: RunRecord) -> str:
    """Reason why a record on a split with adversaries does not say whom contacts are with, in a sentence."""
    facts = [record.run.scene_facts.get(scene) for scene in record.run.scenes]
    why = "older records lack the objects touched; challenger-bench rescore adds them"
    if any(fact is None or fact.adversaries is None for fact in facts):
        why = "the adversaries are unknown, so no contact is attributed to one"
    return f"{record.run.split}: {why}."


def _list_pair_notes(record: RunRecord, paired: PairedEffect) -> list[str]:
    notes = []
    if paired.unpaired:
        some = f" ({', '.join(paired.unpaired_scenes[:3])})" if paired.unpaired_scenes else ""
        notes.append(
            f"{record.planner} on {record.run.split}: {pluralise(paired.unpaired, 'sample')} without a partner on the "
            f"unchanged recordings{some}: in no pair."
        )
    return notes


def _list_too_few(effects: Sequence[AdversaryEffect]) -> list[str]:
    """Sentences on differences without an interval."""
    return [
        f"{effect.record.planner} on {effect.record.run.split}: {reason}."
        for effect in effects
        if effect.paired is not None and (reason := _explain_too_few(effect.paired.difference)) is not None
    ]


def _explain_too_few(difference: PairedDifference) -> str | None:
    if difference.value is None or difference.low is not None:
        return None
    verb = "differs" if difference.differing == 1 else "differ"
    sentence = f"only {difference.differing} of {difference.recordings} recordings {verb}, too few for an interval"
    return (
        sentence if difference.enough is None else f"{sentence}; about {difference.enough} recordings would be enough"
    )
