"""What stands behind ``serve``, and behind models and renderers that answer over HTTP (docs/extensions/http.md)."""

from typing import TYPE_CHECKING

from benchmark.api.planners import model_that_runs

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from benchmark.extensions.http.server import PlannerServer
    from benchmark.planning import Planner
    from benchmark.sandbox.limits import Supervision


def serve_planner(
    name: str,
    checkpoint: "Path | None" = None,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    accept_torch_tensors: bool = False,
    device: str | None = None,
    precision: str | None = None,
    seed: int = 0,
    supervision: "Supervision | None" = None,
) -> "PlannerServer":
    """A planner as a model server for NeuroNCAP, or for whoever speaks its protocol.

    Args:
        name: Planner name or ``package.module:Class``; no miniature stands in for a model without weights.
        checkpoint: Its weights, if not its own.
        host: Where to listen; this machine alone by default.
        port: Where; 0 takes a free one.
        accept_torch_tensors: Whether pictures may be saved tensors, which are pickles.
        device: Where a network runs.
        precision: Of a network.
        seed: For planners that take one.
        supervision: Limits of a planner of another package, which runs in a process of its own (docs/planners.md).

    Returns:
        It listens; ``with`` answers in a thread, `serve` until interrupted.

    Raises:
        InputError: If the planner cannot be built or wants what is not on the wire, or the port is taken.
    """
    from adapters.registry import is_foreign, planner, planner_factory
    from benchmark.extensions.http.server import PlannerServer
    from benchmark.extensions.http.session import Session
    from benchmark.machine.pages import keep_pages_of

    runs = model_that_runs(name, checkpoint, data="")
    built: Planner
    if is_foreign(runs):
        built = planner_factory(
            runs, checkpoint=checkpoint, seed=seed, device=device, precision=precision, supervision=supervision
        )()
    else:
        built = planner(runs, checkpoint=checkpoint, seed=seed, device=device, precision=precision)
    keep_pages_of(getattr(built, "weights_sha256", None))
    return PlannerServer(Session(built, tensors=accept_torch_tensors, seed=seed), host, port)


def require_answers(models: "Sequence[str]", sensors: "Sequence[str]") -> None:
    """Ask servers whether they are there, before anything is made ready for them.

    Args:
        models: Addresses of models.
        sensors: Addresses of renderers.

    Raises:
        InputError: If one is no address, or nobody answers.
    """
    from benchmark.extensions.http.model import http_planner
    from benchmark.extensions.http.sensor import HttpSensor
    from benchmark.machine.address import Address

    for each in models:
        http_planner(each).require_alive()
    for each in sensors:
        HttpSensor(Address.of(each, "--sensor")).require_alive()
