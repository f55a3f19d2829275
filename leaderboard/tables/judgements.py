"""Tables about scenes, not planners: who survives them, how real their adversaries move, what is wrong with those."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from benchmark.metrics.judgements import SplitLadder, judged_scenes, split_ladders
from benchmark.records.judgement import DRIVER_NAMES, FAULT_NAMES, DriverName, FeatureRow, SplitRealism
from benchmark.records.run import RunRecord
from benchmark.report.cells import PERCENT, Origin, Shown, origin_of
from benchmark.report.table import Table, table_of
from benchmark.report.words import counted, titled
from leaderboard.tables.rows import FEW_NOTE, FEW_SCENES, in_table_order, recordings, review_notes, split_place

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

Row = tuple[str | Shown, ...]


def judgement_tables(data_name: str, records: Sequence[RunRecord]) -> list[Table]:
    """Everything that records say of scenes.

    Args:
        data_name: Name of the data set, for the titles.
        records: Runs on this data set, at most one for each planner and split.

    Returns:
        The ladder, a row a split; what is wrong with adversaries; their worst feature, and a table of all features a
        split with recordings to compare with. None of what no record says.
    """
    ordered = in_table_order(records)
    ladders, real = split_ladders(ordered), split_realism(ordered)
    tables = [] if not ladders else [_ladder_table(data_name, ladders)]
    told = [_told(record, said) for record, said in real]
    told += [_told_by_scenes(each) for split, each in ladders.items() if split not in {one.split for one in told}]
    tables += [] if not told else [_validity_table(data_name, sorted(told, key=lambda each: split_place(each.split)))]
    compared = [(record, said) for record, said in real if said.headline is not None]
    tables += [] if not compared else [_headline_table(data_name, compared)]
    return [*tables, *(_realism_table(data_name, record, said) for record, said in compared)]


def split_realism(records: Sequence[RunRecord]) -> list[tuple[RunRecord, SplitRealism]]:
    """Of each split that somebody looked at the first record that says so, in the order of tables."""
    found: dict[str, tuple[RunRecord, SplitRealism]] = {}
    for record in records:
        if record.run.realism is not None:
            found.setdefault(record.run.split, (record, record.run.realism))
    return [found[split] for split in sorted(found, key=split_place)]


def _ladder_table(data_name: str, ladders: dict[str, SplitLadder]) -> Table:
    found = [ladders[split] for split in sorted(ladders, key=split_place)]
    drivers = tuple(DRIVER_HEADS[name] for name in DRIVER_NAMES)
    records = [each.record for each in found]
    few = [FEW_NOTE] if any(recordings(record) < FEW_SCENES for record in records) else []
    return table_of(
        "ladder",
        f"{data_name}: who survives the adversarial scenes (%)",
        (
            *("split", *drivers, "95 % of careful human", "unsolvable"),
            *(
                "margin, s",
                "margin, worst tenth",
                "margin < 0",
                "ego's gap, m",
                "ego's TTC, s",
                "ego's BTN",
                "no fault",
            ),
            *("judged", "recordings"),
        ),
        [_ladder_row(each) for each in found],
        notes=(LADDER_NOTE, _CAUTION_NOTE, _MARGIN_NOTE, *few, *review_notes(records), *_ladder_notes(found)),
        groups=(
            ("", 1),
            (f"survived by, % of the scenes, {LADDER}", len(drivers) + 1),
            (f"time to avoid it, {LADDER}", 4),
            (f"recorded ego, {LADDER}", 3),
            (f"% of the scenes, {VALIDITY}", 1),
            (f"counted, {LADDER}", 2),
        ),
    )


def _ladder_row(ladder: SplitLadder) -> Row:
    record, count = ladder.record, ladder.scenes
    origin, faults = origin_of(record, LADDER), origin_of(record, VALIDITY)
    shares = {name: origin.percent(ladder.survives[name], "scenes") for name in DRIVER_NAMES}
    return (
        record.run.split,
        *(shares[name].shown(1) for name in DRIVER_NAMES),
        shares["cc"].interval(),
        origin.count(ladder.unsolvable, "scenes", count).shown(),
        *(
            origin.cell(value, "s", ladder.margin.samples, "scenes").shown(1)
            for value in (ladder.margin.median, ladder.margin.worst_tenth)
        ),
        origin.count(ladder.too_late, "scenes", ladder.margin.samples).shown(),
        origin.cell(ladder.gap.median, "m", ladder.gap.samples, "scenes").shown(2),
        origin.cell(ladder.ttc.median, "s", ladder.ttc.samples, "scenes").shown(2),
        origin.cell(ladder.btn.median, "BTN", ladder.btn.samples, "scenes").shown(2),
        faults.percent(ladder.without_fault, "scenes").shown(1),
        origin.count(count, "scenes", len(record.run.scenes)).shown(),
        origin.count(recordings(record), "recorded scenes").shown(),
    )


def _ladder_notes(found: Sequence[SplitLadder]) -> list[str]:
    notes = []
    for each in found:
        split, scenes = each.record.run.split, len(each.record.run.scenes)
        if each.scenes < scenes:
            notes.append(f"{split}: {each.scenes} of {counted(scenes, 'scene')} were judged.")
        if each.without_map:
            some = counted(each.without_map, "scene")
            notes.append(f"{split}: no map for {some}, so that manoeuvres may have left the road there.")
        if each.annotated:
            some = counted(each.annotated, "scene")
            notes.append(
                f"{split}: of {some} the generated tracks are not at hand; what lies between keyframes counts."
            )
        if each.outdated:
            notes.append(
                f"{split}: {counted(each.outdated, 'scene')} judged by an earlier definition: drivers take over "
                "at the first frame and not where the adversary acts; eval judges anew."
            )
    return notes


@dataclass(frozen=True, slots=True)
class _Told:
    """What is wrong with the adversaries of a split; each row is fault, how many have it, of how many it was told."""

    record: RunRecord
    of: str
    count: int
    rows: tuple[tuple[str, int, int], ...]
    notes: tuple[str, ...]

    @property
    def split(self) -> str:
        return self.record.run.split


def _told(record: RunRecord, said: SplitRealism) -> _Told:
    apart = [f"not compared with recordings: {said.not_compared}"] if said.not_compared is not None else []
    unknown = [f"{_words(row.fault)}: {why}" for row in said.validity for why in row.unknown]
    notes = tuple(_sentence(f"{record.run.split}: {note}") for note in (*apart, *unknown))
    rows = tuple((row.fault, row.count, row.of) for row in said.validity)
    return _Told(record, "adversaries", said.adversaries, rows, notes)


def _told_by_scenes(ladder: SplitLadder) -> _Told:
    """Where nobody counted adversaries: scenes in which one of them has the fault."""
    judged = [each for each in judged_scenes(ladder.record).values() if each.least_gap_m is not None or each.faults]
    rows = tuple(
        (name, sum(name in each.faults for each in judged), sum(name not in each.unknown_faults for each in judged))
        for name in FAULT_NAMES
    )
    return _Told(ladder.record, "scenes", len(judged), rows, (f"{ladder.record.run.split}: scenes are counted.",))


def _validity_table(data_name: str, found: Sequence[_Told]) -> Table:
    rows: list[Row] = []
    for told in found:
        origin = origin_of(told.record, VALIDITY)
        rows += [
            (
                *(told.split, _words(fault)),
                origin.count(count, told.of, of).shown(),
                origin.count(of, told.of, told.count).shown(),
                origin.cell(count / of if of else None, PERCENT, of, told.of, scale=100.0).shown(1),
            )
            for fault, count, of in told.rows
        ]
    return table_of(
        "validity",
        f"{data_name}: what is wrong with adversaries",
        ("split", "fault", "with it", "could be told", "%"),
        rows,
        notes=(_VALIDITY_NOTE, *dict.fromkeys(note for told in found for note in told.notes)),
        text_columns=2,
        groups=(("", 2), (f"adversaries, {VALIDITY}", 3)),
    )


def _headline_table(data_name: str, found: Sequence[tuple[RunRecord, SplitRealism]]) -> Table:
    rows: list[Row] = []
    for record, said in found:
        origin, worst, adversaries = origin_of(record, REALISM), said.headline, said.adversaries
        assert worst is not None
        ctg = None if said.ctg is None else said.ctg.mean_real_dev
        inter = None if said.ctg is None else said.ctg.mean_real_dev_int
        rows.append(
            (
                *(record.run.split, _words(worst.name)),
                *_feature_numbers(origin, worst, 0 if said.samples is None else said.samples[0])[:3],
                origin.cell(worst.w1_in_halves, "x", adversaries, "adversaries").shown(1),
                *(origin.cell(value, CTG, adversaries, "adversaries").shown(4) for value in (ctg, inter)),
                origin.count(adversaries, "adversaries").shown(),
            )
        )
    versions = [
        f"{record.run.split}: {CTG}, version {said.ctg.version}, normalised by {said.ctg.normalisation}, mask "
        f"{said.ctg.mask}."
        for record, said in found
        if said.ctg is not None
    ]
    return table_of(
        REALISM,
        f"{data_name}: how real adversaries move, by their worst feature",
        (
            *("split", "worst feature", "realism", "95 % of realism", "halves", "W1 in halves"),
            *(CTG, "ctg, relative", "adversaries"),
        ),
        rows,
        notes=(_REALISM_NOTE, *([_CTG_NOTE] if versions else []), *versions),
        text_columns=2,
        groups=(("", 2), (f"1 − JSD, {REALISM}", 3), (f"W1, {REALISM}", 1), (CTG, 2), (f"counted, {REALISM}", 1)),
    )


def _realism_table(data_name: str, record: RunRecord, said: SplitRealism) -> Table:
    split, samples = record.run.split, said.samples or (0, 0)
    origin = origin_of(record, REALISM)
    rows: list[Row] = [_feature_row(origin, row, samples[0], worst=row.name == said.worst) for row in said.features]
    reference = "" if said.reference is None else f" Recordings: {said.reference}."
    return table_of(
        f"{REALISM}-{split}",
        f"{titled(data_name, split)}: how real its adversaries move",
        ("feature", "realism", "95 % of realism", "halves", "W1", "W1 of halves", "W1 in halves"),
        rows,
        notes=(f"{_REALISM_NOTE}{reference}",),
        groups=(("", 1), (f"1 − JSD, {REALISM}", 3), (f"W1, {REALISM}", 3)),
    )


def _feature_row(origin: Origin, row: FeatureRow, samples: int, *, worst: bool) -> Row:
    name = _words(row.name)
    return (f"{name} {WORST_MARK}" if worst else name, *_feature_numbers(origin, row, samples))


def _feature_numbers(origin: Origin, row: FeatureRow, samples: int) -> tuple[Shown, ...]:
    low, high = row.interval or (None, None)
    real = origin.cell(row.realism, REALISM, samples, low=low, high=high)

    def shown(value: float | None, unit: str, digits: int = 3) -> Shown:
        return origin.cell(value, unit, samples).shown(digits)

    return (
        real.shown(3),
        real.interval(3),
        shown(row.realism_of_halves, REALISM),
        shown(row.w1, "unit of the feature"),
        shown(row.w1_of_halves, "unit of the feature"),
        shown(row.w1_in_halves, "x", 1),
    )


def _words(name: str) -> str:
    return name.replace("_", " ")


def _sentence(text: str) -> str:
    return text if text.endswith(".") else f"{text}."
