"""Requests of searches to a diffusion model, and batching of many searches.

A search is a generator: it yields a request for trajectories and is sent the answer. One alone and many side by side
run through the same code (`run_searches`), so that an accelerator answers all of them in one call.
"""

import time
from collections.abc import Callable, Generator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from benchmark.geometry import Floats

Outcome = TypeVar("Outcome")


@dataclass(frozen=True, slots=True)
class SamplingRequest:
    """A request for new trajectories; ``previous`` is the (3,) pose half a second ago in the rear-axle frame now."""

    count: int
    previous: Floats
    rng: np.random.Generator


@dataclass(frozen=True, slots=True)
class MutationRequest:
    """A request for variants of (B, 16, 3) waypoints by ``noise_level`` diffusion steps and back."""

    waypoints: Floats
    noise_level: int
    previous: Floats
    rng: np.random.Generator


Request = SamplingRequest | MutationRequest
SearchSteps = Generator[Request, Floats, Outcome]


class Prior(Protocol):
    """Unconditional generator of driving.

    Waypoints are (B, 16, 3) x, y, heading at 2 Hz over 8 s, metres, in the rear-axle frame of the vehicle now.
    """

    @property
    def fingerprint(self) -> str:
        """Content key of weights and sampler settings."""

    def answer(self, requests: Sequence[Request]) -> list[Floats]:
        """Waypoints for each request; an answer does not depend on the requests beside it."""


Diversify = Callable[[Floats, np.random.Generator], Floats]
"""Spreads the speeds of an initial batch, which makes it diverse; the reference code does it, the paper is silent."""


@dataclass(frozen=True, slots=True)
class SearchSeconds:
    """Processor seconds of one search; ``answers`` takes an equal share of each call that was shared."""

    answers: float
    search: float


def run_searches(searches: Sequence[SearchSteps[Outcome]], prior: Prior) -> tuple[list[Outcome], list[SearchSeconds]]:
    """Run fresh searches side by side until each has ended; all requests open at a time are answered in one call."""
    outcomes: dict[int, Outcome] = {}
    answering, searching = [0.0] * len(searches), [0.0] * len(searches)
    waiting: dict[int, Request] = {}

    def go_on(index: int, answer: Floats | None) -> None:
        start = time.process_time()
        try:
            waiting[index] = next(searches[index]) if answer is None else searches[index].send(answer)
        except StopIteration as end:
            outcomes[index] = end.value
        searching[index] += time.process_time() - start

    for index in range(len(searches)):
        go_on(index, None)
    while waiting:
        asking, requests = list(waiting), list(waiting.values())
        start = time.process_time()
        answers = prior.answer(requests)
        share = (time.process_time() - start) / len(asking)
        waiting.clear()
        for index, answer in zip(asking, answers, strict=True):
            answering[index] += share
            go_on(index, answer)
    seconds = [SearchSeconds(*both) for both in zip(answering, searching, strict=True)]
    return [outcomes[index] for index in range(len(searches))], seconds
