"""Interrupted, repeated, changed and refused writing."""

import contextlib
import json
import multiprocessing
import os
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.datasets.schema.check import check_tables
from benchmark.errors import InputError
from benchmark.scene import Scene
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from tests.generation.nuscenes_writer.written_roots import (
    SolidRenderer,
    contents,
    short_scene,
    with_adversary,
    write_root,
)

NAMES = ("scene-9901", "scene-9902")


def brief_scene(name: str = NAMES[0]) -> Scene:
    return short_scene(name, seconds=1.0)


def plan_of(root: Path, **kwargs: object) -> DataSetPlan:
    return DataSetPlan(**{"root": root, "split": "val", "renderer": SolidRenderer(), **kwargs})  # type: ignore[arg-type]


def write_one(plan: DataSetPlan, name: str) -> str:
    return write_scene(plan, brief_scene(name), name=name, source_scene=name, report={})


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    root = tmp_path_factory.mktemp("undisturbed")
    write_root(root, [brief_scene(name) for name in NAMES])
    return contents(root)


def test_twice_gives_the_same_bytes(tmp_path: Path, undisturbed: dict[str, str]) -> None:
    for _ in range(2):
        write_root(tmp_path, [brief_scene(name) for name in NAMES])
        assert contents(tmp_path) == undisturbed


def test_killed_while_drawing(tmp_path: Path, undisturbed: dict[str, str]) -> None:
    plan = plan_of(tmp_path)
    first = write_one(plan, NAMES[0])
    # What is finished is not drawn again.
    assert write_one(replace(plan, renderer=SolidRenderer(stop_at=0)), NAMES[0]) == first
    with pytest.raises(KeyboardInterrupt):
        write_one(replace(plan, renderer=SolidRenderer(stop_at=7)), NAMES[1])
    (tmp_path / "samples/CAM_FRONT/.half.jpg.4242.part").write_bytes(b"half")
    with pytest.raises(InputError, match="is not written"):
        finish_data_set(plan, [first, "0" * 64])
    finish_data_set(plan, [first, write_one(plan, NAMES[1])])
    assert contents(tmp_path) == undisturbed


