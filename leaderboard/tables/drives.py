"""Closed loop: a table for each setting of drives, and open-loop rates beside closed-loop ones on the same scenes."""

from collections.abc import Mapping, Sequence
from typing import Final

from benchmark.metrics.loops import (
    OPEN_LOOP,
    PlannerLoopComparison,
    RankCorrelation,
    SceneLoopComparison,
    compare_loops,
    compute_rank_correlation,
    find_run,
)
from benchmark.metrics.ranks import average_drives_by_scene
from benchmark.metrics.scores import map_scenes_to_sources
from benchmark.records.drives import (
    AT_FAULT,
    AT_FAULT_NUPLAN,
    ATTRIBUTABLE,
    BYSTANDER,
    COLLISION_RATE,
    NNS,
    SHARED,
    UNCLEAR,
    DriveRecord,
)
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import find_source
from benchmark.report.cells import PERCENT, CellSource, TableCell, ValueSource, join_record_names
from benchmark.report.fault_words import FAULT_CELLS
from benchmark.report.table import Table
from benchmark.report.words import pluralise
from leaderboard.frame.drives import ComparableDrives, DriveTableRow, group_comparable_drives
from leaderboard.frame.specification import (
    Columns,
    TableColumn,
    Value,
    Values,
    estimate_columns,
    group_columns,
    number_columns,
    tabulate,
    text_columns,
)
from leaderboard.tables.paired_drives import paired_drive_tables
from leaderboard.tables.ranks import RANK, RANK_NOTE, Contestant, rank_cells

DISAGREEMENTS = "loops-scenes"
"""How names of tables of single scenes begin."""
_RATES_NOTE = (
    f"Open loop: scenes with any sample whose plan collides under {OPEN_LOOP}. Contact, at fault: drives of the same "
    "scenes that end in a contact, and in one that is the ego's fault (fault@1). Only open, only closed: scenes "
    "failed only in that loop; agree: share of the others. Only scenes with a verdict in both loops count."
)
_SCENES_NOTE = (
    "Scenes that a planner fails in only one of the loops; only closed: a drive ends in a contact and no plan of the "
    f"recording collides under {OPEN_LOOP}. Contact: of the first run that has one, in seconds after the drive began."
)
_LoopPair = tuple[DriveTableRow, PlannerLoopComparison]
"""A planner in closed loop, and in both."""
_RATES = [
    *text_columns("planner", "sensor"),
    *group_columns("open", estimate_columns("open loop %", beside="95 %")),
    *group_columns("closed", estimate_columns("contact %", "at fault %", beside="95 %")),
    *group_columns(
        "both",
        number_columns("only open", "only closed"),
        number_columns("agree %", digits=1),
        number_columns("scenes"),
    ),
]
_BRIEF_RATES = ("planner", "open loop %", "contact %", "at fault %", "only open", "only closed", "agree %", "scenes")
_SCENES = [
    *text_columns("planner", "scene", "recording", "fails", "contact with", "at fault"),
    *number_columns("contact s", digits=1),
]
_BRIEF_SCENES = ("planner", "scene", "fails", "contact with", "at fault", "contact s")


def loop_tables(drives: Sequence[DriveRecord], runs: Sequence[RunRecord]) -> list[Table]:
    """Rates of every world in which a planner drove that ran in open loop, then scenes of those with disagreements."""
    rates, scenes = [], []
    # Scenarios put actors into scenes that the recording, and so open loop, does not have.
    for group in group_comparable_drives(
        [record for record in drives if record.facts.measured.scenarios == "recorded"]
    ):
        loop_pairs, missing = _pair_loops(group, runs)
        if loop_pairs:
            rates.append(_rates_table(group, loop_pairs, missing))
        if any(scene.disagrees for _, loops in loop_pairs for scene in loops.scenes):
            scenes.append(_scenes_table(group, loop_pairs))
    return [*rates, *scenes]


def _pair_loops(group: ComparableDrives, runs: Sequence[RunRecord]) -> tuple[list[_LoopPair], list[str]]:
    """Planners of a world in both loops, and names of those without an open loop."""
    loop_pairs, missing = [], []
    for row in group.rows:
        run = find_run(row.record, runs)
        if run is None:
            missing.append(row.name)
        else:
            loop_pairs.append((row, compare_loops(row.record, run)))
    return loop_pairs, missing


