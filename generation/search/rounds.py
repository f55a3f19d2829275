"""The rounds of a search as they are shown: candidates and scores at every planning frame (``rounds.json``)."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import MotionModel, VehicleState, simulate
from benchmark.geometry import Floats
from benchmark.records.scenes import TraceFrame, TraceRound
from benchmark.scene import Scene
from benchmark.scene_pages.motion import origin_of
from generation.search.hyperparameters import HyperParameters
from generation.search.refinement import Refinement, scores_together

SHOWN_CANDIDATES: Final = 64
"""Of each round; of more, the better half of this number are the best ones and the rest a sample of the others."""
SHOWN_FRAMES: Final = 36
"""Candidates are drawn for 3 s, the horizon of planners and of the scores, or longer if scores look farther."""


def rounds_of(
    scene: Scene,
    agent: int,
    frame: int,
    state: VehicleState,
    found: Refinement,
    hyper: HyperParameters,
    model: MotionModel,
) -> TraceFrame:
    """Candidates and scores that were searched at one planning frame.

    Candidates are relative to the origin of the scene's sheet; for scores by which rounds compare, the challenge is
    normalised over all rounds of the frame together.
    """
    steps = max(SHOWN_FRAMES, hyper.scored_frames[-1])
    length_m, origin_m = float(scene.agents.size[agent, 0]), np.array(origin_of(scene))
    rounds, place = [], 0
    for number, (batch, score) in enumerate(zip(found.batches, scores_together(found.batches, hyper), strict=True)):
        motion = batch.evaluated.motion
        if motion.center.shape[1] <= steps:
            # Scores look no farther than the scene; a picture does.
            motion = simulate(batch.waypoints, state, length_m, steps=steps, model=model)
        chosen = found.chosen if number == found.round else None
        shown = shown_candidates(score, motion.finite, chosen)
        if chosen is not None:
            place = int(np.flatnonzero(shown == chosen)[0])
        points = motion.center[shown, : steps + 1 : FRAMES_PER_KEYFRAME, :2] - origin_m
        rounds.append(
            TraceRound(
                candidates=tuple(tuple((round(x, 2), round(y, 2)) for x, y in line) for line in points.tolist()),
                scores=tuple(round(value, 5) if np.isfinite(value) else None for value in score[shown].tolist()),
                collision_free=found.rounds[number].collision_free,
            )
        )
    return TraceFrame(frame=frame, rounds=tuple(rounds), chosen_round=found.round, chosen=place)


def shown_candidates(scores: Floats, drawable: NDArray[np.bool_], chosen: int | None) -> NDArray[np.int64]:
    """Increasing indices, at most `SHOWN_CANDIDATES`, of the candidates of a round that are kept.

    Args:
        scores: (B,) lower is better.
        drawable: (B,) whether the motion is finite; other candidates are not kept.
        chosen: Index that is among them in any case, if drawable.
    """
    order = np.argsort(scores, kind="stable")
    order = order[drawable[order]]
    if len(order) > SHOWN_CANDIDATES:
        best, rest = order[: SHOWN_CANDIDATES // 2], order[SHOWN_CANDIDATES // 2 :]
        every = np.linspace(0, len(rest) - 1, SHOWN_CANDIDATES - len(best)).round().astype(np.int64)
        shown = np.concatenate([best, rest[every]])
        if chosen is not None and drawable[chosen] and chosen not in shown:
            shown[-1] = chosen
        order = shown
    return np.sort(order)
