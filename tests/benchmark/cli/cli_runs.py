"""Running commands as a user does, in this process, which is quick, or in another one: output and exit code."""

import contextlib
import gc
import io
import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer

from benchmark.cli.app import app, main
from benchmark.errors import InputError


@dataclass(frozen=True)
class Run:
    """What a command left."""

    code: int
    out: str
    err: str

    @property
    def json(self) -> Any:
        return json.loads(self.out)


def run_main(*arguments: str | Path, cache: Path | None = None) -> Run:
    """Run ``challenger-bench`` with arguments in this process, from its words to its exit code."""
    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(io.StringIO()) as out,
        contextlib.redirect_stderr(io.StringIO()) as err,
    ):
        patch.setattr(sys, "argv", ["challenger-bench", *map(str, arguments)])
        patch.setattr(gc, "set_threshold", lambda *_: None)
        patch.setenv("COLUMNS", "200")
        if cache is not None:
            patch.setenv("CHALLENGER_BENCH_CACHE", str(cache))
        with pytest.raises(SystemExit) as ended:
            main()
    code = ended.value.code
    return Run(code if isinstance(code, int) else 0, out.getvalue(), err.getvalue())


def challenger_bench(*arguments: str | Path, cache: Path | None = None) -> Run:
    """Run ``challenger-bench`` with arguments in another process."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "COLUMNS": "200"}
    if cache is not None:
        environment["CHALLENGER_BENCH_CACHE"] = str(cache)
    command = [sys.executable, "-m", "benchmark", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=600, check=False)
    return Run(done.returncode, done.stdout, done.stderr)


def refusal(*arguments: str | Path) -> str:
    """The sentence with which a command refuses its arguments; in this process, which is quick."""
    try:
        typer.main.get_command(app).main([*map(str, arguments)], prog_name="challenger-bench", standalone_mode=False)
    except InputError as error:
        return str(error)
    except typer.TyperException as error:
        return str(error.format_message() if hasattr(error, "format_message") else error)
    raise AssertionError(f"{arguments} is not refused")


def bytes_below(folder: Path) -> dict[str, bytes]:
    """Every file below a folder, by relative path, but for notes on how long work took."""
    files = {path.relative_to(folder).as_posix(): path for path in folder.rglob("*") if path.is_file()}
    return {name: path.read_bytes() for name, path in files.items() if not name.startswith("timings/")}
