"""Running a command in this process, which is quick: what it printed and its exit code."""

import contextlib
import io
from dataclasses import dataclass
from pathlib import Path

import typer

from benchmark.cli.app import app
from benchmark.errors import InputError


@dataclass(frozen=True)
class Done:
    """What a command left."""

    code: int
    out: str
    err: str


def run_here(*arguments: str | Path) -> Done:
    """Run ``challenger-bench`` with arguments; a refusal is exit code 2 and its sentence."""
    with contextlib.redirect_stdout(io.StringIO()) as out, contextlib.redirect_stderr(io.StringIO()) as err:
        try:
            code = typer.main.get_command(app).main(
                [*map(str, arguments)], prog_name="challenger-bench", standalone_mode=False
            )
        except InputError as error:
            print(error, file=err)
            code = 2
        except SystemExit as ended:
            code = ended.code
    return Done(code if isinstance(code, int) else 0, out.getvalue(), err.getvalue())
