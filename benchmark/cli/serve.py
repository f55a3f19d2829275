"""``serve``: a planner, or traffic, as a server for a simulator, in the protocol of an extension."""

import contextlib
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.settings import Option, command, take_options
from benchmark.errors import InputError


@dataclass(frozen=True, slots=True, kw_only=True)
class ServeOptions:
    """Options of ``serve``."""

    EXTENDED: ClassVar = ("protocol",)

    model: Annotated[str, Option("Planner name or package.module:Class; traffic has none.", "Planner")] = ""
    protocol: Annotated[
        Literal["neuroncap", "alpasim", "alpasim-traffic"],
        Option("neuroncap (HTTP), alpasim (gRPC), or alpasim-traffic: our adversary for AlpaSim.", "Planner"),
    ] = "neuroncap"
    port: Annotated[
        int | None,
        Option(
            "Port to listen on; 0 takes a free one, 9000 (alpasim: 6789, its traffic: 6790) unless told.",
            "Execution",
            min=0,
            max=65535,
        ),
    ] = None
    host: Annotated[
        str | None,
        Option("Address to listen on; anything but 127.0.0.1, the default, opens it to other machines.", "Execution"),
    ] = None
    device: shared.NetworkDevice = None
    precision: shared.Precision = None
    checkpoint: shared.Checkpoint = None
    sample_limit: shared.SampleLimit = None
    memory_limit: shared.MemoryLimit = None
    seed: shared.Seed = 0


@command(ServeOptions, panel="Advanced")
def serve_command(options: ServeOptions) -> None:
    """Answer a simulator's requests with a planner's plans, or with traffic that challenges, until interrupted."""
    from benchmark.machine.listening import open_listening_socket

    own = take_options("protocol", (options.protocol,)).get(options.protocol, {})
    protocol = api.find_serving_protocol(options.protocol)
    host, port = protocol.find_address(options.host, options.port)
    if protocol.serves == "traffic":
        if options.model:
            raise InputError(f"--protocol {options.protocol} serves traffic, no planner; leave --model out")
        open_listening_socket(host, port).close()
        server = api.serve_traffic(options.protocol, host=host, port=port, seed=options.seed, options=own)
    else:
        if not options.model:
            raise InputError("name the planner that is served with --model (for example constant-velocity)")
        supervision = api.PlannerSource.of(options, data="").require().supervision
        open_listening_socket(host, port).close()
        same = ("checkpoint", "protocol", "device", "precision", "seed")
        named = {name: getattr(options, name) for name in same}
        server = api.serve_planner(options.model, **named, host=host, port=port, supervision=supervision, options=own)
    if server.is_open:
        api.notify(
            f"warning: {server.host} is open to other machines: anyone who reaches port {server.port} can use this "
            "server, reset it and read its answers, without a password or encryption"
        )
    if own.get("accept_torch_tensors"):
        api.notify("warning: saved tensors are pickles; any client's are read, with weights_only")
    api.notify(f"{options.model or 'traffic'} is served at {server.url}, {protocol.manner}; stop it with Ctrl-C")
    with contextlib.suppress(KeyboardInterrupt):
        server.serve()
    api.notify("ended")
