"""VAD as a planner: from observation to plan, its identity, its memory, and a whole evaluation."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from adapters.camera_inputs import BGR_MEAN, RGB_MEAN_STD, NetworkImageFormat, PixelNormalisation
from adapters.checkpoints.cache import write_weights
from adapters.checkpoints.checkpoint_import import import_checkpoint
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD, VADInputs
from adapters.networks.vad.planner import VADPlanner, example_frame
from adapters.networks.vad.selection import VADOutputs
from adapters.registry import build_planner, planner_factory
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.planning import Observation, PlanFrame, SceneInfo
from benchmark.runs.planner_facts import build_planner_facts
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root

SMALL = replace(
    VADConfig.tiny(),
    bev_rows=10,
    bev_columns=10,
    encoder_layers=1,
    decoder_layers=1,
    channels=32,
    feedforward_channels=32,
    heads=4,
    agents=12,
    map_instances=6,
    backbone_blocks=(1, 1, 1, 1),
    backbone_width=8,
    max_boxes=8,
    max_lines=5,
    image_scale=0.1,
)


def small_vad(normalisation: PixelNormalisation = BGR_MEAN, **kwargs: Any) -> VADPlanner:
    torch.manual_seed(3)
    return VADPlanner(VAD(SMALL), name="small-vad", normalisation=normalisation, device="cpu", **kwargs)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    root = tmp_path_factory.mktemp("root")
    write_root(root, [short_scene("scene-9901", seconds=4.5), short_scene("scene-9902", ego_speed=3.0)])
    return NuScenesData.open(root)


def plans(built: VADPlanner, data: NuScenesData, name: str, *, first: int = 0) -> np.ndarray[Any, Any]:
    scene = data.scene(name)
    built.reset(SceneInfo(name, scene.road_map.location, scene.cameras))
    return np.stack([built.plan(seen).waypoints for seen in list(data.observations(name))[first:]])


def test_a_plan_has_modes_by_command_and_forecasts(data: NuScenesData) -> None:
    seen = next(data.observations("scene-9901"))
    plan = small_vad().plan(seen)
    assert plan.frame is PlanFrame.LIDAR and plan.modes is not None and plan.modes.shape == (3, 6, 2)
    assert np.array_equal(plan.waypoints, plan.modes[int(seen.command)])
    for command, mode in enumerate(plan.modes):
        other = small_vad().plan(replace(seen, command=type(seen.command)(command)))
        assert np.array_equal(other.waypoints, mode)
    assert plan.forecasts is not None
    count = len(plan.forecasts.boxes)
    assert plan.forecasts.boxes.shape == (count, 5) and plan.forecasts.trajectories.shape == (count, 6, 6, 2)
    assert plan.forecasts.scores.shape == (count, 6)


def test_the_past_of_a_scene_counts_and_that_of_another_does_not(data: NuScenesData) -> None:
    built = small_vad()
    alone = plans(small_vad(), data, "scene-9901")
    plans(built, data, "scene-9902")
    assert np.array_equal(plans(built, data, "scene-9901"), alone)
    late = plans(built, data, "scene-9901", first=2)
    assert not np.allclose(late[0], alone[2], atol=1e-6)


def test_forecasts_are_boxes_of_this_project(data: NuScenesData) -> None:
    class Fixed(VAD):
        def forward(self, inputs: VADInputs) -> VADOutputs:
            box = torch.tensor([[5.0, 20.0, -1.0, 2.0, 4.5, 1.6, 1.5, 0.0, 9.0]])
            scores = torch.tensor([0.9, self.config.reporting.least_score - 0.01])
            return replace(
                super().forward(inputs),
                boxes=box.expand(2, 9),
                box_scores=scores,
                box_labels=torch.zeros(2),
                trajectories=torch.full((2, 6, 6, 2), 7.0),
                trajectory_scores=torch.full((2, 6), 1 / 6),
            )

    built = VADPlanner(Fixed(SMALL), name="fixed", normalisation=BGR_MEAN, device="cpu")
    forecasts = built.plan(next(data.observations("scene-9901"))).forecasts
    assert forecasts is not None and np.allclose(forecasts.boxes, [[5.0, 20.0, 4.5, 2.0, 1.5]])
    assert forecasts.trajectories.shape == (1, 6, 6, 2) and forecasts.scores.sum() == pytest.approx(1.0)


def test_the_normalisation_of_the_weights_reaches_the_pixels(data: NuScenesData) -> None:
    seen = next(data.observations("scene-9901"))
    received: list[VADInputs] = []

    class Listening(VAD):
        def forward(self, inputs: VADInputs) -> VADOutputs:
            received.append(inputs)
            return super().forward(inputs)

    for variant in (BGR_MEAN, RGB_MEAN_STD):
        built = VADPlanner(Listening(SMALL), name="listening", normalisation=variant, device="cpu")
        assert built.settings["normalisation"] == variant.name
        built.plan(seen)
    (first, second), colour = received, seen.views["CAM_FRONT"].load()[0, 0].astype(float)
    assert first.images.shape == (6, 3, *NetworkImageFormat.scaled(0.1).padded)
    assert first.images[0, :, 0, 0].tolist() == pytest.approx(list(colour[::-1] - BGR_MEAN.mean), abs=1e-3)
    expected = (colour - RGB_MEAN_STD.mean) / RGB_MEAN_STD.std
    assert second.images[0, :, 0, 0].tolist() == pytest.approx(list(expected), abs=1e-3)
    assert first.scene_token == "scene-9901" and first.command == int(seen.command)
    assert first.can_bus.shape == (18,) and first.can_bus.dtype == torch.float64


def test_single_precision_is_not_rounded_on_graphics_cards(data: NuScenesData) -> None:
    inside: list[tuple[bool, str]] = []

    def arithmetic() -> tuple[bool, str]:
        return torch.backends.cudnn.allow_tf32, torch.get_float32_matmul_precision()

    class Listening(VAD):
        def forward(self, inputs: VADInputs) -> VADOutputs:
            inside.append(arithmetic())
            return super().forward(inputs)

    before = arithmetic()
    built = VADPlanner(Listening(SMALL), name="listening", normalisation=BGR_MEAN, device="cpu")
    built.plan(next(data.observations("scene-9901")))
    assert inside == [(False, "highest")] and arithmetic() == before


def test_half_precision_plans_nearly_the_same(data: NuScenesData) -> None:
    full, half = (plans(small_vad(precision=kind), data, "scene-9902") for kind in ("float32", "bfloat16"))
    assert not np.array_equal(full, half) and np.abs(full - half).max() < 0.1


def test_an_evaluation_runs_from_end_to_end_and_again_gives_the_same(data: NuScenesData, tmp_path: Path) -> None:
    def factory() -> Any:
        return _Small()

    records = [evaluate(data, "val", factory(), tmp_path / str(run), EvalSettings(workers=1)) for run in range(2)]
    assert records[0].run.status == "complete" and records[0].run.planner.settings["normalisation"] == "bgr-mean"
    first, second = ((tmp_path / str(run)).rglob("samples.jsonl") for run in range(2))
    assert next(first).read_bytes() == next(second).read_bytes()


class _Small:
    """What `planner_factory` makes, for a network of the tests."""

    facts = property(lambda self: build_planner_facts(self()))

    def __call__(self) -> VADPlanner:
        return small_vad()


def test_a_scene_without_images_is_one_sentence(data: NuScenesData) -> None:
    seen: Observation = next(data.observations("scene-9901"))
    with pytest.raises(InputError, match="has no image of CAM_FRONT"):
        small_vad().plan(replace(seen, views={}))


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
        VADPlanner(VAD(SMALL), name="small", normalisation=BGR_MEAN, **options)


# --- by name, with weights


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own, and ``vad-tiny`` a network that is built at once."""
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(VADConfig, "tiny", lambda: SMALL)
    return tmp_path / "cache" / "weights"


