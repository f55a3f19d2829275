"""AlpaSim's egodriver contract, both ways: policies behind gRPC are judged here, and our planners are served to it.

Messages are made from one table (`messages`); what they mean is in ``docs/extensions/alpasim.md``.
"""

from typing import Any

from benchmark.machine.listening import ServingProtocol


def _make(*given: Any, **options: Any) -> Any:
    from benchmark.extensions.alpasim.server import make_planner_server

    return make_planner_server(*given, **options)


def _find_address(host: str | None, port: int | None) -> tuple[str, int]:
    from benchmark.extensions.alpasim.server import find_address

    return find_address(host, port)


def describe_protocol() -> ServingProtocol:
    """AlpaSim's egodriver contract, for ``serve``."""
    return ServingProtocol(_make, "sessions side by side", ("grpc", "google.protobuf"), "alpasim", _find_address)
