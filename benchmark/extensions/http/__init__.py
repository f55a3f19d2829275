"""NeuroNCAP's wire protocol, both ways: models and renderers behind HTTP, and our planners for external simulators.

Messages are encoded and decoded without sockets, so that client and server share it and are tested as a pair. Notes on
the protocol and its traps: ``docs/extensions/http.md``.
"""

from typing import Any

from benchmark.machine.listening import ServingProtocol


def _make(*given: Any, **options: Any) -> Any:
    from benchmark.extensions.http.server import make_planner_server

    return make_planner_server(*given, **options)


def describe_protocol() -> ServingProtocol:
    """NeuroNCAP's protocol, for ``serve``."""
    return ServingProtocol(_make, "one scene at a time", ("uvicorn", "starlette"), "serve")