def _rates_table(group: ComparableDrives, loop_pairs: Sequence[_LoopPair], missing: Sequence[str]) -> Table:
    loops = [loops_of_planner for _, loops_of_planner in loop_pairs]
    ranks = compute_rank_correlation(loops), compute_rank_correlation(loops, at_fault=True)
    left_out = [
        f"{row.name}: {pluralise(len(loops_of_planner.without), 'scene')} left out because a drive or a sample failed."
        for row, loops_of_planner in loop_pairs
        if loops_of_planner.without
    ]
    absent = [f"Without a run record of the same planner and scenes: {', '.join(missing)}."] if missing else []
    notes = (_RATES_NOTE, *_describe_ranking(*ranks), *left_out, *absent, *group.notes)
    rows = [_rates_values(row, loops_of_planner) for row, loops_of_planner in loop_pairs]
    return tabulate(f"loops-{group.name}", f"{group.title}: beside open loop", _RATES, rows, notes, brief=_BRIEF_RATES)


def _describe_ranking(contact: RankCorrelation, at_fault: RankCorrelation) -> list[str]:
    where = f"{contact.planners} planners on the {pluralise(contact.scenes, 'scene')} that they share"
    if contact.planners and not contact.scenes:
        where = f"{contact.planners} planners, which share no scenes"
    correlations = ", ".join(
        f"{words} {'–' if correlation.tau is None else f'{correlation.tau:.2f}'}"
        for words, correlation in (("contact", contact), ("at fault", at_fault))
    )
    miniatures = "; miniatures are not ranked"
    return [f"Kendall's tau-b between open loop and closed loop: {correlations} (over {where}{miniatures})."]


def _rates_values(row: DriveTableRow, loops: PlannerLoopComparison) -> Values:
    here, count = row.origin, len(loops.scenes)
    opened = ValueSource(OPEN_LOOP, join_record_names(loops.run))
    closed = ValueSource(here.protocol, f"{join_record_names(loops.run)}; {here.record}")
    only_open = sum(scene.open_fails and not scene.closed_fails for scene in loops.scenes)
    only_closed = sum(scene.closed_fails and not scene.open_fails for scene in loops.scenes)
    agree = None if not count else 100.0 * (count - only_open - only_closed) / count
    return {
        "planner": row.planner,
        "sensor": row.record.facts.measured.sensor,
        "open loop %": opened.percent(loops.open_rate, "scenes"),
        "contact %": closed.percent(loops.contact, "scenes"),
        "at fault %": closed.percent(loops.at_fault, "scenes"),
        "only open": closed.count(only_open, "scenes", count),
        "only closed": closed.count(only_closed, "scenes", count),
        "agree %": CellSource(agree, "%", count, "scenes"),
        "scenes": closed.count(count, "scenes", count + len(loops.without)),
    }


def _scenes_table(group: ComparableDrives, loop_pairs: Sequence[_LoopPair]) -> Table:
    rows = [
        {"planner": row.planner, "recording": map_scenes_to_sources(loops.run)[scene.scene], **_scene_values(scene)}
        for row, loops in loop_pairs
        for scene in loops.scenes
        if scene.disagrees
    ]
    title = f"{group.title}: scenes on which open loop and closed loop disagree"
    notes = (_SCENES_NOTE, *group.notes)
    return tabulate(f"{DISAGREEMENTS}-{group.name}", title, _SCENES, rows, notes, brief=_BRIEF_SCENES)


def _scene_values(scene: SceneLoopComparison) -> dict[str, Value]:
    touched = scene.first.first_contact if scene.first is not None else None
    adversary = ", the adversary" if touched is not None and touched.adversary else ""
    return {
        "scene": scene.scene,
        "fails": "only open" if scene.open_fails else "only closed",
        "contact with": None if touched is None else f"{touched.category}{adversary}",
        "at fault": None if touched is None or touched.fault is None else FAULT_CELLS[touched.fault.verdict],
        "contact s": CellSource(None if touched is None else touched.seconds, "s", 1, "drives"),
    }


