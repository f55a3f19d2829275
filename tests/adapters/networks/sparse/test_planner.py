"""SparseDrive and DiffusionDrive as planners: from observation to plan, identity, memory, noise, evaluation."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import safetensors.torch
import torch

from adapters.camera_inputs import RGB_MEAN_STD, SPARSE_DRIVE_IMAGE
from adapters.checkpoints.checkpoint_import import import_checkpoint, match_model
from adapters.networks.sparse.anchors import BOXES, FORECASTS, LINES, PLANS
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import SparseDrive, SparseInputs
from adapters.networks.sparse.planner import SparsePlanner
from adapters.networks.sparse.selection import SparseOutputs
from adapters.registry import planner_factory
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.evaluation import evaluate
from benchmark.geometry import transform_matrix
from benchmark.machine.storage import file_sha256
from benchmark.planning import SceneInfo
from benchmark.records.planner_versions import label_versions
from benchmark.runs.planner_facts import build_planner_facts
from tests.adapters.networks.small_planners import plans, small_sparse
from tests.adapters.networks.sparse.miniature import MINIATURE, filled
from tests.adapters.networks.test_native_planners import Factory

NAMES = ("sparsedrive", "diffusiondrive")


def test_what_the_network_receives_is_what_the_observation_says(data: NuScenesData) -> None:
    received: list[SparseInputs] = []

    class Listening(SparseDrive):
        def forward(self, inputs: SparseInputs, noise: torch.Tensor | None = None) -> SparseOutputs:
            received.append(inputs)
            return super().forward(inputs, noise)

    torch.manual_seed(0)
    built = SparsePlanner(Listening(MINIATURE), name="listening", normalisation=RGB_MEAN_STD, device="cpu")
    seen = next(data.observations("scene-9901"))
    built.plan(seen)
    (inputs,) = received
    assert inputs.images.shape == (6, 3, 64, 128) and inputs.projections.shape == (6, 4, 4)
    colour = seen.views["CAM_FRONT"].load()[0, 0].astype(float)
    expected = (colour - RGB_MEAN_STD.mean) / RGB_MEAN_STD.std
    assert inputs.images[0, :, 5, 5].tolist() == pytest.approx(list(expected), abs=1e-3)
    assert inputs.timestamp_s == seen.timestamp_us / 1e6
    assert (inputs.command, inputs.scene_token) == (int(seen.command), "scene-9901")
    pose = transform_matrix(seen.ego.rotation, seen.ego.position) @ transform_matrix(
        seen.lidar.rotation, seen.lidar.translation
    )
    assert inputs.global_T_lidar.dtype == torch.float64 and np.allclose(inputs.global_T_lidar.numpy(), pose)


def test_images_are_scaled_and_cut_as_published() -> None:
    assert SparseConfig().image_format == SPARSE_DRIVE_IMAGE
    for config, rows, cut in ((SparseConfig.sparsedrive_base(), 792, 280), (MINIATURE, 72, 8)):
        found = config.image_format
        assert (found.height, found.crop_top) == (rows, cut)
        assert found.padded == (config.image_height_px, config.image_width_px)


def test_noise_comes_from_the_seed_and_belongs_to_the_run(data: NuScenesData) -> None:
    first, again, other = (plans(small_sparse("diffusiondrive", seed=seed), data, "scene-9902") for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    assert build_planner_facts(small_sparse("diffusiondrive", seed=2)).seed == 2
    alone = plans(small_sparse("diffusiondrive", seed=1), data, "scene-9902", first=1)
    built = small_sparse("diffusiondrive", seed=1)
    seen = list(data.observations("scene-9902"))[1]
    built.reset(SceneInfo("scene-9902", "boston-seaport", ()))
    assert np.array_equal(built.plan(seen).waypoints, alone[0]), "noise depends on scene and time, not on the order"


# --- from end to end


def test_several_seeds_are_several_rows(data: NuScenesData, tmp_path: Path) -> None:
    factories = [Factory("diffusiondrive", seed=seed) for seed in (0, 1)]
    records = [evaluate(data, "val", factory, tmp_path) for factory in factories]
    assert records[0].directory != records[1].directory
    assert [record.planner for record in label_versions(records)] == [f"diffusiondrive (seed {k})" for k in (0, 1)]


# --- by name, with weights


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """A cache of its own, and networks that are built at once."""
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    for name in NAMES:
        monkeypatch.setattr(SparseConfig, name, lambda: MINIATURE)
    yield tmp_path / "cache" / "weights"


def published(name: str, folder: Path) -> Path:
    path = folder / f"{name}.pth"
    torch.save({"meta": {"epoch": 10}, "state_dict": filled(name).state_dict(), "optimizer": {"state": {}}}, path)
    return path


@pytest.mark.parametrize("name", NAMES)
def test_an_import_finds_out_the_model_and_its_pixel_values(name: str, cache: Path, tmp_path: Path) -> None:
    path = published(name, tmp_path)
    found = import_checkpoint(path)
    assert found.provenance.model == name and found.provenance.normalisation == "rgb-mean-std"
    factory = planner_factory(name, checkpoint=path, seed=5)
    assert factory.facts.seed == 5 and factory.facts.native_protocol == name
    assert factory.facts.weights_sha256 == planner_factory(name).facts.weights_sha256 == file_sha256(found.path)
    assert factory.facts.settings["weights"]["source"] == path.name
    built = factory()
    assert isinstance(built, SparsePlanner) and built.seed == (5 if name == "diffusiondrive" else 0)


def test_anchors_come_from_the_checkpoint_and_missing_ones_are_named(cache: Path, tmp_path: Path) -> None:
    tensors = dict(filled("sparsedrive").state_dict())
    name = "head.motion_plan_head.plan_anchor"
    tensors[name] = torch.full_like(tensors[name], 7.0)
    _, found = match_model(tmp_path / "a.pth", tensors, "sparsedrive")
    assert bool((found[name] == 7).all())
    without = {key: value for key, value in tensors.items() if key != name}
    with pytest.raises(InputError, match=rf"1 missing \(first: {name}\)"):
        match_model(tmp_path / "a.pth", without, "sparsedrive")
    other = {**tensors, name: torch.zeros(3, 7, 6, 2)}
    with pytest.raises(InputError, match=rf"1 of another shape \(first: {name} \(3, 7, 6, 2\) instead of"):
        match_model(tmp_path / "a.pth", other, "sparsedrive")


def test_weights_without_anchors_take_those_of_a_data_set_and_others_refuse_them(cache: Path, tmp_path: Path) -> None:
    state = filled("sparsedrive").state_dict()
    made = {name: state[name] + 1.0 for name in (BOXES, LINES, FORECASTS, PLANS)}
    anchors = tmp_path / "anchors.safetensors"
    facts = {"challenger-bench-anchors": json.dumps({"model": "sparsedrive"})}
    anchors.write_bytes(safetensors.torch.save(made, facts))
    bare = tmp_path / "bare.pth"
    torch.save({"state_dict": {name: tensor for name, tensor in state.items() if name not in made}}, bare)
    with pytest.raises(InputError, match="4 missing"):
        import_checkpoint(bare)
    found = import_checkpoint(bare, anchors=anchors)
    assert found.provenance.anchors_sha256 == file_sha256(anchors)
    held = safetensors.torch.load_file(found.path)
    assert all(torch.equal(held[name], tensor) for name, tensor in made.items())
    with pytest.raises(InputError, match="was trained with other anchors"):
        import_checkpoint(published("sparsedrive", tmp_path), anchors=anchors)
    with pytest.raises(InputError, match="is not a checkpoint of UniAD"):
        import_checkpoint(bare, anchors=bare)
    anchors.write_bytes(anchors.read_bytes()[:-8])
    with pytest.raises(InputError, match="cannot read anchors"):
        import_checkpoint(bare, anchors=anchors)
