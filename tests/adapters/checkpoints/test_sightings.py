"""What a data set holds for anchors, against hand-made scenes and slow ways; anchors on disk and by command."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import shapely
import torch
from numpy.typing import ArrayLike

from adapters.checkpoints.anchor_files import (
    agent_futures,
    box_centres,
    collect_anchor_samples,
    line_centres,
    read_anchors,
    write_anchors,
)
from adapters.networks.sparse.anchors import BOXES, FORECASTS, LINES, PLANS, add_anchors, cluster_anchors
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import SparseDrive
from benchmark.constants import DETECTION_CLASS_OF_CATEGORY, DETECTION_CLASSES
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.geometry import Floats, rotation_matrix
from benchmark.road_map import RoadMap, as_multipolygon
from benchmark.scene import Scene
from tests.adapters.networks.sparse.miniature import MINIATURE
from tests.benchmark.cli.cli_runs import challenger_bench
from tests.generation.nuscenes_writer.written_roots import short_scene, write_root
from tests.hand_made import Car, straight_road

FEW = replace(MINIATURE, anchors=24, lines=3, remembered_lines=1, modes=2)
WALKER = Car(70.0, 206.0, 1.0, np.pi / 2, "human.pedestrian.adult", (0.6, 0.7, 1.8))
DOG = Car(72.0, 207.0, 1.0, np.pi / 2, "animal", (0.6, 0.4, 0.5))


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    root = tmp_path_factory.mktemp("root")
    cars = (Car(80.0, 198.25, 8.0), Car(120.0, 201.75, 9.0, np.pi), WALKER, DOG)
    scenes = [short_scene(f"scene-990{n}", seconds=8.5, ego_speed=2.0 + 3 * n, cars=cars) for n in range(3)]
    write_root(root, scenes, renderer=None)
    return NuScenesData.open(root)


@pytest.fixture(scope="module")
def scene(data: NuScenesData) -> Scene:
    return data.scene("scene-9901")


def classes_of(scene: Scene) -> list[int]:
    return [
        DETECTION_CLASSES.index(DETECTION_CLASS_OF_CATEGORY[kind]) if kind != "animal" else -1
        for kind in scene.agents.categories
    ]


def test_box_centres_are_in_the_lidar_frame_of_their_key_frame(scene: Scene) -> None:
    found = box_centres(scene, classes_of(scene))
    expected: list[Floats] = []
    for keyframe, frame in enumerate(scene.keyframes):
        for agent, kind in enumerate(scene.agents.categories):
            if kind == "animal" or not scene.annotations.valid[agent, keyframe]:
                continue
            in_ego = rotation_matrix(scene.ego.rotation[frame]).T @ (
                scene.annotations.position[agent, keyframe] - scene.ego.position[frame]
            )
            expected.append(rotation_matrix(scene.lidar.rotation).T @ (in_ego - scene.lidar.translation))
    assert len(expected) > 20 and np.allclose(found, expected, atol=1e-9)
    leader = found[0]
    assert leader[1] > 20 and abs(leader[0]) < 0.5, "straight ahead is y"


def test_futures_begin_at_the_agent_and_have_no_gaps(scene: Scene) -> None:
    walker = scene.agents.categories.index("human.pedestrian.adult")
    keyframes = len(scene.keyframes)
    found = agent_futures(scene, walker, 12)
    assert found.shape == (keyframes - 12, 12, 2)
    steps = 0.5 * np.arange(1, 13)
    assert np.allclose(found[0], np.column_stack([steps, np.zeros(12)]), atol=1e-2), "x is forward"
    valid = scene.annotations.valid.copy()
    valid[walker, 4] = False
    gap = replace(scene, annotations=replace(scene.annotations, valid=valid))
    assert len(agent_futures(gap, walker, 12)) == sum(not start <= 4 <= start + 12 for start in range(keyframes - 12))
    assert agent_futures(scene, walker, 40).shape == (0, 40, 2)


def test_map_elements_are_cut_at_the_rectangle_around_the_lidar() -> None:
    road = straight_road()
    for x, heading in ((100.0, 0.0), (100.0, np.pi)):
        found = line_centres(road, np.array([x, 198.25, heading]), 20)
        turn = 1 if heading == 0 else -1
        lines = turn * np.array([198.25 - y for y in (200.0, 196.5, 203.5, 193.0, 207.0)])
        expected = np.column_stack([lines, np.zeros(5)])
        assert np.allclose(sorted(found.tolist()), sorted(expected.tolist()), atol=1e-6), "right is x"
    crossing = line_centres(road, np.array([152.0, 198.25, 0.0]), 401)
    ahead = line_centres(road, np.array([152.0 - 29.0, 198.25, 0.0]), 401)
    assert len(crossing) == 6 and len(ahead) == 6
    nothing = RoadMap("boston-seaport", as_multipolygon(shapely.Polygon()))
    assert line_centres(nothing, np.zeros(3), 20).shape == (0, 2)
    assert line_centres(road, np.array([5000.0, 0.0, 1.0]), 20).shape == (0, 2)
    assert np.allclose(crossing[0], [-1.75, 0.0], atol=0.05), "the outline of the crossing, around its centre"
    assert 27.0 < ahead[0, 1] < 30.0, "of a crossing that is cut, the part that is inside"


def test_a_split_is_gathered_whole(data: NuScenesData) -> None:
    found = collect_anchor_samples(data, "val", MINIATURE)
    scenes = [data.scene(name) for name in data.scene_names("val")]
    assert len(np.asarray(found.box_centres)) == sum(len(box_centres(scene, classes_of(scene))) for scene in scenes)
    assert [len(np.asarray(futures)) > 0 for futures in found.futures] == [
        name in ("car", "pedestrian") for name in DETECTION_CLASSES
    ]
    right, left, straight = (np.asarray(plans) for plans in found.plans)
    assert right.shape == left.shape == (0, 6, 2)
    truths = [truth for name in data.scene_names("val") for truth in data.truth(name) if truth.complete]
    assert np.array_equal(straight, [truth.ego_future[:, :2] for truth in truths])
    with pytest.raises(InputError, match="no-such-split"):
        collect_anchor_samples(data, "no-such-split", MINIATURE)
    with pytest.raises(InputError, match="plans of 6 steps"):
        collect_anchor_samples(data, "val", replace(MINIATURE, steps=5))


def turning(data: NuScenesData, config: SparseConfig) -> dict[str, torch.Tensor]:
    """Anchors where the missing commands are made up: hand-made scenes only go straight on."""
    found = collect_anchor_samples(data, "val", config)
    straight = np.asarray(found.plans[2])
    plans: list[ArrayLike] = [straight + [side, 0.0] for side in (5.0, -5.0, 0.0)]
    return cluster_anchors(replace(found, plans=plans), config)


def test_anchors_of_a_data_set_fit_a_network_and_are_refused_by_one_with_others(data: NuScenesData) -> None:
    anchors = turning(data, FEW)
    network = SparseDrive(FEW)
    state = {name: tensor + 1.0 for name, tensor in network.state_dict().items()}
    bare = {name: tensor for name, tensor in state.items() if name not in anchors}
    network.load_state_dict(add_anchors(bare, anchors), strict=True)
    with pytest.raises(InputError, match="was trained with other anchors"):
        add_anchors(state, anchors)


def test_a_small_data_set_is_one_sentence(data: NuScenesData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SparseConfig, "sparsedrive", lambda: FEW)
    with pytest.raises(InputError, match="0 different plans of command 0 but anchors need 2"):
        write_anchors("sparsedrive", data, "val", tmp_path / "a.safetensors")
    with pytest.raises(InputError, match="'vad' is not a model with anchors"):
        write_anchors("vad", data, "val", tmp_path / "a.safetensors")
    assert not (tmp_path / "a.safetensors").exists()


def test_anchors_on_disk_are_the_same_bytes_and_read_back(
    data: NuScenesData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(SparseConfig, "diffusiondrive", lambda: FEW)
    monkeypatch.setattr(
        "adapters.checkpoints.anchor_files.cluster_anchors", lambda found, config: turning(data, config)
    )
    paths = [tmp_path / name / "anchors.safetensors" for name in "ab"]
    first, second = (write_anchors("diffusiondrive", data, "val", path) for path in paths)
    assert paths[0].read_bytes() == paths[1].read_bytes() and first.sha256 == second.sha256
    assert first.as_json()["model"] == "diffusiondrive" and first.sightings["plans"] > 10
    anchors, expected = read_anchors(paths[0]), turning(data, FEW)
    assert anchors.keys() == expected.keys() == {BOXES, LINES, FORECASTS, PLANS}
    assert all(torch.equal(anchors[name], expected[name]) for name in anchors)
    paths[1].write_bytes(paths[1].read_bytes()[:-10])
    with pytest.raises(InputError, match="cannot read anchors"):
        read_anchors(paths[1])
    with pytest.raises(InputError, match="cannot read anchors"):
        read_anchors(tmp_path / "absent.safetensors")


def test_the_command_says_what_it_lacks(data: NuScenesData, tmp_path: Path) -> None:
    out = tmp_path / "anchors.safetensors"
    for arguments, says in (
        (("--model", "vad", "--data", data.root), "not a model with anchors"),
        (("--model", "sparsedrive", "--data", data.root, "--split", "val"), "anchors need 900"),
    ):
        run = challenger_bench("weights", "anchors", *arguments, "--out", out)
        assert run.code == 2 and run.err.startswith("error: ") and says in run.err, run
        assert run.err.count("\n") == 1 and not out.exists()