def published(path: Path) -> Path:
    torch.manual_seed(4)
    torch.save({"meta": {"epoch": 60}, "state_dict": VAD(SMALL).state_dict()}, path)
    return path


def test_registered_names_need_weights_and_say_where_they_are(cache: Path) -> None:
    for name in ("vad", "vad-tiny", "vad-base"):
        with pytest.raises(InputError, match=r"there are no weights for vad-.*; get VAD_.*weights import VAD_"):
            build_planner(name)


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
    import_checkpoint(path)
    usual = planner_factory("vad-tiny").facts
    changed = import_checkpoint(path, normalisation="rgb-mean-std").path
    other = planner_factory("vad-tiny", checkpoint=changed).facts
    assert usual.settings["normalisation"] == "bgr-mean" and other.settings["normalisation"] == "rgb-mean-std"
    assert usual.weights_sha256 != other.weights_sha256
    for checkpoint in (None, path):
        with pytest.raises(InputError, match="several weights for vad-tiny"):
            build_planner("vad-tiny", checkpoint=checkpoint)


def test_weights_with_pixel_values_of_a_later_version_are_one_sentence(cache: Path, tmp_path: Path) -> None:
    found = import_checkpoint(published(tmp_path / "a.pth"))
    later = tmp_path / "later.safetensors"
    write_weights(later, load_file(found.path), found.provenance.model_copy(update={"normalisation": "grey"}))
    with pytest.raises(InputError, match="unknown normalisation 'grey'; use one of bgr-mean, rgb-mean-std"):
        build_planner("vad-tiny", checkpoint=later)


def test_an_import_finds_out_the_model(cache: Path, tmp_path: Path) -> None:
    assert import_checkpoint(published(tmp_path / "a.pth")).provenance.model == "vad-tiny"


def test_every_native_model_has_example_inputs_of_its_size() -> None:
    for config, height, width in ((VADConfig.tiny(), 384, 640), (VADConfig.base(), 736, 1280)):
        assert example_frame(config).images.shape == (6, 3, height, width)
