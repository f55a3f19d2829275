"""Commands that check numerics and the machine: ``verify`` and ``doctor``."""

from pathlib import Path
from typing import Annotated

import typer

from benchmark import api
from benchmark.cli.options import JsonOption, OutOption, Verifiable, print_json


def verify_command(
    what: Annotated[Verifiable, typer.Argument(help="What to compare.")],
    golden: Annotated[Path | None, typer.Option(help="Directory of golden numbers, if not the built-in set.")] = None,
    model: Annotated[str | None, typer.Option(help="With model: which one, for example vad-tiny.")] = None,
    noise: Annotated[
        bool, typer.Option("--noise", help="With model: run ours twice more, to tell its own rounding from an error.")
    ] = False,
    json_output: JsonOption = False,
) -> None:
    """Compare numerics with golden numbers; exit code 1 if any differ by more than they may."""
    from benchmark.cli.preflight_places import require_folder
    from benchmark.verification.checks import report

    require_folder(golden, "--golden")
    checks = api.verify(what.value, golden, model, noise=noise)
    if json_output:
        print_json([check.as_json() for check in checks])
    else:
        typer.echo(report(checks))
        if what is Verifiable.MODEL and not noise and not all(check.ok for check in checks):
            typer.echo("--noise says which of these are as far off as our own rounding moves them", err=True)
    raise typer.Exit(0 if all(check.passes for check in checks) else 1)


def doctor_command(out: OutOption = api.OUT, json_output: JsonOption = False) -> None:
    """Say whether this machine computes correctly and has what is needed."""
    from benchmark.machine.environment import checks

    found = checks(out)
    if json_output:
        print_json([{"check": check.name, "ok": check.ok, "says": check.sentence} for check in found])
    else:
        for check in found:
            typer.echo(f"{'ok  ' if check.ok else 'FAIL'}  {check.name}: {check.sentence}")
    raise typer.Exit(0 if all(check.ok for check in found) else 1)
