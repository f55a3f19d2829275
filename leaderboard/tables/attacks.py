"""Attack success on planners in three readings, and how severe their plans are in open loop."""

from collections.abc import Sequence
from typing import Final

from benchmark.metrics.attacks import AttackRates, Reading, can_count_attacks, compute_attack_rates
from benchmark.metrics.split_reference_drivers import (
    ContactSeverities,
    Spread,
    summarise_contacts,
    summarise_near_passes,
)
from benchmark.records.fault import FaultVerdict
from benchmark.records.run import RunRecord
from benchmark.report.cells import PERCENT, CellSource, ValueSource
from benchmark.report.table import Table
from benchmark.report.words import pluralise
from leaderboard.frame.rows import list_run_marks
from leaderboard.frame.runs import DataSetRuns, RunRow, row_notes
from leaderboard.frame.specification import (
    Columns,
    Values,
    estimate_columns,
    group_columns,
    number_columns,
    share_cell,
    tabulate,
    text_columns,
)

SEVERITY: Final = "severity"
"""The definition behind these numbers (docs/severity.md), as groups and cells name it."""
HEADS: Final[dict[Reading, str]] = {"contact": "contact", "at_fault": "at fault", "attributable": "attributable"}
READINGS_NOTE: Final = (
    "Contact: the plan touches the adversary before anything else within 3 s. At fault: that is the planner's fault, "
    "by who had priority and how much time was left (fault@1, docs/fault.md); shared, unclear: contacts that are both "
    "users' fault, and those of which the map does not tell; neither is the planner's. Attributable: at fault, and the "
    "careful and competent human (UN R157) survives the scene. "
    "Bystander: the plan touches a road user other than the adversary first; it counts in no rate."
)
UNKNOWN_FAULT: Final = (
    "the record does not say whose fault its contacts are by fault@1; challenger-bench rescore with the data set adds "
    "it."
)
_SHORT_NOTE: Final = (
    "Attributable: contact with the adversary, at fault, in a scene that a careful human driver (UN R157) survives; "
    "bystander: another road user is touched first."
)
RULES_NOTE: Final = (
    "One sample decides a scene. Unknown cases are left out of rates: attributable needs an assessed scene. "
    "Brackets: 95 % bootstrap interval over recorded scenes (docs/severity.md)."
)
_CONTACT_NOTE: Final = (
    "Of the samples whose plan touches the adversary before anything else: median, and threshold of the worst tenth; "
    "the last columns are of those that touch a bystander first. Delta-v: change of velocity in a plastic impact, by "
    "masses. P(fatal): of an occupant of the ego, the fourth power of delta-v / 31.74 m/s (Joksch); for pedestrians, "
    "see the other's delta-v."
)
_NEAR_NOTE: Final = (
    "Plans without contact, and the adversaries; median, and threshold of the worst tenth. TTC: least time to contact "
    "at constant velocities, of pairs on a collision course. TET: time with a TTC below 1.5 s; TIT: integral of the "
    "shortfall. PET: time between one leaving a place and the other reaching it, where the paths meet. BTN: braking "
    "needed, relative to the limit of a dry road; 1 and more: braking alone is not enough."
)


def _spread_columns(name: str, digits: int, unit: str = "") -> Columns:
    """Columns of a `Spread`: median and worst tenth."""
    return number_columns(f"{name}, {unit}" if unit else name, f"{name}, worst tenth", digits=digits)


