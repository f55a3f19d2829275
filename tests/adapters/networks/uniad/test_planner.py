"""UniAD as a planner: from observation to plan, its variants, identity, memory, weights with anchors, evaluation."""

import importlib
import pickle
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from adapters.camera_inputs import BGR_MEAN, NetworkImageFormat
from adapters.checkpoints.anchor_files import FILE, read_motion_anchors
from adapters.checkpoints.cache import known_weights
from adapters.checkpoints.checkpoint_import import ImportedWeights, fetch_checkpoint, import_checkpoint
from adapters.models import MODELS, MOTION_ANCHORS
from adapters.networks.layers.reporting import PUBLISHED, ReportingRules
from adapters.networks.uniad import collision_optimiser as collision_solvers
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.planner import UniADPlanner
from adapters.planner import select_forecasts
from adapters.registry import build_planner, planner_factory
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.geometry import transform_matrix
from benchmark.planning import Observation, PlanFrame, SceneInfo
from benchmark.weights import fetch
from benchmark.weights.catalogue import PublishedFile, PublishedWeights, find_checkpoint
from leaderboard.build import build_leaderboard_files
from leaderboard.frame.results import read_results
from tests.adapters.networks.small_planners import UNIAD_CONFIG, small_uniad
from tests.adapters.networks.uniad.small_uniad import anchors, small_network
from tests.adapters.networks.vad.small_vad import small_network as small_vad


def begin(built: UniADPlanner, data: NuScenesData, name: str) -> Iterator[Observation]:
    scene = data.scene(name)
    built.reset(SceneInfo(name, scene.road_map.location, scene.cameras))
    yield from data.observations(name)


def test_a_plan_has_the_one_before_it_was_moved_and_forecasts(data: NuScenesData) -> None:
    built = small_uniad()
    plan = built.plan(next(begin(built, data, "scene-9901")))
    assert plan.frame is PlanFrame.LIDAR and plan.modes is not None and plan.modes.shape == (2, 6, 2)
    assert np.array_equal(plan.modes[1], plan.waypoints) and plan.mode_scores is None
    assert built.seen is not None and built.seen.collision is not None
    assert np.allclose(plan.modes[0], built.seen.plan_before_optimisation)
    assert plan.forecasts is not None
    count = int((built.seen.box_scores >= UNIAD_CONFIG.reporting.least_score).sum())
    assert 0 < count == len(plan.forecasts.boxes) and plan.forecasts.trajectories.shape == (count, 6, 6, 2)
    assert np.allclose(plan.forecasts.boxes[:, 2:4], built.seen.boxes[:count, [4, 3]])
    assert plan.forecasts.scores.sum(1) == pytest.approx(np.ones(count))


def test_tracks_keep_their_numbers_from_sample_to_sample(data: NuScenesData) -> None:
    built, numbers = small_uniad(), []
    for seen in begin(built, data, "scene-9901"):
        built.plan(seen)
        assert built.seen is not None
        numbers.append(set(built.seen.track_ids.tolist()))
    assert 0 in numbers[0] and any(one & other for one, other in pairwise(numbers))
    next(begin(built, data, "scene-9902"))
    assert built.seen is None


def test_what_the_network_receives_is_what_the_observation_says(data: NuScenesData) -> None:
    built = small_uniad()
    seen = list(begin(built, data, "scene-9901"))[1]
    inputs = built.inputs(seen)
    assert inputs.images.shape == (6, 3, *NetworkImageFormat.scaled(0.1).padded)
    colour = seen.views["CAM_FRONT"].load()[0, 0].astype(float)
    assert inputs.images[0, :, 0, 0].tolist() == pytest.approx(list(colour[::-1] - BGR_MEAN.mean), abs=1e-3)
    assert inputs.can_bus.dtype == torch.float64 and inputs.can_bus[:3].tolist() == pytest.approx(seen.ego.position)
    assert inputs.can_bus[3:7].tolist() == [seen.ego.rotation[0]] * 4
    assert (inputs.timestamp, inputs.command) == (seen.timestamp_us / 1e6, int(seen.command))
    assert inputs.scene_token == "scene-9901"
    global_T_lidar = transform_matrix(seen.ego.rotation, seen.ego.position) @ transform_matrix(
        seen.lidar.rotation, seen.lidar.translation
    )
    place = torch.tensor([3.0, -7.0, 0.5])
    expected = global_T_lidar @ [3.0, -7.0, 0.5, 1.0]
    assert (place @ inputs.l2g_r_mat + inputs.l2g_t).tolist() == pytest.approx(list(expected[:3]), abs=1e-3)


