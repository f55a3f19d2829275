import os

import pytest

from benchmark.errors import InputError
from benchmark.workers import map_ordered


def die_at_two(item: int) -> int:
    if item == 2:
        os._exit(9)
    return item


def test_a_killed_worker_is_a_sentence() -> None:
    with pytest.raises(InputError, match="a worker process ended abruptly"):
        list(map_ordered(die_at_two, [1, 2, 3], workers=2, label="counting"))
