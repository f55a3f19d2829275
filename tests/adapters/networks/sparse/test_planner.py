"""SparseDrive and DiffusionDrive as planners: from observation to plan, identity, memory, noise, evaluation."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors.torch
import torch

from adapters.camera_inputs import RGB_MEAN_STD, SPARSE_DRIVE_IMAGE
from adapters.checkpoints.checkpoint_import import import_checkpoint, match_model
from adapters.models import MODELS
from adapters.networks.sparse.anchors import BOXES, FORECASTS, LINES, PLANS
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import SparseDrive, SparseInputs
from adapters.networks.sparse.planner import SparsePlanner, example_frame
from adapters.networks.sparse.selection import SparseOutputs
from adapters.registry import build_planner, planner_factory
from benchmark.constants import CAMERA_NAMES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.geometry import transform_matrix
from benchmark.machine.storage import file_sha256
from benchmark.planning import Observation, PlanFrame, SceneInfo
from benchmark.records.planner_versions import label_versions
from benchmark.runs.planner_facts import build_planner_facts
from benchmark.weights.catalogue import find_checkpoint
from tests.adapters.networks.sparse.miniature import MINIATURE, filled
from tests.adapters.real_sample import FRAME, SCENE, boxes_in_lidar, info, real_root
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

NAMES = ("sparsedrive", "diffusiondrive")
real = pytest.mark.skipif(not FRAME.is_dir(), reason="no shared material beside the repository")


def small(
    name: str = "sparsedrive", *, seed: int = 0, config: SparseConfig = MINIATURE, **kwargs: Any
) -> SparsePlanner:
    settings = {"seed": seed} if name == "diffusiondrive" else {}
    network = filled(name, config, **settings)
    known = {"name": name, "normalisation": RGB_MEAN_STD, "native_protocol": name, "device": "cpu"}
    return SparsePlanner(network, **{**known, **kwargs})


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    root = tmp_path_factory.mktemp("root")
    write_root(root, [short_scene("scene-9901", seconds=4.5), short_scene("scene-9902", ego_speed=3.0)])
    return NuScenesData.open(root)


def plans(built: SparsePlanner, data: NuScenesData, name: str, *, first: int = 0) -> np.ndarray[Any, Any]:
    scene = data.scene(name)
    built.reset(SceneInfo(name, scene.road_map.location, scene.cameras))
    return np.stack([built.plan(seen).waypoints for seen in list(data.observations(name))[first:]])


@pytest.mark.parametrize("name", NAMES)
def test_a_plan_is_the_likeliest_mode_of_the_command(name: str, data: NuScenesData) -> None:
    seen = next(data.observations("scene-9901"))
    chosen = []
    for command in type(seen.command):
        plan = small(name).plan(replace(seen, command=command))
        assert plan.frame is PlanFrame.LIDAR and plan.modes is not None and plan.mode_scores is not None
        assert plan.modes.shape == (6, 6, 2) and plan.mode_scores.shape == (6,)
        assert np.array_equal(plan.waypoints, plan.modes[plan.mode_scores.argmax()])
        chosen.append(plan.modes)
    assert not np.array_equal(chosen[0], chosen[1]) and not np.array_equal(chosen[1], chosen[2])
    assert small(name).native_protocol == name


@pytest.mark.parametrize("name", NAMES)
def test_the_past_of_a_scene_counts_and_that_of_another_does_not(name: str, data: NuScenesData) -> None:
    built = small(name)
    assert built.settings["memory_crosses_scenes"] is False
    alone = plans(small(name), data, "scene-9901")
    plans(built, data, "scene-9902")
    assert np.array_equal(plans(built, data, "scene-9901"), alone)
    late = plans(built, data, "scene-9901", first=2)
    assert not np.allclose(late[0], alone[2], atol=1e-6)


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


@pytest.mark.parametrize("name", NAMES)
def test_example_inputs_have_the_published_size(name: str) -> None:
    config = MODELS[name].configuration()
    assert not config.memory_crosses_scenes and example_frame(config).images.shape == (6, 3, 256, 704)


def test_forecasts_are_boxes_of_this_project(data: NuScenesData) -> None:
    class Fixed(SparseDrive):
        def forward(self, inputs: SparseInputs, noise: torch.Tensor | None = None) -> SparseOutputs:
            box = torch.tensor([[5.0, 20.0, -1.0, 2.0, 4.5, 1.6, 1.5, 0.0, 9.0]])
            steps = torch.arange(12.0)[:, None].expand(12, 2)
            return replace(
                super().forward(inputs, noise),
                boxes=box.expand(2, 9),
                box_scores=torch.tensor([0.9, MINIATURE.reporting.least_score - 0.01]),
                trajectories=steps.expand(2, 6, 12, 2),
                trajectory_scores=torch.tensor([[0.9, 0.45, 0.15, 0.0, 0.0, 0.0]] * 2),
            )

    built = SparsePlanner(Fixed(MINIATURE), name="fixed", normalisation=RGB_MEAN_STD, device="cpu")
    forecasts = built.plan(next(data.observations("scene-9901"))).forecasts
    assert forecasts is not None and np.allclose(forecasts.boxes, [[5.0, 20.0, 4.5, 2.0, 1.5]])
    assert forecasts.trajectories.shape == (1, 6, 6, 2), "three seconds of six"
    assert forecasts.trajectories[0, 0, :, 0].tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]
    assert forecasts.scores[0].tolist() == pytest.approx([0.6, 0.3, 0.1, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("name", NAMES)
def test_half_precision_plans_nearly_the_same(name: str, data: NuScenesData) -> None:
    seen = next(data.observations("scene-9902"))
    full, half = (small(name, precision=kind).plan(seen).modes for kind in ("float32", "bfloat16"))
    assert full is not None and half is not None
    assert not np.array_equal(full, half) and np.median(np.abs(full - half)) < 0.1


def test_noise_comes_from_the_seed_and_belongs_to_the_run(data: NuScenesData) -> None:
    first, again, other = (plans(small("diffusiondrive", seed=seed), data, "scene-9902") for seed in (1, 1, 2))
    assert np.array_equal(first, again) and not np.array_equal(first, other)
    assert build_planner_facts(small("diffusiondrive", seed=2)).seed == 2
    alone = plans(small("diffusiondrive", seed=1), data, "scene-9902", first=1)
    built = small("diffusiondrive", seed=1)
    seen = list(data.observations("scene-9902"))[1]
    built.reset(SceneInfo("scene-9902", "boston-seaport", ()))
    assert np.array_equal(built.plan(seen).waypoints, alone[0]), "noise depends on scene and time, not on the order"


# --- from end to end


class _Small:
    """What `planner_factory` makes, for a network of the tests."""

    def __init__(self, name: str, seed: int) -> None:
        self.name, self.seed = name, seed

    @property
    def facts(self) -> Any:
        return build_planner_facts(self())

    def __call__(self) -> SparsePlanner:
        return small(self.name, seed=self.seed)


@pytest.mark.parametrize("name", NAMES)
def test_an_evaluation_does_not_depend_on_the_number_of_processes(
    name: str, data: NuScenesData, tmp_path: Path
) -> None:
    rows = []
    for workers in (1, 2):
        settings = EvalSettings(workers=workers)
        record = evaluate(data, "val", _Small(name, 3), tmp_path / str(workers), settings)
        assert record.run.status == "complete" and record.run.planner.native_protocol == name
        assert record.run.planner.seed == (3 if name == "diffusiondrive" else 0)
        (written,) = (tmp_path / str(workers)).rglob("samples.jsonl")
        rows.append(written.read_bytes())
    assert rows[0] == rows[1]


def test_several_seeds_are_several_rows(data: NuScenesData, tmp_path: Path) -> None:
    records = [evaluate(data, "val", _Small("diffusiondrive", seed), tmp_path) for seed in (0, 1)]
    assert records[0].directory != records[1].directory
    assert [record.planner for record in label_versions(records)] == [
        "diffusiondrive (seed 0)",
        "diffusiondrive (seed 1)",
    ]


def test_a_scene_without_images_is_one_sentence(data: NuScenesData) -> None:
    seen: Observation = next(data.observations("scene-9901"))
    with pytest.raises(InputError, match="has no image of CAM_FRONT"):
        small().plan(replace(seen, views={}))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"device": "abacus"}, "unknown device 'abacus'"),
        ({"device": "cuda:97"}, "no GPU found for device 'cuda:97'"),
        ({"precision": "int4"}, "int4"),
    ],
)
def test_unknown_devices_and_precisions_are_one_sentence(options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        SparsePlanner(filled("sparsedrive"), name="small", normalisation=RGB_MEAN_STD, **options)


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
def test_registered_names_need_weights_and_say_where_they_are(name: str, cache: Path) -> None:
    (file,) = find_checkpoint(name).files
    with pytest.raises(InputError, match=rf"no weights for {name}; get {file.name} from .*weights import"):
        build_planner(name)


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


# --- a real sample


@real
def test_real_boxes_are_seen_where_another_project_sees_them(tmp_path: Path) -> None:
    (sample,) = real_root(tmp_path).observations(SCENE)
    received: list[SparseInputs] = []

    class Listening(SparseDrive):
        def forward(self, inputs: SparseInputs, noise: torch.Tensor | None = None) -> SparseOutputs:
            received.append(inputs)
            return super().forward(inputs, noise)

    config = replace(MINIATURE, image_height_px=256, image_width_px=704)
    built = SparsePlanner(Listening(config), name="listening", normalisation=RGB_MEAN_STD, device="cpu")
    assert np.isfinite(built.plan(sample).waypoints).all()
    (inputs,) = received
    theirs = info()
    boxes = boxes_in_lidar()
    points = np.column_stack([boxes[:, :3], np.ones(len(boxes))])
    seen = 0
    for name, matrix in zip(CAMERA_NAMES, inputs.projections.numpy()):
        projected = matrix @ points.T
        pixels = (projected[:2] / projected[2]).T[projected[2] > 0]
        for entry in theirs["cam_instances"][name]:
            expected = 0.44 * np.array(entry["center_2d"]) - [0, 140]
            assert np.linalg.norm(pixels - expected, axis=1).min() < 0.05
            seen += 1
    assert seen > 10
    assert inputs.timestamp_s == pytest.approx(theirs["timestamp"], abs=1e-6)
    lidar = np.array(theirs["ego2global"]) @ np.array(theirs["lidar_points"]["lidar2ego"])
    assert np.allclose(inputs.global_T_lidar.numpy(), lidar, atol=1e-3)
