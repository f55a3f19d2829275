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

from adapters.checkpoints.cache import read_provenance
from adapters.checkpoints.loading import build_native_planner
from adapters.extensions.training.planners import ENCODER_NAME, PlannerTraining, judge_again, train_planner
from adapters.extensions.training.vad.phases import transfer_start_weights
from adapters.models import miniature
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


def test_two_steps_twice_give_the_same_bytes(town: Path, encoder: Path, trained: Path, tmp_path: Path) -> None:
    again = tmp_path / trained.name
    done = challenger_bench(
        "train", "planner", "--model", MODEL, "--data", town, "--split", "val", "--out", again, "--steps", "2",
        "--image-encoder", encoder, "--workers", "1",
    )  # fmt: skip
    assert done.code == 0, done.err
    for suffix in (".safetensors", ".json", ".md", ".all.log.jsonl"):
        assert again.with_suffix(suffix).read_bytes() == trained.with_suffix(suffix).read_bytes()
    assert done.json == json.loads(trained.with_suffix(".json").read_text())
    assert not list(tmp_path.glob("*.progress.*"))


def test_the_file_says_what_it_is_and_drives(town: Path, trained: Path) -> None:
    provenance = read_provenance(trained)
    assert (provenance.model, provenance.normalisation, provenance.normalisation_from) == (
        MODEL,
        "rgb-mean-std",
        "training",
    )
    tensors = load_file(trained)
    assert {tensor.dtype for tensor in tensors.values() if tensor.numel() >= 256} == {torch.float16}
    planner: Any = build_native_planner(miniature(MODEL), trained)
    data = NuScenesData.open(town)
    scene = data.scene(data.scene_names("val")[0])
    planner.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
    plan = planner.plan(next(iter(data.observations(scene.name))))
    assert np.isfinite(plan.waypoints).all() and planner.native_protocol == "vad"


def test_the_card_names_data_seed_steps_and_scores(trained: Path) -> None:
    facts = json.loads(trained.with_suffix(".json").read_text())
    card = trained.with_suffix(".md").read_text()
    assert facts["seed"] == 0 and facts["phases"]["all"]["steps"] == 1 and facts["frames"] == 40
    for said in (
        "| seed | 0 |",
        "1 (all, learning rate",
        "40 key frames of 2 scenes",
        "its own images",
        "blank images",
    ):
        assert said in card
    assert f"{facts['figures']['own']['l2_3s_m']:.2f}" in card
    assert facts["figures"]["constant-velocity"]["samples"] == 34


def test_a_file_can_be_judged_again_and_only_with_its_own_facts(town: Path, trained: Path, tmp_path: Path) -> None:
    for suffix in (".safetensors", ".json", ".md"):
        shutil.copy(trained.with_suffix(suffix), tmp_path / f"w{suffix}")
    before = json.loads((tmp_path / "w.json").read_text())
    done = challenger_bench("train", "judge", tmp_path / "w.safetensors", "--data", town)
    facts = done.json
    assert facts == json.loads((tmp_path / "w.json").read_text())
    assert {**facts, "figures": 0, "forecasts": 0, "seen": 0, "lost": 0, "judged_on": 0} == {
        **before,
        "figures": 0,
        "forecasts": 0,
        "seen": 0,
        "lost": 0,
        "judged_on": 0,
    }
    assert len(facts["judged_on"]["scenes"]) >= len(before["judged_on"]["scenes"])
    assert f"{facts['figures']['own']['l2_3s_m']:.2f}" in (tmp_path / "w.md").read_text()
    write_json(tmp_path / "w.json", {**facts, "sha256": "0" * 64})
    with pytest.raises(InputError, match="does not hold the facts of"):
        judge_again(tmp_path / "w.safetensors", town)


def test_it_starts_from_the_weights_that_are_given(encoder: Path, trained: Path) -> None:
    """Two steps with a low learning rate move what is learned little, and frozen parts not at all."""
    eyes, own = load_file(encoder), load_file(trained)
    # Nothing reads the encoder's last stage here, and there is none.
    names = [name for name in eyes if name.startswith("img_backbone.") and name in own]
    assert max(float((eyes[name].float() - own[name].float()).abs().max()) for name in names) < 0.05


