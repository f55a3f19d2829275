"""Assessment of a split, as text tables."""

from collections.abc import Mapping, Sequence
from typing import Final

import numpy as np

from benchmark.records.scene_assessment import (
    DRIVER_NAMES,
    CtgRow,
    ReferenceDriverRun,
    SceneAssessment,
    SplitRealism,
    is_unsolvable,
)
from benchmark.records.statistics import SplitAssessment, TrafficStatistics
from benchmark.report.table import Table, build_table
from benchmark.report.words import spell_name

_NOTHING: Final = "-"
_SHOWN: Final = DRIVER_NAMES[1:]
"""The recorded ego is left out of the scenes' table, where it passes; its rung has it."""


def build_split_tables(judged: SplitAssessment) -> list[Table]:
    """All tables of a split: the ladder by scene and in sum, severity, validity and realism, as far as there are."""
    tables = [_build_scene_table(judged), _build_reference_driver_table(judged)]
    if any(row.of for row in judged.severity):
        tables.append(_build_severity_table(judged))
    if judged.realism.adversaries:
        tables += [_build_validity_table(judged.realism), *_build_realism_tables(judged.realism)]
    return tables


def format_assessment(judged: SplitAssessment) -> str:
    """The tables for a terminal, with the reason if realism was not compared."""
    blocks = [table.plain() for table in build_split_tables(judged)]
    if judged.realism.not_compared is not None:
        blocks.append(f"Realism: not compared; {judged.realism.not_compared}.\n")
    return "\n".join(blocks)


TRAFFIC_LABELS: Final = {
    "leader_within_1_s": ("leader within 1 s, %", 100.0, 1),
    "leader_within_3_s": ("leader within 3 s, %", 100.0, 1),
    "leader_headway_s": ("leader, median up to 4 s, s", 1.0, 2),
    "follower_within_1_s": ("follower within 1 s, %", 100.0, 1),
    "follower_within_3_s": ("follower within 3 s, %", 100.0, 1),
    "follower_headway_s": ("follower, median up to 4 s, s", 1.0, 2),
    "speed_m_s": ("speed, m/s", 1.0, 1),
    "acceleration_m_s2": ("acceleration, m/s^2", 1.0, 2),
    "curvature_1_m": ("curvature, 1/km", 1000.0, 1),
    "standing": ("ego stands, %", 100.0, 1),
    "turning": ("ego turns, %", 100.0, 1),
    "junction": ("at a junction, %", 100.0, 1),
    "road_users": ("road users within 30 m", 1.0, 1),
    "pedestrians": ("pedestrians among them", 1.0, 1),
    "parked": ("vehicles that are parked, %", 100.0, 1),
    "oncoming": ("with oncoming traffic, %", 100.0, 1),
    "crossing": ("with crossing traffic, %", 100.0, 1),
    "hidden": ("road users hidden, %", 100.0, 1),
    "adversary_within_2_m": ("adversary within 2 m, %", 100.0, 1),
    "adversary_within_5_m": ("adversary within 5 m, %", 100.0, 1),
}
"""Of figures of `TrafficStatistics`: label, scale and digits."""
_BY_SCENE: Final = {"least": 0.0, "25 %": 0.25, "median": 0.5, "75 %": 0.75, "most": 1.0}


def build_traffic_tables(traffic: TrafficStatistics) -> list[Table]:
    """Figures of traffic and rates of planners, over all samples, and their quantiles over scenes."""
    figures = [
        (label, _scaled(figure.value, scale, digits), str(figure.samples), *_by_scene(figure.scenes, scale, digits))
        for name, (label, scale, digits) in TRAFFIC_LABELS.items()
        if (figure := traffic.figures.get(name)) is not None
    ]
    notes = [
        "Quantiles are over the values of scenes.",
        *([f"A single frame: {', '.join(traffic.not_measured)}."] if traffic.not_measured else []),
    ]
    planners = [
        (
            name,
            str(planner.draws),
            *(_scaled(rate.value, 100.0, 2) for rate in planner.collision.values()),
            _scaled(planner.l2["3s"].value, 1.0, 2),
            *_by_scene(planner.scenes, 100.0, 1)[::2],
        )
        for name, planner in traffic.planners.items()
    ]
    columns = ("planner", "seeds", *(next(iter(traffic.planners.values())).collision if planners else ()), "L2 3s, m")
    return [
        build_table("", "Traffic by sample", ("", "all", "samples", *_BY_SCENE), figures, notes=notes),
        build_table(
            "",
            "Samples in which planners without images collide, exact, %; by scene within 3 s",
            (*columns, *list(_BY_SCENE)[::2]),
            planners,
        ),
    ]