_MeasuredColumn = tuple[str, str, str, bool]
"""Column of a summary, head, unit, and whether its interval stands beside it."""
_DEFAULT: Final[tuple[_MeasuredColumn, ...]] = (
    ("contact", "contact %", PERCENT, True),
    (AT_FAULT, "at fault %", PERCENT, True),
    (SHARED, "shared %", PERCENT, False),
    (UNCLEAR, "unclear %", PERCENT, False),
    (AT_FAULT_NUPLAN, "at fault (nuPlan) %", PERCENT, False),
    ("with_adversary", "adversary %", PERCENT, False),
    ("impact_speed", "impact m/s", "m/s", False),
    ("delta_v", "delta-v m/s", "m/s", False),
    ("route", "route %", PERCENT, True),
    ("off_road", "off road %", PERCENT, False),
    ("comfortable", "comfort %", PERCENT, False),
    ("nuplan_score", "nuPlan terms", "", True),
    ("nuplan_nc", "NC", "", False),
    ("nuplan_dac", "DAC", "", False),
    ("nuplan_mp", "MP", "", False),
    ("nuplan_ddc", "DDC", "", False),
    ("nuplan_p", "P", "", False),
    ("nuplan_ttc", "TTC", "", False),
    ("nuplan_c", "C", "", False),
    ("hd_score", "HD formula", "", True),
)
_BYSTANDERS: Final[_MeasuredColumn] = ("with_bystander", "bystanders %", PERCENT, False)
"""Of windows around an encounter: drives with a contact with anybody but the adversary."""
_NEURONCAP: Final[tuple[_MeasuredColumn, ...]] = (
    (NNS, "NNS", "points", True),
    (COLLISION_RATE, "CR %", PERCENT, True),
    ("impact_speed", "impact m/s", "m/s", False),
    ("route", "route %", PERCENT, True),
    ("comfortable", "comfort %", PERCENT, False),
)
_FAIRNESS: Final = (
    (ATTRIBUTABLE, "attributable %", PERCENT, True),
    (BYSTANDER, "bystander %", PERCENT, False),
    ("survives_cc", "careful survives %", PERCENT, True),
)
"""Where reference drivers drove the same encounters."""
_NOTE_FAIRNESS: Final = (
    "Attributable: contacts at fault with the adversary, in encounters that a careful human driver survives on the "
    "same path against the same adversary (docs/extensions/reactive_adversary.md); bystander: the same with any other "
    "road user; careful survives: share of encounters that this driver survives. The adversary reacts to each "
    "driver, so an encounter is defined by the vehicle, the hand-over and the seed."
)
_PUBLISHED: Final = ("NNS as published code rounds", "CR % as published code rounds")
_PUBLISHED_NOTE: Final = (
    "As published code rounds: means over runs, then scenes, then families, each rounded to three digits; a scene with "
    "an unscored run is left out; as in NeuroNCAP's tables. NNS and CR % have no intermediate rounding."
)
_FAMILIES: Final = ("stationary", "frontal", "side")
_BRIEF: Final = (
    *("planner", "sensor", "contact", "at_fault", "95 % of at_fault", ATTRIBUTABLE, BYSTANDER, "survives_cc"),
    *("impact_speed", "route", "off_road", "comfortable", "nuplan_score", "hd_score", "failed", "drives"),
    RANK,
)
"""Columns of our own engine in a terminal; the only interval is that of fault."""
_BRIEF_OF_WINDOWS: Final = ("with_adversary", "with_bystander")
_NOTE_CONTACT: Final = (
    "Contact: with any object; at fault: by fault@1 (docs/fault.md); shared, unclear: contacts that are both users' "
    "fault, and of which the map does not tell; at fault (nuPlan): by nuPlan's rule (docs/severity.md). Impact "
    "speed and delta-v: means over contacts. Route: driven share of the recorded path. "
)
_OTHERS_GO: Final = (
    "; others that touch the ego are removed from the next planning instant on. Impact speed and delta-v are of the "
    "first contact of a drive, at fault or not."
)
_NOTE_STOP_ON: Final = {
    "contact": "A drive ends at its first contact.",
    "fault@1": "A drive ends at the first contact that is its fault" + _OTHERS_GO,
    "fault@nuplan": "A drive ends at the first contact that is its fault by nuPlan's rule" + _OTHERS_GO,
}
_NOTE_SCORES: Final = (
    "nuPlan terms: NC DAC MP DDC (5 P + 5 TTC + 2 C) / 12, without speed limits, traffic lights and route blocks, "
    "which nuScenes lacks: not nuPlan's score. HD formula: HD-Score's formula with our terms, not HUGSIM."
)
_NOTES_NEURONCAP: Final = (
    "NNS: 5 without contact, else 4 max(0, 1 - impact / reference); CR: drives with a contact. Numbers of this engine "
    "are comparable with published ones only on NeuroNCAP's own scenarios and renderer. Families weigh equally.",
)
_NOTE_FURTHER: Final = (
    "{}: scores whose parts stand in a table of their own; without a map (¶) they do not count leaving the road."
)
_FAILED_NOTE: Final = (
    "failed: drives in which the planner raised, answered no usable plan or was late; in no other column."
)


def drive_tables(records: Sequence[DriveRecord]) -> list[Table]:
    """One table for each thing that was measured: data set, split, scenes, engine, policy of agents, latency, sensor.

    Args:
        records: Of any planners.

    Returns:
        The tables, NeuroNCAP's engines last, then those of adversarial drives paired with drives of the recordings.

    Raises:
        InputError: If two records would share a row.
    """
    groups = group_comparable_drives(records)
    return [*map(_table, groups), *paired_drive_tables(groups)]


