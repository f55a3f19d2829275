"""Closed loop: what came of drives, a table for each thing that was measured; nothing else compares."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from benchmark.metrics.loops import is_stale
from benchmark.records.drive_schema import UntilName
from benchmark.records.drives import ATTRIBUTABLE, BYSTANDER, COLLISION_RATE, NNS, DriveRecord, columns_of
from benchmark.records.run_schema import RateRow
from benchmark.report.cells import UNDEFINED, Origin, Shown, named_record
from benchmark.report.table import Brief, Table, table_of
from benchmark.report.words import counted
from leaderboard.tables.rows import (
    FEW_NOTE,
    FEW_SCENES,
    STALE_MARK,
    caveat_notes,
    mark_notes,
    name_cell,
    with_caveat_mark,
)
from leaderboard.tables.worlds import World, worlds

_PERCENT: Final = "%"
_DEFAULT: Final = (
    ("contact", "contact %", _PERCENT, True),
    ("at_fault", "at fault %", _PERCENT, True),
    ("with_adversary", "adversary %", _PERCENT, False),
    ("impact_speed", "impact m/s", "m/s", False),
    ("delta_v", "delta-v m/s", "m/s", False),
    ("route", "route %", _PERCENT, True),
    ("off_road", "off road %", _PERCENT, False),
    ("comfortable", "comfort %", _PERCENT, False),
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
_NEURONCAP: Final = (
    (NNS, "NNS", "points", True),
    (COLLISION_RATE, "CR %", _PERCENT, True),
    ("impact_speed", "impact m/s", "m/s", False),
    ("route", "route %", _PERCENT, True),
    ("comfortable", "comfort %", _PERCENT, False),
)
"""Column of a summary, head, unit, and whether its interval stands beside it."""
_FAIRNESS: Final = (
    (ATTRIBUTABLE, "attributable %", _PERCENT, True),
    (BYSTANDER, "bystander %", _PERCENT, False),
    ("survives_cc", "careful survives %", _PERCENT, True),
)
"""Where reference drivers drove the same encounters."""
_NOTE_FAIRNESS: Final = (
    "Attributable: contacts at fault with the adversary, in encounters that a careful human survives, who drives the "
    "same path against the same adversary (docs/extensions/reactive_adversary.md); bystander: the same with anybody "
    "else; careful survives: the share of encounters in which this human touches nobody. The adversary answers each "
    "driver, so that an encounter is the vehicle, the hand-over and the seed."
)
_PUBLISHED: Final = ("NNS as published code rounds", "CR % as published code rounds")
_PUBLISHED_NOTE: Final = (
    "As published code rounds: means over runs, then scenes, then families, each rounded to three digits, and a scene "
    "with a run without a score left out; so are the numbers in NeuroNCAP's tables. NNS and CR % are not rounded on "
    "the way."
)
_FAMILIES: Final = ("stationary", "frontal", "side")
_BRIEF_DEFAULT: Final = (
    "planner",
    "sensor",
    "contact %",
    "at fault %",
    "95 %",
    "attributable %",
    "bystander %",
    "careful survives %",
    "impact m/s",
    "route %",
    "off road %",
    "comfort %",
    "nuPlan terms",
    "HD formula",
    "failed",
    "drives",
)
_NOTE_CONTACT: Final = (
    "Contact: any, whoever it is with; at fault: by nuPlan's rules (docs/severity.md). Impact speed and delta-v: means "
    "over contacts. Route: share of the recorded way. "
)
_NOTE_UNTIL: Final[dict[UntilName, str]] = {
    "contact": "A drive ends at its first contact.",
    "fault": "A drive ends at the first contact that is its fault; whoever touches the ego otherwise is gone from the "
    "next planning instant on. Impact speed and delta-v are of the first contact of a drive, whoever's fault it is.",
}
_NOTE_SCORES: Final = (
    "nuPlan terms: NC DAC MP DDC (5 P + 5 TTC + 2 C) / 12, without speed limits, traffic lights and route blocks, "
    "which nuScenes lacks: not nuPlan's score. HD formula: HD-Score's formula with our terms, not HUGSIM."
)
_NOTES_NEURONCAP: Final = (
    "NNS: 5 without contact, else 4 max(0, 1 - impact / reference); CR: drives with a contact. Numbers of this engine "
    "compare with published ones only on NeuroNCAP's own scenarios and renderer. Families of scenarios count alike.",
)
_FAILED_NOTE: Final = (
    "failed: drives in which the planner raised, answered no usable plan or was late; in no other column."
)


def drive_tables(records: Sequence[DriveRecord]) -> list[Table]:
    """One table for each thing that was measured: data set, split, scenes, engine, policy of agents, latency, sensor.

    Args:
        records: Of any planners.

    Returns:
        The tables, NeuroNCAP's engines last.

    Raises:
        InputError: If two records would share a row.
    """
    return [_table(one) for one in worlds(records)]


def _table(one: World) -> Table:
    records, first = one.records, one.records[0].facts
    own = first.measured.engine == "default"
    climbed = any("survives_cc" in record.summary.columns for record in records)
    with_fairness = (*_DEFAULT[:2], *_FAIRNESS, *_DEFAULT[2:]) if climbed else _DEFAULT
    columns = with_fairness if own else (*_NEURONCAP, *_of_families(records))
    heads = ["planner", "sensor"]
    for _, head, _, with_interval in columns:
        heads += [head, "95 %"] if with_interval else [head]
    published = any(record.summary.published is not None for record in records)
    heads += [*(_PUBLISHED if published else ()), "failed", "drives"]
    rows = [_row(record, name, columns, published) for record, name in zip(records, one.planners, strict=True)]
    title = one.title
    said = (_NOTE_CONTACT + _NOTE_UNTIL[first.measured.until], _NOTE_SCORES)
    notes = (*(said if own else _NOTES_NEURONCAP), *([_PUBLISHED_NOTE] if published else ()))
    notes = (*notes, *([_NOTE_FAIRNESS] if climbed else []), _FAILED_NOTE, *notes_of(one))
    places = _brief_places(heads) if own else tuple(range(len(heads)))
    return table_of(
        f"drives-{one.name}",
        title,
        heads,
        rows,
        notes=notes,
        text_columns=2,
        brief=Brief(title, places, notes, text_columns=2),
    )


def _of_families(records: Sequence[DriveRecord]) -> list[tuple[str, str, str, bool]]:
    """Columns of the families of scenarios that were driven."""
    named = {row.family for record in records for row in record.rows if row.family}
    families = [family for family in _FAMILIES if family in named]
    scores = [(f"{NNS}_{family}", f"NNS {family}", "points", False) for family in families]
    return [*scores, *((f"{COLLISION_RATE}_{family}", f"CR {family} %", _PERCENT, False) for family in families)]


def _brief_places(heads: Sequence[str]) -> tuple[int, ...]:
    """Places of the columns that a terminal shows; of intervals that of blame alone."""
    blamed = heads.index("at fault %") + 1
    return tuple(
        place for place, head in enumerate(heads) if (head in _BRIEF_DEFAULT and head != "95 %") or place == blamed
    )


def notes_of(one: World) -> list[str]:
    """What has to be said of the records of one world: sensor, few scenes, marks, old scores."""
    planners = [record.facts.planner for record in one.records]
    marks = mark_notes(
        privileged=any(each.privileged for each in planners), miniature=any(each.miniature for each in planners)
    )
    first = one.records[0].facts
    # A scene of which nobody says where it comes from is its own recording.
    known = first.scene_facts
    few = len({known[name].source if name in known else name for name in first.scenes}) < FEW_SCENES
    stale = [
        f"{STALE_MARK} {name}: scored by version {record.facts.scoring} of closed loop's scores, not the present one; "
        "run the same challenger-bench drive again."
        for record, name in zip(one.records, one.planners, strict=True)
        if is_stale(record)
    ]
    lacking = caveat_notes(record.facts for record in one.records)
    return [*_said_of_sensor(one), *([FEW_NOTE] if few else []), *marks, *lacking, *stale]


def _said_of_sensor(one: World) -> list[str]:
    """What pictures depended on besides the sensor's name."""
    found = [record.facts.measured for record in one.records if record.facts.measured.sensor == one.sensor]
    facts = found[0].sensor_facts if found else {}
    said = ", ".join(f"{name} {value}" for name, value in sorted(facts.items()))
    return [f"Sensor {one.sensor}: {said}."] if said else []


