"""Native networks as in the published runs of their repositories: what is asked for, done, and named in the record."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.as_published import ALL, CAN_AFTER, CAN_ONCE, MEMORY, select_options
from adapters.camera_inputs import BGR_MEAN, RGB_MEAN_STD, can_bus_vector
from adapters.models import MODELS
from adapters.networks.sparse.planner import SparsePlanner
from adapters.networks.uniad.planner import UniADPlanner
from adapters.networks.vad.model import VAD
from adapters.networks.vad.planner import VADPlanner
from adapters.planner import NativePlanner
from adapters.registry import build_planner, planner_factory
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.evaluation import evaluate
from benchmark.geometry import Floats
from benchmark.planning import EgoState, SceneInfo, reads_message_after, remembers_across_scenes
from benchmark.records.planner_versions import label_versions
from benchmark.runs.plan_rows import scene_key
from benchmark.runs.planner_facts import build_planner_facts
from benchmark.runs.run_directory import run_directory
from tests.adapters.networks.sparse.miniature import MINIATURE, filled
from tests.adapters.networks.uniad.small_uniad import SMALL as SMALL_UNIAD
from tests.adapters.networks.uniad.small_uniad import small_network
from tests.adapters.networks.vad.small_vad import SMALL as SMALL_VAD
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    root = tmp_path_factory.mktemp("root")
    write_root(root, [short_scene("scene-9901", seconds=3.0), short_scene("scene-9902", ego_speed=3.0, seconds=3.0)])
    return NuScenesData.open(root)


def sparse(*options: str) -> SparsePlanner:
    config = replace(MINIATURE, memory_crosses_scenes=MEMORY in options)
    return SparsePlanner(
        filled("sparsedrive", config), name="small", normalisation=RGB_MEAN_STD, device="cpu", as_published=options
    )


def uniad(*options: str) -> UniADPlanner:
    network = small_network(config=replace(SMALL_UNIAD, motion_across_scenes=True))
    network.solver = None
    return UniADPlanner(network, name="small", normalisation=BGR_MEAN, device="cpu", as_published=options)


def plans(built: NativePlanner[Any], data: NuScenesData, name: str) -> Floats:
    scene = data.scene(name)
    built.reset(SceneInfo(name, scene.road_map.location, scene.cameras))
    return np.stack([built.plan(seen).waypoints for seen in data.observations(name)])


def test_what_is_asked_for_and_what_a_model_does() -> None:
    assert select_options("uniad", MODELS["uniad"].net.as_published, [ALL]) == (CAN_ONCE, CAN_AFTER)
    assert select_options("vad", MODELS["vad"].net.as_published, [CAN_AFTER]) == (CAN_AFTER,)
    assert select_options("sparsedrive", MODELS["sparsedrive"].net.as_published, []) == ()
    with pytest.raises(InputError, match="vad-tiny does not support --as-published memory: it has can-after"):
        select_options("vad-tiny", MODELS["vad-tiny"].net.as_published, [MEMORY])
    with pytest.raises(InputError, match="idm does not support --as-published all"):
        select_options("idm", {}, [ALL])
    with pytest.raises(InputError, match="did you mean memory"):
        select_options("uniad", {MEMORY}, ["memry"])
    with pytest.raises(InputError, match="does not take --as-published; leave it out"):
        build_planner("constant-velocity", as_published=[MEMORY])


@pytest.mark.parametrize("model", ["sparsedrive-mini", "diffusiondrive-mini", "uniad-mini", "vad-mini"])
def test_a_built_model_is_another_one_with_its_options(model: str) -> None:
    plain, published = planner_factory(model), planner_factory(model, as_published=[ALL])
    facts = published.facts
    assert facts.settings["as_published"] == "+".join(select_options(model, MODELS[model].net.as_published, [ALL]))
    assert scene_key("d", "val", "scene-1", facts) != scene_key("d", "val", "scene-1", plain.facts)
    one, other = (run_directory(Path("runs"), "mini", "val", each) for each in (plain.facts, facts))
    assert one != other and one.name == model
    built: Any = published()
    assert build_planner_facts(built).settings == {
        key: facts.settings[key] for key in build_planner_facts(built).settings
    }
    assert remembers_across_scenes(built) is (model != "vad-mini")
    assert reads_message_after(built) is (model in ("vad-mini", "uniad-mini"))
    if model == "uniad-mini":
        assert built.config.motion_across_scenes
    if model in ("sparsedrive-mini", "diffusiondrive-mini"):
        assert built._network.config.memory_crosses_scenes


def test_sparse_memory_outlives_a_scene_until_a_run_begins(data: NuScenesData) -> None:
    alone = plans(sparse(), data, "scene-9901")
    built = sparse(MEMORY)
    assert np.array_equal(plans(built, data, "scene-9901"), alone), "the first scene of a run has no past"
    after = plans(built, data, "scene-9902")
    assert np.abs(after[0] - plans(sparse(), data, "scene-9902")[0]).max() > 1e-4
    built.begin_run()
    assert np.array_equal(plans(built, data, "scene-9901"), alone)


def test_uniad_is_told_where_it_stands_in_the_first_frame_of_a_run_alone(data: NuScenesData) -> None:
    def motion(built: UniADPlanner, name: str) -> Floats:
        scene = data.scene(name)
        built.reset(SceneInfo(name, scene.road_map.location, scene.cameras))
        seen = next(data.observations(name))
        told = built._network.ego_motion(built.inputs(seen)).can_bus[:3].numpy()
        built.plan(seen)
        return np.asarray(told)

    plain, published = uniad(), uniad(CAN_ONCE)
    first, second = (next(data.observations(name)).ego.position for name in ("scene-9901", "scene-9902"))
    assert motion(plain, "scene-9901") == pytest.approx(first)
    assert motion(plain, "scene-9902") == pytest.approx(second)
    assert motion(published, "scene-9901") == pytest.approx(first)
    assert motion(published, "scene-9902") == pytest.approx(second - first)


def test_uniad_and_vad_read_the_message_after_the_sample(data: NuScenesData) -> None:
    seen = next(data.observations("scene-9901"))
    ego: EgoState = replace(seen.ego, can_motion=np.arange(9.0), can_motion_after=np.arange(10.0, 19.0))
    seen = replace(seen, ego=ego)
    for built in (uniad(CAN_AFTER), uniad()):
        expected = can_bus_vector(ego, after=built.reads_message_after)
        assert np.array_equal(built.inputs(seen).can_bus.numpy(), expected)
    vad = VADPlanner(VAD(SMALL_VAD), name="v", normalisation=BGR_MEAN, device="cpu", as_published=[CAN_AFTER])
    assert vad._inputs(seen).can_bus[7:16].tolist() == [13, 14, 15, 16, 17, 18, 10, 11, 12]
    assert can_bus_vector(ego)[7:16].tolist() == [3, 4, 5, 6, 7, 8, 0, 1, 2]


def test_a_split_is_evaluated_as_published_beside_the_run_without(data: NuScenesData, tmp_path: Path) -> None:
    plain, published = (evaluate(data, "val", built, tmp_path) for built in (sparse(), sparse(MEMORY)))
    assert plain.directory != published.directory
    moved = [
        np.abs(np.subtract(one.plan.waypoints, other.plan.waypoints)).max()
        for one, other in zip(plain.rows, published.rows, strict=True)
        if one.plan and other.plan
    ]
    half = len(moved) // 2
    assert max(moved[:half]) == 0.0 < moved[half]
    names = [record.planner for record in label_versions([plain, published])]
    assert names == ["small (as_published none)", "small (as_published memory)"]