def format_traffic(traffic: TrafficStatistics) -> str:
    """The tables of traffic for a terminal."""
    return "\n".join(table.plain() for table in build_traffic_tables(traffic))


def _by_scene(scenes: Mapping[str, float | None], scale: float, digits: int) -> list[str]:
    values = [value for value in scenes.values() if value is not None]
    return [_scaled(float(np.quantile(values, at)) if values else None, scale, digits) for at in _BY_SCENE.values()]


def _scaled(value: float | None, scale: float, digits: int) -> str:
    return _number(None if value is None else scale * value, digits)


def _build_scene_table(judged: SplitAssessment) -> Table:
    rows = [_build_scene_row(name, assessments) for name, assessments in judged.scenes.items() if assessments]
    missing = sum(not assessments for assessments in judged.scenes.values())
    tracks = {assessment.tracks for assessments in judged.scenes.values() for assessment in assessments}
    maps = {assessment.has_map for assessments in judged.scenes.values() for assessment in assessments}
    notes = [
        "ok: no contact; otherwise kind and time (s) of the driver's first contact, * with an adversary, "
        "> beyond the recorded path.",
        "margin: seconds from 0.75 s after the adversary is first visible to the last chance at constant speed.",
    ]
    if "annotated" in tracks:
        notes.append("Assessed on tracks interpolated between 2 Hz keyframes where no 12 Hz track was available.")
    if any(
        assessment.adversary is not None and assessment.acts_s is None
        for assessments in judged.scenes.values()
        for assessment in assessments
    ):
        notes.append("Where the start of the adversary's action is unknown, drivers take over at the first frame.")
    if False in maps:
        notes.append("No map: manoeuvres are not limited to roads.")
    if missing:
        notes.append(f"{missing} scenes with a single frame are not assessed.")
    columns = ("scene", *_SHOWN, "margin", "gap", "TTC", "PET", "BTN", "faults")
    return build_table("", "Reference drivers by scene", columns, rows, notes=notes)


def _build_scene_row(name: str, assessments: Sequence[SceneAssessment]) -> tuple[str, ...]:
    first, encounters = (
        assessments[0],
        [assessment.encounter for assessment in assessments if assessment.encounter is not None],
    )
    margins = [assessment.margin_s for assessment in assessments if assessment.margin_s is not None]
    margin = f"{min(margins):.2f}" if margins else {"never": "never"}.get(first.chance, _NOTHING)
    faults = {fault for assessment in assessments if assessment.faults is not None for fault in assessment.faults.found}
    return (
        name,
        *(_run_cell(first.drivers[driver]) for driver in _SHOWN),
        f"{margin}, unsolvable" if is_unsolvable(assessments) else margin,
        _least([assessment.least_gap_m for assessment in encounters], 2),
        _least([assessment.least_ttc_s for assessment in encounters], 1),
        _least([assessment.pet_s for assessment in encounters], 1),
        _number(
            max((assessment.max_btn for assessment in encounters if assessment.max_btn is not None), default=None), 2
        ),
        spell_name(", ".join(sorted(faults))) or _NOTHING,
    )


def _run_cell(run: ReferenceDriverRun) -> str:
    beyond = " >" if run.beyond_end else ""
    if run.contact is None:
        return f"ok{beyond}"
    return f"{run.contact.kind}{'' if run.contact.party == 'other' else '*'} {run.contact.time_s:.1f}{beyond}"


