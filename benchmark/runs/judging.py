"""Stored plans against what really happened: the part of a run that never needs the planner, for `eval` and `rescore`.

The verdict on a sample depends on that sample alone, so a scene judged today gives the bytes that it gave in the run.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import repeat
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from benchmark.constants import LONGER_HORIZON_STEPS, PLAN_STEPS
from benchmark.errors import InputError
from benchmark.fairness.plan_severity import plan_severities
from benchmark.geometry import Floats
from benchmark.metrics.circumstances import Circumstances
from benchmark.metrics.diagnosis import diagnose
from benchmark.metrics.disagreement import EXACT, disagreements
from benchmark.pdm.definition import PDM
from benchmark.pdm.judging import judge_planners as judge_driving
from benchmark.pdm.recording import RecordedScene
from benchmark.planning import Forecasts, Plan, PlanFrame
from benchmark.protocols import CollisionProtocol, Outcomes, protocol
from benchmark.protocols.exact import judged_longer
from benchmark.records.row_schema import SampleRow
from benchmark.scene import Scene
from benchmark.truth import SampleTruth
from benchmark.waypoints import waypoints_in_lidar

if TYPE_CHECKING:
    from benchmark.runs.reading import SceneReading

LONGEST_JUDGED: Final = max(LONGER_HORIZON_STEPS.values())
"""Steps of a plan that anything is said about."""
PLANNERS_AT_ONCE: Final = 10
"""Planners whose plans of a scene are judged together: bounds the memory."""


def judge(
    rows: Sequence[Mapping[str, Any]],
    truths: Sequence[SampleTruth],
    protocols: Sequence[str],
    *,
    scene: Scene | None = None,
    around: Sequence[Circumstances] | None = None,
    longer: Callable[[int], Sequence[SampleTruth]] | None = None,
    recorded: RecordedScene | None = None,
    unjudged: Collection[str] = (),
) -> list[SampleRow]:
    """Put what really happened and the verdicts beside the plans.

    Args:
        rows: One JSON object for each sample, as `benchmark.runs.plan_rows` writes them.
        truths: One for each sample, in the same order.
        protocols: Who judges.
        scene: The scene with its map, for driving scores, and for who is to blame for contacts at the ego's sides;
            without it there is neither.
        around: Place and speed of the recorded car at each sample; without them rows do not say where they are.
        longer: The truths with more steps than a plan of 3 s has, asked for where plans go on; without it nothing is
            said beyond 3 s.
        recorded: What the scene gives to judge driving by, if that is there already.
        unjudged: Protocols, and perhaps ``pdm``, that cannot tell whom a plan could touch because the data have other
            categories than they know (`benchmark.runs.vocabulary`).

    Returns:
        One row for each sample. A sample without a plan has no outcome, no diagnosis and no disagreement. Nothing is
        diagnosed or compared without ``exact`` among the protocols. Where objects were not labelled there is L2 alone.

    Raises:
        InputError: If a protocol is unknown or a plan cannot be read.
        ValueError: If rows and truths are not of the same samples.
    """
    return judge_planners(
        [rows],
        truths,
        protocols,
        scene=scene,
        around=around,
        longer=longer,
        recorded=recorded,
        unjudged=unjudged,
    )[0]


def judge_planners(
    rows_of: Sequence[Sequence[Mapping[str, Any]]],
    truths: Sequence[SampleTruth],
    protocols: Sequence[str],
    *,
    scene: Scene | None = None,
    around: Sequence[Circumstances] | None = None,
    longer: Callable[[int], Sequence[SampleTruth]] | None = None,
    recorded: RecordedScene | None = None,
    unjudged: Collection[str] = (),
) -> list[list[SampleRow]]:
    """`judge` of several planners together, each protocol asked once for all of them.

    Args:
        rows_of: Of each planner what `judge` takes of one; the other arguments are those of `judge`.

    Returns:
        Of each planner one row for each sample, the same as one by one.

    Raises:
        InputError: As `judge`, if any planner's plan cannot be read.
        ValueError: As `judge`.
    """
    tokens = [truth.sample_token for truth in truths]
    for rows in rows_of:
        if [row["sample_token"] for row in rows] != tokens:
            raise ValueError(
                f"plans and truth of {rows[0]['scene'] if rows else 'a scene'} do not have the same samples"
            )
    planned = [
        (which, at) for which, rows in enumerate(rows_of) for at, row in enumerate(rows) if row["plan"] is not None
    ]
    happened, whole = [truths[at] for _, at in planned], [plan_of(rows_of[which][at]["plan"]) for which, at in planned]
    plans = [plan.judged for plan in whole]
    in_lidar = _in_lidar(plans, happened)
    outcomes = {
        name: _where_known(
            _at_rate(protocol(name), protocol(name).evaluate(happened, in_lidar), happened),
            happened,
            told=name not in unjudged,
        )
        for name in dict.fromkeys(protocols)
    }
    verdicts = {name: outcome.as_rows() for name, outcome in outcomes.items()}
    causes, differences = _explained(happened, plans, in_lidar, outcomes)
    recorded = None if scene is None else recorded or RecordedScene(scene)
    judged = _by_planner(len(rows_of), planned, plans)
    driven = _driven(None if PDM in unjudged else scene, recorded, judged, len(truths))
    # A map without roads or lanes would blame the ego for every contact at its sides.
    known = recorded is not None and bool(recorded.road.drivable and recorded.road.lanes)
    severe = plan_severities(
        [truth.by_clock for truth in happened], in_lidar, recorded.road if recorded is not None and known else None
    )
    asked = longer if EXACT in outcomes else None
    beyond = [{} if asked is None else longer_verdicts(own, asked) for own in _by_planner(len(rows_of), planned, whole)]
    findings: list[list[dict[str, Any]]] = [[{"outcomes": {}} for _ in truths] for _ in rows_of]
    for place, (which, at) in enumerate(planned):
        findings[which][at] = {
            "longer": beyond[which].get(at),
            "outcomes": {name: found[place] for name, found in verdicts.items()},
        }
        if truths[at].labelled:
            findings[which][at] |= {
                "driving": driven[which][at],
                "diagnosis": causes[place],
                "disagreements": differences[place],
                "severity": severe[place],
            }
    happening = [
        _recorded(truth, at) for truth, at in zip(truths, repeat(None, len(truths)) if around is None else around)
    ]
    return [
        [SampleRow(**row, **told, **found) for row, told, found in zip(rows, happening, own, strict=True)]
        for rows, own in zip(rows_of, findings, strict=True)
    ]


def _at_rate(definition: CollisionProtocol, outcomes: Outcomes, truths: Sequence[SampleTruth]) -> Outcomes:
    """Verdicts that count nothing where key frames come at another rate and a protocol takes them for its steps."""
    at_two_hz = np.array([truth.at_two_hz for truth in truths], np.bool_)
    # Protocols of other packages may be older than the question.
    if at_two_hz.all() or getattr(definition, "goes_by_clock", False):
        return outcomes
    return replace(outcomes, counted=outcomes.counted & at_two_hz)


def _where_known(outcomes: Outcomes, truths: Sequence[SampleTruth], *, told: bool) -> Outcomes:
    """Verdicts that say of which samples nothing is known of contacts: of all where categories do not tell."""
    known = np.array([truth.labelled and told for truth in truths], np.bool_)
    return outcomes if known.all() else replace(outcomes, known=known)


def _in_lidar(plans: Sequence[Plan], truths: Sequence[SampleTruth]) -> Floats:
    """(P, 6, 2) waypoints of the lidar origin of P plans, those of a frame at once."""
    found = np.zeros((len(plans), PLAN_STEPS, 2))
    for frame in dict.fromkeys(plan.frame for plan in plans):
        those = [place for place, plan in enumerate(plans) if plan.frame is frame]
        ahead_m = np.array([truths[place].lidar_ahead_m for place in those])
        found[those] = waypoints_in_lidar(np.array([plans[place].waypoints for place in those]), frame, ahead_m)
    return found


def _by_planner(count: int, planned: Sequence[tuple[int, int]], plans: Sequence[Plan]) -> list[dict[int, Plan]]:
    """Plans of each planner by number of the sample."""
    found: list[dict[int, Plan]] = [{} for _ in range(count)]
    for (which, at), plan in zip(planned, plans, strict=True):
        found[which][at] = plan
    return found


def judge_scene_plans(
    rows: Sequence[Mapping[str, Any]],
    reading: "SceneReading",
    protocols: Sequence[str],
    unjudged: Collection[str] = (),
) -> list[SampleRow]:
    """`judge` with all that is known of a scene.

    Args:
        rows: One JSON object for each sample, as `benchmark.runs.plan_rows` writes them.
        reading: The scene.
        protocols: Who judges.
        unjudged: As of `judge`.

    Returns:
        One row for each sample.

    Raises:
        InputError: If the data is broken, a protocol is unknown or a plan cannot be read.
    """
    return judge_all_plans([rows], reading, protocols, unjudged)[0]


def judge_all_plans(
    rows_of: Sequence[Sequence[Mapping[str, Any]]],
    reading: "SceneReading",
    protocols: Sequence[str],
    unjudged: Collection[str] = (),
) -> list[list[SampleRow]]:
    """`judge_scene_plans` of several planners together; arguments and errors as there, of any of them."""
    found: list[list[SampleRow]] = []
    for start in range(0, len(rows_of), PLANNERS_AT_ONCE):
        found += judge_planners(
            rows_of[start : start + PLANNERS_AT_ONCE],
            reading.truth,
            protocols,
            scene=reading.mapped,
            around=reading.around,
            longer=reading.longer,
            recorded=reading.recorded,
            unjudged=unjudged,
        )
    return found


def _driven(
    scene: Scene | None, recorded: RecordedScene | None, plans: Sequence[Mapping[int, Plan]], count: int
) -> list[list[dict[str, Any] | None]]:
    """Of each planner the driving scores of each sample, as rows hold them."""
    if scene is None:
        return [[None] * count for _ in plans]
    verdicts = judge_driving(scene, [[own.get(index) for index in range(count)] for own in plans], recorded)
    return [[None if verdict is None else verdict.as_json() for verdict in own] for own in verdicts]


def longer_verdicts(
    plans: Mapping[int, Plan], longer: Callable[[int], Sequence[SampleTruth]]
) -> dict[int, dict[str, Any]]:
    """What ``exact`` says of plans that go on beyond 3 s, up to 6 s.

    Args:
        plans: By number of the sample.
        longer: The truths of all samples with so many steps.

    Returns:
        For each plan that goes on, contact at each step of the whole plan, null where objects were not labelled, and
        its displacement, null past the scene.
    """
    steps_of = {index: min(len(plan.waypoints), LONGEST_JUDGED) for index, plan in plans.items()}
    found: dict[int, dict[str, Any]] = {}
    for steps in sorted(set(steps_of.values()) - {PLAN_STEPS}):
        truths = longer(steps)
        chosen = [index for index in plans if steps_of[index] == steps]
        waypoints = [
            replace(plans[index], waypoints=plans[index].waypoints[:steps]).waypoints_in_lidar(
                truths[index].lidar_ahead_m
            )
            for index in chosen
        ]
        collision, l2 = judged_longer([truths[index] for index in chosen], np.array(waypoints))
        for index, hits, metres in zip(chosen, collision.tolist(), l2.tolist()):
            said = hits if truths[index].labelled else None
            found[index] = {"collision": said, "l2": [None if np.isnan(one) else one for one in metres]}
    return found


def plan_of(row: Mapping[str, Any]) -> Plan:
    """A plan from its JSON object, the inverse of what `benchmark.runs.plan_rows` writes.

    Args:
        row: Its JSON object.

    Returns:
        The plan as the planner gave it.

    Raises:
        InputError: If its lists are not of the lengths that a plan has.
    """
    parts, forecasts = ("modes", "mode_scores"), row["forecasts"]
    try:
        return Plan(
            np.array(row["waypoints"], np.float64),
            PlanFrame(row["frame"]),
            **{name: None if row[name] is None else np.array(row[name], np.float64) for name in parts},
            forecasts=None if forecasts is None else _forecasts(forecasts),
        )
    except ValueError as error:
        raise InputError(
            f"a stored plan cannot be read ({error}); remove the run directory and run challenger-bench eval again"
        ) from error


def _forecasts(row: Mapping[str, Any]) -> Forecasts:
    """Lists that may be empty have lost the shape of what they do not hold."""
    agents = len(row["boxes"])
    modes = len(row["trajectories"][0]) if row["trajectories"] else 0
    if agents and not modes:
        raise ValueError("its forecasts have no modes")
    return Forecasts(
        boxes=np.array(row["boxes"], np.float64).reshape(agents, 5),
        trajectories=np.array(row["trajectories"], np.float64).reshape(agents, modes, PLAN_STEPS, 2),
        scores=np.array(row["scores"], np.float64).reshape(agents, modes),
    )


def _explained(
    truths: Sequence[SampleTruth], plans: Sequence[Plan], in_lidar: Floats, outcomes: Mapping[str, Outcomes]
) -> tuple[Sequence[Any], Sequence[dict[str, str]]]:
    """Diagnosis and disagreements of each sample, from the verdicts of ``exact`` on it."""
    if EXACT not in outcomes or not truths:
        return [None] * len(truths), [{} for _ in truths]
    causes = diagnose([truth.by_clock for truth in truths], plans, outcomes[EXACT])
    return causes, disagreements(truths, in_lidar, outcomes)


def _recorded(truth: SampleTruth, at: Circumstances | None) -> dict[str, Any]:
    """What a row says of the recording."""
    ahead = truth.by_clock
    return {
        "command": int(truth.command),
        "lidar_ahead_m": truth.lidar_ahead_m,
        "complete": ahead.complete,
        "recorded_future": [
            pose.tolist() if valid else None for pose, valid in zip(ahead.ego_future, ahead.ego_future_valid)
        ],
        "place": None if at is None else at.place.value,
        "speed_m_s": None if at is None else at.speed_m_s,
    }
