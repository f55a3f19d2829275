"""VAD as a planner: what reaches its network, and its weights."""

from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from adapters.camera_inputs import BGR_MEAN, RGB_MEAN_STD, NetworkImageFormat
from adapters.checkpoints.cache import write_weights
from adapters.checkpoints.checkpoint_import import import_checkpoint
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD, VADInputs
from adapters.networks.vad.planner import VADPlanner
from adapters.networks.vad.selection import VADOutputs
from adapters.registry import build_planner, planner_factory
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from tests.adapters.networks.small_planners import VAD_CONFIG, plans, small_vad


def test_the_normalisation_of_the_weights_reaches_the_pixels_and_single_precision_is_not_rounded(
    data: NuScenesData,
) -> None:
    """Graphics cards round single precision unless they are told not to."""
    seen = next(data.observations("scene-9901"))
    received: list[VADInputs] = []
    inside: list[tuple[bool, str]] = []

    def arithmetic() -> tuple[bool, str]:
        return torch.backends.cudnn.allow_tf32, torch.get_float32_matmul_precision()

    class Listening(VAD):
        def forward(self, inputs: VADInputs) -> VADOutputs:
            received.append(inputs)
            inside.append(arithmetic())
            return super().forward(inputs)

    before = arithmetic()
    for variant in (BGR_MEAN, RGB_MEAN_STD):
        built = small_vad(Listening, normalisation=variant)
        assert built.settings["normalisation"] == variant.name
        built.plan(seen)
    assert set(inside) == {(False, "highest")} and arithmetic() == before
    (first, second), colour = received, seen.views["CAM_FRONT"].load()[0, 0].astype(float)
    assert first.images.shape == (6, 3, *NetworkImageFormat.scaled(0.1).padded)
    assert first.images[0, :, 0, 0].tolist() == pytest.approx(list(colour[::-1] - BGR_MEAN.mean), abs=1e-3)
    expected = (colour - RGB_MEAN_STD.mean) / RGB_MEAN_STD.std
    assert second.images[0, :, 0, 0].tolist() == pytest.approx(list(expected), abs=1e-3)
    assert first.scene_token == "scene-9901" and first.command == int(seen.command)
    assert first.can_bus.shape == (18,) and first.can_bus.dtype == torch.float64


# --- by name, with weights


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own, and ``vad-tiny`` a network that is built at once."""
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(VADConfig, "tiny", lambda: VAD_CONFIG)
    return tmp_path / "cache" / "weights"


def published(path: Path) -> Path:
    torch.manual_seed(4)
    torch.save({"meta": {"epoch": 60}, "state_dict": VAD(VAD_CONFIG).state_dict()}, path)
    return path


def test_a_planner_by_name_takes_either_form_of_checkpoint(cache: Path, tmp_path: Path, data: NuScenesData) -> None:
    path = published(tmp_path / "official.pth")
    first = planner_factory("vad-tiny", checkpoint=path)
    (imported,) = cache.glob("vad-tiny-*.safetensors")
    second, third = planner_factory("vad-tiny", checkpoint=imported), planner_factory("vad-tiny")
    assert first.facts.name == "vad-tiny" and not first.facts.privileged
    assert first.facts.weights_sha256 == second.facts.weights_sha256 == third.facts.weights_sha256
    assert first.facts.settings["weights"]["source"] == "official.pth"
    built = [made() for made in (first, second, third)]
    results = [plans(one, data, "scene-9902") for one in built if isinstance(one, VADPlanner)]
    assert np.array_equal(results[0], results[1]) and np.array_equal(results[0], results[2])


def test_other_weights_are_another_planner(cache: Path, tmp_path: Path) -> None:
    path = published(tmp_path / "a.pth")
    first = import_checkpoint(path)
    assert first.provenance.model == "vad-tiny"
    usual = planner_factory("vad-tiny").facts
    changed = import_checkpoint(path, normalisation="rgb-mean-std").path
    other = planner_factory("vad-tiny", checkpoint=changed).facts
    assert usual.settings["normalisation"] == "bgr-mean" and other.settings["normalisation"] == "rgb-mean-std"
    assert usual.weights_sha256 != other.weights_sha256
    for checkpoint in (None, path):
        with pytest.raises(InputError, match="several weights for vad-tiny"):
            build_planner("vad-tiny", checkpoint=checkpoint)
    later = tmp_path / "later.safetensors"
    write_weights(later, load_file(first.path), first.provenance.model_copy(update={"normalisation": "grey"}))
    with pytest.raises(InputError, match="unknown normalisation 'grey'; use one of bgr-mean, rgb-mean-std"):
        build_planner("vad-tiny", checkpoint=later)
