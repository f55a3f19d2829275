"""Data of each planner in one scene, in the scene's local frame: plans, forecasts, verdicts."""

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from benchmark.constants import PLAN_STEP_S
from benchmark.geometry import Floats, to_global
from benchmark.metrics.attacks import knows_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import attributes_contacts
from benchmark.records.row_schema import OutcomeRow, PlanRow, SampleRow
from benchmark.records.run import RunRecord
from benchmark.report.placement import PlacedForecasts, place_plan
from leaderboard.site.packing import CENTIMETRE, DECIMETRE, MILLIRADIAN, pack_path, pack_series

MODES_SHOWN: Final = 12
"""Alternatives of a plan, most likely first; some models have thousands."""
FORECASTS_SHOWN: Final = 16
"""Forecasts of one sample, nearest to the ego first."""
STANDING_M: Final = 0.5
"""A forecast that stays nearer to its start than this is drawn as its box alone."""
ERROR_CHARACTERS: Final = 240
COUNTED: Final = 64
"""Bit of a verdict above those of the six steps."""
_CENTIRADIAN: Final = 0.01


def build_planner_samples(
    record: RunRecord,
    rows: Mapping[str, SampleRow],
    tokens: Sequence[str],
    poses: Floats,
    protocols: Sequence[str],
    agents: Mapping[str, int],
) -> dict[str, Any]:
    """One planner's part of a scene's script; a plan with lists of the wrong lengths is an `InputError`.

    ``name``, ``privileged``, ``miniature``, ``native`` and ``samples``: null where the record has no row, else
    `build_sample`. `tokens` are the scene's samples in order, `poses` (S, 3) of the rear axle at these, local;
    `protocols` are in the order of the verdicts; `agents` numbers by instance identifier.
    """
    known = knows_adversaries(record) if attributes_contacts(record) else None
    entries = [
        None if token not in rows else build_sample(rows[token], pose, protocols, agents, known=known)
        for token, pose in zip(tokens, poses, strict=True)
    ]
    return {
        "name": record.planner,
        "privileged": record.run.planner.privileged,
        "miniature": record.run.planner.miniature,
        "native": record.native_protocol,
        "samples": entries,
    }


def build_sample(
    row: SampleRow, axle: Floats, protocols: Sequence[str], agents: Mapping[str, int], *, known: bool | None = None
) -> dict[str, Any]:
    """Entry of a planner's sample; a plan with lists of the wrong lengths is an `InputError`.

    ``failed``, the last line of the error, alone where the planner raised. Else ``path`` and ``yaw`` (lidar origin at
    the sample and at the six waypoints, heading at the latter), ``modes`` (paths without the first point),
    ``forecasts`` (x, y, length and width in decimetres, yaw in hundredths of a radian, and the path in decimetres if it
    moves), ``verdicts`` (for each protocol six bits, the first step lowest, and `COUNTED`; null if it did not judge or
    the surroundings are not annotated), ``contact`` (seconds to each protocol's first contact, or null), ``whom`` (on a
    split with adversaries, if there is a contact: for each protocol 1 where it is with an adversary, 0 where it is with
    another object, null where unknown), ``cause``, ``reason``, ``hit`` and ``l2`` (metres at the six steps; null past
    the recording). Every plan has ``path`` and ``yaw``, ``verdicts`` and ``contact``; what there is none of beyond them
    is left out.

    `axle` is the (3,) pose of the rear axle at the sample, local; `known` says, on a split with adversaries, whether
    the record tells who they are; `protocols` and `agents` as in `build_planner_samples`.
    """
    placed = place_plan(_sort_modes(row), axle)
    if placed is None:
        return {"failed": _find_last_line(row.error)}
    start = to_global(np.array([row.lidar_ahead_m, 0.0]), axle)
    begin = (float(start[0]), float(start[1]))
    judged = [row.outcomes.get(name) for name in protocols]
    # A packed series may be empty and still valid: all headings of a plan straight ahead are zero.
    always: dict[str, Any] = {
        "path": pack_path(np.vstack([start, placed.waypoints]), CENTIMETRE),
        "yaw": pack_series(placed.at_waypoints[:, 4].tolist(), MILLIRADIAN),
        "verdicts": [_encode_verdict(name, outcome) for name, outcome in zip(protocols, judged)],
        "contact": [_find_first_contact(name, outcome, row) for name, outcome in zip(protocols, judged, strict=True)],
    }
    sometimes: dict[str, Any] = {
        "modes": [pack_path(mode, CENTIMETRE, begin) for mode in placed.modes[:MODES_SHOWN]],
        "forecasts": [] if placed.forecasts is None else _pack_forecasts(placed.forecasts, axle),
        "l2": _find_displacements(judged),
    }
    if known is not None and any(contact is not None for contact in always["contact"]):
        sometimes["whom"] = [_find_contact_object(outcome) if known else None for outcome in judged]
    if row.diagnosis is not None:
        sometimes |= {"cause": row.diagnosis.cause, "reason": row.diagnosis.reason}
        sometimes["hit"] = agents.get(row.diagnosis.hit)
    return always | {name: value for name, value in sometimes.items() if value is not None and value != []}


