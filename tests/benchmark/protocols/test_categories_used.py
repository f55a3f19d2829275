"""Protocols say themselves whether it depends on an object's category whether it can be hit."""

from dataclasses import replace

import numpy as np
import pytest

from benchmark.protocols import PROTOCOLS, find_category_protocols
from benchmark.protocols.stacked_truths import stack
from tests.benchmark.fake_data import town_of_two


@pytest.mark.parametrize("name", PROTOCOLS)
def test_another_name_hides_an_object_from_those_that_go_by_names_and_from_no_other(name: str) -> None:
    truths = town_of_two(slow_leader=True).truth("scene-9902")
    definition = PROTOCOLS[name]
    named = definition.counted_objects(stack(truths))
    foreign = definition.counted_objects(
        stack([replace(truth, categories=("car",) * len(truth.categories)) for truth in truths])
    )
    assert named.any()
    assert np.array_equal(named, foreign) != definition.uses_categories
    assert (name in find_category_protocols([name])) == definition.uses_categories
    assert not (definition.uses_categories and foreign.any())
