"""What is submitted, through the command line."""

import json
import shutil
from pathlib import Path

from tests.benchmark.cli.in_process import run_here
from tests.benchmark.cli.small_path import PLANNERS, SPLITS, done, judged_town, small_town


def test_what_eval_writes_can_be_submitted_and_a_changed_number_cannot(tmp_path: Path) -> None:
    town, out, records = small_town(tmp_path / "small"), tmp_path / "out", len(SPLITS) * len(PLANNERS)
    judged_town(town, out)
    where = ("--data", town, "--out", out)
    run = done(run_here("leaderboard", "submit-check", out / "runs", *where))
    assert run.out.count("fit: ") == records
    shutil.copytree(out / "runs", tmp_path / "runs")
    summary = next((tmp_path / "runs").rglob("summary.json"))
    summary.write_text(summary.read_text().replace("0", "1", 1))
    refused = run_here("leaderboard", "submit-check", tmp_path / "runs", *where, "--json")
    assert refused.code == 1 and len(json.loads(refused.out)["sound"]) == records - 1
    absent = run_here("leaderboard", "submit-check", tmp_path / "absent", *where)
    assert absent.code == 2 and "there is no folder" in absent.err
