"""The whole networks in miniature: names, memory, noise, outputs."""

import json
from dataclasses import fields, replace
from pathlib import Path

import pytest
import torch

from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import DiffusionDrive, SparseDrive, SparseNetwork
from adapters.networks.sparse.selection import SparseOutputs
from tests.adapters.networks.sparse.miniature import MINIATURE, filled, frame, noise, without_memory_across_scenes

PARITY = Path(__file__).resolve().parents[5] / "shared" / "golden" / "parity"
NAMES = ("sparsedrive", "diffusiondrive")


@pytest.fixture(autouse=True)
def _no_gradients() -> object:
    with torch.inference_mode():
        yield


def run(network: SparseNetwork, *numbers: int, scene: str = "scene") -> list[SparseOutputs]:
    return [network(frame(number, scene), noise(number)) for number in numbers]


def same(first: SparseOutputs, second: SparseOutputs) -> bool:
    return all(torch.equal(getattr(first, f.name), getattr(second, f.name)) for f in fields(SparseOutputs))


@pytest.mark.skipif(not PARITY.is_dir(), reason="no shared material beside the repository")
@pytest.mark.parametrize(("name", "kind"), [("sparsedrive", SparseDrive), ("diffusiondrive", DiffusionDrive)])
def test_names_order_and_shapes_are_those_of_the_published_checkpoint(name: str, kind: type[SparseDrive]) -> None:
    config = {"sparsedrive": SparseConfig.sparsedrive, "diffusiondrive": SparseConfig.diffusiondrive}[name]()
    with torch.device("meta"):
        own = [[key, list(value.shape)] for key, value in kind(config).state_dict().items()]
    assert own == [entry[:2] for entry in json.loads((PARITY / name / "keys.json").read_text())]


def test_the_base_network_differs_in_its_image_network_alone() -> None:
    with torch.device("meta"):
        small = SparseDrive(SparseConfig.sparsedrive()).state_dict()
        base = SparseDrive(SparseConfig.sparsedrive_base()).state_dict()
    assert len(base) > len(small)
    assert all(key.startswith("img_backbone.") for key in base.keys() ^ small.keys())


@pytest.mark.parametrize("name", NAMES)
def test_outputs_have_the_promised_shapes_and_order(name: str) -> None:
    for number, found in enumerate(run(filled(name), 0, 1)):
        assert found.plan.shape == (6, 2)
        assert found.plan_modes.shape == (3, 6, 6, 2)
        assert found.boxes.shape == (8, 9)
        assert found.trajectories.shape == (8, 6, 12, 2)
        assert found.map_points.shape == (6, 4, 2)
        assert (found.boxes[:, 3:6] > 0).all()
        assert (found.box_scores.diff() <= 0).all() and (found.map_scores.diff() <= 0).all()
        assert (found.plan == found.plan_modes[number]).all((-1, -2)).any(), "the plan is one of the command's"
        assert all(torch.isfinite(getattr(found, f.name)).all() for f in fields(found))


def test_memory_outlives_a_change_of_scene_as_published_unless_told_otherwise() -> None:
    published, forgetful = filled("sparsedrive"), filled("sparsedrive", without_memory_across_scenes())
    alone = run(filled("sparsedrive"), 3)[0]
    for network in (published, forgetful):
        run(network, 0, scene="first")
    assert not same(run(published, 3, scene="second")[0], alone)
    assert same(run(forgetful, 3, scene="second")[0], alone)


def test_track_numbers_go_on_over_a_gap_and_stay_with_their_agents() -> None:
    network = filled("sparsedrive")
    numbers = [network.predict(frame(number)).track_ids for number in (0, 1, 3)]
    assert numbers[0].tolist() == list(range(24))
    assert set(numbers[1][:14].tolist()) < set(range(24)), "the first ones are those that were remembered"
    assert numbers[1][14:].tolist() == list(range(24, 34))
    assert numbers[2].tolist() == list(range(34, 58)), "after a gap all are new, and no number is used twice"


def test_noise_depends_on_seed_and_time_alone() -> None:
    network, other = filled("diffusiondrive"), filled("diffusiondrive", seed=1)
    drawn = network.frame_noise(frame(0))
    assert drawn.shape == (6, 6, 2)
    run(network, 1)
    for same_time in (frame(0), frame(0, "an adversarial variant")):
        assert torch.equal(drawn, network.frame_noise(same_time))
    for different in (other.frame_noise(frame(0)), network.frame_noise(frame(1))):
        assert not torch.equal(drawn, different)
    network.reset()
    assert torch.equal(network(frame(0)).plan, filled("diffusiondrive")(frame(0), drawn).plan)
    network.reset()
    assert not torch.equal(network(frame(0), drawn + 0.5).plan_modes, filled("diffusiondrive")(frame(0)).plan_modes)


def test_moving_the_world_changes_nothing() -> None:
    network = filled("sparsedrive")
    plans = []
    shift = torch.eye(4, dtype=torch.float64)
    shift[:2, :2] = torch.tensor([[0.6, -0.8], [0.8, 0.6]])
    shift[:3, 3] = torch.tensor([-300.0, 200.0, 3.0])
    for world in (torch.eye(4, dtype=torch.float64), shift):
        network.reset()
        for number in (0, 1, 2):
            given = frame(number)
            plan = network(replace(given, global_T_lidar=world @ given.global_T_lidar)).plan
        plans.append(plan)
    torch.testing.assert_close(plans[0], plans[1], rtol=0, atol=1e-4)


def test_sizes_of_images_that_the_network_has() -> None:
    given = frame(0)
    for pixels in (64, 160):
        network, images = (
            filled("sparsedrive", replace(MINIATURE, image_width_px=pixels)),
            torch.zeros(6, 3, 64, pixels),
        )
        assert network(replace(given, images=images)).plan.shape == (6, 2)
    for pixels in (0, 32, 96, 100):
        with pytest.raises(ValueError, match="no images of"):
            replace(MINIATURE, image_width_px=pixels)
    with pytest.raises(ValueError, match=r"\(6, 3, 64, 64\)"):
        filled("sparsedrive")(replace(given, images=given.images[..., :64]))
