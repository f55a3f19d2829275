"""Attack success on planners in three readings, and how severe their plans are in open loop."""

from collections.abc import Sequence
from typing import Final

from benchmark.metrics.attacks import READINGS, AttackRates, Reading, attack_rates, counts_attacks
from benchmark.metrics.severities import Spread, contacts_of, near_passes_of
from benchmark.records.run import RunRecord
from benchmark.report.cells import PERCENT, Origin, Shown, origin_of
from benchmark.report.table import Brief, Table, table_of
from benchmark.report.words import counted
from leaderboard.tables.rows import in_table_order, name_cell, notes_of_marks, run_notes, with_caveat_mark

SEVERITY: Final = "severity"
"""The definition behind these numbers (docs/severity.md), as groups and cells name it."""
HEADS: Final[dict[Reading, str]] = {"contact": "contact", "at_fault": "at fault", "attributable": "attributable"}
READINGS_NOTE: Final = (
    "Contact: the plan touches the adversary before anything else within 3 s. At fault: that is the planner's fault, "
    "as nuPlan has it. Attributable: at fault, and the careful and competent human (UN R157) survives the scene. "
    "Bystander: the plan touches another than the adversary first; no reading counts it."
)
RULES_NOTE: Final = (
    "Of a scene one sample is enough. What nobody can tell is in neither part of a rate: attributable needs a scene "
    "that was judged. Brackets: 95 % bootstrap interval over recorded scenes (docs/severity.md)."
)
_CONTACT_NOTE: Final = (
    "Of the samples whose plan touches the adversary before anything else: median, and what the worst tenth reaches; "
    "the last columns are of those that touch a bystander first. Delta-v: change of velocity in a plastic "
    "impact, by masses. P(fatal): of somebody in the ego, the fourth power of delta-v / 31.74 m/s (Joksch); for people "
    "on foot look at the other's delta-v."
)
_NEAR_NOTE: Final = (
    "Plans without contact, and the adversaries; median, and what the worst tenth reaches. TTC: least time to contact "
    "at constant velocities, of those that head for one another. TET: time with a TTC below 1.5 s; TIT: by how much, "
    "summed. PET: time between one leaving a place and the other reaching it, where the ways meet. BTN: braking needed "
    "beside what a dry road allows; 1 and more: braking alone is not enough."
)

Row = tuple[str | Shown, ...]


def attack_tables(data_name: str, records: Sequence[RunRecord]) -> list[Table]:
    """Attack success and severity.

    Args:
        data_name: Name of the data set, for the titles.
        records: Runs on this data set.

    Returns:
        Attack success on each planner, on splits with adversaries; severity with contact and without. Runs that
        cannot tell (`counts_attacks`) are left out; none where no other run has adversaries.
    """
    runs = [record for record in in_table_order(records) if counts_attacks(record)]
    if not runs:
        return []
    notes = tuple(run_notes(runs, ()))
    return [make(data_name, runs, notes) for make in (_success_table, _contact_table, _near_table)]


def success_table(data_name: str, records: Sequence[RunRecord]) -> Table | None:
    """Attack success alone, as ``challenger-bench eval`` prints it; ``None`` where no run has adversaries."""
    return next(iter(attack_tables(data_name, records)), None)


def _success_table(data_name: str, runs: Sequence[RunRecord], notes: tuple[str, ...]) -> Table:
    title = f"{data_name}: attack success (%)"
    found = [(record, attack_rates(record)) for record in runs]
    columns = (
        *("planner", "split"),
        *(head for name in READINGS for head in (HEADS[name], f"95 % of {HEADS[name]}")),
        *("bystander", "95 % of bystander"),
        *(head for name in READINGS for head in (f"{HEADS[name]}, scenes", f"95 % of {HEADS[name]}, scenes")),
        *("bystander, scenes", "95 % of bystander, scenes"),
        *("samples", "scenes", "judged", "careful survives"),
    )
    of_scenes = [columns.index(f"{head}, scenes") for head in (*HEADS.values(), "bystander")]
    shown = (0, 1, *of_scenes, columns.index("judged"))
    all_notes = (READINGS_NOTE, RULES_NOTE, *_unknown_notes(found), *notes)
    return table_of(
        "attack-success",
        title,
        columns,
        [_success_row(record, rates) for record, rates in found],
        notes=all_notes,
        text_columns=2,
        groups=(
            ("", 2),
            (f"of samples in %, {SEVERITY}", 8),
            (f"of scenes in %, {SEVERITY}", 8),
            (f"counted, {SEVERITY}", 4),
        ),
        # The rest of what has to be said of the runs stands below the rates already.
        brief=Brief(title, shown, (READINGS_NOTE, *notes_of_marks(runs), *_unknown_notes(found)), 2),
    )


def _success_row(record: RunRecord, rates: AttackRates) -> Row:
    origin, scenes = origin_of(record, SEVERITY), len(record.run.scenes)
    of_samples = [origin.percent(rate) for rate in (*rates.samples.values(), rates.bystander_samples)]
    of_scenes = [origin.percent(rate, "scenes") for rate in (*rates.scenes.values(), rates.bystander_scenes)]
    return (
        *_who(record),
        *(shown for cell in (*of_samples, *of_scenes) for shown in (cell.shown(1), cell.interval())),
        origin.count(rates.samples["contact"].denominator, "samples", record.summary.samples).shown(),
        origin.count(rates.scenes["contact"].denominator, "scenes", scenes).shown(),
        origin.count(rates.judged, "scenes", scenes).shown(),
        origin.count(rates.spared, "scenes", rates.judged).shown(),
    )


