"""The command reads sheets and records below --out; names of planners and data mean the same in every command."""

import json
from pathlib import Path

import pytest

from benchmark import api
from benchmark.errors import InputError
from benchmark.records.run import RunRecord, write_record
from leaderboard.extensions.films.cli import resolve_planner_names
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.records.hand_made_records import CLEAN, HIT
from tests.benchmark.report import one_scene


def record(runs: Path, planner: str, data: str = "mini", split: str = "adv") -> Path:
    folder = runs / data / split
    (folder / planner).mkdir(parents=True)
    ran = {"data": {"name": data}, "split": split, "planner": {"name": planner}}
    (folder / planner / "run.json").write_text(json.dumps(ran))
    return folder


def test_a_full_model_is_shown_as_the_miniature_that_ran(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("benchmark.api.opening._notified", set())
    folder, *_ = [record(tmp_path, name) for name in ("uniad-mini", "vad-mini", "idm")]
    assert resolve_planner_names(["uniad", "vad", "idm"], [folder], tmp_path) == ["uniad-mini", "vad-mini", "idm"]
    assert resolve_planner_names(["uniad"], [folder], tmp_path) == ["uniad-mini"]
    said = capsys.readouterr().err
    assert said.count("uniad-mini, which ran in its place") == 1 and said.count("\n") == 2
    record(tmp_path, "vad-base")
    assert resolve_planner_names(["vad", "vad-base (seed 1)"], [folder], tmp_path) == ["vad-base", "vad-base (seed 1)"]


def test_records_of_other_data_are_named_and_what_the_demo_made_has_a_name(tmp_path: Path) -> None:
    record(tmp_path, "idm", data="demo")
    with pytest.raises(InputError, match=r"no run records at .*; found records of demo \(adv: idm\)"):
        resolve_planner_names(["idm"], [tmp_path / "mini" / "adv"], tmp_path)
    with pytest.raises(InputError, match="did you mean idm"):
        resolve_planner_names(["idn"], [tmp_path / "demo" / "adv"], tmp_path)
    with pytest.raises(InputError, match="run: challenger-bench demo --out"):
        api.open_data("demo", out=tmp_path)


def stored(run: RunRecord, root: Path) -> None:
    """Write a record where `eval` would."""
    left_out = {"status", "protocols", "seed", "files", "schema_version", "rescored"}
    facts = {name: value for name, value in run.run.model_dump().items() if name not in left_out}
    write_record(root / "d" / "adv" / run.planner, facts, list(run.rows), run.run.protocols, seed=0)


@pytest.mark.path
def test_a_film_from_sheets_and_records(tmp_path: Path) -> None:
    one_scene.written(tmp_path / "sheets")
    stored(one_scene.record("p", [HIT, CLEAN, CLEAN, CLEAN, CLEAN]), tmp_path / "runs")
    command = ("film", "--data", "d", "--out", tmp_path, "--to", tmp_path / "films", "--until", "0.3", "--width", "320")
    made = run_here(*command, "--format", "png", "--model", "p", "--json")
    folder = tmp_path / "films" / "scene-1"
    assert made.code == 0 and json.loads(made.out) == {"films": [str(folder)]}, made.err
    assert sorted(path.name for path in folder.iterdir()) == [f"{number:06d}.png" for number in range(4)]
    missing = run_here(*command, "--scenes", "scene-9")
    assert missing.code == 2 and "challenger-bench sheets" in missing.err and missing.err.count("\n") == 1