def _build_reference_driver_table(judged: SplitAssessment) -> Table:
    ordinary = {row.driver: row for row in judged.ladder_of_recordings}
    rows = [
        (
            row.driver,
            f"{row.survives} of {row.of}",
            _NOTHING if row.share is None else f"{100 * row.share:.0f} %",
            *([f"{ordinary[row.driver].survives} of {ordinary[row.driver].of}"] if ordinary else []),
            str(row.hit_adversary),
            str(row.hit_from_behind),
            str(row.beyond_end),
        )
        for row in judged.ladder
    ]
    recordings = ["of the recordings"] if ordinary else []
    columns = ("driver", "survives", "share", *recordings, "hits an adversary", "is run into", "leaves the path")
    notes = [
        f"Unavoidable scenes ({len(judged.unsolvable)}): {', '.join(judged.unsolvable)}."
        if judged.unsolvable
        else "No scene is unavoidable.",
        "Agents replay their tracks: a driver that brakes where the recording did not may be hit from behind.",
    ]
    if ordinary:
        notes.append("Drivers take over where an adversary begins to act, and in the recordings at the first frame.")
    return build_table("", "Reference drivers", columns, rows, notes=notes)


def _build_severity_table(judged: SplitAssessment) -> Table:
    rows = []
    for row in judged.severity:
        values = [] if row.quantiles is None else list(row.quantiles.model_dump().values())
        rows.append((row.name, str(row.of), *(f"{value:.2f}" for value in values), *[_NOTHING] * (5 - len(values))))
    columns = ("recorded ego and adversary", "of", "least", "tenth", "median", "ninetieth", "most")
    notes = [f"Contact in {judged.contacts}; times to contact, TET and TIT of the others."] if judged.contacts else []
    return build_table("", "Severity", columns, rows, notes=notes)


def _build_validity_table(realism: SplitRealism) -> Table:
    rows = [
        (
            spell_name(row.fault),
            f"{row.count} of {row.of}",
            _NOTHING if not row.of else f"{100 * row.count / row.of:.0f} %",
            "; ".join(row.unknown) or _NOTHING,
        )
        for row in realism.validity
    ]
    columns = ("fault", "adversaries", "share", "not asked of the others because")
    return build_table("", "Validity of the adversaries' tracks", columns, rows)


def _build_realism_tables(realism: SplitRealism) -> list[Table]:
    worst = realism.headline
    if worst is None or realism.samples is None:
        return []
    rows = [
        (
            f"{spell_name(row.name)} (worst)" if row.name == realism.worst else spell_name(row.name),
            _number(row.realism, 3),
            _NOTHING if row.interval is None else f"{row.interval[0]:.3f} .. {row.interval[1]:.3f}",
            _number(row.realism_of_halves, 3),
            _number(row.w1, 3),
            _number(row.w1_in_halves, 2),
        )
        for row in realism.features
    ]
    columns = ("feature", "realism", "95 %", "halves", "W1", "W1 / W1 of halves")
    notes = [
        f"{realism.samples[0]} samples of adversaries against {realism.samples[1]} of {realism.reference}.",
        "halves: one half of the recordings against the other, the noise floor; a realism value above it is not "
        "evidence of a difference.",
    ]
    times = f"{_number(worst.w1_in_halves, 1)} times the W1 of halves"
    title = f"Realism, worst feature {spell_name(worst.name)}: {worst.realism:.3f}, {times}"
    return [build_table("", title, columns, rows, notes=notes), *_build_ctg_tables(realism.ctg)]


def _build_ctg_tables(ctg: CtgRow | None) -> list[Table]:
    if ctg is None:
        return []
    title = f"ctg-realism@code, version {ctg.version}, normalisation {ctg.normalisation}, mask {ctg.mask}"
    rows = [("ctg-realism@code", _number(ctg.mean_real_dev, 3), _number(ctg.mean_real_dev_int, 3))]
    notes = ["For comparison with the literature; not used for ranking (docs/realism.md)."]
    return [build_table("", title, ("", "mean_real_dev", "mean_real_dev_int"), rows, notes=notes)]


def _least(values: Sequence[float | None], digits: int) -> str:
    return _number(min((value for value in values if value is not None), default=None), digits)


def _number(value: float | None, digits: int) -> str:
    return _NOTHING if value is None else f"{value:.{digits}f}"
