"""Data of each planner in one scene, in the scene's local frame: plans, forecasts, verdicts."""

from collections.abc import Collection, Mapping, Sequence
from typing import Any, Final

import numpy as np

from benchmark.constants import PLAN_STEP_S
from benchmark.geometry import Floats, to_global
from benchmark.metrics.attacks import knows_adversaries
from benchmark.metrics.disagreement import EXACT
from benchmark.metrics.effect import attributes_contacts
from benchmark.records.row_schema import OutcomeRow, PlanRow, SampleRow
from benchmark.records.run import RunRecord
from benchmark.report.cells import format_number
from benchmark.report.placement import PlacedForecasts, place_plan
from leaderboard.frame.rows import name_cell
from leaderboard.site.packing import CENTIMETRE, DECIMETRE, MILLIRADIAN, pack_path, pack_series

MODES_SHOWN: Final = 12
"""Alternatives of a plan, most likely first; some models have thousands."""
FORECASTS_SHOWN: Final = 16
"""Forecasts of one sample, nearest to the ego first."""
STANDING_M: Final = 0.5
"""A forecast that stays nearer to its start than this is drawn as its box alone."""
ERROR_CHARACTERS: Final = 240
_HORIZONS: Final = (2, 4, 6)
"""Steps up to 1, 2 and 3 s."""
_CENTIRADIAN: Final = 0.01


def build_planner_samples(
    record: RunRecord,
    rows: Mapping[str, SampleRow],
    tokens: Sequence[str],
    poses: Floats,
    times: Sequence[float],
    protocols: Sequence[str],
    agents: Mapping[str, int],
) -> dict[str, Any]:
    """One planner's part of a scene's script; a plan with lists of the wrong lengths is an `InputError`.

    ``name``, ``shown`` (the name with its marks), ``first`` (for each protocol when the first counted plan touches the
    adversary, or without one anybody, seconds; null where none does), ``outcome`` (kind and words of the same under the
    first protocol) and ``samples``: null where the record has no row, else `build_sample`. `tokens` are the scene's
    samples in order, `poses` (S, 3) of the rear axle at these, local, `times` their seconds; `protocols` are in the
    order of the verdicts; `agents` numbers by instance identifier.
    """
    known = knows_adversaries(record) if attributes_contacts(record) else None
    entries = [
        None if token not in rows else build_sample(rows[token], pose, protocols, agents, known=known, time=time)
        for token, pose, time in zip(tokens, poses, times, strict=True)
    ]
    adversarial = known is not None
    return {
        "name": record.planner,
        "shown": name_cell(record.planner, record.run.planner).text,
        "first": [_find_first_moment(entries, times, place, "xX") for place in range(len(protocols))],
        "outcome": _describe_outcome(entries, times, adversarial=adversarial) if protocols else ["", ""],
        "samples": entries,
    }


def _find_first_moment(
    entries: Sequence[Mapping[str, Any] | None], times: Sequence[float], protocol: int, marks: str
) -> float | None:
    judged = ((time, entry["judged"][protocol]) for time, entry in zip(times, entries) if entry and "judged" in entry)
    moments = [
        time + verdict[2]
        for time, verdict in judged
        if verdict and verdict[1] and len(verdict) > 2 and verdict[0][-1] in marks
    ]
    return min(moments, default=None)


def _describe_outcome(
    entries: Sequence[Mapping[str, Any] | None], times: Sequence[float], *, adversarial: bool
) -> list[str]:
    """What a planner's plans come to: kind and words."""
    contact, other, unsaid = (_find_first_moment(entries, times, 0, marks) for marks in ("xX", "a", "w"))
    if contact is not None:
        return ["bad", f"✕ would {'hit the adversary' if adversarial else 'collide'} at {format_number(contact, 1)} s"]
    if other is not None:
        return ["other", f"◇ would hit another than the adversary at {format_number(other, 1)} s"]
    return ["good", "○ stays clear"] if unsaid is None else ["open", "– would collide; with whom is not said"]


def list_differing(models: Sequence[Mapping[str, Any]], protocol: int, baselines: Collection[str] = ()) -> list[str]:
    """Planners whose verdicts differ: two that fail and one that does not; baselines only where nobody else ran.

    Where nobody differs, the first ones, those that fail before the others.
    """
    ran = [model for model in models if any(model["samples"])]
    ran = [model for model in ran if model["name"] not in baselines] or ran
    failing = [model["name"] for model in ran if model["first"][protocol] is not None]
    others = [model["name"] for model in ran if model["first"][protocol] is None]
    clear = [model["name"] for model in ran if model["name"] in others and _is_judged(model, protocol)]
    chosen = [*failing[:2], *clear][:3] if failing and clear else [*failing, *others][:3]
    return [model["name"] for model in ran if model["name"] in chosen]


