"""The whole path through the command line on a tiny town: build, check, generate, evaluate, transfer, tables."""

import json
from pathlib import Path

import pytest

from tests.cli_runs import Run, bytes_below, challenger_bench

SMALL = ("--frames", "keyframes", "--size", "96x54")
SEARCH = ("--candidates", "32", "--rounds", "2", "--vehicles", "4")
PLANNERS = ("constant-velocity", "ego-status", "idm", "log-replay")


def done(run: Run) -> Run:
    assert run.code == 0, run.err
    return run


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("town") / "small"
    done(challenger_bench("data", "build", "--root", root, "--town-scenes", "2", *SMALL, "--workers", "2"))
    return root


@pytest.fixture(scope="module")
def out(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out")
    for split, search in (("adv", SEARCH), ("val-r", ())):
        common = ("--data", town, "--split", split, "--out", folder, *SMALL, *search, "--workers", "2")
        done(challenger_bench("generate", *common))
    models = [part for name in PLANNERS for part in ("--model", name)]
    for split in ("val", "val-r", "adv"):
        done(challenger_bench("eval", *models, "--data", town, "--split", split, "--out", folder))
    return folder


def rate(out: Path, split: str, planner: str) -> float:
    files = list((out / "runs").rglob("summary.json"))
    path = next(path for path in files if path.parent.parent.name == split and path.parent.name.startswith(planner))
    return float(json.loads(path.read_text())["protocols"]["exact"]["columns"]["collision"]["avg"]["value"])


def test_adversaries_make_planners_collide_and_the_recorded_ego_never(out: Path) -> None:
    assert rate(out, "adv", "log-replay") == rate(out, "val", "log-replay") == 0.0
    assert rate(out, "adv", "constant-velocity") > rate(out, "val", "constant-velocity")


def test_originals_rendered_again_score_like_the_originals(out: Path) -> None:
    for planner in PLANNERS:
        assert rate(out, "val-r", planner) == rate(out, "val", planner)


def test_what_is_written_has_no_faults(town: Path, out: Path) -> None:
    for root in (town, out / "data" / "small" / "adv", out / "data" / "small" / "val-r"):
        run = done(challenger_bench("data", "check", root, "--json"))
        assert run.json == {"errors": 0, "faults": []}


def test_transfer_and_leaderboard(out: Path) -> None:
    assert "surrogate" in done(challenger_bench("transfer", "--out", out)).out
    done(challenger_bench("leaderboard", "--out", out))
    assert done(challenger_bench("leaderboard", "--out", out, "--check")).code == 0
    text = (out / "leaderboard" / "README.md").read_text()
    assert all(name in text for name in (*PLANNERS, "Published numbers, not ours", "UniAD"))
    (out / "leaderboard" / "README.md").write_text(text.replace("idm", "mdi"))
    stale = challenger_bench("leaderboard", "--out", out, "--check")
    assert stale.code == 1
    assert "README.md" in stale.out


def test_one_worker_writes_the_same_bytes(town: Path, out: Path, tmp_path: Path) -> None:
    common = ("--data", town, "--split", "adv", "--out", tmp_path, "--workers", "1")
    done(challenger_bench("generate", *common, *SMALL, *SEARCH))
    done(challenger_bench("eval", "--model", "idm", *common))
    assert bytes_below(tmp_path / "data") == {
        name: data for name, data in bytes_below(out / "data").items() if name.startswith("small/adv/")
    }
    mine = bytes_below(tmp_path / "runs")
    theirs = bytes_below(out / "runs")
    assert mine
    assert all(mine[name] == theirs[name] for name in mine)


def test_dry_run_writes_nothing(town: Path, tmp_path: Path) -> None:
    run = done(challenger_bench("generate", "--data", town, "--split", "adv", "--out", tmp_path, "--dry-run", "--json"))
    assert run.json["tried"] > 0
    assert bytes_below(tmp_path) == {}
