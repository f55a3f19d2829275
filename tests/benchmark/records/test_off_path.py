from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.records.off_path import OFF_PATH, Excursion, find_followable_positions, read_excursions

AWAY = Excursion("lateral", 2.0, 3.0, 6.0, 0.8, 0.0, 0.0, 0.0)


def _said(value: Any) -> dict[str, Any]:
    return {"scenes": {"scene-9000": {"report": {OFF_PATH: value}}}}


def test_where_nothing_is_said_the_ego_was_on_its_path() -> None:
    assert read_excursions(None, "scene-9000") == ()
    assert read_excursions({"scenes": {}}, "scene-9000") == ()
    assert read_excursions({"scenes": {"scene-9000": {"report": {}}}}, "scene-9000") == ()


@pytest.mark.parametrize(
    "value",
    [
        {"kind": "lateral"}, [3], [AWAY.as_json() | {"kind": 3}], [AWAY.as_json() | {"lateral_m": "far"}],
        [AWAY.as_json() | {"worst_s": 1.0}], [AWAY.as_json() | {"end_s": float("inf")}],
        [AWAY.as_json() | {"begin_s": float("nan")}],
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused_in_one_sentence(value: Any) -> None:
    with pytest.raises(InputError) as refused:
        read_excursions(_said(value), "scene-9000")
    assert "build the data again" in str(refused.value) and "\n" not in str(refused.value)


def test_departing_is_nothing_to_learn_and_coming_back_is() -> None:
    steps = 0.5 * np.arange(1, 7)
    expected = {0.0: 4, 1.5: 1, 2.0: 0, 2.5: 0, 3.0: 6, 8.0: 6}
    for now, count in expected.items():
        learned = find_followable_positions([AWAY], np.array(now), now + steps)
        assert learned.tolist() == [True] * count + [False] * (6 - count), now


def test_only_the_beginning_of_a_future_is_ever_left() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        begin, departing, coming = rng.uniform(0.1, 6, 3)
        each = [AWAY, Excursion("fast", begin, begin + departing, begin + departing + coming, 0, 0, 1, 1)]
        now = rng.uniform(0, 18)
        learned = find_followable_positions(each, np.array(now), now + 0.5 * np.arange(1, 7))
        assert not (np.diff(learned.astype(int)) > 0).any()
