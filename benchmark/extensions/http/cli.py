"""``serve``: a planner as a model server for NeuroNCAP and other clients of its protocol."""

import contextlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.settings import Option, command

if TYPE_CHECKING:
    from benchmark.extensions.http.server import PlannerServer
    from benchmark.planning import Planner
    from benchmark.sandbox.limits import SandboxLimits


@dataclass(frozen=True, slots=True, kw_only=True)
class ServeOptions:
    """Options of ``serve``."""

    model: Annotated[str, Option("Planner name or package.module:Class.", "Planner")]
    port: Annotated[int, Option("Port to listen on; 0 takes a free one.", "Execution", min=0, max=65535)] = 9000
    host: Annotated[
        str, Option("Address to listen on; anything but 127.0.0.1 opens it to other machines.", "Execution")
    ] = "127.0.0.1"
    accept_torch_tensors: Annotated[
        bool, Option("Pictures may be saved tensors, as NeuroNCAP's (pickles).", "Planner")
    ] = False
    device: shared.NetworkDevice = None
    precision: shared.Precision = None
    checkpoint: shared.Checkpoint = None
    sample_limit: shared.SampleLimit = None
    memory_limit: shared.MemoryLimit = None
    seed: shared.Seed = 0


@command(ServeOptions)
def serve_command(options: ServeOptions) -> None:
    """Answer a simulator's requests with a planner's plans, over HTTP, until interrupted."""
    supervision = api.PlannerSource.of(options, data="").require().supervision
    _require_server(options.host, options.port)
    same = ("checkpoint", "host", "port", "accept_torch_tensors", "device", "precision", "seed")
    named = {name: getattr(options, name) for name in same}
    server = serve_planner(options.model, **named, supervision=supervision)
    if server.is_open:
        api.notify(
            f"warning: {server.host} is open to other machines: anyone who reaches port {server.port} can use this "
            "planner, reset it and read its answers, without a password or encryption"
        )
    if options.accept_torch_tensors:
        api.notify("warning: saved tensors are pickles; any client's are read, with weights_only")
    api.notify(f"{options.model} is served at {server.url}, one scene at a time; stop it with Ctrl-C")
    with contextlib.suppress(KeyboardInterrupt):
        server.serve()
    api.notify("ended")


def serve_planner(
    name: str,
    checkpoint: Path | None = None,
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    accept_torch_tensors: bool = False,
    device: str | None = None,
    precision: str | None = None,
    seed: int = 0,
    supervision: "SandboxLimits | None" = None,
) -> "PlannerServer":
    """A planner as a model server for NeuroNCAP, or for other clients of its protocol.

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
    from adapters.planners.names import is_third_party
    from adapters.registry import build_planner, planner_factory
    from benchmark.extensions.http.server import PlannerServer
    from benchmark.extensions.http.session import PlannerSession
    from benchmark.machine.metering import disable_malloc_trim_for

    runs = api.find_runnable_model(name, checkpoint, data="")
    built: Planner
    if is_third_party(runs):
        built = planner_factory(
            runs, checkpoint=checkpoint, seed=seed, device=device, precision=precision, supervision=supervision
        )()
    else:
        built = build_planner(runs, checkpoint=checkpoint, seed=seed, device=device, precision=precision)
    disable_malloc_trim_for(getattr(built, "weights_sha256", None))
    return PlannerServer(PlannerSession(built, tensors=accept_torch_tensors, seed=seed), host, port)


def _require_server(host: str, port: int) -> None:
    """Refuse to serve where nothing can listen, or without the packages that do."""
    from benchmark.extensions.http.listening import open_listening_socket
    from benchmark.machine.extension import require_package

    for package in ("uvicorn", "starlette"):
        require_package(package, api.NEEDS_SERVE.format(what="serving", package=package))
    open_listening_socket(host, port).close()
