"""The path to records on a tiny town, in this process: build, generate, evaluate."""

from pathlib import Path

from tests.benchmark.cli.in_process import Done, run_here

SMALL = ("--frames", "keyframes", "--size", "96x54")
SEARCH = ("--preset", "near", "--candidates", "64", "--rounds", "3", "--vehicles", "6")
PLANNERS = ("constant-velocity", "idm")
SPLITS = ("val", "adv")


def done(run: Done) -> Done:
    assert run.code == 0, run.err
    return run


def small_town(root: Path) -> Path:
    """Two scenes with small images."""
    done(run_here("data", "build", "--root", root, "--town-scenes", "2", *SMALL, "--workers", "1"))
    return root


def judged_town(town: Path, out: Path) -> None:
    """Generate adversarial scenes of a town and evaluate planners on each split."""
    done(run_here("generate", "--data", town, "--split", "adv", "--out", out, *SMALL, *SEARCH, "--workers", "1"))
    models = [part for name in PLANNERS for part in ("--model", name)]
    for split in SPLITS:
        done(run_here("eval", *models, "--data", town, "--split", split, "--out", out, "--workers", "1"))
