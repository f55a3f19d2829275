"""A split from data set to sheets: what is written, what is kept, and that nothing but the data decides it."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.roots import VariantRoots
from benchmark.errors import InputError
from benchmark.machine.storage import lock_folder, write_json, write_json_lines
from benchmark.records.run_schema import DataFacts
from benchmark.records.scene_pages import ScenePages, StoredScenePage, find_scene_pages, read_scene_page, scene_folder
from benchmark.records.statistics import BuildRuntime
from benchmark.scene_pages import page_building as making
from benchmark.scene_pages import writing as split_sheets
from benchmark.scene_pages.writing import SheetSettings, describe_plan, write_sheets
from generation.nuscenes_writer.plan import STATE_FOLDER
from generation.pipeline.estimate import read_runtime_table
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.datasets.nuscenes_tables import TinyRoot
from tests.generation.nuscenes_writer.written_roots import SIZE, short_scene, with_adversary
from tests.generation.nuscenes_writer.written_roots import write_root as write_split

TWO = ("scene-9901", "scene-9902")
HERE = SheetSettings(workers=1)
OLD_ATTEMPT = {
    **{"scene": "scene-0001", "agent": "a", "seed": 0, "kept": True, "discard": None, "launch_frame": 6},
    **{"challenge": 0.5, "closest_approach": {"gap_m": 0.4, "time_s": 1.5, "side": "left"}},
    **{"least_time_to_collision_s": None, "plans": []},
}
"""A row of the first version that wrote any."""
LABELS = {
    "manoeuvre": "cut-in-left",
    "occurred": [{"kind": "cut-in-left", "first_s": 0.5, "duration_s": 1.0, "least_gap_m": 0.4}],
    "closest_approach": {"gap_m": 0.4, "frame": 18, "time_s": 1.5, "side": "left"},
    **{"time_to_collision": None, "encroachment": None, "place": "bend"},
}


def written(root: Path, out: Path, settings: SheetSettings = HERE, split: str = "adv") -> ScenePages:
    write_sheets(NuScenesData.open(root, name="small"), split, out, settings)
    return find_scene_pages(out)


def sheet_of(sheets: ScenePages, scene: str = TWO[0], split: str = "adv") -> StoredScenePage:
    return sheets.scenes["small", split, scene]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A generated split of two scenes, one of them with an adversary, images at 12 Hz."""
    folder = tmp_path_factory.mktemp("small")
    scenes = [with_adversary(short_scene(TWO[0], seconds=1.5)), short_scene(TWO[1], seconds=1.5)]
    write_split(folder, scenes, split="adv", frames="all")
    attempts = [
        {**OLD_ATTEMPT, "labels": LABELS, "written": TWO[0]},
        {**OLD_ATTEMPT, "agent": "b", "kept": False, "discard": "hits-another", "written": None},
        {**OLD_ATTEMPT, "agent": "c", "dropped": "beyond-the-number-kept", "extra": 1},
    ]
    write_json_lines(folder / "attempts.jsonl", attempts)
    return folder


@pytest.fixture
def copied(root: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(root, tmp_path / "copied"))


@pytest.fixture(scope="module")
def sheets(root: Path, tmp_path_factory: pytest.TempPathFactory) -> ScenePages:
    return written(root, tmp_path_factory.mktemp("sheets"))


@pytest.fixture
def copied_sheets(sheets: ScenePages, tmp_path: Path) -> Path:
    """A folder with sheets that a test may change."""
    stored = next(iter(sheets.scenes.values()))
    return Path(shutil.copytree(stored.directory.parents[3], tmp_path / "sheets"))


def test_a_sheet_says_what_the_data_set_says(root: Path, sheets: ScenePages) -> None:
    data, sheet = NuScenesData.open(root, name="small"), sheet_of(sheets).sheet
    scene = data.scene(TWO[0])
    assert sheet.timestamps_us == tuple(scene.timestamps_us)
    assert sheet.keyframes == tuple(scene.keyframes)
    assert sheet.sample_tokens == tuple(observation.sample_token for observation in data.observations(TWO[0]))
    assert (sheet.description, sheet.source) == (scene.description, TWO[0])
    made = data.provenance() or {}
    assert sheet.drawn_by == made["renderer"]["name"] is not None
    assert sheet.data.fingerprint == data.fingerprint()
    assert [agent.id for agent in sheet.agents if agent.adversary] == list(scene.adversaries)
    assert sheet.agents[-1].adversary
    assert sheet.road.drivable