def test_variants_differ_in_what_happens_to_the_plan_and_say_so(data: NuScenesData) -> None:
    moved, unmoved = small_uniad(), small_uniad("uniad-unoptimised")
    assert moved.settings["collision_optimisation"] == "newton"
    assert unmoved.settings["collision_optimisation"] == "off"
    for seen in begin(moved, data, "scene-9902"):
        first, second = moved.plan(seen), unmoved.plan(seen)
        assert first.modes is not None and second.modes is not None and second.modes.shape == (1, 6, 2)
        assert np.array_equal(first.modes[0], second.waypoints)


# --- forecasts that are none


@pytest.mark.parametrize(
    ("place", "value"),
    [((1, 0), np.nan), ((1, 3), np.inf), ((1, 3), 0.0), ((1, 4), -1.0), ((1, 1), 3e4), ((1, 6), -np.inf)],
)
def test_what_is_no_box_is_left_out_and_the_rest_is_kept(place: tuple[int, int], value: float) -> None:
    boxes = torch.tensor([[5.0, 20.0, -1.0, 2.0, 4.5, 1.6, 1.5, 0.0, 9.0]]).repeat(4, 1)
    boxes[place] = value
    scores = torch.tensor([0.9, 0.8, 0.4, 0.39])
    found = select_forecasts(
        boxes, scores, torch.full((4, 6, 12, 2), 7.0), torch.full((4, 6), 1 / 6), ReportingRules(least_score=0.4)
    )
    assert np.allclose(found.boxes, [[5.0, 20.0, 4.5, 2.0, 1.5]] * 2)
    assert found.trajectories.shape == (2, 6, 6, 2) and found.scores.shape == (2, 6)


@pytest.mark.parametrize("part", ["trajectories", "shares", "scores"])
def test_a_forecast_that_is_not_finite_is_left_out(part: str) -> None:
    given = {
        "boxes": torch.ones(3, 7),
        "scores": torch.full((3,), 0.9),
        "trajectories": torch.ones(3, 2, 6, 2),
        "shares": torch.full((3, 2), 0.5),
    }
    given[part][1] = float("nan")
    assert len(select_forecasts(**given, reporting=PUBLISHED).boxes) == 2
    none = select_forecasts(**{name: tensor[:0] for name, tensor in given.items()}, reporting=PUBLISHED)
    assert none.boxes.shape == (0, 5) and none.trajectories.shape == (0, 2, 6, 2)