def planner_cell(record: DriveRecord, name: str) -> Shown:
    """The planner's name with its marks, among them that of earlier scores."""
    planner = record.facts.planner
    cell = name_cell(name, privileged=planner.privileged, miniature=planner.miniature)
    cell = with_caveat_mark(cell, record.facts)
    return replace(cell, text=f"{cell.text} {STALE_MARK}") if is_stale(record) else cell


def origin_of_drives(record: DriveRecord, name: str) -> Origin:
    """Where numbers of a record of drives come from."""
    return Origin(record.facts.measured.world, named_record(record.content_id, name, record.facts.split))


def _row(
    record: DriveRecord, name: str, columns: Sequence[tuple[str, str, str, bool]], published: bool
) -> tuple[str | Shown, ...]:
    summary, columns_now, origin = record.summary, columns_of(record), origin_of_drives(record, name)
    cells: list[str | Shown] = [planner_cell(record, name), record.facts.measured.sensor]
    for column, _, unit, with_interval in columns:
        rate = columns_now.get(column)
        cells += _cells(origin, rate, unit, with_interval=with_interval)
    cells += _published_cells(record, origin) if published else []
    failed = origin.count(summary.failed, "drives", summary.drives)
    return (*cells, failed.shown(), origin.count(summary.drives, "drives").shown())


def _published_cells(record: DriveRecord, origin: Origin) -> list[str | Shown]:
    """NeuroNCAP's own averages, with the three digits to which they are rounded."""
    found = record.summary.published
    if found is None:
        return [UNDEFINED, UNDEFINED]
    count = record.summary.drives - record.summary.failed
    share = origin.cell(found.collision, _PERCENT, count, "drives", scale=100.0)
    return [origin.cell(found.nns, "points", count, "drives").shown(3), share.shown(1)]


def _cells(origin: Origin, rate: RateRow | None, unit: str, *, with_interval: bool) -> list[str | Shown]:
    if rate is None:
        return [UNDEFINED, UNDEFINED] if with_interval else [UNDEFINED]
    percent = unit == _PERCENT
    cell = origin.percent(rate, "drives") if percent else origin.amount(rate, unit, "drives")
    digits = 1 if percent else 2
    shown: list[str | Shown] = [cell.shown(digits)]
    return [*shown, cell.interval(digits)] if with_interval else shown


def said_of_failures(record: DriveRecord) -> str:
    """How many drives failed and why, in a sentence."""
    reasons = ", ".join(f"{count} {reason}" for reason, count in record.summary.reasons.items())
    first = next(row for row in record.rows if row.failure is not None)
    assert first.failure is not None
    lines = first.failure.text.strip().splitlines() or [first.failure.reason]
    return (
        f"{record.planner} failed in {record.summary.failed} of {counted(record.summary.drives, 'drive')} ({reasons}; "
        f"the first, {first.scene}: {lines[-1]})"
    )