def _is_judged(model: Mapping[str, Any], protocol: int) -> bool:
    verdicts = [entry["judged"][protocol] for entry in model["samples"] if entry and "judged" in entry]
    return any(verdict and verdict[1] for verdict in verdicts)


def list_distances(models: Sequence[Mapping[str, Any]], samples: int) -> list[list[list[list[str] | None]]]:
    """How far plans are apart after 1, 2 and 3 s, metres in words: of each model with each later one, by sample."""
    places = np.full((len(models), samples, len(_HORIZONS), 2), np.nan)
    for number, model in enumerate(models):
        for sample, entry in enumerate(model["samples"]):
            if entry and "path" in entry:
                path = np.cumsum(np.reshape(entry["path"], (-1, 2)), axis=0) * CENTIMETRE
                places[number, sample] = path[list(_HORIZONS)]
    return [
        [
            [
                None if np.isnan(apart[0]) else [format_number(metres) for metres in apart.tolist()]
                for apart in np.hypot(*np.moveaxis(places[first] - places[second], -1, 0))
            ]
            for second in range(first + 1, len(models))
        ]
        for first in range(len(models))
    ]


def build_sample(
    row: SampleRow,
    axle: Floats,
    protocols: Sequence[str],
    agents: Mapping[str, int],
    *,
    known: bool | None = None,
    time: float = 0.0,
) -> dict[str, Any]:
    """Entry of a planner's sample; a plan with lists of the wrong lengths is an `InputError`.

    ``failed``, the last line of the error, alone where the planner raised. Else ``path`` and ``yaw`` (lidar origin at
    the sample and at the six waypoints, heading at the latter), ``modes`` (paths without the first point),
    ``forecasts`` (x, y, length and width in decimetres, yaw in hundredths of a radian, and the path in decimetres if it
    moves), ``judged`` (for each protocol its marks within 1, 2 and 3 s, 1 if the sample is counted, and where there is
    a contact the seconds to the first one, and in words when it is in the scene; null if it did not judge or the
    surroundings are not annotated), ``cause``, ``reason``, ``hit`` and ``l2`` (metres after 1, 2 and 3 s, in words).
    Every plan has ``path``, ``yaw`` and ``judged``; what there is none of beyond them is left out.

    `axle` is the (3,) pose of the rear axle at the sample, local, `time` its seconds in the scene; `known` says, on a
    split with adversaries, whether the record tells who they are; the others are as in `build_planner_samples`.
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
        "judged": [_judge(name, outcome, row, known, time) for name, outcome in zip(protocols, judged, strict=True)],
    }
    sometimes: dict[str, Any] = {
        "modes": [pack_path(mode, CENTIMETRE, begin) for mode in placed.modes[:MODES_SHOWN]],
        "forecasts": [] if placed.forecasts is None else _pack_forecasts(placed.forecasts, axle),
        "l2": _find_displacements(judged),
    }
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


def _judge(
    protocol: str, outcome: OutcomeRow | None, row: SampleRow, known: bool | None, time: float
) -> list[Any] | None:
    if outcome is None or outcome.collision is None:
        return None
    hits = outcome.collision
    mark = "x" if known is None else {True: "X", False: "a", None: "w"}[outcome.touches_adversary if known else None]
    marks = "".join(mark if any(hits[:steps]) else "o" for steps in _HORIZONS)
    # Without contact up to a gap in the recording, the verdict on the whole sample is unknown.
    unknown = protocol == EXACT and outcome.cut_short and not any(hits)
    counted = int(outcome.counted and not unknown)
    if not any(hits):
        return [marks, counted]
    # Protocols other than ``exact`` look at waypoints only.
    seconds = PLAN_STEP_S * (hits.index(True) + 1)
    if protocol == EXACT and row.diagnosis is not None:
        seconds = row.diagnosis.first_contact_s
    return [marks, counted, round(seconds, 2), f"{format_number(time + seconds, 1)} s"]


def _find_displacements(judged: Sequence[OutcomeRow | None]) -> list[str] | None:
    """L2 at the horizons: the same for all protocols, which differ in how they average it."""
    first = next((outcome for outcome in judged if outcome is not None), None)
    return None if first is None else [format_number(first.l2[steps - 1]) for steps in _HORIZONS]


def _find_last_line(error: str | None) -> str:
    lines = (error or "").strip().splitlines()
    return lines[-1][:ERROR_CHARACTERS] if lines else "no reason was recorded"
