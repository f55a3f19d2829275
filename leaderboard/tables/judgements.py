"""Tables about scenes, not planners: who survives them, how real their adversaries move, what is wrong with those."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from benchmark.metrics.judgements import SplitLadder, judged_scenes, split_ladders
from benchmark.records.judgement import DRIVER_NAMES, FAULT_NAMES, DriverName, FeatureRealism, SplitRealism
from benchmark.records.run import RunRecord
from benchmark.report.cells import Origin, origin_of
from benchmark.report.table import Table
from benchmark.report.words import counted, titled
from leaderboard.frame.rows import FEW_NOTE, FEW_SCENES, recordings, review_notes, split_place
from leaderboard.frame.runs import Frame
from leaderboard.frame.specification import Value, Values, estimates, intervals, numbers, share, tabulate, texts, under

LADDER: Final = "reference drivers"
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
LADDER_NOTE: Final = (
    "Share of the scenes that a driver survives who follows the recorded path and only brakes: the recording itself, "
    "one that keeps its speed, IDM, UN R157 (5.2.5.2), the careful and competent human of R157, the fuzzy safety "
    "model, RSS (docs/severity.md)."
)
_CAUTION_NOTE: Final = (
    "RSS and, in dense traffic, FSM often react at once to an ordinary leader: read them as a car that had driven like "
    "this all along. The careful human and R157 react late by design."
)
_MARGIN_NOTE: Final = (
    "Unsolvable: no sampled manoeuvre avoids it 0.75 s after the adversary is first visible, and neither the careful "
    "human nor FSM survives. Margin: from then to the last chance of an ego at constant speed, where that ends in a "
    "contact of its own; median and worst tenth. Ego's: medians of the recorded ego's encounter with the adversary."
)
_REALISM_NOTE: Final = (
    "How far adversaries' motion is from that of recorded cars, feature by feature: W1 in the unit of the feature, and "
    "as a multiple of the W1 between two halves of the recordings; realism: 1 − Jensen-Shannon divergence over the "
    "recordings' 5 % quantiles. The row of the halves is what zero looks like: a realism above it is no evidence of "
    "anything. The headline is the worst feature, marked among all; a mean would hide it (docs/realism.md)."
)
_CTG_NOTE: Final = (
    "Ctg-realism@code: what papers on nuScenes quote, to compare with them and never to rank by; turning the map "
    "changes it as much as two cars that stop and go."
)
_VALIDITY_NOTE: Final = (
    "Adversaries with a fault, of those of which somebody could tell: beyond the limits of driver and car; a corner "
    "more than 0.3 m off the drivable area; contact with anybody but the ego; against the lanes below it for more than "
    "1 s; within 0.5 m of the same other for more than 0.5 s; jumps between frames (docs/realism.md)."
)
CTG: Final = "ctg-realism@code"
WORST_MARK: Final = "(worst)"
_DRIVERS: Final = [DRIVER_HEADS[name] for name in DRIVER_NAMES]
_LADDER: Final = [
    *texts("split"),
    *under(
        f"survived by, % of the scenes, {LADDER}",
        numbers(*_DRIVERS, digits=1),
        intervals({"95 % of careful human": DRIVER_HEADS["cc"]}),
    ),
    *under(
        f"time to avoid it, {LADDER}",
        numbers("unsolvable"),
        numbers("margin, s", "margin, worst tenth", digits=1),
        numbers("margin < 0"),
    ),
    *under(f"recorded ego, {LADDER}", numbers("ego's gap, m", "ego's TTC, s", "ego's BTN", digits=2)),
    *under(f"% of the scenes, {VALIDITY}", numbers("no fault", digits=1)),
    *under(f"counted, {LADDER}", numbers("judged", "recordings")),
]
_FAULTS: Final = [
    *texts("split", "fault"),
    *under(f"adversaries, {VALIDITY}", numbers("with it", "could be told"), numbers("%", digits=1)),
]
_REAL: Final = under(f"1 − JSD, {REALISM}", estimates("realism", digits=3, ends=3), numbers("halves", digits=3))
_HEADLINES: Final = [
    *texts("split", "worst feature"),
    *_REAL,
    *under(f"W1, {REALISM}", numbers("W1 in halves", digits=1)),
    *under(CTG, numbers(CTG, "ctg, relative", digits=4)),
    *under(f"counted, {REALISM}", numbers("adversaries")),
]
_FEATURES: Final = [
    *texts("feature"),
    *_REAL,
    *under(f"W1, {REALISM}", numbers("W1", "W1 of halves", digits=3), numbers("W1 in halves", digits=1)),
]


def judgement_tables(frame: Frame) -> list[Table]:
    """Everything that records say of scenes, of at most one run for each planner and split.

    The ladder, a row a split; what is wrong with adversaries; their worst feature, and a table of all features a split
    with recordings to compare with. None of what no record says.
    """
    name, drivers_by_split, real = frame.data_name, split_ladders(frame.runs), split_realism(frame.runs)
    tables = (
        [_ladder_table(name, [drivers_by_split[split] for split in sorted(drivers_by_split, key=split_place)])]
        if drivers_by_split
        else []
    )
    split_fault_counts = [_told(record, realism) for record, realism in real]
    split_fault_counts += [
        _told_by_scenes(fault_counts)
        for split, fault_counts in drivers_by_split.items()
        if split not in {counts.split for counts in split_fault_counts}
    ]
    split_fault_counts.sort(key=lambda each: split_place(each.split))
    if split_fault_counts:
        rows = [row for fault_counts in split_fault_counts for row in fault_counts.values()]
        notes = (
            _VALIDITY_NOTE,
            *dict.fromkeys(note for fault_counts in split_fault_counts for note in fault_counts.notes),
        )
        tables.append(tabulate("validity", f"{name}: what is wrong with adversaries", _FAULTS, rows, notes))
    compared = [(record, realism, realism.headline) for record, realism in real if realism.headline is not None]
    tables += [_headline_table(name, compared)] if compared else []
    return [*tables, *(_realism_table(name, record, realism) for record, realism, _ in compared)]


def split_realism(records: Sequence[RunRecord]) -> list[tuple[RunRecord, SplitRealism]]:
    """Realism of each split that was looked at, of the first record that says so, in the order of tables."""
    realism_by_split: dict[str, tuple[RunRecord, SplitRealism]] = {}
    for record in records:
        if record.run.realism is not None:
            realism_by_split.setdefault(record.run.split, (record, record.run.realism))
    return [realism_by_split[split] for split in sorted(realism_by_split, key=split_place)]


def _ladder_table(data_name: str, split_drivers: Sequence[SplitLadder]) -> Table:
    records = [drivers.record for drivers in split_drivers]
    few = [FEW_NOTE] if any(recordings(record) < FEW_SCENES for record in records) else []
    title = f"{data_name}: who survives the adversarial scenes (%)"
    notes = (LADDER_NOTE, _CAUTION_NOTE, _MARGIN_NOTE, *few, *review_notes(records), *_ladder_notes(split_drivers))
    return tabulate("ladder", title, _LADDER, map(_ladder_values, split_drivers), notes)


def _ladder_values(drivers: SplitLadder) -> Values:
    record, count = drivers.record, drivers.scenes
    origin, margin = origin_of(record, LADDER), drivers.margin
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
        "no fault": origin_of(record, VALIDITY).percent(drivers.without_fault, "scenes"),
        "judged": origin.count(count, "scenes", len(record.run.scenes)),
        "recordings": origin.count(recordings(record), "recorded scenes"),
    }


def _ladder_notes(split_drivers: Sequence[SplitLadder]) -> list[str]:
    notes = []
    for drivers in split_drivers:
        split, scenes = drivers.record.run.split, len(drivers.record.run.scenes)
        if drivers.scenes < scenes:
            notes.append(f"{split}: {drivers.scenes} of {counted(scenes, 'scene')} were judged.")
        if drivers.without_map:
            some = counted(drivers.without_map, "scene")
            notes.append(f"{split}: no map for {some}, so that manoeuvres may have left the road there.")
        if drivers.annotated:
            some = counted(drivers.annotated, "scene")
            notes.append(
                f"{split}: of {some} the generated tracks are not at hand; what lies between keyframes counts."
            )
        if drivers.outdated:
            notes.append(
                f"{split}: {counted(drivers.outdated, 'scene')} judged by an earlier definition: drivers take over "
                "at the first frame and not where the adversary acts; eval judges anew."
            )
    return notes


@dataclass(frozen=True, slots=True)
class _Told:
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
        origin = origin_of(self.record, VALIDITY)
        return [
            {
                "split": self.split,
                "fault": _words(fault),
                "with it": origin.count(count, self.of, of),
                "could be told": origin.count(of, self.of, self.count),
                "%": share(origin, count, of, self.of),
            }
            for fault, count, of in self.rows
        ]


def _told(record: RunRecord, realism: SplitRealism) -> _Told:
    apart = [f"not compared with recordings: {realism.not_compared}"] if realism.not_compared is not None else []
    unknown = [f"{_words(row.fault)}: {why}" for row in realism.validity for why in row.unknown]
    notes = tuple(_sentence(f"{record.run.split}: {note}") for note in (*apart, *unknown))
    rows = tuple((row.fault, row.count, row.of) for row in realism.validity)
    return _Told(record, "adversaries", realism.adversaries, rows, notes)


def _told_by_scenes(drivers: SplitLadder) -> _Told:
    """Faults by scenes, where adversaries were not counted: scenes in which one of them has the fault."""
    judged = [
        judgement
        for judgement in judged_scenes(drivers.record).values()
        if judgement.least_gap_m is not None or judgement.faults
    ]
    rows = tuple(
        (
            name,
            sum(name in judgement.faults for judgement in judged),
            sum(name not in judgement.unknown_faults for judgement in judged),
        )
        for name in FAULT_NAMES
    )
    return _Told(drivers.record, "scenes", len(judged), rows, (f"{drivers.record.run.split}: scenes are counted.",))


def _headline_table(data_name: str, headlines: Sequence[tuple[RunRecord, SplitRealism, FeatureRealism]]) -> Table:
    rows: list[Values] = []
    for record, realism, worst in headlines:
        origin, adversaries = origin_of(record, REALISM), realism.adversaries
        ctg = (
            {}
            if realism.ctg is None
            else {CTG: realism.ctg.mean_real_dev, "ctg, relative": realism.ctg.mean_real_dev_int}
        )
        rows.append(
            {
                **_feature_values(origin, worst, 0 if realism.samples is None else realism.samples[0]),
                "split": record.run.split,
                "worst feature": _words(worst.name),
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
    title = f"{data_name}: how real adversaries move, by their worst feature"
    return tabulate(REALISM, title, _HEADLINES, rows, notes)


def _realism_table(data_name: str, record: RunRecord, realism: SplitRealism) -> Table:
    samples, origin = 0 if realism.samples is None else realism.samples[0], origin_of(record, REALISM)
    rows: list[Mapping[str, Value]] = []
    for row in realism.features:
        name = _words(row.name)
        feature = f"{name} {WORST_MARK}" if row.name == realism.worst else name
        rows.append({"feature": feature, **_feature_values(origin, row, samples)})
    reference = "" if realism.reference is None else f" Recordings: {realism.reference}."
    title = f"{titled(data_name, record.run.split)}: how real its adversaries move"
    return tabulate(f"{REALISM}-{record.run.split}", title, _FEATURES, rows, (f"{_REALISM_NOTE}{reference}",))


def _feature_values(origin: Origin, row: FeatureRealism, samples: int) -> dict[str, Value]:
    low, high = row.interval or (None, None)
    return {
        "realism": origin.cell(row.realism, REALISM, samples, low=low, high=high),
        "halves": origin.cell(row.realism_of_halves, REALISM, samples),
        "W1": origin.cell(row.w1, "unit of the feature", samples),
        "W1 of halves": origin.cell(row.w1_of_halves, "unit of the feature", samples),
        "W1 in halves": origin.cell(row.w1_in_halves, "x", samples),
    }


def _words(name: str) -> str:
    return name.replace("_", " ")


def _sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."
