"""From a search to a file and back: the same split from the same recordings, and nothing from others."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.scene_assessments import collect_assessments
from benchmark.errors import InputError
from benchmark.geometry import box_corners
from benchmark.machine.storage import content_key
from benchmark.machine.workers import LocalProcesses
from benchmark.machine.workspace import is_finished
from benchmark.protocols import NATIVE_PROTOCOLS
from benchmark.records.scene_assessment import DEFINITION, SceneAssessment
from benchmark.runs.units import ResultStore
from generation.labels.labelling import read_agent_boxes
from generation.pipeline.report import estimate_build
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import build_split
from generation.search.adversary import ALGORITHM_VERSION
from generation.splits.building import build_frozen
from generation.splits.packaged import NamedSplit
from tests.generation.labels.recorded_roads import CHEAP, QUICK, contents, recorded, write_source
from tests.generation.splits.frozen_files import BUILT, frozen_file, recordings

ONE_EACH: dict[str, Any] = {"hyper": QUICK.hyper, "per_scene": 1}
"""One adversary of each of the two scenes."""


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return recordings(tmp_path_factory.mktemp("recorded"))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("frozen")


@pytest.fixture(scope="module")
def split(source: DataSet, folder: Path) -> NamedSplit:
    return frozen_file(source, folder, **ONE_EACH)


@pytest.fixture(scope="module")
def built(source: DataSet, split: NamedSplit, folder: Path) -> Path:
    report = build_frozen(source, split, replace(BUILT, out=folder / "built"))
    assert (report.other_tables, report.other_images) == ((), ()) and report.images is not None
    assert "tables: equal" in report.summary() and "images: equal" in report.summary()
    assert report.verified_by == ALGORITHM_VERSION and "verified by version" not in report.summary()
    assert {name: report.masked_steps[name]["adversary"] for name in NATIVE_PROTOCOLS} == dict.fromkeys(
        NATIVE_PROTOCOLS, 0
    )
    return folder / "built"


def test_a_split_of_an_earlier_search_is_built_as_it_is_and_says_who_verified_it(
    source: DataSet, split: NamedSplit, tmp_path: Path
) -> None:
    search = split.frozen.search.model_copy(update={"algorithm": "3"})
    older = replace(split, frozen=split.frozen.model_copy(update={"search": search}))
    report = build_frozen(source, older, replace(BUILT, out=tmp_path / "older", renderer=None))
    assert len(report.written) == len(split.frozen.scenes) and report.as_json()["verified_by"] == "3"
    assert (
        f"verified by version 3 of the search, as frozen; today's search verifies by version {ALGORITHM_VERSION}"
        in (report.summary())
    )


def test_the_tracks_are_those_of_the_file_and_within_a_millimetre_of_those_that_were_found(
    split: NamedSplit, built: Path, folder: Path
) -> None:
    data, searched = open_data(built), open_data(folder / "searched")
    assert data.scene_names("adv") == searched.scene_names("adv") == tuple(sorted(s.name for s in split.frozen.scenes))
    for frozen in split.frozen.scenes:
        scene, before = data.scene(frozen.name), searched.scene(frozen.name)
        agent, own = before.agents.ids.index(before.adversaries[0]), scene.agents.ids.index(scene.adversaries[0])
        launch = frozen.adversaries[0].launch_frame
        at = [int(frame) for frame in scene.keyframes if frame >= launch]
        track = np.array(frozen.adversaries[0].track)
        shown = np.column_stack([scene.agents.position[own, at, :2], scene.agents.yaw[own, at]])
        np.testing.assert_allclose(shown, track[np.array(at) - launch], atol=1e-8)
        corners, were = (box_corners(read_agent_boxes(each, who)[at]) for each, who in ((scene, own), (before, agent)))
        assert np.hypot(*np.moveaxis(corners - were, -1, 0)).max() <= 1e-3


def test_the_file_is_small_holds_nothing_of_the_recordings_and_is_frozen_again_to_the_same(
    source: DataSet, split: NamedSplit, folder: Path
) -> None:
    text = (folder / "road-adv-1.json").read_text()
    assert len(text) / len(split.frozen.scenes) < 8_000
    for frozen in split.frozen.scenes:
        fields = {"name", "source", "adversaries", "tables", "images", "numbered", "shift_us"}
        assert frozen.model_dump().keys() == fields
    assert split.frozen.recordings.name and split.frozen.search.seed == 0
    assert split.frozen.chosen.scenes == 2
    before = contents(folder / "searched")
    assert frozen_file(source, folder, **ONE_EACH) == split
    assert contents(folder / "searched") == before


def test_neither_workers_nor_a_second_time_change_a_byte(
    source: DataSet, split: NamedSplit, built: Path, tmp_path: Path
) -> None:
    for workers in (2, 1):
        build_frozen(source, split, replace(BUILT, out=tmp_path / "out", executor=LocalProcesses(workers)))
        assert contents(tmp_path / "out") == contents(built)


def test_provenance_names_the_split_and_describes_the_scenes_anew(built: Path, split: NamedSplit, folder: Path) -> None:
    made, searched = open_data(built).provenance(), open_data(folder / "searched").provenance()
    assert made is not None and searched is not None
    assert made["frozen"] == {"name": "road-adv-1", "content": split.frozen.content_id}
    assert "frozen" not in searched
    for name, entry in made["scenes"].items():
        found, was = entry["report"], searched["scenes"][name]["report"]
        assert (found["agent"], found["launch_frame"]) == (was["agent"], was["launch_frame"])
        assert found["labels"]["manoeuvre"] == was["labels"]["manoeuvre"]
        # A millimetre may take a frame or two of about eighty over the border of what is a threat.
        assert found["challenge"] == pytest.approx(was["challenge"], abs=2e-2)


def test_tokens_do_not_depend_on_the_last_bit_of_a_recording(
    source: DataSet, split: NamedSplit, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # As another processor's sine would have it.
    read = type(source).scene

    def other(self: DataSet, name: str) -> object:
        scene = read(self, name)
        scene.agents.yaw[:] = np.nextafter(scene.agents.yaw, 10.0)
        return scene

    monkeypatch.setattr(type(source), "scene", other)
    report = build_frozen(source, split, replace(BUILT, out=tmp_path / "out"))
    assert report.other_tables == ()
    for table in sorted(built.glob("v1.0-mini/*.json")):
        assert (tmp_path / "out" / "v1.0-mini" / table.name).read_bytes() == table.read_bytes(), table.name


def test_it_says_when_the_images_are_others(source: DataSet, split: NamedSplit, tmp_path: Path) -> None:
    other = split.frozen.model_copy(
        update={"scenes": (split.frozen.scenes[0].model_copy(update={"images": "1" * 64}), *split.frozen.scenes[1:])}
    )
    report = build_frozen(source, NamedSplit("other", other), replace(BUILT, out=tmp_path / "out"))
    assert report.other_images == (split.frozen.scenes[0].name,) and report.other_tables == ()
    said = f"images: differ in 1 of {len(other.scenes)} scenes, because the renderer rounds differently here"
    assert said in report.summary()


def test_any_layout_renderer_and_frames(source: DataSet, split: NamedSplit, tmp_path: Path) -> None:
    settings = replace(BUILT, out=tmp_path / "out", layout="per-variant", renderer=None, frames="all")
    report = build_frozen(source, split, settings)
    assert report.other_tables == () and "images: not compared" in report.summary()
    data = open_data(tmp_path / "out")
    assert len(data.scene_names("adv")) == len(split.frozen.scenes)
    assert all(name.split("/")[1] in ("scene-9901", "scene-9902") for name in data.scene_names("adv"))


def test_some_scenes_only(source: DataSet, split: NamedSplit, tmp_path: Path) -> None:
    one = build_frozen(source, split, replace(BUILT, out=tmp_path / "a", renderer=None, scenes=("scene-9902",)))
    assert one.written and all(name.startswith("scene-9902") for name in one.written)
    name = split.frozen.scenes[0].name
    named = build_frozen(source, split, replace(BUILT, out=tmp_path / "b", renderer=None, scenes=(name,)))
    assert named.written == (name,)
    first = build_frozen(source, split, replace(BUILT, out=tmp_path / "c", renderer=None, limit=1))
    assert {name[:10] for name in first.written} == {"scene-9901"}
    with pytest.raises(InputError, match="no scene made from scene-1"):
        build_frozen(source, split, replace(BUILT, out=tmp_path / "d", scenes=("scene-1",)))
    dry = build_frozen(source, split, replace(BUILT, out=tmp_path / "e", dry_run=True))
    assert "would build" in dry.summary() and not (tmp_path / "e").exists()


def test_two_adversaries(tmp_path: Path) -> None:
    busy = write_source(tmp_path / "recorded", recorded("scene-9901"))
    split = frozen_file(busy, tmp_path, adversaries=2, renderer=None, **ONE_EACH)
    assert [len(frozen.adversaries) for frozen in split.frozen.scenes] == [2]
    report = build_frozen(busy, split, replace(BUILT, out=tmp_path / "out", renderer=None))
    assert report.other_tables == ()
    data = open_data(tmp_path / "out")
    for name in data.scene_names("adv"):
        assert len(data.scene(name).adversaries) == 2
    made = data.provenance()
    assert made is not None
    assert all(len(entry["report"]["adversaries"]) == 2 for entry in made["scenes"].values())


def refused(source: DataSet, split: NamedSplit, settings: BuildSettings) -> str:
    with pytest.raises(InputError) as error:
        build_frozen(source, split, settings)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_other_recordings_are_refused_before_anything_is_written(split: NamedSplit, tmp_path: Path) -> None:
    settings = replace(BUILT, out=tmp_path / "out", renderer=None)
    moved = recordings(tmp_path / "moved", moved_m=0.02)
    assert "0.020 m from its position in the frozen split" in refused(moved, split, settings)
    named = replace(split, path=tmp_path / "named.json")
    assert f"frozen split {named.path}: scene-9901 has 103 frames" in refused(
        recordings(tmp_path / "longer", seconds=9.0), named, settings
    )
    assert not (tmp_path / "out").exists()
    hardly = recordings(tmp_path / "hardly", moved_m=0.005)
    report = build_frozen(hardly, split, settings)
    assert report.other_tables and "differ in" in report.summary()


def test_unknown_vehicles_and_scenes_are_refused(source: DataSet, split: NamedSplit, tmp_path: Path) -> None:
    settings, first = replace(BUILT, out=tmp_path / "out", renderer=None), split.frozen.scenes[0]
    stranger = first.adversaries[0].model_copy(update={"instance": "f" * 32})
    changed = first.model_copy(update={"adversaries": (stranger,)})
    assert "has no object ffff" in refused(source, of(split, changed), settings)
    elsewhere = first.model_copy(update={"source": "scene-0001", "name": "scene-0001-x"})
    assert "lacks 1 of the 1 recorded scenes" in refused(source, of(split, elsewhere), settings)
    assert not (tmp_path / "out").exists()


def of(split: NamedSplit, *scenes: object) -> NamedSplit:
    return NamedSplit("changed", split.frozen.model_copy(update={"scenes": scenes}))


def test_a_search_and_a_frozen_split_never_share_a_root(
    source: DataSet, split: NamedSplit, built: Path, folder: Path, tmp_path: Path
) -> None:
    for root, build in (
        (built, lambda: build_split(source, "adv", replace(CHEAP, out=built))),
        (built, lambda: estimate_build(source, "adv", replace(CHEAP, out=built))),
        (folder / "searched", lambda: build_frozen(source, split, replace(BUILT, out=folder / "searched"))),
        (built, lambda: build_frozen(source, of(split, split.frozen.scenes[0]), replace(BUILT, out=built))),
    ):
        before = contents(root)
        with pytest.raises(InputError, match="another --out, nothing was changed"):
            build()
        assert contents(root) == before and is_finished(root)
    # Neither is one that was only begun.
    (tmp_path / "out" / ".challenger" / "attempts").mkdir(parents=True)
    assert "another --out" in refused(source, split, replace(BUILT, out=tmp_path / "out"))


def test_what_cannot_be_frozen_is_said_before_the_search(source: DataSet, tmp_path: Path) -> None:
    other = tmp_path / "notes.json"
    other.write_text(json.dumps({"mine": 1}))
    for split, file, word in (
        ("adv", other, "is not a frozen split"),
        ("adv", tmp_path / "nowhere" / "a.json", "there is no folder"),
        ("val-r", tmp_path / "a.json", "only adv can be frozen"),
    ):
        with pytest.raises(InputError, match=word):
            build_split(source, split, replace(CHEAP, out=tmp_path / "out", freeze=file))
    assert not (tmp_path / "out").exists() and json.loads(other.read_text()) == {"mine": 1}


def test_frozen_scenes_are_judged_where_they_are_written_and_kept_as_frozen(
    source: DataSet, split: NamedSplit, built: Path, folder: Path, tmp_path: Path
) -> None:
    data = open_data(built)
    judged = collect_assessments(data.root, data.version)
    searched = collect_assessments(folder / "searched", data.version)
    assert set(judged) == set(data.scene_names("adv"))
    for name, (said,) in judged.items():
        (before,) = searched[name]
        assert said.tracks == "generated" and said.adversary == before.adversary
        # A millimetre moves no verdict here, and no limit is broken by it.
        assert {driver: run.survives for driver, run in said.drivers.items()} == {
            driver: run.survives for driver, run in before.drivers.items()
        }
        assert said.faults == before.faults
    work = built / ".challenger" / "judgements"
    assert len(list(work.iterdir())) == len(judged)
    bare = replace(BUILT, out=tmp_path / "built", renderer=None)
    report = build_frozen(source, split, bare)
    again = open_data(tmp_path / "built")
    assert collect_assessments(again.root, again.version) == judged and report.unsolvable == ()
    assert "unavoidable scenes: 0, kept as frozen" in report.summary()
    # Judged once: what was judged is kept.
    kept: ResultStore[tuple[SceneAssessment, ...]] = ResultStore(
        tmp_path / "built" / ".challenger" / "judgements", tuple[SceneAssessment, ...]
    )
    for path in kept.folder.iterdir():
        key = content_key(DEFINITION, path.stem)
        changed = [each.model_copy(update={"unsolvable": True}) for each in kept.get(key, path.stem) or ()]
        kept.put(key, tuple(changed), path.stem)
    assert len(build_frozen(source, split, bare).unsolvable) == len(judged)
