"""ScenarioNet files that were written here and edited, built like a frozen split; other changes are refused."""

import json
import pickle
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.scenario_map import OWN
from benchmark.errors import InputError
from benchmark.extensions.exchange.exporting import export_scenarionet, scene_file
from generation.splits.building import build_frozen
from generation.splits.edited import build_edited_split
from generation.splits.format import EDITED, read_frozen
from tests.benchmark.cli.in_process import run_here
from tests.generation.splits.frozen_files import BUILT, drifting_split, recordings

PLAIN = replace(BUILT, renderer=None)
NAME = "scene-9901"
Change = Callable[[dict[str, Any]], object]


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return recordings(tmp_path_factory.mktemp("recorded"))


@pytest.fixture(scope="module")
def exported(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("exported")
    export_scenarionet(source, source.scene_names(None), folder, workers=1)
    return folder


def edit(exported: Path, to: Path, change: Change, name: str = NAME) -> Path:
    value = pickle.loads(scene_file(exported, name, "pkl").read_bytes())  # noqa: S301 - made by this test
    change(value)
    to.parent.mkdir(parents=True, exist_ok=True)
    to.write_bytes(pickle.dumps(value))
    return to


def car(value: dict[str, Any], number: int = 0) -> dict[str, Any]:
    state: dict[str, Any] = value["tracks"][[name for name in value["tracks"] if name != "ego"][number]]["state"]
    return state


def drifts(by_m: float = 1.2, number: int = 0, start: int = 30) -> Change:
    """A car drifts to the left from a frame on."""

    def change(value: dict[str, Any]) -> None:
        frames = np.arange(value["length"])
        car(value, number)["position"][:, 1] += by_m * np.clip((frames - start) / 30, 0.0, 1.0)

    return change


def test_what_was_moved_is_the_adversary_from_the_last_keyframe_before(
    source: DataSet, exported: Path, tmp_path: Path
) -> None:
    path = edit(exported, tmp_path / "mine.pkl", drifts())
    split = build_edited_split(source, path)
    (scene,) = split.frozen.scenes
    (adversary,) = scene.adversaries
    recorded = source.scene(NAME)
    assert (split.name, scene.source, split.frozen.search.algorithm) == ("mine", NAME, EDITED)
    assert adversary.instance == recorded.agents.ids[0] and adversary.launch_frame == 30
    assert len(adversary.track) == len(recorded.timestamps_us) - 30
    expected = recorded.agents.position[0, 30:, 1] + 1.2 * np.clip(np.arange(len(adversary.track)) / 30, 0.0, 1.0)
    assert np.allclose([y for _, y, _ in adversary.track], expected, atol=6e-4)
    assert build_edited_split(source, path) == split
    report = build_frozen(source, split, replace(PLAIN, out=tmp_path / "adv"))
    assert report.other_tables == () and report.edited and "edited and not verified" in report.summary()
    assert set(report.as_json()["faults"]) == {scene.name}
    built = open_data(tmp_path / "adv")
    found = built.scene(scene.name)
    assert len(found.adversaries) == 1 and built.scene_facts([scene.name])[scene.name].source == NAME
    row = found.agents.ids.index(found.adversaries[0])
    at = found.keyframes
    expected_keyframes = recorded.agents.position[0, at, 1] + 1.2 * np.clip((at - 30) / 30, 0.0, 1.0)
    assert np.allclose(found.annotations.position[row, :, 1], expected_keyframes, atol=1e-3)
    others = np.arange(len(found.agents)) != row
    assert np.allclose(found.agents.position[others], recorded.agents.position[1:], atol=1e-9)


def test_two_vehicles_are_two_adversaries_in_the_order_of_their_departure(
    source: DataSet, exported: Path, tmp_path: Path
) -> None:
    def both(value: dict[str, Any]) -> None:
        drifts(1.0, 0, 40)(value)
        drifts(-1.0, 1, 10)(value)

    (scene,) = build_edited_split(source, edit(exported, tmp_path / "two.pkl", both)).frozen.scenes
    ids = source.scene(NAME).agents.ids
    # The first keyframe at which the second car is off by a centimetre is the one after frame 12.
    assert [(each.instance, each.launch_frame) for each in scene.adversaries] == [(ids[1], 6), (ids[0], 36)]


def test_generated_scenes_come_back_as_the_adversaries_that_they_have(source: DataSet, tmp_path: Path) -> None:
    split = drifting_split(source, tmp_path / "road-adv-1.json")
    build_frozen(source, split, replace(PLAIN, out=tmp_path / "adv"))
    built = open_data(tmp_path / "adv")
    export_scenarionet(built, built.scene_names("adv"), tmp_path / "files", workers=1)
    again = build_edited_split(source, tmp_path / "files").frozen.scenes
    assert len(again) == len(split.frozen.scenes) == 4
    known = {(scene.source, scene.adversaries[0].instance): scene for scene in split.frozen.scenes}
    for scene in again:
        (adversary,) = scene.adversaries
        before = known[scene.source, adversary.instance].adversaries[0]
        assert adversary.launch_frame in (6, 12) and adversary.track[-1] == before.track[-1]


def test_a_file_without_our_block_is_compared_too(source: DataSet, exported: Path, tmp_path: Path) -> None:
    def change(value: dict[str, Any]) -> None:
        drifts()(value)
        del value["metadata"][OWN]

    # What another tool saved has no clock and no annotations, and its times end with the last whole keyframe.
    (scene,) = build_edited_split(source, edit(exported, tmp_path / "plain.pkl", change)).frozen.scenes
    assert scene.adversaries[0].instance == source.scene(NAME).agents.ids[0]


def first_track(value: dict[str, Any]) -> Any:
    return next(track for name, track in value["tracks"].items() if name != "ego")


def gone(value: dict[str, Any]) -> None:
    drifts()(value)
    car(value)["valid"][-3:] = 0


def other_clock(value: dict[str, Any]) -> None:
    own = value["metadata"][OWN]
    own["timestamps_us"] = own["timestamps_us"] + np.arange(value["length"]) * 2000
    value["metadata"]["ts"] = (own["timestamps_us"] - own["timestamps_us"][0]) * 1e-6


def pedestrian(value: dict[str, Any]) -> None:
    drifts()(value)
    first_track(value)["metadata"][OWN]["category"] = "human.pedestrian.adult"


def added(value: dict[str, Any]) -> None:
    track = first_track(value)
    value["tracks"]["more"] = {**track, "metadata": {**track["metadata"], "object_id": "more"}}


def shift(state: Any, name: str, by: float, at: Any = ...) -> None:
    state[name][at] += by


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda value: None, "unchanged; move a vehicle"),
        (drifts(0.004), "unchanged; move a vehicle"),
        (gone, "is absent at frame"),
        (other_clock, "its times are not those of scene-9901"),
        (pedestrian, "another size or category"),
        (lambda value: shift(car(value), "length", 0.5), "another size or category"),
        (lambda value: shift(value["tracks"]["ego"]["state"], "position", 0.05, (..., 1)), "the ego of scene-9901 is"),
        (lambda value: value["tracks"].pop(list(value["tracks"])[2]), "lacks .* of scene-9901; vehicles may be moved"),
        (added, "adds more; vehicles may be moved, but not added"),
        (
            lambda value: value["metadata"][OWN].update(name="scene-0001", source_scene="scene-0001"),
            "was made from scene-0001, which .* has no recording of",
        ),
        (lambda value: shift(car(value), "position", np.nan, 50), "a pose that is not finite at step 50"),
        (lambda value: value["metadata"].update(sdc_id=["ego", "ego"]), "metadata sdc_id must be a name"),
    ],
)  # fmt: skip
def test_what_else_differs_is_refused(
    source: DataSet, exported: Path, tmp_path: Path, change: Change, message: str
) -> None:
    path = edit(exported, tmp_path / "wrong.pkl", change)
    with pytest.raises(InputError, match=message) as caught:
        build_edited_split(source, path)
    assert "wrong.pkl" in str(caught.value) and len(str(caught.value).splitlines()) == 1