_SAMPLES, _BYSTANDERS = "samples with the adversary first", "samples with a bystander first"
_PLANNER_COLUMNS: Final = text_columns("planner", "split")
_READINGS: Final = (*HEADS.values(), "bystander")
_OTHER_FAULTS: Final = ("shared", "unclear")
_SUCCESS: Final = [
    *_PLANNER_COLUMNS,
    *group_columns(
        f"of samples in %, {SEVERITY}", estimate_columns(*_READINGS), number_columns(*_OTHER_FAULTS, digits=1)
    ),
    *group_columns(f"of scenes in %, {SEVERITY}", estimate_columns(*(f"{head}, scenes" for head in _READINGS))),
    *group_columns(f"counted, {SEVERITY}", number_columns("samples", "scenes", "judged", "careful survives")),
]
_CONTACTS: Final = [
    *_PLANNER_COLUMNS,
    *group_columns(f"{_SAMPLES}, {SEVERITY}", number_columns("samples")),
    *group_columns(
        f"share of them, {SEVERITY}",
        number_columns("at fault %", "shared %", "unclear %", "front %", "side %", "rear %", "standing %", digits=1),
    ),
    *group_columns(
        f"m/s, {SEVERITY}", *(_spread_columns(name, 1) for name in ("impact speed", "delta-v ego", "delta-v other"))
    ),
    *group_columns(f"%, {SEVERITY}", number_columns("P(fatal) mean", "P(fatal) most", digits=2)),
    *group_columns(
        f"{_BYSTANDERS}, {SEVERITY}",
        number_columns("samples, bystander"),
        number_columns("at fault %, bystander", "impact speed, bystander", "delta-v ego, bystander", digits=1),
        number_columns("P(fatal) mean, bystander", digits=2),
    ),
]
_UNITS: Final = {"gap": "m", "TTC": "s", "TET": "s", "TIT": "s^2", "PET": "s", "BTN": ""}
_NEAR: Final = [
    *_PLANNER_COLUMNS,
    *group_columns(f"without contact, {SEVERITY}", number_columns("samples")),
    *group_columns(
        f"plan and adversary, {SEVERITY}",
        *(_spread_columns(name, 1 if name == "PET" else 2, unit) for name, unit in _UNITS.items()),
        number_columns("BTN >= 1, %", digits=1),
    ),
]


def attack_tables(frame: DataSetRuns) -> list[Table]:
    """Attack success on each planner on splits with adversaries, and severity with contact and without.

    Runs that cannot tell (`can_count_attacks`) are left out; there are no tables where no other run has adversaries.
    """
    rows = frame.rows(SEVERITY, _compute_rates)
    if not rows:
        return []
    notes, unknown = row_notes(rows), _unknown_notes(rows)
    success = tabulate(
        "attack-success",
        f"{frame.data_name}: attack success (%)",
        _SUCCESS,
        map(_success_values, rows),
        (READINGS_NOTE, RULES_NOTE, *unknown, *notes),
        brief=("planner", "split", *(f"{head}, scenes" for head in _READINGS), "judged"),
        # The other notes on the runs are below the rates already.
        brief_notes=(_SHORT_NOTE, *list_run_marks(row.record for row in rows), *unknown),
    )
    contacts = f"{frame.data_name}: severity of the first contact of a plan"
    near = f"{frame.data_name}: near misses of plans without contact with an adversary"
    return [
        success,
        tabulate("severity-contacts", contacts, _CONTACTS, map(_contact_values, rows), (_CONTACT_NOTE, *notes)),
        tabulate("severity-near", near, _NEAR, map(_near_values, rows), (_NEAR_NOTE, *notes)),
    ]


def success_table(frame: DataSetRuns) -> Table | None:
    """Attack success alone, as ``challenger-bench eval`` prints it; ``None`` where no run has adversaries."""
    return next(iter(attack_tables(frame)), None)


def _compute_rates(record: RunRecord) -> AttackRates | None:
    return compute_attack_rates(record) if can_count_attacks(record) else None


def _planner_values(row: RunRow[AttackRates]) -> Values:
    return {"planner": row.with_caveats, "split": row.split}


def _success_values(row: RunRow[AttackRates]) -> Values:
    rates, percent = row.found, row.origin.percent
    samples, scenes = (
        (*rates.samples.values(), rates.bystander_samples),
        (*rates.scenes.values(), rates.bystander_scenes),
    )
    return {
        **_planner_values(row),
        **{head: percent(rate) for head, rate in zip(_READINGS, samples, strict=True)},
        **{head: percent(rate) for head, rate in zip(_OTHER_FAULTS, (rates.shared, rates.unclear), strict=True)},
        **{f"{head}, scenes": percent(rate, "scenes") for head, rate in zip(_READINGS, scenes, strict=True)},
        "samples": row.samples(rates.samples["contact"].denominator),
        "scenes": row.scenes(rates.scenes["contact"].denominator),
        "judged": row.scenes(rates.judged),
        "careful survives": row.origin.count(rates.spared, "scenes", rates.judged),
    }


