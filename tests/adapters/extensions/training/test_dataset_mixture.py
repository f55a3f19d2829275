"""Adversarial scenes among those that are learned from: whose they must be, and that nothing held out is learned."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner

from adapters.extensions.training.dataset_mixture import (
    IN_THE_WAY_M,
    MixedFrames,
    PrefixedScenes,
    RecordedFutureFrames,
    build_frames,
    require_source_scenes,
)
from benchmark.cli.app import app
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from generation.nuscenes_writer.plan import SourceInfo
from tests.benchmark.cli.cli_runs import refusal
from tests.generation.nuscenes_writer.written_roots import SolidRenderer, short_scene, with_adversary, write_root

SCENES = ("scene-9901", "scene-9902")


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    folder = tmp_path_factory.mktemp("root")
    write_root(folder, [short_scene(name) for name in SCENES], split="train")
    return NuScenesData.open(folder)


def write_adversarial(folder: Path, source: NuScenesData, names: tuple[str, ...] = SCENES) -> Path:
    plan = DataSetPlan(
        root=folder,
        split="adv",
        renderer=SolidRenderer(),
        source=SourceInfo(source.name, source.fingerprint(), source.root),
    )
    keys = []
    for name in names:
        scene = with_adversary(short_scene(name))
        keys.append(write_scene(plan, scene, name=f"{name}-0a", source_scene=name, report={}))
    finish_data_set(plan, keys)
    return folder


@pytest.fixture(scope="module")
def adversarial(data: NuScenesData, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_adversarial(tmp_path_factory.mktemp("adversarial"), data)


def test_stores_end_to_end_give_the_frames_of_each(data: NuScenesData, adversarial: Path, tmp_path: Path) -> None:
    stores = [
        build_frames(data.root, "train", tmp_path / "recorded"),
        build_frames(adversarial, "adv", tmp_path / "adversarial"),
    ]
    mixed = MixedFrames(stores)
    assert mixed.scenes == (*SCENES, *(f"{name}-0a" for name in SCENES))
    numbers = [number for name in mixed.scenes for number in mixed.frames_of(name)]
    assert numbers == list(range(len(mixed))) and len(mixed) == sum(map(len, stores))
    for name in mixed.scenes:
        for index, number in enumerate(mixed.frames_of(name)):
            clip = mixed.clip(number, 3)
            assert [each.index for each in clip] == list(range(max(index - 2, 0), index + 1))
            assert {each.scene for each in [*clip, mixed.frame(number)]} == {name} and mixed.frame(
                number
            ).index == index
    assert mixed.identity != MixedFrames(stores[:1]).identity != stores[0].identity


def test_of_adversarial_scenes_as_much_is_followed_as_of_the_recorded_ones(
    data: NuScenesData, adversarial: Path, tmp_path: Path
) -> None:
    store = build_frames(adversarial, "adv", tmp_path / "adversarial")
    recorded = build_frames(data.root, "train", tmp_path / "recorded")
    sources = {f"{name}-0a": name for name in SCENES}
    followed = RecordedFutureFrames(store, recorded, sources)
    assert followed.scenes == store.scenes and len(followed) == len(store)
    assert followed.identity not in (store.identity, recorded.identity)
    hidden = recorded.learnable_steps(SCENES[0], 1)
    hidden[2:] = False
    first, second = (followed.frames_of(f"{name}-0a") for name in SCENES)
    frame, untouched = followed.clip(first[1], 1)[0], store.frame(first[1])
    assert frame.ego_future_valid.tolist() == [*untouched.ego_future_valid[:2].tolist(), False, False, False, False]
    assert (frame.images == untouched.images).all()
    assert (followed.frame(second[0]).ego_future_valid <= store.frame(second[0]).ego_future_valid).all()
    recorded.learnable_steps(SCENES[0], 1)[:] = True
    # Somebody stands where the ego will be after 1.5 s.
    met = untouched.futures.clone()
    met[0, :, :2] = untouched.ego_future[2]
    near = (met[0, :6, :2] - untouched.ego_future).norm(dim=-1) < IN_THE_WAY_M
    store.frame = lambda number: replace(untouched, futures=met, futures_valid=untouched.futures_valid | True)  # type: ignore[method-assign]
    reached = int(near.int().argmax())
    assert not followed.frame(first[1]).ego_future_valid[reached:].any()
    assert followed.frame(first[1]).ego_future_valid[:reached].equal(untouched.ego_future_valid[:reached])


def test_adversarial_scenes_come_from_what_is_learned(data: NuScenesData, adversarial: Path, tmp_path: Path) -> None:
    assert require_source_scenes(adversarial, data, "train") == {f"{name}-0a": name for name in SCENES}
    with pytest.raises(InputError, match="was not made from"):
        require_source_scenes(adversarial, other_data(tmp_path / "other"), "train")


def test_scenes_that_planners_are_judged_on_are_never_learned_from(tmp_path: Path) -> None:
    folder = tmp_path / "both"
    plan = DataSetPlan(root=folder, split="val", renderer=SolidRenderer())
    scenes = [short_scene(name) for name in SCENES]
    keys = [write_scene(plan, scene, name=scene.name, source_scene=scene.name, report={}) for scene in scenes]
    finish_data_set(plan, keys, extra_splits={"train": [SCENES[0]]})
    data = NuScenesData.open(folder)
    evaluated = write_adversarial(tmp_path / "adversarial", data, (SCENES[1],))
    with pytest.raises(InputError, match="scored on"):
        require_source_scenes(evaluated, data, "train")
    learned = write_adversarial(tmp_path / "learned", data, (SCENES[0],))
    assert require_source_scenes(learned, data, "train") == {f"{SCENES[0]}-0a": SCENES[0]}


def other_data(folder: Path) -> NuScenesData:
    """Other scenes with the same names."""
    write_root(folder, [short_scene(name, seconds=3.0) for name in SCENES], split="train")
    return NuScenesData.open(folder)


def test_two_data_sets_that_name_their_scenes_alike_are_told_apart(data: NuScenesData, tmp_path: Path) -> None:
    store = build_frames(data.root, "train", tmp_path / "store")
    with pytest.raises(InputError, match="scene-9901"):
        MixedFrames([store, store])
    other = build_frames(other_data(tmp_path / "other").root, "train", tmp_path / "other store")
    apart = PrefixedScenes(other, "also-1")
    mixed = MixedFrames([store, apart])
    assert mixed.scenes == (*SCENES, *(f"also-1/{name}" for name in SCENES))
    for name in SCENES:
        numbers = mixed.frames_of(f"also-1/{name}")
        times = [
            [frames.frame(each).timestamp_s for each in found]
            for frames, found in ((mixed, numbers), (other, other.frames_of(name)))
        ]
        assert times[0] == times[1]
        assert {frame.scene for frame in mixed.clip(numbers[-1], 2)} == {f"also-1/{name}"}
    assert len({each.identity for each in (other, apart, PrefixedScenes(other, "also-2"))}) == 3


def test_the_command_learns_from_all_data_sets_that_are_named(
    data: NuScenesData, adversarial: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    other = other_data(tmp_path / "other")
    command = ["train", "planner", "--model", "image-encoder", "--data", str(data.root), "--steps", "1"]
    command += ["--workers", "1", "--out", str(tmp_path / "eyes.safetensors"), "--adversarial", str(adversarial)]
    done = CliRunner().invoke(app, [*command, "--also", str(other.root)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    facts = json.loads(done.stdout)
    assert facts["scenes"] == 6
    # Of two recorded scenes one is held out, and with it what was made from it; none of the other data set's is.
    assert facts["frames"] == 2 * len(data.truth(SCENES[1])) + sum(len(other.truth(name)) for name in SCENES)
    assert facts["adversarial"] == [adversarial.name] and facts["also"] == [other.root.name]
    assert "the same data set as" in refusal(*command, "--also", data.root)
