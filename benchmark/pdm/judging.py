"""The plans of one scene, judged: what `eval` and `rescore` put beside each stored plan."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats
from benchmark.pdm.comfort import disagreement, extended_comfort, states_between
from benchmark.pdm.definition import DT_S
from benchmark.pdm.motion import headed, tracked
from benchmark.pdm.recording import RecordedScene
from benchmark.pdm.scoring import Judged, Surroundings, beside, human_scores, judged
from benchmark.planning import Plan
from benchmark.scene import Scene

AT_ONCE: Final = 64
"""Samples that are judged together: bounds the memory of a long scene."""
DECIMALS: Final = 6
"""Of stored numbers: far below them, processors differ in the last bits of a motion."""


@dataclass(frozen=True, slots=True)
class DrivenPlan:
    """What is said of one plan.

    Attributes:
        nc: No collision at fault: 0, 1/2 or 1.
        dac: Drivable area compliance: 0 or 1.
        ddc: Driving direction compliance: 0, 1/2 or 1.
        ep: Ego progress beside the recorded future, 0 to 1.
        ttc: Time to collision: 0 or 1.
        lk: Lane keeping: 0 or 1.
        hc: History comfort: 0 or 1; ``None`` where the recording began less than 1.5 s before (totals count it as 1).
        ec: Extended comfort: 0 or 1; ``None`` where no plan was made up to 0.55 s before.
        forgiven: Sub-scores in which the recorded driver has 0: 1 in the filtered scores.
        progress_m: Along the route in 3 s.
        recorded_progress_m: The same of the recorded future, tracked in the same way.
        collision_s: When the first contact at fault begins, if there is one.
        ttc_s: The first time that is followed by contact within 0.9 s, if there is one.
    """

    nc: float
    dac: float
    ddc: float
    ep: float
    ttc: float
    lk: float
    hc: float | None
    ec: float | None
    forgiven: tuple[str, ...]
    progress_m: float
    recorded_progress_m: float
    collision_s: float | None
    ttc_s: float | None

    def as_json(self) -> dict[str, Any]:
        """JSON values."""
        return {**{each.name: getattr(self, each.name) for each in fields(self)}, "forgiven": list(self.forgiven)}


def judge_scene(
    scene: Scene, plans: Sequence[Plan | None], recorded: RecordedScene | None = None
) -> list[DrivenPlan | None]:
    """Judge the plans of a scene.

    Args:
        scene: The scene, with its map.
        plans: One for each of its K samples in time order, ``None`` where the planner failed.
        recorded: What the scene gives to judge by, if that is there already.

    Returns:
        K verdicts; ``None`` where there is no plan, the recording ends within 3 s, or the map there has no
        road or no lanes.
    """
    found: list[DrivenPlan | None] = [None] * len(plans)
    recorded = recorded or RecordedScene(scene)
    samples = np.flatnonzero(recorded.complete & np.array([plan is not None for plan in plans], np.bool_))
    # Without lanes every plan would be on the wrong side of the road.
    if not (recorded.road.drivable and recorded.road.lanes and len(samples)):
        return found
    ahead_m = float(scene.lidar.translation[0])
    judged_plans = [plan for plan, sample in zip(plans, recorded.complete, strict=True) if sample and plan is not None]
    poses = np.stack([headed(plan, ahead_m) for plan in judged_plans])
    states: list[Floats] = []
    for start in range(0, len(samples), AT_ONCE):
        batch = slice(start, start + AT_ONCE)
        motions, verdicts = _batch(recorded, samples[batch], poses[batch])
        states.append(motions)
        for sample, verdict in zip(samples[batch].tolist(), verdicts, strict=True):
            found[sample] = verdict
    for sample, comfort in _between_plans(samples, recorded.seconds, np.concatenate(states)).items():
        found[sample] = replace(_known(found[sample]), ec=comfort)
    return found


def _batch(recorded: RecordedScene, samples: NDArray[np.int64], poses: Floats) -> tuple[Floats, list[DrivenPlan]]:
    """Motions and verdicts of some plans, less what needs the plan before."""
    own = np.arange(len(samples))
    around, references = _references(recorded, samples)
    plans = judged(tracked(poses, around.now), own, around)
    scores = beside(plans, references.course.progress_m, references.scores.multiplier)
    forgiven = human_scores(references).zeros()
    verdicts = [
        DrivenPlan(
            **{name: float(getattr(scores, name)[row]) for name in ("nc", "dac", "ddc", "ttc", "lk")},
            ep=round(float(scores.ep[row]), DECIMALS),
            hc=float(scores.hc[row]) if around.has_history[row] else None,
            ec=None,
            forgiven=tuple(name for name, zero in forgiven.items() if zero[row]),
            progress_m=round(float(plans.course.progress_m[row]), DECIMALS),
            recorded_progress_m=round(float(references.course.progress_m[row]), DECIMALS),
            collision_s=_seconds(int(plans.collisions.step[row])),
            ttc_s=_seconds(int(plans.near_misses.step[row])),
        )
        for row in own.tolist()
    ]
    return plans.states, verdicts


def _references(recorded: RecordedScene, samples: NDArray[np.int64]) -> tuple[Surroundings, Judged]:
    """Surroundings and the recorded futures as they are judged: the same for all planners that planned the samples."""
    key = samples.tobytes()
    if key not in recorded.references:
        around = recorded.surroundings(samples)
        plans = tracked(recorded.recorded_plans(samples), around.now)
        recorded.references[key] = around, judged(plans, np.arange(len(samples)), around)
    found: tuple[Surroundings, Judged] = recorded.references[key]
    return found


def _between_plans(samples: NDArray[np.int64], seconds: Floats, states: Floats) -> dict[int, float]:
    """EC of each plan that follows another closely enough."""
    found: dict[int, float] = {}
    for row in range(1, len(samples)):
        apart = states_between(float(seconds[samples[row]] - seconds[samples[row - 1]]))
        if apart is not None:
            differences = disagreement(states[row - 1 : row], states[row : row + 1], apart)
            found[int(samples[row])] = float(extended_comfort(differences)[0])
    return found


def _known(verdict: DrivenPlan | None) -> DrivenPlan:
    assert verdict is not None
    return verdict


def _seconds(state: int) -> float | None:
    """Time of a state, ``None`` for none."""
    return None if state < 0 else round(state * DT_S, 1)