def test_killed_between_any_two_writes(
    tmp_path: Path, undisturbed: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rng = np.random.default_rng(0)
    original = Path.replace
    for stop_at in rng.integers(0, 200, size=3).tolist():
        root = tmp_path / str(stop_at)
        count = 0

        def counted(self: Path, target: Path, limit: int = stop_at) -> Path:
            nonlocal count
            count += 1
            if count > limit:
                raise KeyboardInterrupt
            return original(self, target)

        monkeypatch.setattr(Path, "replace", counted)
        with contextlib.suppress(KeyboardInterrupt):
            write_root(root, [brief_scene(name) for name in NAMES])
        monkeypatch.setattr(Path, "replace", original)
        write_root(root, [brief_scene(name) for name in NAMES])
        assert contents(root) == undisturbed


def test_workers_do_not_matter(tmp_path: Path, undisturbed: dict[str, str]) -> None:
    plan = plan_of(tmp_path)
    with multiprocessing.get_context("fork").Pool(2) as pool:
        keys = pool.map(partial(write_one, plan), NAMES[::-1])
    finish_data_set(plan, keys[::-1])
    assert contents(tmp_path) == undisturbed


def test_a_damaged_or_missing_image_is_drawn_again(tmp_path: Path, undisturbed: dict[str, str]) -> None:
    plan = write_root(tmp_path, [brief_scene(name) for name in NAMES])
    images = sorted(tmp_path.glob("samples/CAM_BACK/*.jpg"))
    images[0].unlink()
    images[-1].write_bytes(images[-1].read_bytes()[:-20])
    finish_data_set(plan, [write_one(plan, name) for name in NAMES])
    assert contents(tmp_path) == undisturbed


@pytest.mark.parametrize(
    "damage", [{"files": None}, {"variant": []}, {"key": {}}, {"files": ["../kept.txt"]}, {"files": ["ABSOLUTE"]}]
)
def test_a_damaged_claim_is_made_again_and_removes_nothing_outside(
    tmp_path: Path, undisturbed: dict[str, str], damage: dict[str, object]
) -> None:
    root, outside = tmp_path / "root", tmp_path / "kept.txt"
    outside.write_text("somebody else's")
    plan = write_root(root, [brief_scene(name) for name in NAMES])
    path = plan.claim_path(0, NAMES[0])
    if damage.get("files") == ["ABSOLUTE"]:
        damage = {"files": [str(outside)]}
    path.write_text(json.dumps({**json.loads(path.read_text()), **damage}))
    finish_data_set(plan, [write_one(plan, name) for name in NAMES])
    assert contents(root) == undisturbed
    assert outside.exists()


def test_adding_and_removing_scenes(tmp_path: Path, undisturbed: dict[str, str]) -> None:
    write_root(tmp_path, [brief_scene(NAMES[0])])
    one = contents(tmp_path)
    write_root(tmp_path, [brief_scene(name) for name in NAMES])
    assert contents(tmp_path) == undisturbed
    write_root(tmp_path, [brief_scene(NAMES[0])])
    assert contents(tmp_path) == one


def test_changed_settings_leave_nothing_behind(tmp_path: Path, undisturbed: dict[str, str]) -> None:
    scenes = [brief_scene(name) for name in NAMES]
    write_root(tmp_path, scenes, lossless=True)
    assert check_tables(tmp_path) == []
    assert list(tmp_path.glob("samples/CAM_BACK/*.png"))
    plan = plan_of(tmp_path, jpeg_quality=30)
    with pytest.raises(KeyboardInterrupt):
        write_one(replace(plan, renderer=SolidRenderer(stop_at=9)), NAMES[0])
    write_root(tmp_path, scenes)
    assert contents(tmp_path) == undisturbed


def test_stale_variant_roots_disappear(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, layout="per-variant")

    def write(variant: int) -> str:
        scene = with_adversary(brief_scene(), variant)
        return write_scene(plan, scene, name=scene.name, variant=variant, source_scene=scene.name, report={})

    keys = [write(variant) for variant in range(2)]
    finish_data_set(plan, keys[:1])
    only_one = contents(tmp_path)
    finish_data_set(plan, [write(variant) for variant in range(2)])
    assert (tmp_path / "v1/v1.0-trainval/challenger.json").is_file()
    finish_data_set(plan, keys[:1])
    assert contents(tmp_path) == only_one
    assert not (tmp_path / "v1").exists()


def test_somebody_elses_data_set_is_left_alone(tmp_path: Path) -> None:
    write_root(tmp_path, [brief_scene()])
    shutil.rmtree(tmp_path / ".challenger")
    before = contents(tmp_path)
    with pytest.raises(InputError, match="holds a foreign data set"):
        write_one(plan_of(tmp_path), NAMES[1])
    assert contents(tmp_path) == before


def test_no_scenes_and_scenes_that_would_overwrite_each_other(tmp_path: Path) -> None:
    plan = plan_of(tmp_path, renderer=None)
    with pytest.raises(InputError, match="no scenes to write"):
        finish_data_set(plan, [])
    scene = brief_scene()
    key = write_scene(plan, scene, name="scene-9901", source_scene="scene-9901", report={})
    twin = write_scene(plan, scene, name="scene-9908", source_scene="scene-9908", report={})
    with pytest.raises(InputError, match="share"):
        finish_data_set(plan, [key, twin])


@pytest.mark.parametrize(
    ("array", "place", "value", "match"),
    [
        (lambda scene: scene.ego.position, (3, 1), np.nan, "ego positions"),
        (lambda scene: scene.annotations.position, (0, 1, 2), np.inf, "annotated positions"),
        (lambda scene: scene.annotations.size, (0, 1, 2), 0.0, "not positive"),
        (lambda scene: scene.timestamps_us, 4, 0, "do not increase"),
    ],
)
def test_unsound_scenes(tmp_path: Path, array: Any, place: Any, value: float, match: str) -> None:
    scene = brief_scene()
    array(scene)[place] = value
    with pytest.raises(InputError, match=match):
        write_scene(plan_of(tmp_path), scene, name="scene-9901", source_scene="scene-9901", report={})
    assert not list(tmp_path.iterdir())


def test_numbers_outside_an_objects_presence_do_not_matter(tmp_path: Path) -> None:
    scene = brief_scene()
    scene.annotations.valid[0, 1] = False
    scene.annotations.position[0, 1] = np.nan
    write_root(tmp_path, [scene], renderer=None)
    assert check_tables(tmp_path) == []


@pytest.mark.parametrize("name", ["../scene-9901", "", "scene 9901", "a/b", ".hidden"])
def test_names_that_are_no_file_names(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="cannot be a file name"):
        write_scene(plan_of(tmp_path), brief_scene(), name=name, source_scene="scene-9901", report={})


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a place that cannot be written")
def test_unwritable_target(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot write"):
        write_one(plan_of(tmp_path / "file"), NAMES[0])
    if os.geteuid() != 0:
        (tmp_path / "locked").mkdir(mode=0o500)
        with pytest.raises(InputError, match="cannot write"):
            write_one(plan_of(tmp_path / "locked"), NAMES[0])
