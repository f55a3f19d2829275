"""What commands print with ``--json``, as the paths of its members."""

import json
import shutil
from pathlib import Path

import benchmark
from generation.sources.mini import TownSettings
from tests.benchmark.cli.in_process import run_here
from tests.promise.surface import members


def small_town(root: Path) -> Path:
    """One scene of the embedded town, without images."""
    return benchmark.build_town(root, TownSettings(val_scenes=1, images=False), workers=1)


def said(town: Path, out: Path) -> list[str]:
    """Lines ``command | path`` of commands that end quickly, run on a small town; ``out`` is taken away first."""
    shutil.rmtree(out, ignore_errors=True)
    on = "--data", town, "--split", "val", "--out", out
    commands: dict[str, tuple[str | Path, ...]] = {
        "data info": ("data", "info", town),
        "data check": ("data", "check", town),
        "data stats": ("data", "stats", town, "--no-judge"),
        "eval": ("eval", *on, "--model", "constant-velocity", "--workers", "1"),
        "rescore": ("rescore", "--data", town, "--out", out, "--workers", "1"),
        "drive": ("drive", *on, "--model", "constant-velocity", "--workers", "1"),
        "models": ("models",),
        "weights list": ("weights", "list"),
        "doctor": ("doctor",),
    }
    lines: set[str] = set()
    for name, arguments in commands.items():
        done = run_here(*arguments, "--json")
        assert done.out, f"{name}: {done.err}"
        lines |= {f"challenger-bench {name} | {path}" for path in members(json.loads(done.out))}
    return sorted(lines)
