"""The plans of one scene, judged: what `eval` and `rescore` put beside each stored plan."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final, TypeVar

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats
from benchmark.pdm.definition import DT_S
from benchmark.pdm.plan_motion import (
    compute_disagreement,
    count_states_between,
    plans_to_poses,
    score_extended_comfort,
    track_plans,
)
from benchmark.pdm.recorded_scene import RecordedScene
from benchmark.pdm.scoring import (
    ScoredMotions,
    ScoringContext,
    score_against_references,
    score_motions,
    score_recorded_motions,
)
from benchmark.pdm.totals import DrivenPlan
from benchmark.planning import Plan
from benchmark.scene import Scene

There = TypeVar("There")
AT_ONCE: Final = 256
"""Plans that are judged together: bounds the memory of a long scene, or of many planners."""
DECIMALS: Final = 6
"""Of stored numbers: far below them, processors differ in the last bits of a motion."""


def score_scene_plans(
    scene: Scene, plans: Sequence[Plan | None], recorded: RecordedScene | None = None
) -> list[DrivenPlan | None]:
    """Judge the plans of the K samples of a scene with its map, in time order; ``None`` where the planner failed.

    The verdict is ``None`` where there is no plan, the recording ends within 3 s, or the map there has no road or no
    lanes.
    """
    return score_planners(scene, [plans], recorded)[0]


def score_planners(
    scene: Scene, plans: Sequence[Sequence[Plan | None]], recorded: RecordedScene | None = None
) -> list[list[DrivenPlan | None]]:
    """`score_scene_plans` of several planners together: of each planner K verdicts, the same as one by one."""
    scores: list[list[DrivenPlan | None]] = [[None] * len(own) for own in plans]
    recorded = recorded or RecordedScene(scene)
    chosen = [
        (planner, sample)
        for planner, own in enumerate(plans)
        for sample, complete in zip(range(len(own)), recorded.complete.tolist(), strict=True)
        if complete and own[sample] is not None
    ]
    # Without lanes every plan would be on the wrong side of the road.
    if not (recorded.road.drivable and recorded.road.lanes and chosen):
        return scores
    ahead_m = float(scene.lidar.translation[0])
    samples = np.array([sample for _, sample in chosen], np.int64)
    poses = plans_to_poses([_require_known(plans[planner][sample]) for planner, sample in chosen], ahead_m)
    states: list[Floats] = []
    for start in range(0, len(samples), AT_ONCE):
        batch = slice(start, start + AT_ONCE)
        motions, verdicts = _score_batch(recorded, samples[batch], poses[batch])
        states.append(motions)
        for (planner, sample), verdict in zip(chosen[batch], verdicts, strict=True):
            scores[planner][sample] = verdict
    for row, comfort in _score_consecutive_plans(chosen, recorded.seconds, np.concatenate(states)).items():
        planner, sample = chosen[row]
        scores[planner][sample] = replace(_require_known(scores[planner][sample]), ec=comfort)
    return scores


def _score_batch(recorded: RecordedScene, samples: NDArray[np.int64], poses: Floats) -> tuple[Floats, list[DrivenPlan]]:
    """Motions and verdicts of some plans, less what needs the plan before; a sample may have several plans."""
    at, own = np.unique(samples, return_inverse=True)
    around, references = _score_references(recorded, at)
    plans = score_motions(track_plans(poses, around.now[own]), own, around)
    scores = score_against_references(plans, references.course.progress_m[own], references.scores.multiplier[own])
    forgiven = score_recorded_motions(references).zeros()
    touches = _find_touched_objects(plans.collisions.events, around.traffic.number, recorded, len(own))
    verdicts = [
        DrivenPlan(
            nc=float(scores.nc[row]),
            dac=float(scores.dac[row]),
            ddc=float(scores.ddc[row]),
            ttc=float(scores.ttc[row]),
            lk=float(scores.lk[row]),
            ep=round(float(scores.ep[row]), DECIMALS),
            hc=float(scores.hc[row]) if around.has_history[of] else None,
            ec=None,
            forgiven=[name for name, zero in forgiven.items() if zero[of]],
            progress_m=round(float(plans.course.progress_m[row]), DECIMALS),
            recorded_progress_m=round(float(references.course.progress_m[of]), DECIMALS),
            collision_s=_seconds(int(plans.collisions.step[row])),
            ttc_s=_seconds(int(plans.near_misses.step[row])),
            **touches[row],
        )
        for row, of in enumerate(own.tolist())
    ]
    return plans.states, verdicts


def _find_touched_objects(
    events: NDArray[np.int64], number: NDArray[np.int64], recorded: RecordedScene, plans: int
) -> list[dict[str, Any]]:
    """Whom each of some plans touches; contacts in order of time within each plan, `number` as of `SampleTraffic`."""
    touched: list[dict[str, Any]] = [
        {"hit": None, "first_contact_s": None, "hit_adversary": False, "adversary_contact_s": None}
        for _ in range(plans)
    ]
    for plan, state, row in events[:, :3].tolist():
        own, time_s, agent = touched[plan], _seconds(state), int(number[row])
        name, adversary = recorded.instances[agent], bool(recorded.adversaries[agent])
        if own["hit"] is None or (own["first_contact_s"] == time_s and name < own["hit"]):
            own |= {"hit": name, "first_contact_s": time_s, "hit_adversary": adversary}
        if adversary and own["adversary_contact_s"] is None:
            own["adversary_contact_s"] = time_s
    return touched


def _score_references(recorded: RecordedScene, samples: NDArray[np.int64]) -> tuple[ScoringContext, ScoredMotions]:
    """Surroundings and the recorded futures as they are judged: the same for all planners that planned the samples."""
    key = samples.tobytes()
    if key not in recorded.references:
        around = recorded.build_context(samples)
        plans = track_plans(recorded.build_recorded_plans(samples), around.now)
        recorded.references[key] = around, score_motions(plans, np.arange(len(samples)), around)
    references: tuple[ScoringContext, ScoredMotions] = recorded.references[key]
    return references


def _score_consecutive_plans(chosen: Sequence[tuple[int, int]], seconds: Floats, states: Floats) -> dict[int, float]:
    """EC of each row whose plan follows another one of the same planner closely enough."""
    rows_apart: dict[int, list[int]] = {}
    for row in range(1, len(chosen)):
        (before, earlier), (planner, later) = chosen[row - 1 : row + 1]
        apart = count_states_between(float(seconds[later] - seconds[earlier])) if planner == before else None
        if apart is not None:
            rows_apart.setdefault(apart, []).append(row)
    comfort_of_row: dict[int, float] = {}
    for apart, rows in rows_apart.items():
        here = np.array(rows)
        comfort = score_extended_comfort(compute_disagreement(states[here - 1], states[here], apart))
        comfort_of_row |= dict(zip(rows, comfort.tolist(), strict=True))
    return comfort_of_row


def _require_known(there: There | None) -> There:
    assert there is not None
    return there


def _seconds(state: int) -> float | None:
    return None if state < 0 else round(state * DT_S, 1)
