"""The whole network in miniature: what it remembers, what it forgets, and what it reports."""

import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import torch

from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.model import UniAD
from adapters.networks.uniad.planning import UniADOutputs
from adapters.networks.uniad.tracking import EGO
from benchmark.errors import InputError
from tests.adapters.networks.uniad.small_uniad import SMALL, anchors, class_layer, frame, in_scene, small_network

KEYS = Path(__file__).resolve().parents[5] / "shared" / "golden" / "parity" / "uniad" / "keys.json"


def same(one: UniADOutputs, other: UniADOutputs) -> bool:
    pairs = [(getattr(one, field.name), getattr(other, field.name)) for field in fields(one)]
    tensors = [pair for pair in pairs if isinstance(pair[0], torch.Tensor)]
    return all(left.shape == right.shape and torch.equal(left, right) for left, right in tensors)


@pytest.mark.skipif(not KEYS.is_file(), reason="no shared material beside the repository")
def test_names_shapes_and_order_are_the_published_ones() -> None:
    with torch.device("meta"):
        own = [(name, list(tensor.shape)) for name, tensor in UniAD(UniADConfig.base()).state_dict().items()]
    assert own == [(name, shape) for name, shape, _ in json.loads(KEYS.read_text())]


def test_levels_of_the_map_head_follow_the_checkpoint() -> None:
    name = "seg_head.transformer.encoder.layers.0.attentions.0.sampling_offsets.weight"
    assert UniADConfig.base_of({name: (256, 256)}) == UniADConfig.base() == UniADConfig.base_of({})
    single = UniADConfig.base_of({name: (64, 256)})
    assert single.map_levels == 1
    with torch.device("meta"):
        assert UniAD(single).state_dict()[name].shape == (64, 256)


def test_outputs_have_the_promised_shapes() -> None:
    network = small_network()
    network.masks = True
    with torch.inference_mode():
        found = network(frame(0))
    count = len(found.box_scores)
    assert 0 < count <= SMALL.queries
    assert found.plan.shape == found.plan_before_optimisation.shape == (6, 2) and found.plan.dtype == torch.float32
    assert found.boxes.shape == (count, 9) and found.trajectories.shape == (count, 6, 12, 2)
    torch.testing.assert_close(found.trajectory_scores.sum(-1), torch.ones(count))
    assert (found.box_scores.diff() <= 0).all() and len(set(found.track_ids.tolist())) == count
    assert (found.boxes[:, 6].abs() <= np.pi).all()
    assert found.occupied.shape == (5, 32, 32) and found.occupied.dtype == torch.bool
    assert found.road is not None and found.road.lanes.shape == (3, 16, 24)
    assert found.collision is not None and found.collision.solver == "newton"
    numbers = (found.plan, found.boxes, found.trajectories)
    assert all(bool(tensor.isfinite().all()) for tensor in numbers)


def test_a_new_scene_keeps_numbers_and_the_motion_but_no_tracks() -> None:
    network = small_network()
    with torch.inference_mode():
        before = [network.predict(in_scene(number, "a")) for number in range(2)]
        given = max(int(p.after.track_ids.max()) for p in before) + 1
        seen = network.ego_motion(in_scene(2, "b")).can_bus
        after = network.predict(in_scene(2, "b"))
    assert len(before[1].entering.scores) > SMALL.queries + 1
    assert len(after.entering.scores) == SMALL.queries + 1 and len(after.moved_references) == 0
    ids = after.tracks.track_ids
    assert int(ids.min()) >= given
    expected = frame(2).can_bus - frame(1).can_bus
    torch.testing.assert_close(seen[[0, 1, 17]], expected[[0, 1, 17]])
    assert seen[16] == frame(2).can_bus[16]


def test_the_ego_is_always_the_last_fresh_query() -> None:
    network = small_network()
    with torch.inference_mode():
        for number in range(3):
            p = network.predict(frame(number))
            assert (p.after.track_ids == EGO).nonzero().flatten().tolist() == [SMALL.queries]
            assert len(p.ego.scores) == 1 and len(p.forecasts.positions) == len(p.tracks.scores) + 1


def test_no_vehicle_leaves_the_ground_free() -> None:
    network = small_network()
    with torch.inference_mode():
        class_layer(network).weight.zero_()
        class_layer(network).bias.fill_(-9.0)
        found = network(frame(0))
    assert len(found.boxes) == 0 and not found.occupied.any()
    assert torch.equal(found.plan, found.plan_before_optimisation) and bool(found.plan.isfinite().all())


def test_missing_or_odd_anchors_are_told() -> None:
    network = UniAD(SMALL)
    with torch.inference_mode(), pytest.raises(InputError, match="no motion anchors"):
        network.predict(frame(0))
    with pytest.raises(InputError, match=r"\[4, 6, 12, 2\], not \[4, 6, 12\]"):
        network.motion_head.load_anchors(anchors()[..., 0])
    with pytest.raises(InputError, match="finite"):
        network.motion_head.load_anchors(anchors() * np.nan)
    network.motion_head.load_anchors(anchors())
    with torch.inference_mode():
        network.predict(frame(0))


def test_what_is_not_finite_is_told_and_can_be_forgotten() -> None:
    network = small_network()
    with torch.inference_mode():
        network.predict(frame(0))
        broken = replace(frame(1), images=torch.full((6, 3, 64, 96), float("nan")))
        with pytest.raises(InputError, match="not finite"):
            network(broken)
        network.reset()
        first, second = network(frame(0)), network(frame(1))
        network.reset()
        again = [network(frame(number)) for number in range(2)]
    assert same(first, again[0]) and same(second, again[1])