def _unknown_notes(found: Sequence[tuple[RunRecord, AttackRates]]) -> list[str]:
    """Runs of which something is unknown; what concerns all planners of a split is said once."""
    said: dict[str, None] = {}
    for record, rates in found:
        scenes, split = len(record.run.scenes), record.run.split
        if rates.judged < scenes:
            some = f"{rates.judged} of {counted(scenes, 'scene')} were judged: attributable is of these alone"
            said[f"{split}: {some if rates.judged else 'nobody judged its scenes: attributable is unknown'}."] = None
    for record, rates in found:
        if rates.unknown_blame:
            said[
                f"{record.planner} on {record.run.split}: {counted(rates.unknown_blame, 'contact')} at the ego's sides "
                "without a map of lanes, so that nobody can tell whose fault they are."
            ] = None
    return list(said)


def _contact_table(data_name: str, runs: Sequence[RunRecord], notes: tuple[str, ...]) -> Table:
    quantities = ("impact speed", "delta-v ego", "delta-v other")
    columns = (
        *("planner", "split", "samples", "at fault %", "front %", "side %", "rear %", "standing %"),
        *(head for name in quantities for head in (name, f"{name}, worst tenth")),
        *("P(fatal) mean", "P(fatal) most"),
        *(f"{head}, bystander" for head in ("samples", "at fault %", "impact speed", "delta-v ego", "P(fatal) mean")),
    )
    return table_of(
        "severity-contacts",
        f"{data_name}: how severe the first contact of a plan is",
        columns,
        [_contact_row(record) for record in runs],
        notes=(_CONTACT_NOTE, *notes),
        text_columns=2,
        groups=(
            ("", 2),
            (f"samples with the adversary first, {SEVERITY}", 1),
            (f"share of them, {SEVERITY}", 5),
            (f"m/s, {SEVERITY}", 6),
            (f"%, {SEVERITY}", 2),
            (f"samples with a bystander first, {SEVERITY}", 5),
        ),
    )


def _contact_row(record: RunRecord) -> Row:
    origin, found, others = origin_of(record, SEVERITY), contacts_of(record), contacts_of(record, bystanders=True)
    kinds = found.kinds
    # A contact with what stands, or while the ego itself stands.
    standing = kinds.get("stopped_track", 0) + kinds.get("stopped_ego", 0)
    parts = (kinds.get("front", 0), kinds.get("lateral", 0), kinds.get("rear", 0), standing)
    return (
        *_who(record),
        origin.count(found.samples, "samples", record.summary.samples).shown(),
        *(
            _share(origin, count, found.samples, "samples with the adversary first")
            for count in (found.at_fault, *parts)
        ),
        *_spreads(origin, "m/s", found.impact_speed, found.delta_v_ego, found.delta_v_other, digits=1),
        *(
            origin.cell(value, PERCENT, found.samples, "samples with the adversary first", scale=100.0).shown(2)
            for value in (found.mean_fatal, found.most_fatal)
        ),
        origin.count(others.samples, "samples", record.summary.samples).shown(),
        _share(origin, others.at_fault, others.samples, "samples with a bystander first"),
        origin.cell(others.impact_speed.median, "m/s", others.samples).shown(1),
        origin.cell(others.delta_v_ego.median, "m/s", others.samples).shown(1),
        origin.cell(others.mean_fatal, PERCENT, others.samples, "samples with a bystander first", scale=100.0).shown(2),
    )


def _near_table(data_name: str, runs: Sequence[RunRecord], notes: tuple[str, ...]) -> Table:
    units = {"gap": "m", "TTC": "s", "TET": "s", "TIT": "s^2", "PET": "s", "BTN": ""}
    columns = (
        *("planner", "split", "samples"),
        *(
            head
            for name, unit in units.items()
            for head in (f"{name}, {unit}" if unit else name, f"{name}, worst tenth")
        ),
        "BTN >= 1, %",
    )
    return table_of(
        "severity-near",
        f"{data_name}: how near plans without contact come to an adversary",
        columns,
        [_near_row(record) for record in runs],
        notes=(_NEAR_NOTE, *notes),
        text_columns=2,
        groups=(("", 2), (f"without contact, {SEVERITY}", 1), (f"plan and adversary, {SEVERITY}", 13)),
    )


def _near_row(record: RunRecord) -> Row:
    origin, found = origin_of(record, SEVERITY), near_passes_of(record)
    return (
        *_who(record),
        origin.count(found.samples, "samples", record.summary.samples).shown(),
        *_spreads(origin, "m", found.gap, digits=2),
        *_spreads(origin, "s", found.ttc, found.tet, digits=2),
        *_spreads(origin, "s^2", found.tit, digits=2),
        *_spreads(origin, "s", found.pet, digits=1),
        *_spreads(origin, "BTN", found.btn, digits=2),
        _share(origin, found.critical, found.samples, "samples without contact"),
    )


def _who(record: RunRecord) -> tuple[Shown, str]:
    planner = record.run.planner
    name = name_cell(record.planner, privileged=planner.privileged, miniature=planner.miniature)
    return with_caveat_mark(name, record.run), record.run.split


def _spreads(origin: Origin, unit: str, *spreads: Spread, digits: int) -> list[Shown]:
    return [
        origin.cell(value, unit, spread.samples).shown(digits)
        for spread in spreads
        for value in (spread.median, spread.worst_tenth)
    ]


def _share(origin: Origin, count: int, among: int, of: str) -> Shown:
    return origin.cell(count / among if among else None, PERCENT, among, of, scale=100.0).shown(1)