def test_other_recordings_and_the_same_scene_twice_are_refused(source: DataSet, exported: Path, tmp_path: Path) -> None:
    shorter = recordings(tmp_path / "shorter", seconds=6.0)
    path = edit(exported, tmp_path / "wrong.pkl", drifts())
    both = tmp_path / "both"
    both.mkdir()
    for name in ("sd_a.pkl", "sd_b.pkl"):
        shutil.copy(path, both / name)
    with pytest.raises(InputError, match=r"has 91 frames but scene-9901 was recorded with"):
        build_edited_split(shorter, path)
    with pytest.raises(InputError, match="the same scene as another file"):
        build_edited_split(source, both)


def test_the_command_builds_edited_scenes_and_freezes_them(source: DataSet, exported: Path, tmp_path: Path) -> None:
    for number, name in enumerate(("scene-9901", "scene-9902")):
        edit(exported, tmp_path / "edited" / f"sd_{number}.pkl", drifts(number=number), name)
    out = ("--data", source.root, "--renderer", "none", "--frames", "keyframes", "--workers", "1")
    done = run_here(
        "generate", "--from", tmp_path / "edited", "--out", tmp_path / "out", "--freeze", tmp_path / "mine.json", *out
    )
    assert done.code == 0 and "2 scenes built from the edited edited" in done.out, done.err
    again = run_here("generate", "--from", tmp_path / "mine.json", "--out", tmp_path / "again", *out, "--json")
    assert again.code == 0 and json.loads(again.out)["other_tables"] == [], again.err
    name = Path(str(source.root)).name
    first, second = (open_data(tmp_path / folder / "data" / name / "adv") for folder in ("out", "again"))
    assert first.scene_names("adv") == second.scene_names("adv") and len(first.scene_names("adv")) == 2
    assert len(read_frozen(tmp_path / "mine.json").scenes) == 2
    dry = run_here("generate", "--from", tmp_path / "edited", "--out", tmp_path / "dry", "--dry-run", *out)
    assert dry.code == 0 and "nothing was written" in dry.out and not (tmp_path / "dry").exists()
    for wrong, message in (
        (("--seeds", "0,1"), "edited scenes are not searched"),
        (("--top", "3"), "--top applies only to a search"),
        (("--split", "val-r"), "--from always builds split adv"),
    ):
        refused = run_here("generate", "--from", tmp_path / "edited", "--out", tmp_path / "no", *wrong, *out)
        assert refused.code == 2 and message in refused.err
