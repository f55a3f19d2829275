"""The search for an adversary made again with its rounds kept: what refinement did, on the map.

A build keeps the track and the scores alone. The same scene, settings and model give the same search, so that the
candidates of every round can be had later, of any scene; the track that comes out must be the one that was kept.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import MotionModel, simulate
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.records.scenes import SCHEMA, RefinementTrace, TraceFrame, TraceRound
from benchmark.scene import Scene
from generation.search.adversary import Attempt, Planned, attempt
from generation.search.attempts import StoredAttempt
from generation.search.hyperparameters import HyperParameters
from generation.search.proposals import Diversify, Prior
from generation.search.refinement import scores_together

SHOWN_CANDIDATES: Final = 64
"""Of each round; of more, the better half of this number are the best ones and the rest a sample of the others."""
SHOWN_FRAMES: Final = 36
"""Candidates are drawn for 3 s, the horizon of planners and of the scores, or longer if scores look farther."""
SAME_M: Final = 1e-9
"""How far a track made again may be from the one that was kept; radians for the heading."""


@dataclass(frozen=True, slots=True)
class Searched:
    """An adversarial scene whose search is made again.

    Attributes:
        name: Name of the generated scene.
        scene: The recorded scene, with the earlier adversaries in it.
        agent_index: Index of the adversary there.
        instance: Its identifier in the generated data set.
        origin_m: (x, y) that positions are relative to.
        seed: User's seed.
        hyper: Settings of the search.
        stored: What the search gave when the scene was generated.
        facts: What ``rounds.json`` says of the search.
    """

    name: str
    scene: Scene
    agent_index: int
    instance: str
    origin_m: tuple[float, float]
    seed: int
    hyper: HyperParameters
    stored: StoredAttempt
    facts: dict[str, Any]


def trace(searched: Searched, prior: Prior, *, diversify: Diversify | None = None) -> RefinementTrace:
    """Make a search again and keep its rounds.

    Args:
        searched: The scene and its search.
        prior: The diffusion model of that search.
        diversify: Spread of the initial batch; the package's own by default.

    Returns:
        Candidates and scores of the last search for the vehicle, the one that was kept. Scores are those by which
        rounds are compared: the challenge is normalised over all rounds of a planning frame together.

    Raises:
        InputError: If another track comes out than the one that was kept.
    """
    frames: list[TraceFrame] = []

    def watch(planned: Planned) -> None:
        if frames and planned.frame <= frames[-1].frame:
            frames.clear()  # a second search for the same vehicle began
        length_m = float(searched.scene.agents.size[searched.agent_index, 0])
        frames.append(_trace_frame(planned, searched.hyper, length_m, searched.origin_m))

    result = attempt(
        searched.scene, searched.agent_index, searched.seed, searched.hyper, prior, diversify=diversify, watch=watch
    )
    _require_same(searched, result)
    return RefinementTrace(
        schema=SCHEMA,
        scene=searched.name,
        agent=searched.instance,
        origin_m=searched.origin_m,
        search=searched.facts,
        frames=tuple(frames),
    )


def _require_same(searched: Searched, result: Attempt) -> None:
    """The search must give the track that the scene has."""
    stored = searched.stored
    expected: Floats = np.array(stored.poses, dtype=np.float64).reshape(-1, 3)
    same = result.kept and result.start == stored.start and result.poses.shape == expected.shape
    if not same or not np.abs(result.poses - expected).max(initial=0.0) <= SAME_M:
        raise InputError(
            f"{searched.name} cannot be traced: its search gives another track here than when it was generated, as "
            "happens with other versions of the numerical libraries; generate it again on this machine"
        )


def _trace_frame(
    planned: Planned, hyper: HyperParameters, length_m: float, origin_m: tuple[float, float]
) -> TraceFrame:
    scores = scores_together(planned.batches, hyper)
    steps = max(SHOWN_FRAMES, hyper.scored_frames[-1])
    rounds, place = [], 0
    for number, (batch, score) in enumerate(zip(planned.batches, scores, strict=True)):
        motion = simulate(batch.waypoints, planned.state, length_m, steps=steps, model=MotionModel.si())
        chosen = planned.found.chosen if number == planned.found.round else None
        shown = shown_candidates(score, motion.finite, chosen)
        if chosen is not None:
            place = int(np.flatnonzero(shown == chosen)[0])
        points = motion.center[shown, ::FRAMES_PER_KEYFRAME, :2] - np.array(origin_m)
        rounds.append(
            TraceRound(
                candidates=tuple(tuple((round(x, 2), round(y, 2)) for x, y in line) for line in points.tolist()),
                scores=tuple(round(value, 5) if np.isfinite(value) else None for value in score[shown].tolist()),
                collision_free=planned.found.rounds[number].collision_free,
            )
        )
    return TraceFrame(frame=planned.frame, rounds=tuple(rounds), chosen_round=planned.found.round, chosen=place)


def shown_candidates(scores: Floats, drawable: NDArray[np.bool_], chosen: int | None) -> NDArray[np.int64]:
    """Which candidates of a round are kept.

    Args:
        scores: (B,) lower is better.
        drawable: (B,) whether the motion is finite; other candidates are not kept.
        chosen: Index that is among them in any case, if drawable.

    Returns:
        Increasing indices, at most `SHOWN_CANDIDATES`.
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
