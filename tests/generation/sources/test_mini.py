import json
from collections.abc import Iterable
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

ONE = TownSettings(val_scenes=1, width=64, height=40, frames="keyframes")
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
    # Poses between samples are there, and the check says in one sentence what is not.
    assert len(open_data(root).scene(open_data(root).scene_names()[0]).timestamps_us) == FRAMES
    (fault,) = check_tables(root)
    assert fault.severity == "warning" and "every other image between samples" in fault.sentence
    samples = times(root.glob("samples/CAM*/*.jpg"))
    build_town_data_set(root, whole, workers=1)
    assert files_of(root) == at_once and open_data(root).fingerprint() == identity
    assert samples == times(samples)
    # Whoever asks for samples alone is content with more.
    build_town_data_set(root, first, workers=1)
    assert files_of(root) == at_once


def test_an_image_that_is_lost_is_drawn_again_while_others_wait(tmp_path: Path) -> None:
    settings = replace(ONE, frames="all", width=32, height=18, pictures="keyframes")
    build_town_data_set(tmp_path, settings, workers=1)
    before = files_of(tmp_path)
    lost = sorted(tmp_path.glob("samples/CAM_FRONT/*.jpg"))[3]
    lost.unlink()
    (tmp_path / ".challenger" / "town.json").unlink()
    build_town_data_set(tmp_path, settings, workers=1)
    assert files_of(tmp_path) == before
