"""AlpaSim's contracts, both ways: policies behind gRPC are judged here, and our planners and our adversary served.

Messages are made from one table (`messages`); what they mean is in ``docs/extensions/alpasim.md``.
"""

from typing import Any, Final

from benchmark.machine.listening import LOOPBACK, ServingProtocol

TRAFFIC_PORT: Final = 6790
"""Of traffic: one beside that of a driver."""


def _make(*given: Any, **options: Any) -> Any:
    from benchmark.extensions.alpasim.server import make_planner_server

    return make_planner_server(*given, **options)


def _find_address(host: str | None, port: int | None) -> tuple[str, int]:
    from benchmark.extensions.alpasim.server import find_address

    return find_address(host, port)


def describe_protocol() -> ServingProtocol:
    """AlpaSim's egodriver contract, for ``serve``."""
    return ServingProtocol(_make, "sessions side by side", ("grpc", "google.protobuf"), "alpasim", _find_address)


def _make_traffic(*given: Any, **options: Any) -> Any:
    from benchmark.extensions.alpasim.traffic.serving import make_traffic_server

    return make_traffic_server(*given, **options)


def describe_traffic_protocol() -> ServingProtocol:
    """AlpaSim's traffic contract, for ``serve``."""

    def find_address(host: str | None, port: int | None) -> tuple[str, int]:
        return host or LOOPBACK, TRAFFIC_PORT if port is None else port

    packages = ("grpc", "google.protobuf")
    return ServingProtocol(_make_traffic, "sessions side by side", packages, "alpasim", find_address, "traffic")
