"""``train planner`` from a data set to weights, facts and card: the same bytes twice, and what it refuses."""

import json
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file
from typer.testing import CliRunner

from adapters.checkpoints.cache import read_provenance
from adapters.checkpoints.loading import build_native_planner
from adapters.extensions.training.planners import ENCODER_NAME, PlannerTraining, judge_again, train_planner
from adapters.extensions.training.vad.phases import transfer_start_weights
from adapters.models import miniature
from benchmark.cli.app import app
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.machine.storage import write_json
from benchmark.planning import SceneInfo
from generation.sources.mini import TownSettings, build_town_data_set
from tests.benchmark.cli.cli_runs import challenger_bench

MODEL = "vad-mini"


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_town_data_set(tmp_path_factory.mktemp("town"), TownSettings(2, 0, 0, 64, 36, "keyframes"), workers=1)


@pytest.fixture(scope="module")
def one_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return build_town_data_set(tmp_path_factory.mktemp("one"), TownSettings(1, 0, 0, 64, 36, "keyframes"), workers=1)


@pytest.fixture(scope="module", autouse=True)
def _own_cache(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield


@pytest.fixture(scope="module")
def encoder(town: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("encoder") / "eyes.safetensors"
    train_planner(PlannerTraining(ENCODER_NAME, town, "val", out, steps=2))
    return out


@pytest.fixture(scope="module")
def trained(town: Path, encoder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("first") / f"{MODEL}.safetensors"
    train_planner(PlannerTraining(MODEL, town, "val", out, steps=2, image_encoder=encoder))
    return out


def command(*arguments: str | Path) -> Any:
    """Facts that a command prints, which runs in this process."""
    done = CliRunner().invoke(app, ["train", *map(str, arguments)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return json.loads(done.stdout)


@pytest.mark.slow
def test_two_steps_twice_give_the_same_bytes(town: Path, encoder: Path, trained: Path, tmp_path: Path) -> None:
    again = tmp_path / trained.name
    done = challenger_bench(
        "train", "planner", "--model", MODEL, "--data", town, "--split", "val", "--out", again, "--steps", "2",
        "--image-encoder", encoder, "--workers", "1",
    )  # fmt: skip
    assert done.code == 0, done.err
    for suffix in (".safetensors", ".json", ".md", ".all.log.jsonl"):
        assert again.with_suffix(suffix).read_bytes() == trained.with_suffix(suffix).read_bytes()
    assert not list(tmp_path.glob("*.progress.*"))
    facts, card = done.json, again.with_suffix(".md").read_text()
    assert facts == json.loads(trained.with_suffix(".json").read_text())
    assert facts["figures"]["constant-velocity"]["samples"] == 34
    own = f"{facts['figures']['own']['l2_3s_m']:.2f}"
    for said in ("| seed | 0 |", "1 (all, learning rate", "40 key frames of 2 scenes", "blank images", own):
        assert said in card
    # Two steps with a low learning rate move the eyes that it started with a little; their last stage is not there.
    eyes, tensors = load_file(encoder), load_file(again)
    names = [name for name in tensors if name.startswith("img_backbone.")]
    assert 0 < max(float((eyes[name].float() - tensors[name].float()).abs().max()) for name in names) < 0.05


@pytest.mark.path
def test_a_planner_is_trained_says_what_it_is_and_drives(one_scene: Path, tmp_path: Path) -> None:
    """Of one scene, which leaves none to measure on."""
    out = tmp_path / f"{MODEL}.safetensors"
    facts = train_planner(PlannerTraining(MODEL, one_scene, "val", out, steps=1, only=("all",)))
    assert facts == json.loads(out.with_suffix(".json").read_text())
    assert facts["seed"] == 0 and facts["phases"]["all"]["steps"] == 1 and facts["frames"] == 40
    provenance = read_provenance(out)
    assert (provenance.model, provenance.normalisation) == (MODEL, "rgb-mean-std")
    assert provenance.normalisation_from == "training"
    assert {value.dtype for value in load_file(out).values() if value.numel() >= 256} == {torch.float16}
    planner: Any = build_native_planner(miniature(MODEL), out)
    data = NuScenesData.open(one_scene)
    scene = data.scene(data.scene_names("val")[0])
    planner.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
    plan = planner.plan(next(iter(data.observations(scene.name))))
    assert np.isfinite(plan.waypoints).all() and planner.native_protocol == "vad"


@pytest.mark.slow
def test_a_file_can_be_judged_again_and_only_with_its_own_facts(town: Path, trained: Path, tmp_path: Path) -> None:
    for suffix in (".safetensors", ".json", ".md"):
        shutil.copy(trained.with_suffix(suffix), tmp_path / f"w{suffix}")
    before = json.loads((tmp_path / "w.json").read_text())
    facts = command("judge", tmp_path / "w.safetensors", "--data", town)
    assert facts == json.loads((tmp_path / "w.json").read_text())
    measured = {"figures", "forecasts", "seen", "lost", "judged_on"}
    assert {name: facts[name] for name in facts.keys() - measured} == {
        name: before[name] for name in before.keys() - measured
    }
    assert len(facts["judged_on"]["scenes"]) >= len(before["judged_on"]["scenes"])
    assert f"{facts['figures']['own']['l2_3s_m']:.2f}" in (tmp_path / "w.md").read_text()
    write_json(tmp_path / "w.json", {**facts, "sha256": "0" * 64})
    with pytest.raises(InputError, match="does not hold the facts of"):
        judge_again(tmp_path / "w.safetensors", town)


@pytest.mark.slow
def test_of_several_weights_the_last_count(town: Path, encoder: Path, trained: Path, tmp_path: Path) -> None:
    """One step at a rate of nearly nothing: eyes of the one, everything else of the other."""
    facts = command(
        "planner", "--model", MODEL, "--data", town, "--split", "val", "--out", tmp_path / "w.safetensors",
        "--steps", "1", "--only", "planner", "--learning-rate", "1e-9", "--start-from", trained,
        "--start-from", encoder, "--workers", "1",
    )  # fmt: skip
    assert list(facts["phases"]) == ["planner"] and list(facts["started_from"]) == ["start_from"]
    eyes, first = transfer_start_weights(load_file(encoder)), load_file(trained)
    for name, value in load_file(tmp_path / "w.safetensors").items():
        given = eyes[name] if name in eyes and eyes[name].shape == value.shape else first[name]
        torch.testing.assert_close(value.float(), given.float(), rtol=1e-2, atol=1e-3, msg=name)
    assert any(not torch.equal(eyes[name].float(), first[name].float()) for name in eyes if name in first)


@pytest.mark.slow
def test_a_share_of_the_start_can_be_kept(town: Path, trained: Path, tmp_path: Path) -> None:
    found = {}
    for kept in ("0", "0.25"):
        out = tmp_path / f"{kept}.safetensors"
        facts = command(
            "planner", "--model", MODEL, "--data", town, "--split", "val", "--out", out, "--steps", "2",
            "--only", "planner", "--learning-rate", "0.05", "--start-from", trained, "--kept-of-start", kept,
            "--workers", "1",
        )  # fmt: skip
        assert facts.get("kept_of_start", 0) == float(kept)
        found[kept] = {name: value.float() for name, value in load_file(out).items()}
    assert "25% of them kept" in (tmp_path / "0.25.md").read_text() and "kept" not in (tmp_path / "0.md").read_text()
    assert any(not torch.equal(learned, found["0.25"][name]) for name, learned in found["0"].items())
    for name, start in load_file(trained).items():
        mean = 0.75 * found["0"][name] + 0.25 * start.float()
        torch.testing.assert_close(found["0.25"][name], mean, rtol=2e-3, atol=1e-4, msg=name)


def test_parts_and_weights_that_cannot_be_used_are_a_sentence(one_scene: Path, tmp_path: Path) -> None:
    training = PlannerTraining(MODEL, one_scene, "val", tmp_path / "w.safetensors", steps=1)
    broken, other = tmp_path / "broken.safetensors", tmp_path / "other.safetensors"
    broken.write_bytes(b"no")
    save_file({"other": torch.zeros(2)}, other)
    for change, sentence in (
        ({"only": ("everything",)}, f"--only everything: the parts of the training of {MODEL} are .*all"),
        ({"only": ("everything",), "model": ENCODER_NAME}, "--only everything: the parts of the training of image-enc"),
        ({"start_from": (broken,)}, "cannot read the weights"),
        ({"image_encoder": other}, "no weights of an image encoder"),
        ({"start_from": (other,)}, "none of the weights to start from fit this model"),
        ({"split": "nonsense"}, "nonsense"),
    ):
        with pytest.raises(InputError, match=sentence):
            train_planner(replace(training, **change))
    assert not training.out.exists()


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"model": "uniad"}, r"'uniad' is not a miniature; did you mean uniad-mini\? use one of uniad-mini"),
        ({"out": Path("w.pth")}, "written as .safetensors"),
        ({"steps": 0}, "--steps must be at least 1"),
        ({"learning_rate": 3.0}, "--learning-rate must be between 0 and 1"),
        ({"kept_of_start": 1.0}, "--kept-of-start is a share below 1, got 1"),
        (
            {"kept_of_start": 0.5},
            "--kept-of-start keeps of the weights of a miniature that are given with --start-from",
        ),
    ],
)
def test_wrong_use_is_a_sentence(changes: dict[str, object], sentence: str) -> None:
    known: dict[str, object] = {"model": MODEL, "data_root": Path(), "split": "train", "out": Path("w.safetensors")}
    with pytest.raises(InputError, match=sentence):
        PlannerTraining(**(known | changes))  # type: ignore[arg-type]
