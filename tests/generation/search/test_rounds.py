"""Rounds that a search keeps: they belong to the tracks, cost nothing else, and survive whatever interrupts a build."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.machine.workers import LocalProcesses
from benchmark.records.scene_pages import RefinementTrace, StoredScenePage, find_scene_pages, kept_rounds_path
from benchmark.runs.units import ResultStore
from benchmark.scene_pages.writing import SheetSettings, write_sheets
from generation.pipeline.report import estimate_build
from generation.pipeline.split import build_split
from generation.search.refinement import SHOWN_CANDIDATES, select_shown_candidates
from tests.generation.labels.recorded_roads import CHEAP, HYPER, contents, recorded, write_source
from tests.generation.search.driving_prior import DrivingPrior

TWO = replace(CHEAP, per_scene=2, keep_rounds=True)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return write_source(tmp_path_factory.mktemp("recorded"), recorded("scene-9901", seconds=7.0))


@pytest.fixture(scope="module")
def built(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("built")
    build_split(source, "adv", replace(TWO, out=root))
    return root


@pytest.fixture
def copied(built: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(built, tmp_path / "copied"))


def shown(root: Path, sheets: Path, **changes: Any) -> list[StoredScenePage]:
    """Sheets with rounds of a generated root."""
    data = open_data(root, name="small")
    write_sheets(data, "adv", sheets, SheetSettings("none", workers=1, rounds=True, **changes))
    return list(find_scene_pages(sheets).scenes.values())


def rounds_of(stored: StoredScenePage) -> RefinementTrace:
    assert stored.rounds is not None
    return stored.rounds


def data_set(root: Path) -> dict[str, bytes]:
    """All that a reader of the data set sees."""
    return {name: data for name, data in contents(root).items() if not name.startswith((".challenger", "rounds/"))}


def assert_is_what_was_driven(stored: StoredScenePage, data: DataSet) -> None:
    """The executed candidates lead along the adversary's track, from each planning frame to the next."""
    rounds, scene = rounds_of(stored), data.scene(stored.sheet.scene)
    track = scene.agents.position[scene.agents.ids.index(rounds.agent), :, :2] - np.array(stored.sheet.origin_m)
    assert len(rounds.frames) >= 4
    for at in rounds.frames:
        chosen = np.array(at.rounds[at.chosen_round].candidates[at.chosen])
        assert chosen.shape == (7, 2)
        frames = [frame for frame in (at.frame, at.frame + 6, at.frame + 12) if frame < len(track)]
        np.testing.assert_allclose(chosen[: len(frames)], track[frames], atol=0.0051)
        known = [score for entry in at.rounds for score in entry.scores if score is not None]
        assert at.rounds[at.chosen_round].scores[at.chosen] == min(known)
        for entry in at.rounds:
            assert len(entry.candidates) == len(entry.scores) == HYPER.candidates


def test_the_rounds_belong_to_the_track_that_is_in_the_data_set(source: DataSet, built: Path, tmp_path: Path) -> None:
    data, found = open_data(built, name="small"), shown(built, tmp_path)
    assert [stored.sheet.scene for stored in found] == sorted(data.scene_names("adv"))
    for stored in found:
        assert_is_what_was_driven(stored, data)
        assert rounds_of(stored).search["candidates"] == HYPER.candidates
        assert rounds_of(stored).search["scored_s"] == 3.0
    said = json.loads((built / "search.json").read_text())
    assert (said["source"], said["hyper_fingerprint"]) == (source.fingerprint(), HYPER.fingerprint)
    assert said["prior"] == DrivingPrior.fingerprint and said["sampler"] is None


def test_of_several_adversaries_the_last_ones_search_is_kept(source: DataSet, tmp_path: Path) -> None:
    root = tmp_path / "adv"
    build_split(source, "adv", replace(CHEAP, out=root, adversaries=2, total=1, keep_rounds=True))
    (stored,) = shown(root, tmp_path / "sheets")
    made = (open_data(root).provenance() or {})["scenes"][stored.sheet.scene]
    last = made["report"]["adversaries"][-1]
    assert rounds_of(stored).agent in made["adversaries"]
    assert rounds_of(stored).frames[0].frame == last["launch_frame"]
    assert_is_what_was_driven(stored, open_data(root, name="small"))


def test_variants_in_roots_of_their_own_have_their_rounds(source: DataSet, tmp_path: Path) -> None:
    build_split(source, "adv", replace(TWO, out=tmp_path / "adv", layout="per-variant"))
    data = open_data(tmp_path / "adv", name="small")
    for stored in shown(tmp_path / "adv", tmp_path / "sheets"):
        assert stored.sheet.scene.startswith("v")
        assert_is_what_was_driven(stored, data)


