"""Whom a verdict is about, against judging each object alone."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.geometry import Floats
from benchmark.protocols import PROTOCOLS
from benchmark.protocols.raster import ADVERSARY_S, HIT_ADVERSARY, TOUCHED, TOUCHED_ADVERSARY
from benchmark.truth import SampleTruth
from tests.benchmark.protocols.protocol_cases import PARTS, Traits, plan_of, sample_of, traits

BY_STEP = ("uniad", "vad", "vad-23", "sparsedrive", "diffusiondrive", "stp3")


def alone(sample: SampleTruth, row: int) -> SampleTruth:
    """The sample with one of its objects."""
    assert sample.seen_before is not None
    return replace(
        sample, instances=(sample.instances[row],), categories=(sample.categories[row],),
        **{name: getattr(sample, name)[row : row + 1] for name in PARTS},
    )  # fmt: skip


def case(kind: Traits, adversaries: list[int]) -> tuple[SampleTruth, Floats]:
    sample = sample_of(kind)
    named = frozenset(sample.instances[row] for row in adversaries if row < len(sample.instances))
    return replace(sample, index=2, adversaries=named), plan_of(kind)


@pytest.mark.parametrize("name", BY_STEP)
@settings(max_examples=15, deadline=None)
@given(kind=traits(coarse=True), adversaries=st.lists(st.integers(0, 11), max_size=3))
def test_who_is_touched_is_who_would_be_touched_alone(name: str, kind: Traits, adversaries: list[int]) -> None:
    sample, plan = case(kind, adversaries)
    judge = PROTOCOLS[name]
    found = judge.evaluate([sample], plan[None])
    singles = [judge.evaluate([alone(sample, row)], plan[None]).steps["before_mask"][0] for row in range(kind.objects)]
    if not found.collision.any():
        assert found.facts[TOUCHED] == found.facts[TOUCHED_ADVERSARY] == (None,)
        return
    for step, collides in enumerate(found.collision[0].tolist()):
        touching = [sample.instances[row] for row in range(kind.objects) if singles[row][step]] if collides else []
        assert found.facts[TOUCHED][0][step] == min(touching, default=None)
        assert (found.facts[TOUCHED][0][step] is not None) == collides
        assert found.facts[TOUCHED_ADVERSARY][0][step] == bool(sample.adversaries & set(touching))


@settings(max_examples=40, deadline=None)
@given(kind=traits(coarse=False), adversaries=st.lists(st.integers(0, 11), max_size=3))
def test_exact_says_when_an_adversary_is_touched_whoever_was_before(kind: Traits, adversaries: list[int]) -> None:
    sample, plan = case(kind, adversaries)
    exact = PROTOCOLS["exact"]
    found = exact.evaluate([sample], plan[None]).facts
    times = {
        sample.instances[row]: exact.evaluate([alone(sample, row)], plan[None]).facts["first_contact_s"][0]
        for row in range(kind.objects)
    }
    touched = {name: time for name, time in times.items() if time is not None}
    first = min(((time, name) for name, time in touched.items()), default=None)
    hit = None if first is None else first[1]
    assert found["hit"] == (hit,)
    assert found[HIT_ADVERSARY] == (None if hit is None else hit in sample.adversaries,)
    assert found[ADVERSARY_S] == (
        min((time for name, time in touched.items() if name in sample.adversaries), default=None),
    )
