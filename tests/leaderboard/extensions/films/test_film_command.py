"""The command reads sheets and records below --out and nothing else."""

import json
from pathlib import Path

from benchmark.records.run import RunRecord, write_record
from tests.benchmark.cli.cli_runs import challenger_bench
from tests.benchmark.records.hand_made_records import CLEAN, HIT
from tests.benchmark.report.one_scene import record, written

SHORT = ("--until", "0.3", "--width", "320", "--format", "png")


def stored(run: RunRecord, root: Path) -> None:
    """Write a record where `eval` would."""
    left_out = {"status", "protocols", "seed", "files", "schema_version", "rescored"}
    facts = {name: value for name, value in run.run.model_dump().items() if name not in left_out}
    directory = root / "d" / "adv" / run.planner
    write_record(directory, facts, list(run.rows), run.run.protocols, seed=0)


def test_a_film_from_sheets_and_records(tmp_path: Path) -> None:
    written(tmp_path / "sheets")
    stored(record("p", [HIT, CLEAN, CLEAN, CLEAN, CLEAN]), tmp_path / "runs")
    common = ("--data", "d", "--out", tmp_path, "--to", tmp_path / "films", *SHORT)
    made = challenger_bench("film", *common, "--model", "p", "--json")
    assert made.code == 0, made.err
    folder = tmp_path / "films" / "scene-1"
    assert made.json == {"films": [str(folder)]}
    assert sorted(path.name for path in folder.iterdir()) == [f"{number:06d}.png" for number in range(4)]
    missing = challenger_bench("film", *common, "--scenes", "scene-9")
    assert missing.code == 2 and "challenger-bench sheets" in missing.err and missing.err.count("\n") == 1
    assert json.dumps(str(folder)) in made.out
