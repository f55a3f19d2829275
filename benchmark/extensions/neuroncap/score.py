"""NeuroNCAP's score of one run."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.constants import PLAN_STEP_S, PLAN_STEPS
from benchmark.errors import InputError
from benchmark.extensions.neuroncap.actors import Actor
from benchmark.extensions.neuroncap.loop import Engine, NeuroncapWorld
from benchmark.extensions.neuroncap.recording import NeuroncapRecording
from benchmark.extensions.neuroncap.scenarios import STEP_S
from benchmark.records.neuroncap_aggregate import NeuroncapSwitches

WITHOUT_CONTACT: Final = 5.0
_BEST_CONTACT: Final = 4.0
_FRAMES_AHEAD: Final = 8
"""Frames from the start to an impact that cannot be avoided."""


@dataclass(frozen=True, slots=True)
class NeuroncapRunScore:
    """Score of one run, 0 to 5, NaN where impact and reference are nothing; m/s, 0 without a contact.

    `reference_speed` is what the impact is measured by; `metrics` are as in the published file, but for recall.
    """

    score: float
    collided: bool
    impact_speed: float
    reference_speed: float
    metrics: dict[str, bool | float]


def compute_reference_speed(
    recording: NeuroncapRecording, start_frame: int, target: Actor | None, switches: NeuroncapSwitches
) -> float:
    """Impact speed in m/s if no one acts; refused less than four seconds from the end, as published code fails."""
    count, ahead = len(recording.times), start_frame + _FRAMES_AHEAD
    if switches.reference_speed == "code":
        if ahead >= count:
            raise InputError(
                f"a run from frame {start_frame} of {count} has no frame four seconds on; neuroncap@code needs it, "
                "start earlier or use neuroncap@paper"
            )
        frame = count - 2
    else:
        frame = min(ahead, count - 2)
    moved = recording.poses[frame + 1, :2, 3] - recording.poses[frame, :2, 3]
    real = int(recording.times[frame + 1] - recording.times[frame]) / 1e6
    velocity = moved / (STEP_S if switches.reference_dt == "code" else real)
    if target is not None and len(target.times) > 1:
        time_us = int(recording.times[min(ahead, count - 1)])
        nearest = min(int(np.argmin(np.abs(target.times - time_us))), len(target.times) - 2)
        step = target.poses[nearest + 1, :2, 3] - target.poses[nearest, :2, 3]
        velocity = velocity - step / (int(target.times[nearest + 1] - target.times[nearest]) / 1e6)
    return float(np.linalg.norm(velocity))


def score_impact(impact: float, reference: float) -> float:
    """Score of a contact: 4 for none of the reference speed left, 0 for all of it; NaN for nothing of nothing."""
    if reference == 0.0:
        return 0.0 if impact > 0.0 else float("nan")
    return _BEST_CONTACT * max(0.0, 1.0 - impact / reference)


def score_run(engine: Engine, world: NeuroncapWorld) -> NeuroncapRunScore:
    """Score of a run from `finish_run`."""
    target = next((actor for actor in engine.actors if actor.is_target), None)
    reference = compute_reference_speed(engine.recording, engine.start_frame, target, engine.switches)
    impact = 0.0 if world.contact is None else world.contact.impact_speed(engine.switches)
    score = WITHOUT_CONTACT if world.contact is None else score_impact(impact, reference)
    collided = world.contact is not None
    metrics: dict[str, bool | float] = {"any_collide@0.0s": collided}
    metrics["avg_collide@0.0s"] = float(collided) / world.checked
    if engine.check_futures:
        for number in range(PLAN_STEPS):
            name = f"collide@{PLAN_STEP_S * (number + 1):.1f}s"
            metrics[f"any_{name}"] = world.future_hits[number] > 0
            metrics[f"avg_{name}"] = world.future_hits[number] / world.checked
    metrics["ncap_score"] = score
    return NeuroncapRunScore(score, collided, impact, reference, metrics)
