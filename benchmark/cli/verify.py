"""Commands that check numerics and the machine: ``verify`` and ``doctor``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import typer

from benchmark import api
from benchmark.cli import options as shared
from benchmark.cli.output import print_json, print_result
from benchmark.cli.settings import Option, command


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifyOptions:
    """Options of ``verify``."""

    what: Annotated[
        Literal[
            "physics",
            "scoring",
            "denoiser",
            "protocols",
            "pdm",
            "neuroncap",
            "alpasim",
            "ability",
            "infos",
            "results",
            "drivers",
            "severity",
            "realism",
            "fault",
            "ability",
            "hub",
            "import-123d",
            "model",
        ],
        Option("What to compare.", names=""),
    ]
    golden: Annotated[Path | None, Option("Directory of golden numbers, if not the built-in set.")] = None
    model: Annotated[str | None, Option("With model: which one, for example vad-tiny.", "Planner")] = None
    noise: Annotated[bool, Option("With model: run ours twice more, to tell its own rounding from an error.")] = False
    json_output: shared.Json = False


@command(VerifyOptions, panel="Advanced")
def verify_command(options: VerifyOptions) -> None:
    """Compare numerics with golden numbers; exit code 1 if any differ by more than they may."""
    from benchmark.machine.path_checks import require_folder
    from benchmark.verification.checks import format_report

    require_folder(options.golden, "--golden")
    checks = api.verify(options.what, options.golden, options.model, noise=options.noise)
    if options.json_output:
        print_json([check.as_json() for check in checks])
    else:
        typer.echo(format_report(checks))
        if options.what == "model" and not options.noise and not all(check.ok for check in checks):
            typer.echo("--noise shows which of these errors are within our own floating-point noise", err=True)
    raise typer.Exit(0 if all(check.passes for check in checks) else 1)


@dataclass(frozen=True, slots=True, kw_only=True)
class DoctorOptions:
    """Options of ``doctor``."""

    out: shared.Out = api.OUT
    json_output: shared.Json = False


@command(DoctorOptions, panel="Advanced")
def doctor_command(options: DoctorOptions) -> None:
    """Say whether this machine computes correctly and has what is needed."""
    from benchmark.machine.environment import checks

    machine_checks = checks(options.out)
    checks_json = [{"check": check.name, "ok": check.ok, "says": check.sentence} for check in machine_checks]
    lines = [f"{'ok  ' if check.ok else 'FAIL'}  {check.name}: {check.sentence}" for check in machine_checks]
    print_result(checks_json, "\n".join(lines), json_output=options.json_output)
    raise typer.Exit(0 if all(check.ok for check in machine_checks) else 1)