def test_what_was_searched_without_is_the_same_data_set_and_is_searched_again_for_them(
    source: DataSet, built: Path, tmp_path: Path
) -> None:
    build_split(source, "adv", replace(TWO, out=tmp_path, keep_rounds=False))
    assert not (tmp_path / "rounds").exists() and not (tmp_path / ".challenger" / "rounds").exists()
    assert data_set(tmp_path) == data_set(built)
    assert open_data(tmp_path).fingerprint() == open_data(built).fingerprint()
    counted = [
        estimate_build(source, "adv", replace(TWO, out=tmp_path, keep_rounds=keep)).finished_before
        for keep in (False, True)
    ]
    assert counted[1] < counted[0]
    build_split(source, "adv", replace(TWO, out=tmp_path))
    assert contents(tmp_path) == contents(built)
    written = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("rounds/*.json")}
    # Rounds that are there stay, asked for or not, while they belong to what is written.
    build_split(source, "adv", replace(TWO, out=tmp_path, keep_rounds=False))
    assert {path: path.stat().st_mtime_ns for path in tmp_path.rglob("rounds/*.json")} == written


def test_two_workers_and_a_killed_build_give_the_same_bytes(source: DataSet, built: Path, tmp_path: Path) -> None:
    build_split(source, "adv", replace(TWO, out=tmp_path, executor=LocalProcesses(2), together=2))
    assert contents(tmp_path) == contents(built)
    for folder in (tmp_path / ".challenger" / "rounds", tmp_path / "rounds"):
        sorted(folder.iterdir())[0].unlink()
    (tmp_path / "v1.0-mini" / "challenger.json").unlink()
    build_split(source, "adv", replace(TWO, out=tmp_path))
    assert contents(tmp_path) == contents(built)


def test_rounds_of_another_search_go(source: DataSet, copied: Path) -> None:
    before = set((copied / "rounds").iterdir())
    build_split(source, "adv", replace(TWO, out=copied, seed=1, keep_rounds=False))
    assert before and not list((copied / "rounds").iterdir())
    build_split(source, "adv", replace(TWO, out=copied, total=1, keep_rounds=False))
    assert len(list((copied / "rounds").iterdir())) == 1


def test_damaged_rounds_and_a_search_that_gives_another_track_here_are_refused(source: DataSet, copied: Path) -> None:
    for path in (copied / ".challenger" / "rounds").iterdir():
        path.write_text("{}")
    with pytest.raises(InputError, match=r"rounds/.*is damaged; delete it"):
        build_split(source, "adv", replace(TWO, out=copied))
    for path in (copied / ".challenger" / "attempts").iterdir():
        store: ResultStore[Any] = ResultStore(path.parent, Any)
        content = store.get(path.stem)
        assert content is not None
        if content["poses"]:
            content["poses"][5][0] += 1e-6
        store.put(path.stem, content)
    shutil.rmtree(copied / ".challenger" / "rounds")
    with pytest.raises(InputError, match="another track here"):
        build_split(source, "adv", replace(TWO, out=copied))


def test_a_root_without_rounds_names_the_option(built: Path, source: DataSet, copied: Path, tmp_path: Path) -> None:
    shutil.rmtree(copied / "rounds")
    with pytest.raises(InputError, match="generate --split adv --keep-rounds"):
        shown(copied, tmp_path / "sheets")
    assert not (tmp_path / "sheets").exists()
    data = open_data(copied, name="small")
    write_sheets(data, "adv", tmp_path / "sheets", SheetSettings("none", workers=1))


def test_damaged_and_foreign_rounds_are_not_shown(copied: Path, tmp_path: Path) -> None:
    first, second = open_data(copied, name="small").scene_names("adv")
    kept_rounds_path(copied, first).write_bytes(kept_rounds_path(copied, second).read_bytes())
    data = open_data(copied, name="small")
    settings = SheetSettings("none", workers=2, rounds=True)
    assert write_sheets(data, "adv", tmp_path, settings).traced == 1
    kept_rounds_path(copied, first).write_bytes(kept_rounds_path(copied, second).read_bytes()[:1000])
    assert write_sheets(data, "adv", tmp_path, settings).as_json()["traced"] == 1
    assert len(shown(copied, tmp_path, scenes=(second,))) == 2


@pytest.mark.parametrize("count", [1, 64, 65, 1000])
def test_the_best_and_some_of_the_others_are_kept(count: int) -> None:
    scores = np.random.default_rng(count).exponential(size=count)
    drawable = np.ones(count, dtype=np.bool_)
    chosen = int(np.argsort(scores)[count // 2])
    shown = select_shown_candidates(scores, drawable, chosen)
    assert chosen in shown
    assert len(set(shown.tolist())) == len(shown) == min(count, SHOWN_CANDIDATES)
    assert list(shown) == sorted(shown)
    assert set(np.argsort(scores)[: min(count, SHOWN_CANDIDATES // 2)]) <= set(shown)


def test_candidates_without_a_finite_motion_are_left_out() -> None:
    drawable = np.array([True, False, True])
    scores = np.array([np.inf, np.inf, 0.5])
    assert select_shown_candidates(scores, drawable, 1).tolist() == [0, 2]
    assert select_shown_candidates(scores, np.zeros(3, dtype=np.bool_), None).tolist() == []