def test_a_sheet_with_a_frame_too_many_is_named(copied_sheets: Path) -> None:
    folder = scene_folder(copied_sheets, "small", "adv", TWO[0])
    content = json.loads((folder / "sheet.json").read_text())
    times = content["timestamps_us"]
    for changed, said in (
        ([*times, times[-1] + 1], r"has \d+ frames but another number"),
        (times[::-1], "not in order"),
    ):
        (folder / "sheet.json").write_text(json.dumps({**content, "timestamps_us": changed}))
        with pytest.raises(InputError, match=rf"{TWO[0]}/sheet\.json .*{said}"):
            read_scene_page(folder)


def test_a_split_says_what_the_search_tried(sheets: ScenePages) -> None:
    split = sheets.splits["small", "adv"]
    assert split.scenes == TWO and split.statistics.counts.scenes == 2 and split.runtime is None
    assert "root" not in split.model_dump()["statistics"]
    assert [(each.agent, each.scene, each.discarded, each.manoeuvre) for each in split.attempts] == [
        ("a", TWO[0], None, "cut-in-left"),
        ("b", None, "hits-another", None),
        ("c", None, "beyond-the-number-kept", None),
    ]


def test_pictures_show_each_camera_in_its_cell(root: Path, sheets: ScenePages) -> None:
    stored = sheet_of(sheets)
    videos = NuScenesData.open(root).videos(TWO[0], sweeps=False)
    assert stored.sheet.pictures == stored.sheet.keyframes
    picture = cv2.imread(str(stored.picture_path(6)))[..., ::-1]
    assert picture.shape == (2 * SIZE[1], 3 * SIZE[0], 3)
    for cell in stored.sheet.cameras:
        inside = picture[cell.top : cell.top + cell.height, cell.left : cell.left + cell.width]
        expected = videos[cell.name][1].load()
        assert np.abs(np.median(inside, axis=(0, 1)) - np.median(expected, axis=(0, 1))).max() < 12
    assert set(stored.sheet.adversary_edges) <= {str(frame) for frame in stored.sheet.pictures}
    assert any(stored.sheet.adversary_edges.values())
    assert not sheet_of(sheets, TWO[1]).sheet.adversary_edges


def test_all_frames_none_and_smaller_ones_give_the_same_bytes_for_any_workers_and_place(
    root: Path, copied: Path, tmp_path: Path
) -> None:
    settings = replace(HERE, pictures="all", cell_width_px=16)
    every = sheet_of(written(root, tmp_path / "one", settings)).sheet
    write_sheets(NuScenesData.open(copied, name="small"), "adv", tmp_path / "many", replace(settings, workers=2))
    assert bytes_below(tmp_path / "one") == bytes_below(tmp_path / "many")
    assert every.pictures == tuple(range(len(every.timestamps_us)))
    assert {(cell.width, cell.height) for cell in every.cameras} == {(16, 9)}
    none = sheet_of(written(root, tmp_path / "one", replace(HERE, pictures="none"))).sheet
    assert none.pictures == () and none.cameras == () and not list((tmp_path / "one").rglob("*.webp"))
    assert none.agents == every.agents


