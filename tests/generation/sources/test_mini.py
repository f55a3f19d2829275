import json
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from benchmark.datasets.roots import open_data
from benchmark.datasets.schema.check import check_tables
from benchmark.errors import InputError
from benchmark.scene import Scene
from generation.sources.mini import TownSettings, build_town_data_set
from generation.sources.town import build_town_scene

ONE = TownSettings(val_scenes=1, width=64, height=40, frames="keyframes", version=2)
FRAMES = 25
"""So long are the scenes of these towns, so that few images are drawn."""


@cache
def beginning() -> Scene:
    """Of the first scene of the town."""
    return build_town_scene("val", 0).first_frames(FRAMES)


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("generation.sources.mini.build_town_scene", lambda *_, **__: beginning())


def times(paths: Iterable[Path]) -> dict[Path, int]:
    """When each file was written."""
    return {path: path.stat().st_mtime_ns for path in paths if path.is_file()}


def test_finished_work_is_left_alone_and_not_taken_for_other_settings(tmp_path: Path) -> None:
    build_town_data_set(tmp_path, ONE, workers=1)
    before = times(tmp_path.rglob("*"))
    build_town_data_set(tmp_path, ONE, workers=1)
    assert times(tmp_path.rglob("*")) == before
    for width in (64, 80):
        build_town_data_set(tmp_path, replace(ONE, width=width), workers=1)
        data = open_data(tmp_path)
        assert [data.scene(name).cameras[0].width for name in data.scene_names()] == [width]


