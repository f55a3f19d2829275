"""Commands that check numerics and the machine: ``verify`` and ``doctor``."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from benchmark import api
from benchmark.cli.options import JsonOption, OutOption, Verifiable, print_json
from benchmark.errors import InputError

if TYPE_CHECKING:
    from benchmark.verification.checks import Check


def verify_command(
    what: Annotated[Verifiable, typer.Argument(help="What to compare.")],
    golden: Annotated[Path | None, typer.Option(help="Directory of golden numbers, if not the built-in set.")] = None,
    model: Annotated[str | None, typer.Option(help="With model: which one, for example vad-tiny.")] = None,
    json_output: JsonOption = False,
) -> None:
    """Compare numerics with golden numbers; exit code 1 if any differ by more than they may."""
    from benchmark.verification.checks import report

    if what is Verifiable.MODEL:
        checks = _verify_model(model, golden)
    elif model is not None:
        raise InputError("--model belongs to verify model; leave it out")
    else:
        checks = _numerics(what)(golden)
    if json_output:
        print_json([check.as_json() for check in checks])
    else:
        typer.echo(report(checks))
    raise typer.Exit(0 if all(check.ok for check in checks) else 1)


def doctor_command(out: OutOption = api.OUT, json_output: JsonOption = False) -> None:
    """Whether this machine computes correctly and has what is needed."""
    from benchmark.machine.environment import checks

    found = checks(out)
    if json_output:
        print_json([{"check": check.name, "ok": check.ok, "says": check.sentence} for check in found])
    else:
        for check in found:
            typer.echo(f"{'ok  ' if check.ok else 'FAIL'}  {check.name}: {check.sentence}")
    raise typer.Exit(0 if all(check.ok for check in found) else 1)


def _numerics(what: Verifiable) -> "Callable[[Path | None], list[Check]]":
    """What compares physics, scoring, denoiser or protocols with golden numbers, or with the built-in ones."""
    if what is Verifiable.PHYSICS:
        from generation.verification.physics import verify_physics

        return verify_physics
    if what is Verifiable.SCORING:
        from generation.verification.scoring import verify_scoring

        return verify_scoring
    if what is Verifiable.DENOISER:
        from generation.verification.denoiser import verify_denoiser

        return verify_denoiser
    from benchmark.protocols.verification import verify_protocols

    return verify_protocols


def _verify_model(model: str | None, golden: Path | None) -> "list[Check]":
    from adapters.verification.models import verified_models, verify_model
    from generation.verification.magicdrive import verify_magicdrive

    known = (*verified_models(), "magicdrive")
    if model not in known:
        missing = "verify model needs --model" if model is None else f"no model {model!r} can be verified"
        raise InputError(f"{missing}; known are {', '.join(known)}")
    if golden is None:
        raise InputError("verify model needs --golden, a directory of numbers of the official code; none is built in")
    return verify_magicdrive(golden) if model == "magicdrive" else verify_model(model, golden)