def _table(group: ComparableDrives) -> Table:
    first, own = group.records[0].facts, group.records[0].facts.measured.engine == "default"
    fair = any("survives_cc" in record.summary.columns for record in group.records)
    windows = any("with_bystander" in record.summary.columns for record in group.records)
    further = (*(_FAIRNESS if fair else ()), *_DEFAULT[5:6], *((_BYSTANDERS,) if windows else ()), *_DEFAULT[6:])
    names = {name for record in group.records for row in record.rows if row.scores for name in row.scores.further}
    further = (*further, *((name, name, "", True) for name in sorted(names)))
    measured = (*_DEFAULT[:5], *further) if own else _neuroncap_columns(group.records)
    published = any(record.summary.published is not None for record in group.records)
    columns = [
        *text_columns("planner", "sensor"),
        *(column for column_values in measured for column in _columns(*column_values)),
        *(number_columns(_PUBLISHED[0], digits=3) if published else ()),
        *(number_columns(_PUBLISHED[1], digits=1) if published else ()),
        *number_columns("failed", "drives", *([RANK] if own else [])),
    ]
    ranks: Sequence[TableCell | None] = [None] * len(group.rows)
    rank_notes: list[str] = []
    if own:
        ranks, rank_notes = _rank(group)
    own_notes = (_NOTE_CONTACT + _NOTE_STOP_ON[first.measured.rule or "contact"], _NOTE_SCORES)
    notes = (*(own_notes if own else _NOTES_NEURONCAP), *([_PUBLISHED_NOTE] if published else ()))
    also = [_NOTE_FURTHER.format(", ".join(sorted(names)))] if names else []
    notes = (*notes, *([_NOTE_FAIRNESS] if fair else []), *also, _FAILED_NOTE, *rank_notes, *group.notes)
    units = {name: unit for name, _, unit, _ in measured}
    rows = [{**_values(row, units), RANK: rank} for row, rank in zip(group.rows, ranks, strict=True)]
    brief = (*_BRIEF, *_BRIEF_OF_WINDOWS[: 2 * windows]) if own else [column.key for column in columns]
    failed = [_FAILED_NOTE] if any(record.summary.failed for record in group.records) else []
    brief_notes = (*failed, *rank_notes[1:], *group.notes)
    return tabulate(f"drives-{group.name}", group.title, columns, rows, notes, brief=brief, brief_notes=brief_notes)


def _rank(group: ComparableDrives) -> tuple[list[TableCell], list[str]]:
    """Ranks by nuPlan's terms, and notes on them."""
    contestants = []
    for row in group.rows:
        facts, totals = row.record.facts, average_drives_by_scene(row.record)
        sources = {name: find_source(name, facts.scene_facts) for name in totals}
        contestants.append(Contestant(row.name, facts.planner, totals, sources, row.origin))
    cells, told = rank_cells(contestants, lower_is_better=False, unit="")
    return cells, [RANK_NOTE.format("nuPlan terms, highest first", "drive"), *told]


def _neuroncap_columns(records: Sequence[DriveRecord]) -> Sequence[_MeasuredColumn]:
    """Columns of NeuroNCAP's engines, with those of the families of scenarios that were driven."""
    named = {row.family for record in records for row in record.rows if row.family}
    families = [family for family in _FAMILIES if family in named]
    scores = [(f"{NNS}_{family}", f"NNS {family}", "points", False) for family in families]
    rates = [(f"{COLLISION_RATE}_{family}", f"CR {family} %", PERCENT, False) for family in families]
    return [*_NEURONCAP, *scores, *rates]


def _columns(name: str, head: str, unit: str, with_interval: bool) -> Columns:
    digits = 1 if unit == PERCENT else 2
    ends = [TableColumn("95 %", name, digits=digits, interval=True)] if with_interval else []
    return [TableColumn(head, name, digits=digits), *ends]


def _values(row: DriveTableRow, units: Mapping[str, str]) -> Values:
    summary, origin = row.record.summary, row.origin
    cells: dict[str, Value] = {name: row.cell(name, unit) for name, unit in units.items()}
    if summary.published is not None:
        count = summary.drives - summary.failed
        cells[_PUBLISHED[0]] = origin.cell(summary.published.nns, "points", count, "drives")
        cells[_PUBLISHED[1]] = origin.cell(summary.published.collision, PERCENT, count, "drives", scale=100.0)
    failed = origin.count(summary.failed, "drives", summary.drives)
    identity: Values = {"planner": row.planner, "sensor": row.record.facts.measured.sensor}
    return {**cells, **identity, "failed": failed, "drives": row.drives()}


def describe_failures(record: DriveRecord) -> str:
    """Sentence on how many drives failed and why."""
    reasons = ", ".join(f"{count} {reason}" for reason, count in record.summary.reasons.items())
    first = next(row for row in record.rows if row.failure is not None)
    assert first.failure is not None
    lines = first.failure.text.strip().splitlines() or [first.failure.reason]
    return (
        f"{record.planner} failed in {record.summary.failed} of {pluralise(record.summary.drives, 'drive')} "
        f"({reasons}; the first, {first.scene}: {lines[-1]})"
    )
