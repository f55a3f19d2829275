"""What a data set says of driven scenes is refused where it is something else."""

from typing import Any

import pytest

from benchmark.errors import InputError
from benchmark.records.driven_ego import DrivenEgoTargets

WAY: list[Any] = [[float(step), 0.5] for step in range(5)] + [None]
SAID: dict[str, Any] = {"planner": "vad-mini", "commands": [2, 0], "wanted": [WAY, [None] * 6]}


def test_it_is_read() -> None:
    found = DrivenEgoTargets.from_json(SAID)
    assert found.known.sum() == 5 and found.wanted.shape == (2, 6, 2)
    assert found.as_json() == SAID


@pytest.mark.parametrize(
    "broken",
    [
        None, [], {}, {**SAID, "planner": 3}, {**SAID, "commands": None}, {**SAID, "commands": [2]},
        {**SAID, "commands": [2, 3]}, {**SAID, "commands": [2, True]}, {**SAID, "commands": [2, [0]]},
        {**SAID, "wanted": [WAY]}, {**SAID, "wanted": [WAY, None]}, {**SAID, "wanted": [WAY, WAY[:5]]},
        {**SAID, "wanted": [WAY, "abcdef"]}, {**SAID, "wanted": [WAY, [[1.0]] * 6]},
        {**SAID, "wanted": [WAY, [[1.0, "x"]] * 6]}, {**SAID, "wanted": [WAY, [[1.0, float("inf")]] * 6]},
        {**SAID, "wanted": [WAY, [[1.0, 10**400]] * 6]},
    ],
)  # fmt: skip
def test_anything_else_is_refused(broken: object) -> None:
    with pytest.raises(InputError, match="build the data again"):
        DrivenEgoTargets.from_json(broken)
