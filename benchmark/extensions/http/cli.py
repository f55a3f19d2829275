"""``serve``: a planner as a model server for NeuroNCAP, and for whoever speaks its protocol."""

import contextlib
from pathlib import Path
from typing import Annotated

import typer

from benchmark import api
from benchmark.cli.extensions import Groups
from benchmark.cli.options import MemoryLimitOption, SampleLimitOption, SeedOption


def serve_command(
    model: Annotated[str, typer.Option("--model", metavar="<str>", help="Planner name or package.module:Class.")],
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port to listen on; 0 takes a free one.")] = 9000,
    host: Annotated[
        str, typer.Option(help="Address to listen on; anything but 127.0.0.1 opens it to other machines.")
    ] = "127.0.0.1",
    accept_torch_tensors: Annotated[
        bool, typer.Option("--accept-torch-tensors", help="Pictures may be saved tensors, as NeuroNCAP's (pickles).")
    ] = False,
    device: Annotated[
        str | None, typer.Option(help="Where a network runs: cpu, cuda, cuda:1; the first GPU if there is one.")
    ] = None,
    precision: Annotated[str | None, typer.Option(help="Of a network: float32 or bfloat16.")] = None,
    checkpoint: Annotated[Path | None, typer.Option(help="Weights of the model.")] = None,
    sample_limit: SampleLimitOption = None,
    memory_limit: MemoryLimitOption = None,
    seed: SeedOption = 0,
) -> None:
    """Answer a simulator's requests with a planner's plans, over HTTP, until interrupted."""
    from benchmark.cli.preflight_names import require_models, supervision_of
    from benchmark.cli.preflight_over_http import require_server

    require_models([model], checkpoint, data="", device=device, precision=precision)
    supervision = supervision_of([model], sample_limit, memory_limit)
    require_server(host, port)
    server = api.serve_planner(
        model,
        checkpoint,
        host=host,
        port=port,
        accept_torch_tensors=accept_torch_tensors,
        device=device,
        precision=precision,
        seed=seed,
        supervision=supervision,
    )
    if server.is_open:
        api.tell(
            f"warning: {server.host} is open to other machines: whoever reaches port {server.port} can use this "
            "planner, reset it and see what it answers; there is no password and nothing is encrypted"
        )
    if accept_torch_tensors:
        api.tell("warning: saved tensors are pickles; they are read with weights_only, from whoever reaches this port")
    api.tell(f"{model} answers at {server.url}, one scene at a time; Ctrl-C ends it")
    with contextlib.suppress(KeyboardInterrupt):
        server.serve()
    api.tell("ended")


def add_commands(groups: Groups) -> None:
    """``serve``."""
    groups[""].command("serve")(serve_command)