def test_finished_work_is_kept_and_damage_is_mended(
    root: Path, copied_sheets: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = bytes_below(copied_sheets)
    data = NuScenesData.open(root, name="small")
    assert describe_plan(data, "adv", copied_sheets, HERE).endswith("; 2 already exist")
    with monkeypatch.context() as patched:
        patched.setattr(making, "draw_mosaic", None)
        patched.setattr(split_sheets, "statistics", None)
        assert not any(each.made for each in write_sheets(data, "adv", copied_sheets, HERE).scenes)
    folder = scene_folder(copied_sheets, "small", "adv", TWO[0])
    for damage in (
        lambda: (folder / "cameras/000000.webp").write_bytes(b"x"),
        lambda: (folder / "cameras/000006.webp").unlink(),
        lambda: (folder / "sheet.json").write_text('{"schema": 1'),
        lambda: (folder / "key.json").write_text("[]"),
    ):
        damage()
        assert [each.made for each in write_sheets(data, "adv", copied_sheets, HERE).scenes] == [True, False]
        assert bytes_below(copied_sheets) == before


def test_a_traced_search_stays_unless_it_is_damaged(root: Path, copied_sheets: Path) -> None:
    stored = sheet_of(find_scene_pages(copied_sheets))
    trace = {"schema": 1, "scene": TWO[0], "agent": "a", "search": {}, "frames": []}
    rounds = stored.directory / "rounds.json"
    rounds.write_text(json.dumps({**trace, "origin_m": stored.sheet.origin_m}))
    assert sheet_of(written(root, copied_sheets, replace(HERE, cell_width_px=16))).rounds is not None
    rounds.write_text(json.dumps({**trace, "origin_m": [0.0, 0.0]}))
    assert sheet_of(written(root, copied_sheets)).rounds is None
    rounds.write_text('{"schema"')
    assert sheet_of(written(root, copied_sheets)).rounds is None


def test_an_interrupted_sheet_is_no_sheet_and_the_other_part_stays(
    root: Path, sheets: ScenePages, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    written(root, tmp_path, replace(HERE, cell_width_px=20))
    pictures = iter([b"picture"])

    def stopping(*arguments: object) -> bytes:
        for picture in pictures:
            return picture
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(making, "draw_mosaic", stopping)
        with pytest.raises(KeyboardInterrupt):
            written(root, tmp_path)
    # What is left can be read; the scene that was being written is missing.
    assert [scene for _, _, scene in find_scene_pages(tmp_path).scenes] == [TWO[1]]
    for part in (TWO[:1], TWO[1:]):
        both = written(root, tmp_path, replace(HERE, scenes=part))
        assert [scene for _, _, scene in both.scenes] == list(TWO) and both.splits["small", "adv"].scenes == TWO
    assert bytes_below(tmp_path) == bytes_below(sheet_of(sheets).directory.parents[3])


def test_sheets_of_another_version_of_the_data_go(copied: Path, tmp_path: Path) -> None:
    written(copied, tmp_path / "out")
    rounds = scene_folder(tmp_path / "out", "small", "adv", TWO[1]) / "rounds.json"
    rounds.write_text("{}")
    (tmp_path / "out/small/adv/scenes/scene-gone").mkdir()
    splits = copied / "v1.0-trainval" / "splits.json"
    splits.write_text(json.dumps({"adv": [TWO[0]]}))
    left = written(copied, tmp_path / "out", replace(HERE, limit=1))
    assert [scene for _, _, scene in left.scenes] == [TWO[0]]
    assert [path.name for path in (tmp_path / "out/small/adv/scenes").iterdir()] == [TWO[0]]


def test_scenes_without_images_and_with_a_part_of_them(copied: Path, tmp_path: Path) -> None:
    every, out = replace(HERE, pictures="all"), tmp_path / "out"
    before = sheet_of(written(copied, out, every)).sheet
    sweep = sorted((copied / "sweeps" / "CAM_FRONT").iterdir())[0]
    cv2.imwrite(str(sweep), np.random.default_rng(0).integers(0, 255, (18, 32, 3), np.uint8))
    # An image that was rendered anew gives another sheet.
    after = sheet_of(written(copied, out, every)).sheet
    assert sum(before.files[name] != after.files[name] for name in after.files) == 1
    for sweep in (copied / "sweeps").rglob("*.jpg"):
        sweep.unlink()
    sheet = sheet_of(written(copied, out, every)).sheet
    assert sheet.pictures == sheet.keyframes
    images = sorted((copied / "samples").rglob("*.jpg"))
    images[0].unlink()
    with pytest.raises(InputError, match=r"1 of 18 images of scene scene-9901 are; .*--pictures none"):
        written(copied, out)
    for image in images[1:]:
        image.unlink()
    assert sheet_of(written(copied, out)).sheet.pictures == ()


def test_a_data_set_with_one_camera_and_no_provenance(tmp_path: Path) -> None:
    made = TinyRoot.of(tmp_path / "root", [short_scene(seconds=1.5)], sweeps=False)
    made.tables["scene"][0]["description"] = "</script><img src=x onerror=alert(1)> \N{FIRE}"
    made.write()
    made.write_images((160, 90))
    (tmp_path / "root" / "splits.json").write_text(json.dumps({"../up": [TWO[0]]}))
    found = written(tmp_path / "root", tmp_path / "out", split="../up")
    sheet = found.scenes["small", "../up", TWO[0]].sheet
    assert [cell.name for cell in sheet.cameras] == ["CAM_FRONT"]
    assert sheet.description == "</script><img src=x onerror=alert(1)> \N{FIRE}"
    assert found.splits["small", "../up"].attempts == () and sheet.labels == ()
    assert {path.relative_to(tmp_path / "out").parts[1] for path in (tmp_path / "out").rglob("*.json")} == {"%2E.%2Fup"}


def test_variants_are_scenes_of_one_split(tmp_path: Path) -> None:
    for variant in ("v0", "v1"):
        write_split(tmp_path / "roots" / variant, [short_scene(seconds=1.0)], frames="keyframes")
    write_sheets(VariantRoots.open(tmp_path / "roots", name="small"), "val", tmp_path / "out", HERE)
    found = find_scene_pages(tmp_path / "out")
    assert [scene for _, _, scene in found.scenes] == ["v0/scene-9901", "v1/scene-9901"]
    assert sheet_of(found, "v1/scene-9901", "val").sheet.source == "scene-9901"
    assert found.splits["small", "val"].statistics.counts.scenes == 2


def test_labels_are_shown_as_they_are_but_for_numbers_that_are_none(copied: Path, tmp_path: Path) -> None:
    path = copied / "v1.0-trainval/challenger.json"
    made = json.loads(path.read_text())
    labels = {"manoeuvre": "<b>", "gap": float("inf")}
    made["scenes"][TWO[0]]["report"] = {"adversaries": [{"labels": labels}, {"labels": 3}]}
    path.write_text(json.dumps(made))
    job = making.PageJob(tmp_path, DataFacts(name="small", version="v", fingerprint="f"), "adv", "none", 320)
    making.write_page(job, NuScenesData.open(copied, name="small"), TWO[0])
    sheet = read_scene_page(job.folder(TWO[0])).sheet
    assert sheet.labels == ({"manoeuvre": "<b>", "gap": None},) and sheet.manoeuvre == "<b>"


def test_what_cannot_be_read_or_written_is_one_sentence(copied: Path, tmp_path: Path) -> None:
    out, attempts, poses = tmp_path / "out", copied / "attempts.jsonl", copied / "v1.0-trainval/ego_pose.json"
    with lock_folder(out / "small" / "adv"), pytest.raises(InputError, match="another command is writing"):
        written(copied, out)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        written(copied, tmp_path / "file")
    for text, said in (
        ('{"agent": "a", "scene": 7}', r"attempts\.jsonl line 1 lacks a proper scene"),
        ("[]", "object"),
    ):
        attempts.write_text(f"{text}\n")
        with pytest.raises(InputError, match=said):
            written(copied, out)
    rows = json.loads(poses.read_text())
    rows[3]["translation"][0] = float("nan")
    poses.write_text(json.dumps(rows))
    with pytest.raises(InputError, match="finite"):
        written(copied, out)
    wrong: tuple[dict[str, Any], ...] = ({"cell_width_px": 0}, {"cell_width_px": 100_000}, {"workers": -1})
    for settings in wrong:
        with pytest.raises(InputError):
            SheetSettings(**settings)


def test_seconds_are_those_of_attempts_and_of_written_scenes(copied: Path, tmp_path: Path) -> None:
    state, timings = copied / STATE_FOLDER, tmp_path / "timings"
    timed = {path.stem for path in (state / "fragments").glob("*.json")}
    for name in ("old", *timed):
        write_json(timings / "rendering" / f"{name}.timing.json", {"seconds": {"rendering": 2.0}})
    write_json(timings / "attempts" / "a.timing.json", {"seconds": {"physics": 1.5}})
    runtime = read_runtime_table(state, timings)
    assert runtime is not None
    assert (runtime.attempts, runtime.scenes) == (1, len(timed)) == (1, 2)
    data = NuScenesData.open(copied, name="small")
    write_sheets(data, "adv", tmp_path / "out", replace(HERE, limit=1, pictures="none"), runtime=runtime)
    assert find_scene_pages(tmp_path / "out").splits["small", "adv"].runtime == BuildRuntime(**runtime.model_dump())
    assert read_runtime_table(tmp_path / "nowhere", tmp_path / "nowhere") is None


def test_the_command(root: Path, tmp_path: Path) -> None:
    wanted = ("sheets", "--data", root, "--split", "adv", "--out", tmp_path, "--workers", "1")
    first = run_here(*wanted, "--json", "--limit", "1")
    said = json.loads(first.out)
    assert (first.code, said["made"], said["scenes"], said["pictures"]) == (0, 1, [TWO[0]], 3)
    unknown = run_here(*wanted, "--scenes", "scene-1")
    assert unknown.code == 2 and unknown.err.startswith("split 'adv' has no scene scene-1")
