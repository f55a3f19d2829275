"""A split from images to record: what scores say of known videos, and that nothing but the data decides them."""

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.extensions.quality import measure, musiq
from benchmark.extensions.quality.definition import QualityDefinition, find_mask_source, list_required_weights
from benchmark.extensions.quality.measure import QualitySettings, describe_plan, measure_quality, measure_shard
from benchmark.extensions.quality.musiq import Musiq
from benchmark.extensions.quality.scoring import score_scene
from benchmark.records.quality import (
    QualityRecord,
    SceneQualityRows,
    SubjectRow,
    find_quality,
    load_quality,
    summarise_quality,
)
from benchmark.records.run_schema import SceneFacts
from benchmark.runs.units import Shard
from benchmark.weights.catalogue import FOLDERS, MUSIQ
from leaderboard.extensions.quality.tables import quality_tables
from tests.benchmark.cli import test_bad_input as any_command
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.quality.small_networks import SMALL_MUSIQ, save_musiq
from tests.benchmark.extensions.quality.synthetic_videos import (
    Picture,
    as_seeded,
    standing_scene,
    texture,
    write_root,
)
from tests.generation.nuscenes_writer.written_roots import short_scene, with_adversary
from tests.generation.nuscenes_writer.written_roots import write_root as write_split
from tests.hand_made import without_frames

BOXES = QualityDefinition(masks="boxes", min_mask_px=60, crop_px=64, batch=4)
TWO = ("scene-9901", "scene-9902")
PUBLISHED_SCALES = musiq.LONGER_SIDES_PX


@pytest.fixture(scope="module", autouse=True)
def small_scales() -> Iterator[None]:
    """MUSIQ looks at pictures smaller than the published ones, which takes a fifth of the time."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(musiq, "LONGER_SIDES_PX", (32, 64))
        yield


def settings(
    networks: Path, definition: QualityDefinition = BOXES, *, workers: int = 1, **others: object
) -> QualitySettings:
    return replace(QualitySettings(definition, networks, "cpu", workers=workers), **others)  # type: ignore[arg-type]


def run(root: Path, out: Path, used: QualitySettings, split: str = "val") -> QualityRecord:
    data = NuScenesData.open(root, name="painted")
    return measure_quality(data, split, out, used)


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two scenes with standing cars; in the second one of them is away for a while."""
    away = without_frames(standing_scene(TWO[1], seconds=2.0), 0, slice(1, 3))
    folder = write_root(tmp_path_factory.mktemp("painted"), [standing_scene(TWO[0], seconds=1.5), away])
    (folder / "splits.json").write_text(json.dumps({"val": list(TWO)}))
    return folder


