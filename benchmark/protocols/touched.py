"""Which road user a verdict is about: who is touched at each colliding step, and whether it is an adversary."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools
from benchmark.protocols.stacked import StackedTruths

TOUCHED, TOUCHED_ADVERSARY = "touched", "touched_adversary"
"""Facts of protocols that look at the steps alone."""
HIT_ADVERSARY, ADVERSARY_S = "hit_adversary", "adversary_contact_s"
"""Facts of ``exact``, beside ``hit`` and ``first_contact_s``."""


def touches_adversary(collision: Sequence[bool], facts: Mapping[str, Any]) -> bool | None:
    """Whether the first contact of a plan is with an adversary.

    ``None`` where there is no contact, or the verdict does not say whom it is with: it is older, or of a protocol
    that never does.
    """
    if not any(collision):
        return None
    said = facts.get(TOUCHED_ADVERSARY)
    first = facts.get(HIT_ADVERSARY) if said is None else said[list(collision).index(True)]
    return None if first is None else bool(first)


def touched_facts(
    truths: StackedTruths, collision: Bools, objects: NDArray[np.int64], steps: NDArray[np.int64]
) -> dict[str, tuple[Any, ...]]:
    """Facts on which objects are touched at each colliding step.

    Args:
        truths: S samples with M objects.
        collision: (S, 6) verdicts, after the protocol's own exclusions.
        objects: (N,) objects that the ego touches, in any order.
        steps: (N,) at which step, 0 to 5.

    Returns:
        ``touched``: for each sample the instance that is touched at each of the six steps, the first by name of
        several, null at a step without a collision; ``touched_adversary``: whether any of them there is an adversary.
        Null of a sample without a collision.
    """
    names: list[list[str | None]] = [[None] * PLAN_STEPS for _ in collision]
    adversaries = [[False] * PLAN_STEPS for _ in collision]
    samples = truths.sample_of[objects]
    counts = collision[samples, steps]
    for sample, step, row in zip(samples[counts].tolist(), steps[counts].tolist(), objects[counts].tolist()):
        name, known = truths.instances[row], names[sample][step]
        names[sample][step] = name if known is None else min(known, name)
        adversaries[sample][step] |= bool(truths.adversarial[row])
    collides = collision.any(axis=1).tolist()
    return {
        TOUCHED: tuple(own if any_step else None for own, any_step in zip(names, collides)),
        TOUCHED_ADVERSARY: tuple(own if any_step else None for own, any_step in zip(adversaries, collides)),
    }
