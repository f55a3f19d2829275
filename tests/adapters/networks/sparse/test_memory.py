"""What is remembered: confidence, numbers of tracks, the queue of the planner."""

import math

import pytest
import torch
from torch import Tensor

from adapters.networks.sparse.boxes import KeyframeMotion, KeyframePose
from adapters.networks.sparse.decoder import (
    BoxDecoder,
    DecodedInstances,
    DecoderStage,
    InstanceMemory,
    find_most_certain,
)
from adapters.networks.sparse.model import number_instances
from adapters.networks.sparse.queue import InstanceQueue, Queue, QueueMemory
from tests.adapters.networks.sparse.miniature import MINIATURE

COUNT, CHANNELS = 4, MINIATURE.channels


def decoded(scores: list[float], places: float = 0.0) -> DecodedInstances:
    anchors = torch.full((len(scores), 11), places) + torch.arange(len(scores))[:, None]
    logits = torch.stack([torch.tensor(scores).logit(), torch.full((len(scores),), -9.0)], 1)
    features = torch.arange(float(len(scores)))[:, None].expand(-1, CHANNELS) + places
    return DecodedInstances((DecoderStage(anchors, logits, None),), features, features)


def stay(seconds: float) -> KeyframeMotion:
    pose = torch.eye(4, dtype=torch.float64)
    return KeyframeMotion.between(KeyframePose(0.0, pose, ""), KeyframePose(seconds, pose, ""), torch.device("cpu"))


def test_confidence_falls_slowly_and_rises_at_once() -> None:
    assert find_most_certain(torch.tensor([0.5, 0.9, 0.5, 0.9, 0.1]), 3).tolist() == [1, 3, 0], "of equals the first"
    decoder = BoxDecoder(MINIATURE, 4)
    decoder.remembered = 2
    past = InstanceMemory(torch.zeros(2, CHANNELS), torch.zeros(2, 11), torch.tensor([0.9, 0.2]), torch.tensor([0, 1]))
    found = decoder.remember(decoded([0.1, 0.7, 0.6]), past)
    assert found.rows.tolist() == [1, 2]
    found = decoder.remember(decoded([0.1, 0.7, 0.5]), past)
    assert found.rows.tolist() == [1, 0], "0.6 of 0.9 is more than 0.5"
    assert found.confidence.tolist() == pytest.approx([0.7, 0.54])
    assert decoder.remember(decoded([0.1, 0.7, 0.5]), None).rows.tolist() == [1, 2]
    assert decoder.remember(decoded([0.1, 0.7, 0.5]), past, torch.tensor([2, 0])).confidence.tolist() == pytest.approx(
        [0.5, 0.54]
    )


def test_numbers_of_tracks() -> None:
    first, left = number_instances(None, False, torch.tensor([3, 0]), COUNT)
    assert first.tolist() == [0, 1, 2, 3]
    second, left = number_instances(left, True, torch.tensor([2, 0]), COUNT)
    assert second.tolist() == [3, 0, 4, 5]
    third, left = number_instances(left, False, torch.tensor([0, 1]), COUNT)
    assert third.tolist() == [6, 7, 8, 9], "stale memory has no numbers left, but they are not used again"
    assert left.ids.tolist() == [6, 7] and int(left.next_id) == 10


class Follower:
    """A queue that is fed frame after frame."""

    def __init__(self) -> None:
        torch.manual_seed(0)
        self.queue = InstanceQueue(MINIATURE).eval()
        self.past: QueueMemory | None = None

    @torch.inference_mode()
    def add(self, ids: list[int], scores: list[float], seconds: float = 0.5, places: float = 0.0) -> Queue:
        front = torch.ones(1, CHANNELS, 2, 4)
        agents, names = decoded(scores, places), torch.tensor(ids)
        found: Queue = self.queue(self.past, stay(seconds) if self.past else None, agents, names, front)
        status = torch.arange(10.0)
        ego = torch.full((1, 1, CHANNELS), 7.0)
        self.past = QueueMemory(
            found.features,
            found.boxes,
            found.periods,
            names,
            agents.scores,
            torch.cat([found.ego_features[:-1], ego]),
            found.ego_boxes,
            found.ego_period,
            status,
        )
        return found


def visible(queue: Queue, row: int) -> Tensor:
    return queue.allowed()[row].nonzero()[:, 0]


def test_agents_are_followed_by_their_numbers_if_they_were_certain() -> None:
    follower = Follower()
    follower.add([10, 11, 12], [0.9, 0.1, 0.8], places=100.0)
    found = follower.add([12, 11, 13], [0.9, 0.9, 0.9], places=200.0)
    assert found.periods.tolist() == [2, 1, 1]
    assert found.features[0, :, 0].tolist() == [102.0, 0.0, 0.0], "the second was not certain, the third is new"
    assert found.features[1, :, 0].tolist() == [200.0, 201.0, 202.0]
    assert visible(found, 0).tolist() == [0, 1] and visible(found, 1).tolist() == [1]
    assert visible(found, -1).tolist() == [0, 1], "the ego"
    nobody = found.boxes[0, 1]
    assert not nobody.any() and math.atan2(nobody[6], nobody[7]) == 0, "zeros, none of them negative"


def test_the_queue_forgets_its_oldest_frame() -> None:
    follower = Follower()
    for number in range(6):
        found = follower.add([1, 2], [0.9, 0.9], places=10.0 * number)
    assert found.features[:, 0, 0].tolist() == [20, 30, 40, 50]
    assert found.periods.tolist() == [4, 4] and found.ego_period == 4
    assert bool((found.ego_features[:-1] == 7).all()), "of earlier frames it has what the planner made of them"


def test_stale_memory_leaves_the_ego_alone_without_speed() -> None:
    follower = Follower()
    first = follower.add([1, 2], [0.9, 0.9])
    assert first.ego_boxes[-1, 0, 9] == 0
    assert follower.add([1, 2], [0.9, 0.9]).ego_boxes[-1, 0, 9] == 6, "the predicted forward speed"
    late = follower.add([3, 4], [0.9, 0.9], seconds=20.0)
    assert late.ego_period == 1 and late.ego_boxes[-1, 0, 9] == 0
    assert visible(late, -1).tolist() == [2] and len(late.features) == 3
    assert torch.equal(late.ego_boxes[-1], follower.queue.ego_anchor)
