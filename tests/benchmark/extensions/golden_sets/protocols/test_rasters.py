"""Rasters of the official form against the slow and obvious version."""

from hypothesis import given, settings

from benchmark.extensions.golden_sets.protocols.official import draw_rasters
from benchmark.protocols.stacked_truths import stack
from tests.benchmark.protocols import slow_protocols as slow
from tests.benchmark.protocols.protocol_cases import Traits, plan_of, sample_of, traits


@settings(max_examples=40, deadline=None)
@given(traits(coarse=True))
def test_rasters_are_those_of_whole_pictures(kind: Traits) -> None:
    sample = sample_of(kind)
    here = sample.ego_future_valid
    for name, judge in (("uniad", slow.slow_uniad), ("vad", slow.slow_vad)):
        expected = judge(sample, plan_of(kind)).rasters
        assert expected is not None
        assert (draw_rasters(name, stack([sample]))[0][here] == expected[here]).all()
