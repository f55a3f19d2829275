"""What all native planners do alike: from observation to plan, memory, precision, whole evaluations, absent weights."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.planner import example_frame as sparse_example
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.planner import example_frame as uniad_example
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.planner import example_frame as vad_example
from adapters.registry import build_planner
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.planning import PlanFrame
from benchmark.runs.planner_facts import build_planner_facts
from tests.adapters.networks.small_planners import NAMES, plans, small, small_vad


@pytest.mark.parametrize("name", NAMES)
def test_a_plan_follows_the_command_and_has_forecasts(name: str, data: NuScenesData) -> None:
    seen = next(data.observations("scene-9901"))
    chosen = []
    for command in type(seen.command):
        plan = small(name).plan(replace(seen, command=command))
        assert plan.frame is PlanFrame.LIDAR and plan.modes is not None and plan.waypoints.shape == (6, 2)
        chosen.append(plan.waypoints)
        if name == "vad":
            assert plan.modes.shape == (3, 6, 2) and np.array_equal(plan.waypoints, plan.modes[command])
        elif name != "uniad":
            assert plan.modes.shape == (6, 6, 2) and plan.mode_scores is not None
            assert np.array_equal(plan.waypoints, plan.modes[plan.mode_scores.argmax()])
    assert not np.array_equal(chosen[0], chosen[1]) and not np.array_equal(chosen[1], chosen[2])
    assert plan.forecasts is not None
    count = len(plan.forecasts.boxes)
    assert plan.forecasts.boxes.shape == (count, 5) and plan.forecasts.trajectories.shape == (count, 6, 6, 2)
    assert plan.forecasts.scores.sum(1) == pytest.approx(np.ones(count))


@pytest.mark.parametrize("name", NAMES)
def test_the_past_of_a_scene_counts_and_that_of_another_does_not(name: str, data: NuScenesData) -> None:
    built, alone = small(name), plans(small(name), data, "scene-9901")
    assert built.settings.get("memory_crosses_scenes", False) is False
    plans(built, data, "scene-9902")
    assert np.array_equal(plans(built, data, "scene-9901"), alone)
    assert not np.allclose(plans(built, data, "scene-9901", first=2)[0], alone[2], atol=1e-6)


@pytest.mark.parametrize("name", ["vad", "uniad-unoptimised", "sparsedrive", "diffusiondrive"])
def test_half_precision_plans_nearly_the_same(name: str, data: NuScenesData) -> None:
    seen = next(data.observations("scene-9902"))
    full, half = (small(name, precision=kind).plan(seen).modes for kind in ("float32", "bfloat16"))
    assert full is not None and half is not None
    assert not np.array_equal(full, half) and np.median(np.abs(full - half)) < 0.1


@pytest.mark.parametrize("name", NAMES)
def test_a_scene_without_images_is_one_sentence(name: str, data: NuScenesData) -> None:
    with pytest.raises(InputError, match="has no image of CAM_FRONT"):
        small(name).plan(replace(next(data.observations("scene-9901")), views={}))


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
        small_vad(**options)


class Factory:
    """What `planner_factory` makes, for a network of the tests."""

    def __init__(self, name: str, **settings: Any) -> None:
        self.name, self.settings = name, settings

    facts = property(lambda self: build_planner_facts(self()))

    def __call__(self) -> Any:
        return small(self.name, **self.settings)


@pytest.mark.parametrize(("name", "settings"), [("vad", {}), ("sparsedrive", {}), ("diffusiondrive", {"seed": 3})])
def test_an_evaluation_does_not_depend_on_the_number_of_processes(
    name: str, settings: dict[str, Any], data: NuScenesData, tmp_path: Path
) -> None:
    rows = []
    for workers in (1, 2):
        record = evaluate(
            data, "val", Factory(name, **settings), tmp_path / str(workers), EvalSettings(workers=workers)
        )
        assert record.run.status == "complete" and record.run.planner.seed == settings.get("seed", 0)
        (written,) = (tmp_path / str(workers)).rglob("samples.jsonl")
        rows.append(written.read_bytes())
    assert rows[0] == rows[1]


def test_example_inputs_have_the_published_sizes() -> None:
    for inputs, size in (
        (vad_example(VADConfig.tiny()), (384, 640)),
        (vad_example(VADConfig.base()), (736, 1280)),
        (uniad_example(UniADConfig.base()), (928, 1600)),
        (sparse_example(SparseConfig.sparsedrive()), (256, 704)),
        (sparse_example(SparseConfig.diffusiondrive()), (256, 704)),
    ):
        assert inputs.images.shape == (6, 3, *size)


def test_registered_names_need_weights_and_say_where_they_are(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path))
    anchors = r"uniad_base_e2e.pth from .*v1.0.1 and motion_anchor_infos_mode6.pkl from .*--anchors"
    for name, says in {
        "vad": r"weights for vad-base; get VAD_base.* from .*weights import VAD_",
        "vad-tiny": r"weights for vad-tiny; get VAD_tiny.* from .*weights import VAD_",
        "uniad": f"weights for uniad; get {anchors}",
        "uniad-unoptimised": f"weights for uniad; get {anchors}",
        "sparsedrive": r"weights for sparsedrive; get \S+ from .*weights import",
        "diffusiondrive": r"weights for diffusiondrive; get \S+ from .*weights import",
    }.items():
        with pytest.raises(InputError, match=f"no {says}"):
            build_planner(name)
