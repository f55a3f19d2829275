from dataclasses import replace
from pathlib import Path

from benchmark.datasets.roots import open_data
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