def _unknown_notes(rows: Sequence[RunRow[AttackRates]]) -> list[str]:
    """Notes on runs with unknowns; what concerns all planners of a split is said once."""
    sentences: dict[str, None] = {}
    for row in rows:
        scenes, judged = len(row.record.run.scenes), row.found.judged
        if judged < scenes:
            some = f"{judged} of {pluralise(scenes, 'scene')} were assessed: attributable covers only these"
            sentences[
                f"{row.split}: {some if judged else 'its scenes were not assessed: attributable is unknown'}."
            ] = None
    for row in rows:
        if row.found.unknown_fault:
            sentences[f"{row.describe_run}: {UNKNOWN_FAULT}"] = None
    return list(sentences)


def _contact_values(row: RunRow[AttackRates]) -> Values:
    origin, severity, others = (
        row.origin,
        summarise_contacts(row.record),
        summarise_contacts(row.record, bystanders=True),
    )
    kinds = severity.kinds
    # A contact with a standing object, or while the ego itself stands.
    standing = kinds.get("stopped_track", 0) + kinds.get("stopped_ego", 0)
    parts = {"front": kinds.get("front", 0), "side": kinds.get("lateral", 0)}
    parts |= {"rear": kinds.get("rear", 0), "standing": standing}
    fatal = {"mean": severity.mean_fatal, "most": severity.most_fatal}
    return {
        **_planner_values(row),
        "samples": row.samples(severity.samples),
        **_fault_cells(origin, severity, _SAMPLES),
        **{f"{name} %": share_cell(origin, count, severity.samples, _SAMPLES) for name, count in parts.items()},
        **_spread_cells(origin, "impact speed", "m/s", severity.impact_speed),
        **_spread_cells(origin, "delta-v ego", "m/s", severity.delta_v_ego),
        **_spread_cells(origin, "delta-v other", "m/s", severity.delta_v_other),
        **{
            f"P(fatal) {name}": origin.cell(value, PERCENT, severity.samples, _SAMPLES, scale=100.0)
            for name, value in fatal.items()
        },
        "samples, bystander": row.samples(others.samples),
        "at fault %, bystander": _fault_cells(origin, others, _BYSTANDERS)["at fault %"],
        "impact speed, bystander": origin.cell(others.impact_speed.median, "m/s", others.samples),
        "delta-v ego, bystander": origin.cell(others.delta_v_ego.median, "m/s", others.samples),
        "P(fatal) mean, bystander": origin.cell(others.mean_fatal, PERCENT, others.samples, _BYSTANDERS, scale=100.0),
    }


def _fault_cells(origin: ValueSource, contacts: ContactSeverities, of: str) -> dict[str, CellSource]:
    """Whose fault contacts are; nothing where some do not say it."""
    faults = contacts.faults
    heads = {"at fault": FaultVerdict.EGO, "shared": FaultVerdict.SHARED, "unclear": FaultVerdict.UNCLEAR}
    among = 0 if None in faults else contacts.samples
    return {f"{head} %": share_cell(origin, faults.get(verdict, 0), among, of) for head, verdict in heads.items()}


def _near_values(row: RunRow[AttackRates]) -> Values:
    passes = summarise_near_passes(row.record)
    spreads = {"gap": passes.gap, "TTC": passes.ttc, "TET": passes.tet, "TIT": passes.tit, "PET": passes.pet}
    cells: dict[str, CellSource] = {}
    for name, spread in spreads.items():
        cells |= _spread_cells(row.origin, name, _UNITS[name], spread, f", {_UNITS[name]}")
    return {
        **_planner_values(row),
        "samples": row.samples(passes.samples),
        **cells,
        **_spread_cells(row.origin, "BTN", "BTN", passes.btn),
        "BTN >= 1, %": share_cell(row.origin, passes.critical, passes.samples, "samples without contact"),
    }


def _spread_cells(origin: ValueSource, name: str, unit: str, spread: Spread, after: str = "") -> dict[str, CellSource]:
    return {
        f"{name}{after}": origin.cell(spread.median, unit, spread.samples),
        f"{name}, worst tenth": origin.cell(spread.worst_tenth, unit, spread.samples),
    }