def test_a_town_of_before_gets_the_shared_tables_of_now(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    now, drawn = ONE.folder_name("town"), ONE.drawn_name("town")
    with monkeypatch.context() as before:
        before.setattr("generation.sources.mini.SHARED_TABLES_VERSION", 1)
        # What is measured depends on the scenes and not on what they share.
        assert ONE.folder_name("town") != now and ONE.drawn_name("town") == drawn
        build_town_data_set(tmp_path, ONE, workers=1)
        categories = tmp_path / "v1.0-mini" / "category.json"
        categories.write_text("[]")
        images = times(tmp_path.rglob("*.jpg"))
        build_town_data_set(tmp_path, ONE, workers=1)
        assert categories.read_text() == "[]"
    build_town_data_set(tmp_path, ONE, workers=1)
    assert len(json.loads(categories.read_text())) == 32
    assert images and times(tmp_path.rglob("*.jpg")) == images


@pytest.mark.parametrize("settings", [replace(ONE, val_scenes=10**9), replace(ONE, train_scenes=10**400)])
def test_more_scenes_than_have_names_are_refused_before_they_are_listed(settings: TownSettings, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"(val|train) scenes .* between 0 and \d+, got"):
        build_town_data_set(tmp_path / "town", settings, workers=1)
    assert not (tmp_path / "town").exists()


def files_of(root: Path) -> dict[str, bytes]:
    """Everything that belongs to the data set, without what the writer remembers."""
    paths = (path for path in root.rglob("*") if path.is_file() and ".challenger" not in path.parts)
    return {str(path.relative_to(root)): path.read_bytes() for path in paths}


def test_samples_are_drawn_first_and_the_rest_when_it_is_asked_for(tmp_path: Path) -> None:
    whole = replace(ONE, frames="all", width=32, height=18)
    first = replace(whole, pictures="keyframes")
    assert first.folder_name("town") == whole.folder_name("town") and first.drawn_name("a") == whole.drawn_name("a")
    build_town_data_set(tmp_path / "at-once", whole, workers=1)
    at_once, root = files_of(tmp_path / "at-once"), tmp_path / "later"
    build_town_data_set(root, first, workers=1)
    before, identity = files_of(root), open_data(root).fingerprint()
    sweeps = {name for name in at_once if name.startswith("sweeps/CAM")}
    assert len(sweeps) == 6 * (FRAMES - 5)
    assert before == {name: content for name, content in at_once.items() if name not in sweeps}
    # Poses between samples are there, and images that are drawn when they are looked at are no fault.
    assert len(open_data(root).scene(open_data(root).scene_names()[0]).timestamps_us) == FRAMES
    assert not check_tables(root)
    samples = times(root.glob("samples/CAM*/*.jpg"))
    build_town_data_set(root, whole, workers=1)
    assert files_of(root) == at_once and open_data(root).fingerprint() == identity
    assert samples == times(samples)
    # Whoever asks for samples alone is content with more.
    build_town_data_set(root, first, workers=1)
    assert files_of(root) == at_once


def look(root: Path, scene: str) -> float:
    """What a planner sees of the first sample."""
    return float(next(open_data(root).observations(scene)).views["CAM_FRONT"].load().mean())


def test_images_are_drawn_when_they_are_looked_at_and_nothing_else_depends_on_it(tmp_path: Path) -> None:
    whole = replace(ONE, frames="all", width=32, height=18)
    asked = replace(whole, pictures="asked")
    build_town_data_set(tmp_path / "whole", whole, workers=1)
    for name in ("town", "again"):
        build_town_data_set(tmp_path / name, asked, workers=1)
    root, first = tmp_path / "town", "scene-8000"
    identity = open_data(root).fingerprint()
    whole_files = files_of(tmp_path / "whole")

    def drawn() -> set[str]:
        return {path for path in files_of(root) if "/CAM_" in path}

    assert not drawn() and not list(check_tables(root))
    list(open_data(root).observations(first))
    assert not drawn()
    seen = look(root, first)
    assert len(drawn()) == 6 * 5 and seen == look(tmp_path / "whole", first)
    lost = next(root.glob("samples/CAM_FRONT/*.jpg"))
    lost.unlink()
    videos = open_data(root).videos(first, sweeps=True)
    assert all(view.path.is_file() for of_camera in videos.values() for view in of_camera)
    assert len(drawn()) == 6 * FRAMES and lost.is_file()
    assert open_data(root).fingerprint() == identity == open_data(tmp_path / "again").fingerprint()
    assert identity == open_data(tmp_path / "whole").fingerprint()
    # Whoever builds it now keeps what is there, and the rest comes out as when all is drawn at once.
    build_town_data_set(root, asked, workers=1)
    assert len(drawn()) == 6 * FRAMES
    build_town_data_set(root, whole, workers=1)
    assert files_of(root) == whole_files


def test_two_commands_that_look_at_once_draw_one_scene_once(tmp_path: Path) -> None:
    asked = replace(ONE, frames="all", width=32, height=18, pictures="asked")
    build_town_data_set(tmp_path, asked, workers=1)
    with ThreadPoolExecutor(2) as both:
        seen = list(both.map(look, [tmp_path] * 2, ["scene-8000"] * 2))
    assert seen[0] == seen[1] and not list(tmp_path.rglob("*.part"))


def test_a_root_that_forgot_what_it_was_made_of_says_so(tmp_path: Path) -> None:
    build_town_data_set(tmp_path, replace(ONE, pictures="asked"), workers=1)
    (tmp_path / ".challenger" / "town.json").write_text("[]")
    with pytest.raises(InputError, match="cannot be drawn; build it again"):
        look(tmp_path, "scene-8000")


def test_an_image_that_is_lost_is_drawn_again_while_others_wait(tmp_path: Path) -> None:
    settings = replace(ONE, frames="all", width=32, height=18, pictures="keyframes")
    build_town_data_set(tmp_path, settings, workers=1)
    before = files_of(tmp_path)
    lost = sorted(tmp_path.glob("samples/CAM_FRONT/*.jpg"))[3]
    lost.unlink()
    (tmp_path / ".challenger" / "town.json").unlink()
    build_town_data_set(tmp_path, settings, workers=1)
    assert files_of(tmp_path) == before