def _sort_modes(row: SampleRow) -> SampleRow:
    """The row with the modes that can be shown; in their order where they have no scores."""
    plan: PlanRow | None = row.plan
    if plan is None or not plan.modes:
        return row
    scores = plan.mode_scores or []
    if len(scores) != len(plan.modes):
        return row
    order = sorted(range(len(scores)), key=lambda index: -scores[index])
    # One more than shown, because one of them is the plan itself.
    modes = [plan.modes[index] for index in order[: MODES_SHOWN + 1]]
    return row.model_copy(update={"plan": plan.model_copy(update={"modes": modes})})


def _pack_forecasts(forecasts: PlacedForecasts, axle: Floats) -> list[list[Any]]:
    distance = np.hypot(forecasts.boxes[:, 0] - axle[0], forecasts.boxes[:, 1] - axle[1])
    packed = []
    for index in np.argsort(distance, kind="stable")[:FORECASTS_SHOWN].tolist():
        x, y, length, width, yaw = forecasts.boxes[index].tolist()
        path = forecasts.paths[index]
        turned = (yaw + np.pi) % (2 * np.pi) - np.pi
        forecast: list[Any] = [*(round(value / DECIMETRE) for value in (x, y, length, width))]
        forecast.append(round(turned / _CENTIRADIAN))
        if np.hypot(path[:, 0] - x, path[:, 1] - y).max() >= STANDING_M:
            forecast.append(pack_path(path, DECIMETRE, (x, y)))
        packed.append(forecast)
    return packed


def _encode_verdict(protocol: str, outcome: OutcomeRow | None) -> int | None:
    if outcome is None or outcome.collision is None:
        return None
    steps = sum(1 << step for step, collides in enumerate(outcome.collision) if collides)
    # Without contact up to a gap in the recording, the verdict on the whole sample is unknown.
    unknown = protocol == EXACT and outcome.cut_short and not steps
    return steps + (COUNTED if outcome.counted and not unknown else 0)


def _find_first_contact(protocol: str, outcome: OutcomeRow | None, row: SampleRow) -> float | None:
    """Seconds from the sample; protocols other than ``exact`` look at waypoints only."""
    if outcome is None or outcome.collision is None or not any(outcome.collision):
        return None
    if protocol == EXACT and row.diagnosis is not None:
        return round(row.diagnosis.first_contact_s, 2)
    return PLAN_STEP_S * (outcome.collision.index(True) + 1)


def _find_contact_object(outcome: OutcomeRow | None) -> int | None:
    adversary = None if outcome is None else outcome.touches_adversary
    return None if adversary is None else int(adversary)


def _find_displacements(judged: Sequence[OutcomeRow | None]) -> list[float | None] | None:
    """L2 at the steps: the same for all protocols, which differ in how they average it."""
    first = next((outcome for outcome in judged if outcome is not None), None)
    return None if first is None else [None if metres is None else round(metres, 2) for metres in first.l2]


def _find_last_line(error: str | None) -> str:
    lines = (error or "").strip().splitlines()
    return lines[-1][:ERROR_CHARACTERS] if lines else "no reason was recorded"
