"""``serve`` itself: who may be served; the protocols are tested with their extensions."""

import pytest

import benchmark
from adapters.registry import build_planner
from benchmark.api.serving import require_servable
from benchmark.errors import InputError
from tests.benchmark.closed_loop.seeing import Looking


def test_who_sees_more_than_the_wire_has_is_not_served() -> None:
    for name in ("idm", "log-replay", "constant-velocity-on-path"):
        with pytest.raises(InputError, match="which requests do not carry"):
            require_servable(build_planner(name))
    require_servable(build_planner("constant-velocity"))

    class Continuous(Looking):
        memory_crosses_scenes = True

        def begin_run(self) -> None:
            pass

    with pytest.raises(InputError, match="keeps state across scenes"):
        require_servable(Continuous())


def test_a_server_is_not_served_again() -> None:
    with pytest.raises(InputError, match="is a server already"):
        benchmark.serve_planner("http://127.0.0.1:9000")
