"""Multi-round trajectory refinement: sample, score, resample, renew with a little diffusion noise, repeat.

Paper section 3 "Multi-round Trajectory Refinement", Algorithm 1 lines 4-18, appendix of that name; ``rounds.json``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAMES_PER_KEYFRAME
from benchmark.dynamics.bicycle import MotionModel, SimulatedMotion, VehicleState, simulate
from benchmark.geometry import Floats
from benchmark.records.scene_pages import TraceFrame, TraceRound
from benchmark.scene import Scene
from benchmark.scene_pages.page_tracks import find_origin
from generation.search.hyperparameters import HyperParameters
from generation.search.proposals import Diversify, MutationRequest, SamplingRequest, SearchSteps
from generation.search.scoring import ScoreTerms, compute_final_scores


@dataclass(frozen=True, slots=True)
class EvaluatedBatch:
    """One simulated and scored batch."""

    motion: SimulatedMotion
    terms: ScoreTerms


@dataclass(frozen=True, slots=True)
class RoundSummary:
    """(B,) scores of one round, normalised within it, and how many candidates have no contact over the horizon."""

    scores: Floats
    collision_free: int


@dataclass(frozen=True, slots=True)
class Refinement:
    """Chosen (16, 3) trajectory of one planning frame; round 0 is the initial batch, ``score`` compares all rounds."""

    waypoints: Floats
    motion: SimulatedMotion
    chosen: int
    round: int
    score: float
    rounds: tuple[RoundSummary, ...]
    batches: tuple["SearchedBatch", ...]


@dataclass(frozen=True, slots=True)
class SearchedBatch:
    """One round as it was searched: (B, 16, 3) candidates before the simulation, and (B,) random initial scores."""

    waypoints: Floats
    evaluated: EvaluatedBatch
    start: Floats


class ResamplingUnderflowError(ArithmeticError):
    """Every weight of the resampling underflowed, as can happen without `HyperParameters.stable_softmax`."""


def refine(
    diversify: Diversify,
    evaluate: Callable[[Floats], EvaluatedBatch],
    previous: Floats,
    hyper: HyperParameters,
    rng: np.random.Generator,
) -> SearchSteps[Refinement]:
    """Search one planning frame; yields its requests to the diffusion model (`generation.search.proposals`).

    ``evaluate`` takes (B, 16, 3) waypoints, ``previous`` is the (3,) pose half a second ago in the local frame. The
    result is the best candidate of all rounds, or of the last one (``hyper.best_of_all_rounds``).
    """
    waypoints = diversify((yield SamplingRequest(hyper.candidates, previous, rng)), rng)
    batches: list[SearchedBatch] = []
    rounds: list[RoundSummary] = []
    for level in (*hyper.noise_levels(), 0):
        start = hyper.init_least + rng.uniform(0.0, hyper.init_scale, len(waypoints))
        evaluated = evaluate(waypoints)
        scores = compute_final_scores(evaluated.terms, start, hyper)
        batches.append(SearchedBatch(waypoints, evaluated, start))
        rounds.append(_summarise(scores, evaluated.terms, hyper))
        if level:
            drawn = resample(scores, hyper, rng)
            waypoints = yield MutationRequest(waypoints[drawn], level, previous, rng)
    number, chosen, score = _find_best(batches, hyper, rng)
    best = batches[number]
    motion = best.evaluated.motion
    return Refinement(best.waypoints[chosen], motion, chosen, number, score, tuple(rounds), tuple(batches))


def resample(scores: Floats, hyper: HyperParameters, rng: np.random.Generator) -> NDArray[np.int64]:
    """(B,) indices drawn with replacement with probability softmax(-score x temperature); lower scores are better.

    Infinite scores are never drawn. Uniform over the finite ones without scoring, over all where none is finite;
    `ResamplingUnderflowError` if every weight underflows, which only an unstable softmax can do.
    """
    finite = np.isfinite(scores)
    if not finite.any():
        return np.arange(len(scores))
    sharpness = hyper.temperature if hyper.scored else 0.0
    known = np.where(finite, scores, 0.0)
    if hyper.stable_softmax:
        weight = np.where(finite, np.exp(-sharpness * (known - scores[finite].min())), 0.0)
    else:
        single = np.exp(np.float32(-sharpness) * known.astype(np.float32))
        weight = np.where(finite, single, np.float32(0.0)).astype(np.float64)
    total = weight.sum()
    if total == 0.0:
        raise ResamplingUnderflowError(f"the smallest of {int(finite.sum())} scores is {scores[finite].min():.1f}")
    return np.asarray(rng.choice(len(scores), size=len(scores), p=weight / total), dtype=np.int64)


def compare_scores(batches: Sequence[SearchedBatch], hyper: HyperParameters) -> Floats:
    """(R, B) scores with the challenge normalised over all rounds; lower is better, infinite is never chosen."""
    terms = [batch.evaluated.terms for batch in batches]
    finite = np.stack([batch_terms.finite for batch_terms in terms])
    challenge = terms[0].challenges(terms)
    safety = np.stack([batch_terms.compute_safety(batch.start, hyper) for batch, batch_terms in zip(batches, terms)])
    wanted = hyper.ac_weight * challenge
    if terms[0].asked is not None:
        wanted = hyper.manoeuvre_weight * terms[0].requests(terms)
    return np.where(finite, safety + wanted, np.inf)


def _find_best(
    batches: Sequence[SearchedBatch], hyper: HyperParameters, rng: np.random.Generator
) -> tuple[int, int, float]:
    skipped = 0 if hyper.best_of_all_rounds else len(batches) - 1
    score = compare_scores(batches[skipped:], hyper)
    if hyper.scored:
        number, chosen = np.unravel_index(int(np.argmin(score)), score.shape)
        return skipped + int(number), int(chosen), float(score[number, chosen])
    last = len(score) - 1
    finite = np.isfinite(score[last])
    options = np.flatnonzero(finite) if finite.any() else np.arange(score.shape[1])
    chosen = rng.choice(options)
    return skipped + last, int(chosen), float(score[last, chosen])


def _summarise(scores: Floats, terms: ScoreTerms, hyper: HyperParameters) -> RoundSummary:
    free = terms.finite & ~terms.collision[:, : hyper.horizon].any(axis=1)
    return RoundSummary(scores, int(free.sum()))


SHOWN_CANDIDATES: Final = 64
"""Of each round; of more, the better half of this number are the best ones and the rest a sample of the others."""
SHOWN_FRAMES: Final = 36
"""Candidates are drawn for 3 s, the horizon of planners and of the scores, or longer if scores look farther."""


def build_trace_frame(
    scene: Scene,
    agent: int,
    frame: int,
    state: VehicleState,
    found: Refinement,
    hyper: HyperParameters,
    model: MotionModel,
) -> TraceFrame:
    """Candidates relative to the sheet's origin and scores, the challenge normalised over all rounds of the frame."""
    steps = max(SHOWN_FRAMES, hyper.scored_frames[-1])
    length_m, origin_m = float(scene.agents.size[agent, 0]), np.array(find_origin(scene))
    rounds, place = [], 0
    for number, (batch, score) in enumerate(zip(found.batches, compare_scores(found.batches, hyper), strict=True)):
        motion = batch.evaluated.motion
        if motion.center.shape[1] <= steps:
            # Scores end with the scene; pictures show the full trajectories.
            motion = simulate(batch.waypoints, state, length_m, steps=steps, model=model)
        chosen = found.chosen if number == found.round else None
        shown = select_shown_candidates(score, motion.finite, chosen)
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


def select_shown_candidates(scores: Floats, drawable: NDArray[np.bool_], chosen: int | None) -> NDArray[np.int64]:
    """Increasing indices, at most `SHOWN_CANDIDATES`, of drawable candidates that are kept, the chosen one included."""
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
