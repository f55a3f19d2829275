"""Use an installed wheel as a newcomer does: run this with the Python of an environment that holds nothing else.

Standard library alone, and no test framework, since the environment must be what the wheel asks for. Works in an empty
folder of its own, away from the checkout: ``python check_installed.py [--demo]``.
"""

import json
import os
import re
import subprocess
import sys
import sysconfig
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

COMMAND = Path(sys.executable).parent / "challenger-bench"
OF_EXTRAS = (
    "ray", "casadi", "diffusers", "transformers", "sentencepiece", "av", "uvicorn", "starlette", "httpx2", "foxglove",
    "grpc",
    "numpyro", "jax",
)  # fmt: skip
GOLDEN = (
    "physics", "scoring", "denoiser", "protocols", "pdm", "neuroncap", "drivers", "severity", "realism", "fault",
    "ability",
)  # fmt: skip
TINY = ("--town-scenes", "1", "--size", "96x54", "--frames", "keyframes")


def run(*arguments: str, expect: int = 0) -> str:
    """What a command prints on stdout; ends the check where the exit code is another."""
    begun = time.monotonic()
    environment = {**os.environ, "CHALLENGER_BENCH_CACHE": "cache", "COLUMNS": "160"}
    environment.pop("PYTHONPATH", None)
    done = subprocess.run([COMMAND, *arguments], capture_output=True, text=True, env=environment)
    print(f"{time.monotonic() - begun:6.1f} s  challenger-bench {' '.join(arguments)}", flush=True)
    require(done.returncode == expect, f"exit code {done.returncode}, not {expect}:\n{done.stdout}\n{done.stderr}")
    return done.stdout if expect == 0 else done.stderr


def require(right: bool, otherwise: str) -> None:
    """End the check with a sentence unless something holds."""
    if not right:
        sys.exit(f"the installed wheel does not do: {otherwise}")


def answer(*arguments: str) -> Any:
    """What a command answers with ``--json``."""
    return json.loads(run(*arguments, "--json"))


def check_place() -> None:
    """The packages come from the environment, and no extra is in it."""
    installed = Path(sysconfig.get_paths()["purelib"])
    for package in ("benchmark", "generation", "adapters", "leaderboard"):
        spec = find_spec(package)
        place = Path(spec.origin) if spec is not None and spec.origin is not None else Path()
        require(installed in place.parents, f"{package} is not from {installed} but from {place}")
    extras = [name for name in OF_EXTRAS if find_spec(name) is not None]
    require(not extras, f"the environment holds packages of extras: {', '.join(extras)}")


def check_site(folder: Path, *planners: str) -> None:
    """The site's first page finds all that it names, and its data name the planners."""
    page = (folder / "index.html").read_text()
    named = re.findall(r'(?:src|href)="([^"#:]+)"', page)
    require(bool(named), f"{folder}/index.html names no file")
    missing = [name for name in named if not (folder / name).is_file()]
    require(not missing, f"{folder}/index.html names {', '.join(missing)}, which is not there")
    data = (folder / "data" / "index.js").read_text()
    unknown = [name for name in planners if f'"{name}"' not in data]
    require(not unknown, f"{folder} does not show {', '.join(unknown)}")


def check_commands() -> None:
    """Doctor, numerics, a tiny town, plans, a drive, tables and the site."""
    require(all(finding["ok"] for finding in answer("doctor")), "doctor finds a fault")
    for what in GOLDEN:
        run("verify", what)
    run("data", "build", "--root", "town", *TINY)
    planners = ("constant-velocity", "uniad-mini", "vad-mini", "sparsedrive-mini", "diffusiondrive-mini", "ego-status")
    models = [word for name in planners for word in ("--model", name)]
    summaries = answer("eval", "--data", "town", "--split", "val", *models)
    require([each["failed"] for each in summaries] == [0] * len(planners), f"planners fail: {summaries}")
    drive = ("drive", "--data", "town", "--split", "val", "--model", "constant-velocity", "--sensor", "none")
    run(*drive)
    run("sheets", "--data", "town", "--split", "val")
    run("leaderboard")
    check_site(Path("challenger-out/leaderboard/site"), *planners)
    frozen = run("generate", "--from", "mini-adv-3", "--data", "mini@1", "--limit", "1", "--dry-run")
    require("mini-adv-3" in frozen, f"the packaged split is not known: {frozen}")


def check_refusals() -> None:
    """A command whose extra is not there says which one."""
    for arguments, extra in (
        (("serve", "--model", "constant-velocity"), "serve"),
        (("serve", "--protocol", "alpasim", "--model", "constant-velocity"), "alpasim"),
        (("generate", "--data", "town", "--executor", "ray"), "ray"),
    ):
        said = run(*arguments, expect=2)
        require(f"challenger-bench[{extra}]" in said, f"{arguments[0]} does not name its extra: {said}")


def main() -> None:
    """Check everything, in a folder that goes away."""
    check_place()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)
        if "--demo" in sys.argv:
            said = run("demo", "--out", "shown")
            require("site: " in said, f"the demo does not say where its site is: {said}")
            check_site(Path("shown/leaderboard/site"), "constant-velocity", "uniad-mini")
        check_commands()
        check_refusals()
        os.chdir("/")
    print("the installed wheel does what it should")


if __name__ == "__main__":
    main()