# --- by name, with weights


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own, and ``uniad`` the only network, one that is built at once."""

    def base(_cls: type[UniADConfig], map_levels: int = 4) -> UniADConfig:
        return replace(UNIAD_CONFIG, map_levels=map_levels)

    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(UniADConfig, "base", classmethod(base))
    monkeypatch.setattr("adapters.models.MODELS", {"uniad": MODELS["uniad"]})
    return tmp_path / "cache" / "weights"


def published(path: Path, map_levels: int = 4, **extra: torch.Tensor) -> Path:
    tensors = dict(small_network(1, replace(UNIAD_CONFIG, map_levels=map_levels)).state_dict())
    torch.save({"meta": {"epoch": 20}, "state_dict": tensors | extra}, path)
    return path


def anchor_file(path: Path, content: Any = None) -> Path:
    groups = [np.asarray(group, np.float64) for group in anchors()]
    path.write_bytes(pickle.dumps(content or {"anchors_all": groups, "grouped_classes": [["car"]]}, protocol=2))
    return path


def with_beside(folder: Path) -> ImportedWeights:
    """Both official files in one folder."""
    folder.mkdir()
    anchor_file(folder / FILE)
    return import_checkpoint(published(folder / "official.pth"))


def test_what_comes_with_the_weights_is_listed(cache: Path) -> None:
    (entry,) = (entry for entry in known_weights(cache) if entry.weights.name == "uniad")
    assert "needs motion_anchor_infos_mode6.pkl" in " ".join(entry.plain().split())
    assert entry.as_json()["with"][0]["url"].endswith(FILE)


def test_anchors_beside_the_checkpoint_or_named_are_kept_with_the_weights(cache: Path, tmp_path: Path) -> None:
    beside = with_beside(tmp_path / "both")
    path, named = published(tmp_path / "official.pth"), anchor_file(tmp_path / "anchors.pkl")
    given = import_checkpoint(path, anchors=named)
    held = load_file(beside.path)
    assert torch.equal(held[MOTION_ANCHORS], anchors()) and beside.path == given.path
    assert beside.provenance.model == "uniad" and beside.provenance.anchors_sha256 == given.provenance.anchors_sha256
    with pytest.raises(InputError, match=r"comes without motion anchors.*--anchors motion_anchor_infos_mode6\.pkl"):
        import_checkpoint(path)
    torch.save({**torch.load(path)["state_dict"], MOTION_ANCHORS: anchors()}, tmp_path / "own.pth")
    assert import_checkpoint(tmp_path / "own.pth").provenance.anchors_sha256 is None
    # Anchors that changed beside a checkpoint are read again.
    anchor_file(tmp_path / "both" / FILE, {"anchors_all": [np.ones((6, 12, 2))] * 4})
    build_planner("uniad", checkpoint=tmp_path / "both" / "official.pth")
    assert len({beside.path, *cache.glob("uniad-*.safetensors")}) == 3
    with pytest.raises(InputError, match="already has motion anchors"):
        other = anchor_file(tmp_path / "other.pkl", {"anchors_all": [np.zeros((6, 12, 2))] * 4})
        import_checkpoint(tmp_path / "own.pth", anchors=other)


def test_fetching_uniad_gets_its_anchors_too(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def receive(weights: PublishedWeights, file: PublishedFile, path: Path) -> None:
        asked.append(weights.url(file).removeprefix("https://github.com/OpenDriveLab/UniAD/releases/download/"))
        (anchor_file if path.name == FILE else published)(path)

    monkeypatch.setattr(fetch, "_download", receive)
    found = fetch_checkpoint(find_checkpoint("uniad"), cache)
    assert asked == ["v1.0.1/uniad_base_e2e.pth", f"v1.0/{FILE}"]
    assert torch.equal(load_file(found.path)[MOTION_ANCHORS], anchors()) and list(cache.iterdir()) == [found.path]


def test_the_map_head_follows_the_checkpoint_and_old_names_and_leftovers_are_known(cache: Path, tmp_path: Path) -> None:
    network = small_network(1, replace(UNIAD_CONFIG, map_levels=1))
    tensors = {name.replace(".conv2.conv_offset.", ".conv2_offset."): t for name, t in network.state_dict().items()}
    assert any(".conv2_offset." in name for name in tensors)
    leftovers = ("bbox_size_fc.weight", "pts_bbox_head.query_embedding.weight")
    tensors |= dict.fromkeys((*leftovers, "pts_bbox_head.transformer.reference_points.bias"), torch.ones(3))
    torch.save(tensors, tmp_path / "later.pth")
    found = import_checkpoint(tmp_path / "later.pth", anchors=anchor_file(tmp_path / "anchors.pkl"))
    built = build_planner("uniad", checkpoint=found.path)
    assert isinstance(built, UniADPlanner) and built.config.map_levels == 1


class _Hostile:
    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (Path("ran"),)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"anchors": []}, "has no list 'anchors_all'"),
        ([1.0, 2.0], "has no list 'anchors_all'"),
        ({"anchors_all": "four"}, "has no list 'anchors_all'"),
        ({"anchors_all": [np.zeros((6, 12, 2))] * 3}, r"are 3 of \(6, 12, 2\), but UniAD needs 4 arrays"),
        ({"anchors_all": [np.zeros((6, 12, 2))] * 3 + [np.zeros((6, 6, 2))]}, r"4 of \(6, 12, 2\), \(6, 6, 2\)"),
        ({"anchors_all": [[1.0]] * 4}, "4 of list"),
        ({"anchors_all": []}, "0 of nothing"),
        ({"anchors_all": [np.full((6, 12, 2), np.nan)] * 4}, "implausible values"),
        ({"anchors_all": [np.full((6, 12, 2), 1e9)] * 4}, "implausible values"),
        ({"anchors_all": [np.full((6, 12, 2), "a")] * 4}, "4 of ndarray"),
        ({"anchors_all": [_Hostile()] * 4}, "is refused: its pickle uses"),
    ],
)
def test_what_are_no_anchors_is_one_sentence(tmp_path: Path, content: Any, says: str) -> None:
    with pytest.raises(InputError, match=says):
        read_motion_anchors(anchor_file(tmp_path / "anchors.pkl", content))
    assert not Path("ran").exists()


def test_damaged_anchors_and_those_of_another_model_are_one_sentence(cache: Path, tmp_path: Path) -> None:
    path = anchor_file(tmp_path / "anchors.pkl")
    torch.save(small_vad().state_dict(), tmp_path / "vad.pth")
    with pytest.raises(InputError, match=r"is not a \.safetensors file, .* is not a checkpoint of UniAD"):
        import_checkpoint(tmp_path / "vad.pth", anchors=path)
    path.write_bytes(path.read_bytes()[:-100])
    for broken in (path, tmp_path / "absent.pkl"):
        with pytest.raises(InputError, match=r"anchors\.pkl is not a readable pickle|cannot read .*absent\.pkl"):
            import_checkpoint(published(tmp_path / "official.pth"), anchors=broken)


def test_the_official_solver_without_its_package_is_one_sentence(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def absent(name: str) -> Any:
        raise ImportError(name)

    with_beside(tmp_path / "both")
    monkeypatch.setattr(collision_solvers, "import_module", absent)
    with pytest.raises(InputError, match=r"needs casadi, which is not installed; install challenger-bench\[uniad\]"):
        build_planner("uniad-ipopt")
    monkeypatch.setattr(collision_solvers, "import_module", lambda name: importlib.import_module("math"))
    built = build_planner("uniad-ipopt")
    assert isinstance(built, UniADPlanner) and built.settings["collision_optimisation"] == "ipopt"


def test_variants_share_weights_and_stand_side_by_side(cache: Path, tmp_path: Path, data: NuScenesData) -> None:
    with_beside(tmp_path / "both")
    checkpoint = tmp_path / "both" / "official.pth"
    records, settings = [], EvalSettings(scenes=("scene-9902",), workers=1)
    for name in ("uniad", "uniad-unoptimised"):
        factory = planner_factory(name, checkpoint=checkpoint, device="cpu")
        records.append(evaluate(data, "val", factory, tmp_path / "runs", settings))
    first, second = records
    assert first.run.planner.weights_sha256 == second.run.planner.weights_sha256
    assert first.complete and first.native_protocol == "uniad" and "uniad" in first.run.protocols
    assert [record.run.planner.settings["collision_optimisation"] for record in records] == ["newton", "off"]
    for before, after in zip(second.rows, first.rows, strict=True):
        assert before.plan is not None and after.plan is not None and after.plan.modes is not None
        assert after.plan.modes[0] == before.plan.waypoints
    again = evaluate(
        data, "val", planner_factory("uniad", checkpoint=checkpoint, device="cpu"), tmp_path / "again", settings
    )
    assert again.rows == first.rows
    pages = "\n".join(map(str, build_leaderboard_files(read_results(records)).values()))
    assert "uniad-unoptimised" in pages
