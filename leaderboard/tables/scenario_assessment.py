"""Tables about scenes, not planners: who survives them, how real their adversaries move, what is wrong with those."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from benchmark.metrics.split_reference_drivers import (
    SplitReferenceDrivers,
    collect_split_reference_drivers,
    read_scene_assessments,
)
from benchmark.records.run import RunRecord
from benchmark.records.scene_assessment import (
    DRIVER_NAMES,
    TRACK_DEFECT_NAMES,
    DriverName,
    FeatureRealism,
    SplitRealism,
)
from benchmark.report.cells import ValueSource, make_value_source
from benchmark.report.table import Table
from benchmark.report.words import format_title, pluralise, spell_name
from leaderboard.frame.rows import FEW_NOTE, FEW_SCENES, count_recordings, review_notes, split_sort_key
from leaderboard.frame.runs import DataSetRuns
from leaderboard.frame.specification import (
    Value,
    Values,
    estimate_columns,
    group_columns,
    interval_columns,
    number_columns,
    share_cell,
    tabulate,
    text_columns,
)

REFERENCE_DRIVERS: Final = "reference drivers"
REALISM: Final = "realism"
VALIDITY: Final = "validity"
"""The definitions behind these numbers (docs/severity.md, docs/realism.md), as groups and cells name them."""
DRIVER_HEADS: Final[dict[DriverName, str]] = {
    "recorded": "recorded",
    "constant": "constant speed",
    "idm": "IDM",
    "r157": "R157",
    "cc": "careful human",
    "fsm": "FSM",
    "rss": "RSS",
}
REFERENCE_DRIVERS_NOTE: Final = (
    "Share of scenes survived by reference drivers that follow the recorded path and only brake: the recording itself, "
    "constant speed, IDM, UN R157 (5.2.5.2), the careful and competent human of R157, the fuzzy safety "
    "model, RSS (docs/severity.md)."
)
_CAUTION_NOTE: Final = (
    "RSS and, in dense traffic, FSM often react at once to an ordinary leader: read them as cars that had always kept "
    "their own distance. The careful human and R157 react late by design."
)
_MARGIN_NOTE: Final = (
    "Unsolvable: no sampled manoeuvre avoids it 0.75 s after the adversary is first visible, and neither the careful "
    "human nor FSM survives. Margin: from then to the last avoidable time of an ego at constant speed, if it ends in "
    "a contact; median and worst tenth. Ego's: medians of the recorded ego's encounter with the adversary."
)
_REALISM_NOTE: Final = (
    "Distance between the motion of adversaries and of recorded cars, by feature: W1 in the unit of the feature, and "
    "as a multiple of the W1 between two halves of the recordings; realism: 1 − Jensen-Shannon divergence over the "
    "recordings' 5 % quantiles. The row of the halves is the noise floor: a realism above it is no evidence of "
    "anything. The headline is the worst feature, marked among all; a mean would hide it (docs/realism.md)."
)
_CTG_NOTE: Final = (
    "Ctg-realism@code: the measure quoted in papers on nuScenes, for comparison with them, not for ranking; rotating "
    "the map changes it as much as two cars in stop-and-go traffic."
)
_VALIDITY_NOTE: Final = (
    "Adversaries with a fault, of those that could be checked: beyond the limits of driver and car; a corner more "
    "than 0.3 m off the drivable area; contact with an object other than the ego; against the lanes below it for more "
    "than 1 s; within 0.5 m of the same object for more than 0.5 s; jumps between frames (docs/realism.md)."
)
CTG: Final = "ctg-realism@code"
WORST_MARK: Final = "(worst)"
_DRIVERS: Final = [DRIVER_HEADS[name] for name in DRIVER_NAMES]
_REFERENCE_DRIVER_COLUMNS: Final = [
    *text_columns("split"),
    *group_columns(
        f"survived by, % of the scenes, {REFERENCE_DRIVERS}",
        number_columns(*_DRIVERS, digits=1),
        interval_columns({"95 % of careful human": DRIVER_HEADS["cc"]}),
    ),
    *group_columns(
        f"time to avoid it, {REFERENCE_DRIVERS}",
        number_columns("unsolvable"),
        number_columns("margin, s", "margin, worst tenth", digits=1),
        number_columns("margin < 0"),
    ),
    *group_columns(
        f"recorded ego, {REFERENCE_DRIVERS}", number_columns("ego's gap, m", "ego's TTC, s", "ego's BTN", digits=2)
    ),
    *group_columns(f"% of the scenes, {VALIDITY}", number_columns("no fault", digits=1)),
    *group_columns(f"counted, {REFERENCE_DRIVERS}", number_columns("judged", "recordings")),
]
_FAULTS: Final = [
    *text_columns("split", "fault"),
    *group_columns(
        f"adversaries, {VALIDITY}", number_columns("with it", "could be told"), number_columns("%", digits=1)
    ),
]
_REAL: Final = group_columns(
    f"1 − JSD, {REALISM}", estimate_columns("realism", digits=3, ends=3), number_columns("halves", digits=3)
)
_HEADLINES: Final = [
    *text_columns("split", "worst feature"),
    *_REAL,
    *group_columns(f"W1, {REALISM}", number_columns("W1 in halves", digits=1)),
    *group_columns(CTG, number_columns(CTG, "ctg, relative", digits=4)),
    *group_columns(f"counted, {REALISM}", number_columns("adversaries")),
]
_FEATURES: Final = [
    *text_columns("feature"),
    *_REAL,
    *group_columns(
        f"W1, {REALISM}", number_columns("W1", "W1 of halves", digits=3), number_columns("W1 in halves", digits=1)
    ),
]


def assessment_tables(frame: DataSetRuns) -> list[Table]:
    """Assessment of scenes by records, of at most one run for each planner and split.

    The ladder, a row a split; what is wrong with adversaries; their worst feature, and a table of all features a split
    with recordings to compare with. None of what no record says.
    """
    name, drivers_by_split, real = (
        frame.data_name,
        collect_split_reference_drivers(frame.runs),
        list_split_realism(frame.runs),
    )
    tables = (
        [
            _reference_driver_table(
                name, [drivers_by_split[split] for split in sorted(drivers_by_split, key=split_sort_key)]
            )
        ]
        if drivers_by_split
        else []
    )
    split_fault_counts = [_count_faults(record, realism) for record, realism in real]
    split_fault_counts += [
        _count_scene_faults(fault_counts)
        for split, fault_counts in drivers_by_split.items()
        if split not in {counts.split for counts in split_fault_counts}
    ]
    split_fault_counts.sort(key=lambda each: split_sort_key(each.split))
    if split_fault_counts:
        rows = [row for fault_counts in split_fault_counts for row in fault_counts.values()]
        notes = (
            _VALIDITY_NOTE,
            *dict.fromkeys(note for fault_counts in split_fault_counts for note in fault_counts.notes),
        )
        tables.append(tabulate("validity", f"{name}: faults of adversaries", _FAULTS, rows, notes))
    compared = [(record, realism, realism.headline) for record, realism in real if realism.headline is not None]
    tables += [_headline_table(name, compared)] if compared else []
    return [*tables, *(_realism_table(name, record, realism) for record, realism, _ in compared)]


def list_split_realism(records: Sequence[RunRecord]) -> list[tuple[RunRecord, SplitRealism]]:
    """Realism of each split that was looked at, of the first record that says so, in the order of tables."""
    realism_by_split: dict[str, tuple[RunRecord, SplitRealism]] = {}
    for record in records:
        if record.run.realism is not None:
            realism_by_split.setdefault(record.run.split, (record, record.run.realism))
    return [realism_by_split[split] for split in sorted(realism_by_split, key=split_sort_key)]


def _reference_driver_table(data_name: str, split_drivers: Sequence[SplitReferenceDrivers]) -> Table:
    records = [drivers.record for drivers in split_drivers]
    few = [FEW_NOTE] if any(count_recordings(record) < FEW_SCENES for record in records) else []
    title = f"{data_name}: avoidability of the adversarial scenes by reference drivers (%)"
    notes = (
        REFERENCE_DRIVERS_NOTE,
        _CAUTION_NOTE,
        _MARGIN_NOTE,
        *few,
        *review_notes(records),
        *_reference_driver_notes(split_drivers),
    )
    return tabulate("ladder", title, _REFERENCE_DRIVER_COLUMNS, map(_reference_driver_values, split_drivers), notes)


def _reference_driver_values(drivers: SplitReferenceDrivers) -> Values:
    record, count = drivers.record, drivers.scenes
    origin, margin = make_value_source(record, REFERENCE_DRIVERS), drivers.margin
    return {
        "split": record.run.split,
        **{DRIVER_HEADS[name]: origin.percent(rate, "scenes") for name, rate in drivers.survives.items()},
        "unsolvable": origin.count(drivers.unsolvable, "scenes", count),
        "margin, s": origin.cell(margin.median, "s", margin.samples, "scenes"),
        "margin, worst tenth": origin.cell(margin.worst_tenth, "s", margin.samples, "scenes"),
        "margin < 0": origin.count(drivers.too_late, "scenes", margin.samples),
        "ego's gap, m": origin.cell(drivers.gap.median, "m", drivers.gap.samples, "scenes"),
        "ego's TTC, s": origin.cell(drivers.ttc.median, "s", drivers.ttc.samples, "scenes"),
        "ego's BTN": origin.cell(drivers.btn.median, "BTN", drivers.btn.samples, "scenes"),
        "no fault": make_value_source(record, VALIDITY).percent(drivers.without_fault, "scenes"),
        "judged": origin.count(count, "scenes", len(record.run.scenes)),
        "recordings": origin.count(count_recordings(record), "recorded scenes"),
    }


def _reference_driver_notes(split_drivers: Sequence[SplitReferenceDrivers]) -> list[str]:
    notes = []
    for drivers in split_drivers:
        split, scenes = drivers.record.run.split, len(drivers.record.run.scenes)
        if drivers.scenes < scenes:
            notes.append(f"{split}: {drivers.scenes} of {pluralise(scenes, 'scene')} were assessed.")
        if drivers.without_map:
            some = pluralise(drivers.without_map, "scene")
            notes.append(f"{split}: no map for {some}, so manoeuvres may have left the road there.")
        if drivers.annotated:
            some = pluralise(drivers.annotated, "scene")
            notes.append(f"{split}: the generated tracks of {some} are not available; interpolated ones are used.")
        if drivers.outdated:
            notes.append(
                f"{split}: {pluralise(drivers.outdated, 'scene')} assessed by an earlier definition: drivers take over "
                "at the first frame and not where the adversary acts; run eval to assess them again."
            )
    return notes


@dataclass(frozen=True, slots=True)
class _FaultCounts:
    """Faults of the adversaries of a split; each row is fault, how many have it, of how many it was told."""

    record: RunRecord
    of: str
    count: int
    rows: tuple[tuple[str, int, int], ...]
    notes: tuple[str, ...]

    @property
    def split(self) -> str:
        return self.record.run.split

    def values(self) -> list[Values]:
        origin = make_value_source(self.record, VALIDITY)
        return [
            {
                "split": self.split,
                "fault": spell_name(fault),
                "with it": origin.count(count, self.of, of),
                "could be told": origin.count(of, self.of, self.count),
                "%": share_cell(origin, count, of, self.of),
            }
            for fault, count, of in self.rows
        ]


def _count_faults(record: RunRecord, realism: SplitRealism) -> _FaultCounts:
    apart = [f"not compared with recordings: {realism.not_compared}"] if realism.not_compared is not None else []
    unknown = [f"{spell_name(row.fault)}: {why}" for row in realism.validity for why in row.unknown]
    notes = tuple(_to_sentence(f"{record.run.split}: {note}") for note in (*apart, *unknown))
    rows = tuple((row.fault, row.count, row.of) for row in realism.validity)
    return _FaultCounts(record, "adversaries", realism.adversaries, rows, notes)


def _count_scene_faults(drivers: SplitReferenceDrivers) -> _FaultCounts:
    """Faults by scenes, where adversaries were not counted: scenes in which one of them has the fault."""
    judged = [
        judgement
        for judgement in read_scene_assessments(drivers.record).values()
        if judgement.least_gap_m is not None or judgement.faults
    ]
    rows = tuple(
        (
            name,
            sum(name in judgement.faults for judgement in judged),
            sum(name not in judgement.unknown_faults for judgement in judged),
        )
        for name in TRACK_DEFECT_NAMES
    )
    return _FaultCounts(
        drivers.record, "scenes", len(judged), rows, (f"{drivers.record.run.split}: scenes are counted.",)
    )


def _headline_table(data_name: str, headlines: Sequence[tuple[RunRecord, SplitRealism, FeatureRealism]]) -> Table:
    rows: list[Values] = []
    for record, realism, worst in headlines:
        origin, adversaries = make_value_source(record, REALISM), realism.adversaries
        ctg = (
            {}
            if realism.ctg is None
            else {CTG: realism.ctg.mean_real_dev, "ctg, relative": realism.ctg.mean_real_dev_int}
        )
        rows.append(
            {
                **_feature_values(origin, worst, 0 if realism.samples is None else realism.samples[0]),
                "split": record.run.split,
                "worst feature": spell_name(worst.name),
                "W1 in halves": origin.cell(worst.w1_in_halves, "x", adversaries, "adversaries"),
                **{
                    name: origin.cell(ctg.get(name), CTG, adversaries, "adversaries") for name in (CTG, "ctg, relative")
                },
                "adversaries": origin.count(adversaries, "adversaries"),
            }
        )
    versions = [
        f"{record.run.split}: {CTG}, version {realism.ctg.version}, normalised by {realism.ctg.normalisation}, mask "
        f"{realism.ctg.mask}."
        for record, realism, _ in headlines
        if realism.ctg is not None
    ]
    notes = (_REALISM_NOTE, *([_CTG_NOTE] if versions else []), *versions)
    title = f"{data_name}: realism of adversaries' motion, by the worst feature"
    return tabulate(REALISM, title, _HEADLINES, rows, notes)


def _realism_table(data_name: str, record: RunRecord, realism: SplitRealism) -> Table:
    samples, origin = 0 if realism.samples is None else realism.samples[0], make_value_source(record, REALISM)
    rows: list[Mapping[str, Value]] = []
    for row in realism.features:
        name = spell_name(row.name)
        feature = f"{name} {WORST_MARK}" if row.name == realism.worst else name
        rows.append({"feature": feature, **_feature_values(origin, row, samples)})
    reference = "" if realism.reference is None else f" Recordings: {realism.reference}."
    title = f"{format_title(data_name, record.run.split)}: realism of its adversaries' motion"
    return tabulate(f"{REALISM}-{record.run.split}", title, _FEATURES, rows, (f"{_REALISM_NOTE}{reference}",))


def _feature_values(origin: ValueSource, row: FeatureRealism, samples: int) -> dict[str, Value]:
    low, high = row.interval or (None, None)
    return {
        "realism": origin.cell(row.realism, REALISM, samples, low=low, high=high),
        "halves": origin.cell(row.realism_of_halves, REALISM, samples),
        "W1": origin.cell(row.w1, "unit of the feature", samples),
        "W1 of halves": origin.cell(row.w1_of_halves, "unit of the feature", samples),
        "W1 in halves": origin.cell(row.w1_in_halves, "x", samples),
    }


def _to_sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."
