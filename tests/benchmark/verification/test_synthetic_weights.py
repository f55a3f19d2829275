"""The rule for synthetic weights against the program that filled the golden networks."""

import importlib.util
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.verification.synthetic_weights import (
    WeightsRecipe,
    draw_seeded_normal,
    make_synthetic_tensor,
    read_shapes,
)

ONE_TWO = np.array([1.0, 2.0], np.float32)
RULES = {"embedding": 0.5, r"\.bias$": 2.0}


@pytest.fixture(scope="module")
def by_name() -> ModuleType:
    path = Path(__file__).resolve().parents[2] / "golden" / "weights_by_name.py"
    found = importlib.util.spec_from_file_location("weights_by_name", path)
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


@settings(max_examples=60, deadline=None)
@given(
    leaf=st.sampled_from(["weight", "bias", "running_mean", "running_var", "num_batches_tracked", "in_proj_weight"]),
    stem=st.sampled_from(["", "a.", "layers.0.norm.", "type_embedding."]),
    shape=st.lists(st.integers(1, 5), max_size=4),
    salt=st.text(max_size=5),
    rules=st.sampled_from([None, RULES]),
)
def test_every_tensor_is_the_same(
    by_name: ModuleType, leaf: str, stem: str, shape: list[int], salt: str, rules: dict[str, float] | None
) -> None:
    ours = make_synthetic_tensor(stem + leaf, shape, salt, rules)
    theirs = by_name.tensor_for(stem + leaf, tuple(shape), salt, rules)
    assert ours.dtype == theirs.dtype and ours.shape == theirs.shape
    np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(draw_seeded_normal(stem, shape, salt), by_name.normal(stem, tuple(shape), salt))


def test_kept_values_win_over_constants_and_constants_over_chance() -> None:
    recipe = WeightsRecipe(
        salt="s",
        constant_overrides={"a.bias": 3.0, "code": 9.0},
        kept_buffers={"code": [1.0, 0.2]},
        shift_rules={r"^b\.": [1.0, 2.0], "bias": 100.0},
    )
    shapes = {"a.bias": (2,), "code": (2,), "b.bias": (2,), "c.bias": (2,), "index": (2,)}
    state = recipe.state(shapes, {"index": np.array([4, 5])})
    np.testing.assert_array_equal(state["a.bias"], [3.0, 3.0])
    np.testing.assert_array_equal(state["code"], np.array([1.0, 0.2], np.float32))
    np.testing.assert_array_equal(state["b.bias"], make_synthetic_tensor("b.bias", (2,), "s") + ONE_TWO)
    np.testing.assert_array_equal(state["c.bias"], make_synthetic_tensor("c.bias", (2,), "s") + 100 * ONE_TWO[0])
    assert state["index"].dtype == np.int64
    assert list(state) == list(shapes)
    assert all(value.dtype == np.float32 for name, value in state.items() if name != "index")


def test_both_forms_of_keys_are_read() -> None:
    expected = {"b": (2, 3), "a": ()}
    for stored in ({"b": {"shape": [2, 3], "dtype": "x"}, "a": {"shape": []}}, [["b", [2, 3], "x"], ["a", [], "x"]]):
        assert list(read_shapes(stored).items()) == list(expected.items())


@pytest.mark.parametrize(
    "stored", [{"salt": 3}, {"salt": "", "std_rules": {"a": "b"}}, {"salt": "", "std_rules": {"(": 1}}]
)
def test_a_manifest_without_a_recipe_is_refused(stored: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="validation error"):
        WeightsRecipe.model_validate(stored)
