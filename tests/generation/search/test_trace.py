"""Searches made again with their rounds: the same tracks, the same bytes, and a sentence where it cannot be."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json
from benchmark.records.scenes import RefinementTrace, StoredSheet, find_sheets, scene_folder
from benchmark.sheets.writing import SheetSettings, write_sheets
from generation.build.split import build_split
from generation.search.adversary import Planned, attempt
from generation.search.attempts import _keep_work
from generation.search.hyperparameters import HyperParameters
from generation.search.refinement import scores_together
from generation.search.rounds import SHOWN_CANDIDATES, shown_candidates
from generation.search.search_file import read_search
from generation.search.trace import write_traces
from tests.generation.labels.recorded_roads import CHEAP, HYPER, recorded, write_source
from tests.generation.search.driving_prior import DrivingPrior, unchanged

Say = Callable[[str], None]


class OtherPrior(DrivingPrior):
    fingerprint = "another model"


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return write_source(tmp_path_factory.mktemp("recorded"), recorded("scene-9901", seconds=7.0))


def built_in(folder: Path, source: DataSet, **changes: Any) -> Path:
    """A folder with a generated split and its sheets."""
    build_split(source, "adv", replace(CHEAP, out=folder / "adv", **changes))
    write_sheets(open_data(folder / "adv", name="small"), "adv", folder / "sheets", SheetSettings("none", workers=1))
    return folder


@pytest.fixture(scope="module")
def built(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built_in(tmp_path_factory.mktemp("built"), source, per_scene=2)


@pytest.fixture
def copied(built: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(built, tmp_path / "copied"))


def never(sentence: str) -> None:
    raise AssertionError(sentence)


def traced(folder: Path, source: DataSet, say: Say = never, workers: int = 1) -> list[Path]:
    data = open_data(folder / "adv", name="small")
    return write_traces(
        data, source, "adv", folder / "sheets", data.scene_names("adv"), workers=workers, prior=DrivingPrior, say=say
    )


def stored_in(folder: Path) -> list[StoredSheet]:
    return list(find_sheets(folder / "sheets").scenes.values())


def rounds_of(stored: StoredSheet) -> RefinementTrace:
    assert stored.rounds is not None
    return stored.rounds


def test_whoever_watches_changes_nothing() -> None:
    scene, seen = recorded("scene-9901", seconds=7.0), list[Planned]()
    alone, watched = (
        attempt(scene, 0, 0, HYPER, DrivingPrior(), diversify=unchanged, watch=watch) for watch in (None, seen.append)
    )
    assert canonical_json(alone.report()) == canonical_json(watched.report())
    np.testing.assert_array_equal(alone.poses, watched.poses)
    last = [planned for planned in seen if planned.search == watched.tries - 1]
    assert [planned.frame for planned in last] == [plan.frame for plan in watched.plans]
    for planned, plan in zip(last, watched.plans, strict=True):
        assert len(planned.batches) == len(plan.collision_free) == HYPER.rounds + 1
        assert scores_together(planned.batches, HYPER).min() == plan.score


def assert_is_what_was_driven(stored: StoredSheet, data: DataSet) -> None:
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


def test_the_rounds_belong_to_the_track_that_is_in_the_data_set(source: DataSet, copied: Path) -> None:
    paths = traced(copied, source)
    data = open_data(copied / "adv", name="small")
    assert len(paths) == len(data.scene_names("adv")) == 2
    for stored in stored_in(copied):
        assert stored.directory / "rounds.json" in paths
        assert_is_what_was_driven(stored, data)
        assert rounds_of(stored).search["candidates"] == HYPER.candidates
        assert rounds_of(stored).search["scored_s"] == 3.0


def test_of_several_adversaries_the_last_ones_search_is_traced(source: DataSet, tmp_path: Path) -> None:
    folder = built_in(tmp_path, source, adversaries=2, total=1)
    traced(folder, source)
    (stored,) = stored_in(folder)
    made = json.loads((folder / "adv/v1.0-mini/challenger.json").read_text())["scenes"][stored.sheet.scene]
    assert rounds_of(stored).agent in made["adversaries"]
    assert_is_what_was_driven(stored, open_data(folder / "adv", name="small"))


def test_finished_traces_stay_and_damaged_ones_are_made_again(source: DataSet, copied: Path) -> None:
    first, second = traced(copied, source)
    before, written = [path.read_bytes() for path in (first, second)], first.stat().st_mtime_ns
    second.write_bytes(before[1][:1000])
    assert traced(copied, source, workers=2) == [first, second]
    assert [path.read_bytes() for path in (first, second)] == before
    assert first.stat().st_mtime_ns == written


def test_another_number_of_workers_gives_the_same_bytes(source: DataSet, copied: Path, tmp_path: Path) -> None:
    other = Path(shutil.copytree(copied, tmp_path / "other"))
    one, two = traced(copied, source, workers=1), traced(other, source, workers=2)
    assert [path.read_bytes() for path in one] == [path.read_bytes() for path in two]


def test_scenes_that_cannot_be_traced_are_said_and_the_others_traced(source: DataSet, copied: Path) -> None:
    names = open_data(copied / "adv").scene_names("adv")
    said: list[str] = []
    (scene_folder(copied / "sheets", "small", "adv", names[0]) / "sheet.json").unlink()
    assert len(traced(copied, source, said.append)) == 1
    assert "run challenger-bench sheets" in said.pop()
    for path in (copied / "adv/.challenger/attempts").iterdir():
        path.unlink()
    for path in (copied / "sheets").rglob("rounds.json"):
        path.unlink()
    assert traced(copied, source, said.append) == []
    assert len(said) == 2
    assert "run the same challenger-bench generate again" in said[1]


def test_a_search_that_gives_another_track_here_is_not_shown(source: DataSet, copied: Path) -> None:
    search, said = read_search(copied / "adv", DrivingPrior), list[str]()
    moved = replace(search, state=copied / "elsewhere")
    shutil.move(search.state, moved.state)
    for path in (moved.state / "attempts").iterdir():
        content = json.loads(path.read_text())
        content.pop("sha256", None)
        if content["poses"]:
            content["poses"][5][0] += 1e-6
        _keep_work(search.state / "attempts" / path.name, content)
    assert traced(copied, source, said.append) == []
    assert all("another track" in sentence for sentence in said)
    assert len(said) == 2


def test_what_was_not_generated_here_is_refused(source: DataSet, built: Path) -> None:
    with pytest.raises(InputError, match="does not say that its scenes have adversaries"):
        write_traces(source, source, "val", built / "sheets", source.scene_names("val"), prior=DrivingPrior)


def test_another_source_is_refused(built: Path, tmp_path: Path) -> None:
    other = write_source(tmp_path / "other", recorded("scene-9901", seconds=6.0))
    with pytest.raises(InputError, match="from other recordings"):
        traced(built, other)


def test_another_model_is_refused(source: DataSet, built: Path) -> None:
    data = open_data(built / "adv", name="small")
    with pytest.raises(InputError, match="other weights"):
        write_traces(data, source, "adv", built / "sheets", data.scene_names("adv"), prior=OtherPrior)


@pytest.mark.parametrize(
    "damage",
    [
        lambda said: said | {"algorithm": "2"},
        lambda said: said | {"hyper": said["hyper"] | {"rounds": 7}},
        lambda said: said | {"hyper": said["hyper"] | {"unheard_of": 7}},
        lambda said: said | {"hyper": said["hyper"] | {"rounds": -1}},
        lambda said: said | {"sampler": {"unheard_of": 7}},
        lambda said: {},
        lambda said: [said],
        lambda said: None,
    ],
)
def test_another_or_a_damaged_search_is_refused(
    source: DataSet, copied: Path, damage: Callable[[dict[str, Any]], Any]
) -> None:
    path = copied / "adv" / "search.json"
    path.write_text(json.dumps(damage(json.loads(path.read_text()))))
    with pytest.raises(InputError, match="damaged or of another version"):
        traced(copied, source)


def test_a_root_that_does_not_say_how_it_searched_is_refused(source: DataSet, copied: Path) -> None:
    (copied / "adv" / "search.json").unlink()
    with pytest.raises(InputError, match="run the same challenger-bench generate again"):
        traced(copied, source)
    build_split(source, "adv", replace(CHEAP, out=copied / "adv", per_scene=2))
    assert len(traced(copied, source)) == 2


def test_settings_come_back_as_they_were(source: DataSet, built: Path) -> None:
    search = read_search(built / "adv", DrivingPrior)
    assert search.hyper == HYPER
    assert search.fingerprint == source.fingerprint()
    assert type(search.hyper) is HyperParameters


@pytest.mark.parametrize("count", [1, 63, 64, 65, 256, 1000])
def test_the_best_and_some_of_the_others_are_kept(count: int) -> None:
    scores = np.random.default_rng(count).exponential(size=count)
    drawable = np.ones(count, dtype=np.bool_)
    chosen = int(np.argsort(scores)[count // 2])
    shown = shown_candidates(scores, drawable, chosen)
    assert chosen in shown
    assert len(set(shown.tolist())) == len(shown) == min(count, SHOWN_CANDIDATES)
    assert list(shown) == sorted(shown)
    assert set(np.argsort(scores)[: min(count, SHOWN_CANDIDATES // 2)]) <= set(shown)


def test_candidates_without_a_finite_motion_are_left_out() -> None:
    drawable = np.array([True, False, True])
    scores = np.array([np.inf, np.inf, 0.5])
    assert shown_candidates(scores, drawable, 1).tolist() == [0, 2]
    assert shown_candidates(scores, np.zeros(3, dtype=np.bool_), None).tolist() == []
