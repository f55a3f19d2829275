"""Every protocol against its slow and obvious version, on random samples: border, gaps, jitter, ends of scenes."""

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings

from benchmark.protocols import PROTOCOLS
from benchmark.protocols.vad import COUNTED_23, COUNTED_32
from tests.benchmark.protocols import slow_protocols as slow
from tests.benchmark.protocols.protocol_cases import Traits, plan_of, sample_of, traits
from tests.benchmark.protocols.slow_protocols import SlowVerdicts

Slow = Callable[..., SlowVerdicts]


def compare(name: str, judge: Slow, kind: Traits, *further: object) -> None:
    sample, plan = sample_of(kind), plan_of(kind)
    outcomes, expected = PROTOCOLS[name].evaluate([sample], plan[None]), judge(sample, plan, *further)
    # The slow UniAD has a full raster past the end of a scene, as the official one; there are no verdicts there.
    here = sample.ego_future_valid
    assert outcomes.collision[0].tolist() == expected.collision
    assert outcomes.steps["before_mask"][0][here].tolist() == np.array(expected.before_mask)[here].tolist()
    assert outcomes.steps["recorded"][0][here].tolist() == np.array(expected.recorded)[here].tolist()
    if "obj_col" in outcomes.steps:
        assert outcomes.steps["obj_col"][0].tolist() == expected.obj_col
    assert outcomes.l2[0] == pytest.approx(expected.l2, abs=1e-12)
    assert bool(outcomes.counted[0]) == expected.counted
    values = PROTOCOLS[name].sample_values(outcomes)
    for column, wanted in expected.values.items():
        assert values[column][0] == pytest.approx(wanted, abs=0.0 if column != "l2" else 1e-12)


@settings(max_examples=100, deadline=None)
@given(traits(coarse=True))
def test_uniad(kind: Traits) -> None:
    compare("uniad", slow.slow_uniad, kind)


@settings(max_examples=40, deadline=None)
@given(traits(coarse=True))
def test_vad(kind: Traits) -> None:
    compare("vad", slow.slow_vad, kind, slow.COUNTED_BY_VAD)
    compare("vad-23", slow.slow_vad, kind, slow.COUNTED_BY_VAD_23)


@settings(max_examples=60, deadline=None)
@given(traits(coarse=False))
def test_sparsedrive_and_diffusiondrive(kind: Traits) -> None:
    compare("sparsedrive", slow.slow_sparsedrive, kind)
    compare("diffusiondrive", slow.slow_sparsedrive, kind)


@settings(max_examples=40, deadline=None)
@given(traits(coarse=False))
def test_exact(kind: Traits) -> None:
    sample, plan = sample_of(kind), plan_of(kind)
    outcomes, contact = PROTOCOLS["exact"].evaluate([sample], plan[None]), slow.slow_exact(sample, plan)
    assert outcomes.collision[0].tolist() == contact.reshape(6, 5).any(axis=1).tolist()
    assert outcomes.steps["waypoint_collision"][0].tolist() == contact[4::5].tolist()
    first = float(np.argmax(contact) + 1) / 10 if contact.any() else None
    assert outcomes.facts["first_contact_s"] == (first,)


def test_the_category_tables_name_the_same_objects() -> None:
    assert COUNTED_32 == slow.COUNTED_BY_VAD and COUNTED_23 == slow.COUNTED_BY_VAD_23
    assert len(slow.BLOCK) == 32


def test_the_cases_are_not_empty() -> None:
    rng = np.random.default_rng(5)
    seeds = rng.integers(0, 2**32, 60).tolist()
    kinds = [Traits(seed, 8, 20.0, 6, "drive", seed % 2 == 0) for seed in seeds]
    truths, plans = [sample_of(kind) for kind in kinds], np.array([plan_of(kind) for kind in kinds])
    for name in PROTOCOLS:
        share = PROTOCOLS[name].evaluate(truths, plans).collision.any(axis=1).mean()
        assert 0.04 < share < 0.9, name