def test_of_several_weights_the_last_count(town: Path, encoder: Path, trained: Path, tmp_path: Path) -> None:
    """One step at a rate of nearly nothing: eyes of the one, everything else of the other."""
    out = tmp_path / "w.safetensors"
    done = challenger_bench(
        "train", "planner", "--model", MODEL, "--data", town, "--split", "val", "--out", out, "--steps", "1",
        "--only", "planner", "--learning-rate", "1e-9", "--start-from", trained, "--start-from", encoder,
        "--workers", "1",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert list(done.json["phases"]) == ["planner"] and list(done.json["started_from"]) == ["start_from"]
    eyes, first, found = transfer_start_weights(load_file(encoder)), load_file(trained), load_file(out)
    for name, value in found.items():
        given = eyes[name] if name in eyes and eyes[name].shape == value.shape else first[name]
        torch.testing.assert_close(value.float(), given.float(), rtol=1e-2, atol=1e-3, msg=name)
    assert any(not torch.equal(eyes[name].float(), first[name].float()) for name in eyes if name in first)


def test_a_share_of_the_start_can_be_kept(town: Path, trained: Path, tmp_path: Path) -> None:
    found = {}
    for kept in ("0", "0.25"):
        out = tmp_path / f"{kept}.safetensors"
        done = challenger_bench(
            "train", "planner", "--model", MODEL, "--data", town, "--split", "val", "--out", out, "--steps", "2",
            "--only", "planner", "--learning-rate", "0.05", "--start-from", trained, "--kept-of-start", kept,
            "--workers", "1",
        )  # fmt: skip
        assert done.code == 0, done.err
        assert done.json.get("kept_of_start", 0) == float(kept)
        found[kept] = {name: value.float() for name, value in load_file(out).items()}
    assert "25% of them kept" in (tmp_path / "0.25.md").read_text() and "kept" not in (tmp_path / "0.md").read_text()
    moved = 0
    for name, start in load_file(trained).items():
        learned, mean = found["0"][name], found["0.25"][name]
        torch.testing.assert_close(mean, 0.75 * learned + 0.25 * start.float(), rtol=2e-3, atol=1e-4, msg=name)
        moved += not torch.equal(learned, mean)
    assert moved


@pytest.mark.parametrize("model", [MODEL, ENCODER_NAME])
def test_a_part_that_no_training_has_is_a_sentence(town: Path, tmp_path: Path, model: str) -> None:
    training = PlannerTraining(model, town, "val", tmp_path / "w.safetensors", only=("everything",))
    with pytest.raises(InputError, match=f"--only everything: the parts of the training of {model} are .*all"):
        train_planner(training)


def test_weights_that_cannot_be_started_from_are_a_sentence(town: Path, encoder: Path, tmp_path: Path) -> None:
    training = PlannerTraining(MODEL, town, "val", tmp_path / "w.safetensors", steps=1)
    (tmp_path / "broken.safetensors").write_bytes(b"no")
    with pytest.raises(InputError, match="cannot read the weights"):
        train_planner(replace(training, start_from=(tmp_path / "broken.safetensors",)))
    save_file({"other": torch.zeros(2)}, tmp_path / "other.safetensors")
    with pytest.raises(InputError, match="no weights of an image encoder"):
        train_planner(replace(training, image_encoder=tmp_path / "other.safetensors"))
    with pytest.raises(InputError, match="none of the weights to start from fit this model"):
        train_planner(replace(training, start_from=(tmp_path / "other.safetensors",)))
    assert not (tmp_path / "w.safetensors").exists()


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


def test_a_data_set_without_the_split_is_a_sentence_and_exit_code_2(town: Path, tmp_path: Path) -> None:
    out = tmp_path / "w.safetensors"
    done = challenger_bench("train", "planner", "--model", MODEL, "--data", town, "--split", "nonsense", "--out", out)
    assert done.code == 2 and "nonsense" in done.err and "Traceback" not in done.err
