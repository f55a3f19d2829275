import json
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.datasets.roots import open_data
from benchmark.errors import InputError
from generation.sources.mini import TownSettings, build_town

ONE = TownSettings(val_scenes=1, width=64, height=40, frames="keyframes")


def test_other_settings_are_not_taken_for_finished_work(tmp_path: Path) -> None:
    build_town(tmp_path, ONE, workers=1)
    first = open_data(tmp_path)
    assert [first.scene(name).cameras[0].width for name in first.scene_names()] == [64]
    build_town(tmp_path, replace(ONE, width=80), workers=1)
    second = open_data(tmp_path)
    assert [second.scene(name).cameras[0].width for name in second.scene_names()] == [80]


def test_finished_work_is_left_alone(tmp_path: Path) -> None:
    build_town(tmp_path, ONE, workers=1)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
    build_town(tmp_path, ONE, workers=1)
    assert times == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}


def test_a_town_of_before_gets_the_shared_tables_of_now(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now, drawn = ONE.folder_name("town"), ONE.drawn_name("town")
    monkeypatch.setattr("generation.sources.mini.SHARED_TABLES_VERSION", 1)
    # What is measured depends on the scenes and not on what they share.
    assert ONE.folder_name("town") != now and ONE.drawn_name("town") == drawn
    build_town(tmp_path, ONE, workers=1)
    categories = tmp_path / "v1.0-mini" / "category.json"
    categories.write_text("[]")
    images = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.jpg")}
    build_town(tmp_path, ONE, workers=1)
    assert categories.read_text() == "[]"
    monkeypatch.undo()
    build_town(tmp_path, ONE, workers=1)
    assert len(json.loads(categories.read_text())) == 32
    assert images == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*.jpg")}


@pytest.mark.parametrize("settings", [replace(ONE, val_scenes=10**9), replace(ONE, train_scenes=10**400)])
def test_more_scenes_than_have_names_are_refused_before_they_are_listed(settings: TownSettings, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"between 0 and \d+ (val|train) scenes"):
        build_town(tmp_path / "town", settings, workers=1)
    assert not (tmp_path / "town").exists()
