"""Names of planners and data sets mean the same in every command."""

import json
from pathlib import Path

import pytest

from benchmark import api
from benchmark.errors import InputError
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from leaderboard.extensions.films.cli import resolve_planner_names
from tests.hand_made import scene_on_straight_road


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


def test_records_of_other_data_are_named(tmp_path: Path) -> None:
    record(tmp_path, "idm", data="demo")
    with pytest.raises(InputError, match=r"no run records at .*; found records of demo \(adv: idm\)"):
        resolve_planner_names(["idm"], [tmp_path / "mini" / "adv"], tmp_path)
    with pytest.raises(InputError, match="did you mean idm"):
        resolve_planner_names(["idn"], [tmp_path / "demo" / "adv"], tmp_path)


def test_what_the_demo_made_has_a_name(tmp_path: Path) -> None:
    scene = scene_on_straight_road(seconds=3.0)
    plan = DataSetPlan(root=tmp_path / "data" / "demo" / "val", split="val")
    with pytest.raises(InputError, match="run: challenger-bench demo --out"):
        api.open_data("demo", out=tmp_path)
    finish_data_set(plan, [write_scene(plan, scene, name=scene.name, source_scene=scene.name, report={})])
    data = api.open_data("demo", out=tmp_path)
    assert (data.name, data.scene_names("val")) == ("demo", (scene.name,))