@pytest.fixture(scope="module")
def short(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene of two frames."""
    return write_root(tmp_path_factory.mktemp("short"), [standing_scene(seconds=1.0)])


@pytest.fixture(scope="module")
def record(root: Path, networks: Path, tmp_path_factory: pytest.TempPathFactory) -> QualityRecord:
    return run(root, tmp_path_factory.mktemp("out"), settings(networks))


def rows_of(record: QualityRecord, scene: str) -> list[SubjectRow]:
    return [row for row in record.subjects if row.scene == scene]


def test_identical_frames_are_fully_consistent(record: QualityRecord) -> None:
    assert len(rows_of(record, TWO[0])) == 3
    for row in record.subjects:
        assert row.consistency.total == pytest.approx(row.consistency.count, abs=1e-5)
        assert row.consistency.count == row.appearances - 1 and row.imaging.count == row.appearances
    assert record.facts.summary.groups["all"].consistency.value == pytest.approx(1.0, abs=1e-5)
    assert set(record.facts.summary.groups) == {"all"}


def test_subjects_leave_and_return(record: QualityRecord) -> None:
    away, *others = sorted(rows_of(record, TWO[1]), key=lambda row: row.appearances)
    assert (away.appearances, away.returns) == (2, 1) and away.last_us - away.first_us == pytest.approx(1.5e6)
    assert [(row.appearances, row.returns) for row in others] == [(4, 0), (4, 0)]


def test_a_swapped_subject_scores_lower_and_the_others_as_before(
    root: Path, record: QualityRecord, networks: Path, tmp_path: Path
) -> None:
    scene = standing_scene(TWO[0], seconds=1.5)
    swapped_one = scene.agents.ids[0]

    def paint(instance: str, keyframe: int) -> Picture:
        return texture("another car") if instance == swapped_one and keyframe >= 1 else as_seeded(instance, keyframe)

    found = run(write_root(tmp_path / "root", [scene], paint), tmp_path / "out", settings(networks))
    before = {row.instance: row.consistency for row in rows_of(record, TWO[0])}
    for row in found.subjects:
        if row.instance.endswith(swapped_one):
            assert row.consistency.total < before[row.instance].total - 1e-3
        else:
            assert row.consistency.total == pytest.approx(before[row.instance].total, abs=1e-5)


def test_the_record_says_what_was_measured(record: QualityRecord) -> None:
    facts = record.facts
    assert facts.definition == BOXES.as_json() and facts.device == "cpu"
    assert set(facts.weights) == {"dino-vitb16", "musiq-spaq"} and facts.weights["dino-vitb16"].content
    assert facts.environment["transformers"] and facts.summary.frames == 3 + 4
    assert {video.formats.get("png") for video in record.videos} == {3, 4}
    assert {(video.width, video.height) for video in record.videos} == {(320, 180)}
    assert load_quality(record.directory) == record and find_quality(record.directory.parents[2]) == [record]
    assert record.facts.summary.scenes[TWO[1]].consistency == pytest.approx(1.0, abs=1e-5)


def test_a_killed_command_goes_on_and_gives_the_same_bytes(
    root: Path, record: QualityRecord, networks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole, scored = score_scene, []

    def dies(*arguments: object) -> SceneQualityRows:
        scored.append(arguments[1])
        if len(scored) == 2:
            raise KeyboardInterrupt
        return whole(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(measure, "score_scene", dies)
    with pytest.raises(KeyboardInterrupt):
        run(root, tmp_path, settings(networks))
    assert not find_quality(tmp_path)
    run(root, tmp_path, settings(networks))
    assert scored == [TWO[0], TWO[1], TWO[1]]
    monkeypatch.setattr(measure, "load_networks", None)
    run(root, tmp_path, settings(networks))
    assert bytes_below(tmp_path) == bytes_below(record.directory.parents[2])


def test_damaged_kept_rows_are_made_again(root: Path, record: QualityRecord, networks: Path, tmp_path: Path) -> None:
    out = shutil.copytree(record.directory.parents[2], tmp_path / "out")
    scenes = out / record.directory.relative_to(record.directory.parents[2]) / "scenes"
    for name, damage in ((TWO[0], '{"key": 1'), (TWO[1], '{"key": "old", "rows": {}}'), ("left", "{}")):
        (scenes / f"{name}.json").write_text(damage)
    run(root, out, settings(networks))
    assert bytes_below(out) == bytes_below(record.directory.parents[2])


def test_damaged_records_are_refused(root: Path, networks: Path, tmp_path: Path) -> None:
    found = run(root, tmp_path, settings(networks, limit=1))
    assert found.directory.name.startswith("boxes-") and not found.covers_split
    rows = found.directory / "subjects.jsonl"
    whole = rows.read_bytes()
    rows.write_bytes(whole[:-20])
    with pytest.raises(InputError, match=r"is not the file that quality\.json was written with; run challenger-bench"):
        load_quality(found.directory)
    rows.unlink()
    with pytest.raises(InputError, match="damaged"):
        load_quality(found.directory)
    rows.write_bytes(whole)
    facts = found.directory / "quality.json"
    stored = json.loads(facts.read_text())
    for changes, says in (
        ({"definition": {}}, r"damaged \(QualityFacts definition: .*lacks 'masks'"),
        ({"files": {}}, r"is not the file that quality\.json was written with"),
        ({"summary": None}, r"damaged \(QualityFacts summary: "),
    ):
        facts.write_text(json.dumps(stored | changes))
        with pytest.raises(InputError, match=says):
            load_quality(found.directory)
    facts.write_text('{"schema": 99}')
    with pytest.raises(InputError, match="schema 99"):
        find_quality(tmp_path)


def test_small_subjects_are_no_appearances(root: Path, record: QualityRecord, networks: Path, tmp_path: Path) -> None:
    largest = max(row.mean_area_px for row in record.subjects)
    some = run(root, tmp_path, settings(networks, replace(BOXES, min_mask_px=round(largest))))
    none = run(root, tmp_path, settings(networks, replace(BOXES, min_mask_px=10**6)))
    assert 0 < len(some.subjects) < len(record.subjects) and not none.subjects
    summary = none.facts.summary
    assert summary.groups["all"].consistency.value is None and summary.groups["all"].imaging.value is None
    assert summary.frames_imaging.value is not None and summary.scenes[TWO[0]].imaging is None


def test_the_adversary_has_numbers_of_its_own(record: QualityRecord) -> None:
    marked = []
    for scene in TWO:
        rows = [row.model_copy(update={"adversary": not index}) for index, row in enumerate(rows_of(record, scene))]
        videos = [video for video in record.videos if video.scene == scene]
        marked.append(SceneQualityRows(scene=scene, subjects=rows, videos=videos))
    summary = summarise_quality(marked, {})
    groups = summary.groups
    assert groups["adversary"].subjects == 2 and groups["others"].subjects == 4
    assert groups["adversary"].imaging.low is not None
    # Two scenes made from one recording are drawn together: no interval.
    together = summarise_quality(marked[::-1], {scene: SceneFacts(source="one") for scene in TWO})
    assert together.groups["adversary"].imaging.low is None
    assert together.groups["all"].imaging.value == pytest.approx(summary.groups["all"].imaging.value, rel=1e-12)
    assert summarise_quality(marked[::-1], {}) == summary


def test_the_adversary_of_a_written_split_is_the_one_that_its_provenance_names(networks: Path, tmp_path: Path) -> None:
    scene = with_adversary(short_scene(seconds=1.5), agent=1)
    write_split(tmp_path / "root", [scene], split="adv")
    found = run(tmp_path / "root", tmp_path / "out", settings(networks, replace(BOXES, min_mask_px=1)), "adv")
    assert {row.instance for row in found.subjects if row.adversary} == set(scene.adversaries)
    assert {row.instance for row in found.subjects if not row.adversary}
    groups = found.facts.summary.groups
    assert groups["adversary"].subjects + groups["others"].subjects == groups["all"].subjects == len(found.subjects)
    assert groups["adversary"].consistency.value is not None
    assert found.facts.scene_facts[scene.name].source == scene.name
    (table,) = quality_tables([found])
    assert [row[:2] for row in table.rows] == [("adv", "all"), ("adv", "adversary"), ("adv", "others")]


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda path: path.unlink(), "is missing"),
        (lambda path: path.write_bytes(path.read_bytes()[:100]), "cannot be read"),
        (lambda path: path.write_text("<html>"), "cannot be read"),
        (lambda path: Image.new("RGB", (100, 100)).save(path), "does not have the proportions of its camera"),
        (lambda path: Image.new("RGB", (160, 90)).save(path), "differs in size from others"),
    ],
)
def test_images_that_cannot_be_scored_are_one_sentence(
    short: Path, networks: Path, tmp_path: Path, damage: Callable[[Path], object], says: str
) -> None:
    root = Path(shutil.copytree(short, tmp_path / "root"))
    views = NuScenesData.open(root).videos("scene-9901", sweeps=False)["CAM_FRONT"]
    damage(views[1].path)
    with pytest.raises(InputError, match=says):
        run(root, tmp_path / "out", settings(networks))


def test_lossless_frames_are_scored_where_asked_for(short: Path, networks: Path, tmp_path: Path) -> None:
    root = Path(shutil.copytree(short, tmp_path / "root"))
    lossless = settings(networks, replace(BOXES, files="lossless"))
    assert run(root, tmp_path / "out", lossless).videos[0].formats == {"png": 2}
    tables = root / "v1.0-tiny" / "sample_data.json"
    tables.write_text(tables.read_text().replace(".png", ".jpg"))
    for path in (root / "samples").rglob("*.png"):
        Image.open(path).save(path.with_suffix(".jpg"), quality=20)
    own = run(root, tmp_path / "own", settings(networks))
    assert own.videos[0].formats == {"jpg": 2}
    again = run(root, tmp_path / "again", lossless)
    assert again.videos[0].imaging.total != own.videos[0].imaging.total
    next((root / "samples").rglob("*.png")).unlink()
    with pytest.raises(InputError, match="there is no lossless frame"):
        run(root, tmp_path / "third", lossless)


def test_all_frames_include_the_sweeps_between_keyframes(networks: Path, tmp_path: Path) -> None:
    root = write_root(tmp_path / "root", [standing_scene(seconds=1.0)], sweeps=True)
    found = run(root, tmp_path / "out", settings(networks, replace(BOXES, frames="all")))
    assert found.videos[0].frames == 7 and {row.appearances for row in found.subjects} == {7}
    assert found.facts.summary.groups["all"].consistency.value == pytest.approx(1.0, abs=1e-5)


@pytest.mark.parametrize("masks", ["sam2-boxes", "grounded-sam2"])
def test_the_other_sources_of_masks_run_from_disk_to_record(
    short: Path, networks: Path, tmp_path: Path, masks: str
) -> None:
    loose = replace(BOXES, min_mask_px=1, min_overlap=0.0, box_threshold=0.0, text_threshold=0.0)
    definition = replace(loose, masks=find_mask_source(masks))
    found = run(short, tmp_path / "out", settings(networks, definition))
    assert found.masks == masks and found.facts.summary.frames == 2
    assert {"sam2.1-hiera-large"} <= set(found.facts.weights)


def test_without_weights_one_sentence_says_what_to_get(root: Path, tmp_path: Path) -> None:
    empty = QualitySettings(BOXES, tmp_path / "none", "cpu")
    with pytest.raises(InputError, match=r"no weights dino-vitb16 found in .*about 343 MB.*weights fetch dino-vitb16"):
        run(root, tmp_path, empty)
    said = describe_plan(NuScenesData.open(root), "val", replace(empty, definition=QualityDefinition()))
    assert "2 scenes of val with 7 images" in said and said.count("no weights") == 4


def test_weights_that_give_no_numbers_are_one_sentence(root: Path, networks: Path, tmp_path: Path) -> None:
    shutil.copytree(networks, tmp_path / "networks")
    broken = Musiq(SMALL_MUSIQ)
    torch.nn.init.constant_(broken.head.bias, float("nan"))
    save_musiq(tmp_path / "networks" / MUSIQ.name, broken)
    with pytest.raises(InputError, match=r"musiq.* give scores that are not finite"):
        run(root, tmp_path / "out", settings(tmp_path / "networks"))


def test_wrong_settings_and_places_are_one_sentence(root: Path, networks: Path, tmp_path: Path) -> None:
    (tmp_path / "out").write_text("a file where a folder should be")
    with pytest.raises(InputError, match="cannot write"):
        run(root, tmp_path / "out", settings(networks))
    with pytest.raises(
        InputError, match="unknown source of masks 'magic'; use one of grounded-sam2, sam2-boxes, boxes"
    ):
        QualityDefinition(masks="magic")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="detect_every of the definition must be at least 1"):
        QualityDefinition(detect_every=0)
    with pytest.raises(InputError, match="has no scene scene-1"):
        run(root, tmp_path, settings(networks, scenes=("scene-1",)))
    with pytest.raises(InputError, match="--workers must be 0 or more"):
        settings(networks, workers=-1)


@pytest.mark.path
def test_the_command_scores_a_split_and_prints_the_table(root: Path, scoring_networks: Path, tmp_path: Path) -> None:
    places = ("--data", root, "--weights-folder", scoring_networks, "--out", tmp_path)
    arguments = ("quality", *places, "--masks", "boxes", "--device", "cpu", "--limit", "1", "--workers", "1")
    done = run_here(*arguments, "--json")
    assert done.code == 0, done.err
    stored = json.loads(done.out)
    assert Path(stored["directory"], "quality.json").is_file()
    assert np.isfinite(stored["summary"]["frames_imaging"]["value"])
    assert "video quality, masks from boxes" in run_here(*arguments).out


def shard(root: Path, networks: Path, out: Path, number: int, of: int, **changes: object) -> int:
    data = NuScenesData.open(root, name="painted")
    return measure_shard(data, "val", out, settings(networks, **changes), Shard(number, of)).done  # type: ignore[arg-type]


def finished(root: Path, networks: Path, out: Path, **changes: object) -> QualityRecord:
    data = NuScenesData.open(root, name="painted")
    return measure_quality(data, "val", out, settings(networks, **changes))  # type: ignore[arg-type]


@pytest.mark.parametrize("of", [3])
def test_shards_become_the_bytes_of_one_command(
    root: Path, record: QualityRecord, networks: Path, tmp_path: Path, of: int
) -> None:
    done: list[int] = []
    written: dict[Path, int] = {}
    for number in range(of, 0, -1):
        done.append(shard(root, networks, tmp_path, number, of))
        now = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("*") if path.is_file()}
        assert written.items() <= now.items()
        written = now
    assert sum(done) == len(TWO)
    made = finished(root, networks, tmp_path)
    assert bytes_below(made.directory) == bytes_below(record.directory)


def test_workers_and_devices_make_no_difference(
    root: Path, networks: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Other processes have the published ones.
    monkeypatch.setattr(musiq, "LONGER_SIDES_PX", PUBLISHED_SCALES)
    with pytest.raises(InputError, match="leaves some of cpu,cpu without work"):
        finished(root, networks, tmp_path, device="cpu,cpu", workers=1)
    one = finished(root, networks, tmp_path / "one")
    for name, device, workers in (("devices", "cpu,cpu", 0), ("workers", "cpu", 2)):
        other = finished(root, networks, tmp_path / name, device=device, workers=workers)
        assert bytes_below(other.directory) == bytes_below(one.directory)


def test_the_command_takes_shards_and_finishes(root: Path, networks: Path, tmp_path: Path) -> None:
    given = ("--data", root, "--out", tmp_path)
    how = ("--split", "val", "--masks", "boxes", "--weights-folder", networks, "--device", "cpu", "--workers", "1")
    done = run_here("quality", *given, *how, "--shard", "2/2", "--json")
    assert done.code == 0 and [each["scored"] for each in json.loads(done.out)] == [1], done.err
    assert run_here("quality", *given, *how, "--shard", "1/2").code == 0
    assert run_here("quality", *given, *how).code == 0


def test_adversarial_scenes_are_never_val(tmp_path: Path) -> None:
    road = write_split(tmp_path / "road", [short_scene()], version=any_command.VERSION, renderer=None).root
    any_command.test_adversarial_scenes_are_never_val(road, tmp_path, ("quality", "--masks", "boxes"), "--split")


def test_the_weights_of_quality_are_complete() -> None:
    assert [weights.name for weights in list_required_weights("boxes")] == ["dino-vitb16", "musiq-spaq"]
    for weights in list_required_weights("grounded-sam2"):
        assert weights in FOLDERS and weights.revision != "main"
