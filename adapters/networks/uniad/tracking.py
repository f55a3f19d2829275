"""Tracks as queries of the bird's-eye view (BEVFormer, Li et al., 2022): detection, life cycle, memory and motion."""

import math
from dataclasses import dataclass, replace

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from adapters.networks.layers.attention import LearnedGridEncoding, normalised_branch, plain_branch
from adapters.networks.layers.bev_network import BEVTransformer, bev_decoder, can_bus_network
from adapters.networks.layers.deformable_decoder import are_within, box_codes, decode_boxes, logit, to_metres
from adapters.networks.layers.ego_motion import BEVMotion
from adapters.networks.layers.reporting import find_distinct
from adapters.networks.uniad.config import UniADConfig

BOX_CODE = 10
PAST_STEPS = 8
"""Past positions that the published network also predicts and does not use."""


@dataclass(frozen=True, slots=True)
class Detections:
    """Predictions of the K layers of the decoder for Q queries.

    `states` (K, Q, C); `class_logits` (K, Q, classes); `box_codes` (K, Q, 10) as `deformable_decoder.box_codes`, metres
    in the lidar frame; `reference_logits` (Q, 3) of the last layer's centres as shares of the perception range.
    """

    states: Tensor
    class_logits: Tensor
    box_codes: Tensor
    reference_logits: Tensor


class DetectionTransformer(BEVTransformer):
    """The encoder of the bird's-eye view and the decoder of agents."""

    def __init__(self, config: UniADConfig) -> None:
        super().__init__(config, config.pyramid_levels)
        self.decoder = bev_decoder(config)
        self.can_bus_mlp = can_bus_network(config.channels)


class DetectionHead(nn.Module):
    """Bird's-eye view and boxes (sections 3.1 of the paper)."""

    def __init__(self, config: UniADConfig) -> None:
        super().__init__()
        self.config = config
        channels, layers = config.channels, config.decoder_layers
        # Weights of training losses; nothing reads them here, but published checkpoints hold them.
        self.code_weights = nn.Parameter(torch.tensor([1.0] * 8 + [0.2] * 2), requires_grad=False)
        self.positional_encoding = LearnedGridEncoding(config.bev_rows, config.bev_columns, channels)
        self.transformer = DetectionTransformer(config)
        self.cls_branches = nn.ModuleList([normalised_branch(channels, config.agent_classes) for _ in range(layers)])
        self.reg_branches = nn.ModuleList([plain_branch(channels, BOX_CODE) for _ in range(layers)])
        self.past_traj_reg_branches = nn.ModuleList([plain_branch(channels, PAST_STEPS * 2) for _ in range(layers)])
        self.bev_embedding = nn.Embedding(config.grid.cells, channels)

    def encode(
        self, maps: list[Tensor], images: Tensor, projections: Tensor, motion: BEVMotion, previous: Tensor | None
    ) -> Tensor:
        """(cells, C) bird's-eye view of one moment; arguments as in `BEVTransformer.encode`."""
        return self.transformer.encode(
            self.bev_embedding.weight, self.positional_encoding(), maps, images, projections, motion, previous
        )

    def detect(self, bev: Tensor, queries: Tensor, reference_logits: Tensor) -> Detections:
        """Boxes by layer from (Q, 2 C) queries (positions, contents), (cells, C) view and (Q, 3) reference logits."""
        positions, contents = queries.chunk(2, -1)
        references, shapes = reference_logits.float().sigmoid(), (self.config.grid.shape,)
        decoded = self.transformer.decoder(contents, positions, references, bev, shapes, self.reg_branches, (0, 1, 4))
        logits = [branch(states).float() for branch, states in zip(self.cls_branches, decoded.states, strict=True)]
        lower, upper = self.config.perception_range_m[:3], self.config.perception_range_m[3:]
        return Detections(
            states=decoded.states,
            class_logits=torch.stack(logits),
            box_codes=box_codes(to_metres(decoded.references, lower, upper), decoded.corrections),
            reference_logits=logit(decoded.references[-1]),
        )

    def past_offsets(self, states: Tensor) -> Tensor:
        """(Q, C) states of the last layer to (Q, 8, 2) past positions; for diagnosis, nothing here uses them."""
        predicted: Tensor = self.past_traj_reg_branches[-1](states)
        return predicted.float().view(-1, PAST_STEPS, 2)


PATIENCE = 5
"""Key frames without an awake one after which a track ends."""
NO_TRACK, EGO = -1, -2
MARGIN_M = 10.0
"""How far outside the perception range, on the ground, boxes are still reported."""
HIGHEST_M = 10.0
"""Boxes whose centre is higher or lower are not."""


@dataclass(frozen=True, slots=True)
class Instances:
    """Q queries and what is known of them; the first ones are fresh, of these the last is the ego, then come tracks.

    Attributes:
        queries: (Q, 2 C) positions and then contents.
        reference_logits: (Q, 3) logits of centres as shares of the perception range.
        track_ids: (Q,) int64, `NO_TRACK` or `EGO` where there is no track.
        frames_asleep: (Q,) int64.
        frames_to_save: (Q,) float32 until the next state is remembered.
        memory: (Q, M, C) remembered states, the oldest first.
        memory_empty: (Q, M) which of them are not there.
        class_logits: (Q, classes).
        box_codes: (Q, 10) metres in the lidar frame of their key frame.
        states: (Q, C) after the last layer of the decoder.
        scores: (Q,) of the most certain class.
    """

    queries: Tensor
    reference_logits: Tensor
    track_ids: Tensor
    frames_asleep: Tensor
    frames_to_save: Tensor
    memory: Tensor
    memory_empty: Tensor
    class_logits: Tensor
    box_codes: Tensor
    states: Tensor
    scores: Tensor

    @classmethod
    def fresh(cls, config: UniADConfig, queries: Tensor, reference_logits: Tensor) -> "Instances":
        """Queries, (Q, 2 C) with (Q, 3) reference logits, of which nothing is known."""
        count, device = len(queries), queries.device

        def zeros(*shape: int) -> Tensor:
            return torch.zeros(count, *shape, device=device)

        return cls(
            queries=queries,
            reference_logits=reference_logits.float(),
            track_ids=torch.full((count,), NO_TRACK, device=device),
            frames_asleep=torch.zeros(count, dtype=torch.int64, device=device),
            frames_to_save=zeros(),
            memory=zeros(config.memory_length, config.channels).to(queries.dtype),
            memory_empty=torch.ones(count, config.memory_length, dtype=torch.bool, device=device),
            class_logits=zeros(config.agent_classes),
            box_codes=zeros(10),
            states=zeros(config.channels).to(queries.dtype),
            scores=zeros(),
        )

    def kept(self, which: Tensor | slice) -> "Instances":
        """Those of a mask, of a list of indices or of a slice."""
        return Instances(*(getattr(self, name)[which] for name in self.__slots__))

    def then(self, others: "Instances") -> "Instances":
        """These and others."""
        pairs = ((getattr(self, name), getattr(others, name)) for name in self.__slots__)
        return Instances(*(torch.cat(pair) for pair in pairs))


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of a key frame, for rows in metres: global = lidar @ rotation + translation, with (3, 3) float32."""

    rotation: Tensor
    inverse: Tensor
    translation: Tensor
    time_s: float

    @classmethod
    def of(cls, rotation: Tensor, translation: Tensor, time_s: float, device: torch.device) -> "Pose":
        """Pose from tensors on the processor, with one transfer to the device and no wait for it."""
        single = rotation.detach().to("cpu", torch.float32)
        rows = [single, torch.linalg.inv(single), translation.detach().to("cpu", torch.float32)[None]]
        packed = torch.cat(rows).to(device)
        return cls(packed[:3], packed[3:6], packed[6], time_s)


def move_references(tracks: Instances, then: Pose, now: Pose, config: UniADConfig) -> Tensor:
    """Places of T tracks now at the speed they had: (T, 3) logits of shares of the range around the present lidar."""
    low, high = config.perception_range_m[:3], config.perception_range_m[3:]
    places = to_metres(tracks.reference_logits.sigmoid(), low, high)
    step = F.pad(tracks.box_codes[:, 8:10], (0, 1)) * (now.time_s - then.time_s)
    # Hundreds of metres in the global frame leave a tenth of a millimetre in single precision; rotations are exact
    # enough in it only if they are not rounded further, which reduced-precision products would do.
    turned = _rows_times(places + step, then.rotation) + then.translation - now.translation
    places = _rows_times(turned, now.inverse)
    axes = zip(places.unbind(-1), low, high, strict=True)
    return logit(torch.stack([(place - least) / (most - least) for place, least, most in axes], -1))


def _rows_times(rows: Tensor, matrix: Tensor) -> Tensor:
    """(T, 3) rows times (3, 3), in full single precision on any device."""
    return (rows[:, :, None] * matrix).sum(1)


def update_tracks(
    instances: Instances, detections: Detections, fresh: int, next_id: Tensor, config: UniADConfig
) -> tuple[Instances, Tensor]:
    """Instances after the decoder, and the next id: births, naps and ends of tracks.

    Of the `fresh` first instances the last is the ego; `next_id` is the first id not given yet.
    """
    logits = detections.class_logits[-1]
    scores = logits.sigmoid().amax(-1)
    ids = instances.track_ids.clone()
    ids[fresh - 1 : fresh].fill_(EGO)
    awake = scores >= config.born_score
    if config.tracks_apart > 0:
        again = _find_duplicates(detections.box_codes[-1], scores, ids, config)
        awake &= ~again
        ids = torch.where(again, NO_TRACK, ids)
    asleep_for = instances.frames_asleep.masked_fill(awake, 0)
    born = (ids == NO_TRACK) & awake
    order = born.cumsum(0)
    naps = (ids >= 0) & (scores < config.asleep_score)
    asleep_for = asleep_for + naps
    ids = torch.where(naps & (asleep_for >= PATIENCE), NO_TRACK, ids)
    ids = torch.where(born, next_id + order - 1, ids)
    after = replace(
        instances,
        reference_logits=detections.reference_logits,
        track_ids=ids,
        frames_asleep=asleep_for,
        class_logits=logits,
        box_codes=detections.box_codes[-1],
        states=detections.states[-1],
        scores=scores,
    )
    return after, next_id + order[-1]


def _find_duplicates(box_codes: Tensor, scores: Tensor, ids: Tensor, config: UniADConfig) -> Tensor:
    """(Q,) instances that follow, or would follow, what another does; tracks that are awake go before all others."""
    boxes, again = decode_boxes(box_codes), torch.zeros_like(ids, dtype=torch.bool)
    alive = ((ids >= 0) | ((ids == NO_TRACK) & (scores >= config.born_score))).nonzero()[:, 0]
    certainty = scores[alive] + ((ids[alive] >= 0) & (scores[alive] >= config.asleep_score))
    again[alive] = ~find_distinct(boxes[alive, :2], boxes[alive, 4], certainty, config.tracks_apart)
    return again


@dataclass(frozen=True, slots=True)
class Boxes:
    """N boxes with the conventions of the network, scores falling.

    `boxes` are (N, 9) centre x, y, z, width, length, height, yaw, velocity x, y; see `convert_yaws`. `states` are (N,
    C).
    """

    boxes: Tensor
    scores: Tensor
    labels: Tensor
    track_ids: Tensor
    states: Tensor

    def then(self, others: "Boxes") -> "Boxes":
        """These and others."""
        pairs = ((getattr(self, name), getattr(others, name)) for name in self.__slots__)
        return Boxes(*(torch.cat(pair) for pair in pairs))


def convert_yaws(yaws: Tensor, config: UniADConfig) -> Tensor:
    """Headings of boxes, counter-clockwise from the x axis, -pi to pi, from yaws in the network's convention.

    The published weights were trained with that of mmdet3d before version 1.0: -heading - pi/2.
    """
    turned = yaws + math.pi / 2 if config.counterclockwise_yaw else math.pi / 2 - yaws
    return torch.remainder(turned, 2 * math.pi) - math.pi


def decode_instances(instances: Instances) -> Boxes:
    """A box for each instance, in their order."""
    return Boxes(
        boxes=decode_boxes(instances.box_codes),
        scores=instances.scores,
        labels=instances.class_logits.argmax(-1),
        track_ids=instances.track_ids,
        states=instances.states,
    )


def select_strongest_boxes(instances: Instances, config: UniADConfig) -> Boxes:
    """Boxes of the most certain instances whose centres are not far outside the perception range."""
    chosen = instances.kept(instances.scores.topk(min(config.max_boxes, len(instances.scores))).indices)
    return decode_instances(chosen.kept(_are_near(chosen.box_codes, config)))


@dataclass(frozen=True, slots=True)
class TrackSelection:
    """Indices of the instances that a key frame reports and hands on.

    `reported` (N,) tracks are awake and near, by falling scores; `vehicles` (V,) index these; `surviving` (T,) are
    tracks in the next key frame, in their order.
    """

    reported: Tensor
    vehicles: Tensor
    surviving: Tensor


def select_tracks(instances: Instances, vehicle_classes: Tensor, config: UniADConfig) -> TrackSelection:
    """Choose, with one wait for the device: how many there are of each must be known to go on."""
    living = instances.track_ids >= 0
    awake = living & (instances.scores >= config.asleep_score)
    scores, strongest = torch.where(awake, instances.scores, -1.0).topk(min(config.max_boxes, len(awake)))
    reported = (scores >= 0) & _are_near(instances.box_codes[strongest], config)
    vehicles = reported & vehicle_classes[instances.class_logits[strongest].argmax(-1)]
    masks = reported, vehicles, living
    counts = torch.stack([mask.sum() for mask in masks]).tolist()
    first, second, third = (_true_indices(mask, count) for mask, count in zip(masks, counts, strict=True))
    return TrackSelection(strongest[first], (reported.cumsum(0) - 1)[second], third)


def _are_near(box_codes: Tensor, config: UniADConfig) -> Tensor:
    """Whether the centres of (Q, 10) box codes are not far outside the perception range."""
    x_low, y_low, _, x_high, y_high, _ = config.perception_range_m
    lower = (x_low - MARGIN_M, y_low - MARGIN_M, -HIGHEST_M)
    upper = (x_high + MARGIN_M, y_high + MARGIN_M, HIGHEST_M)
    return are_within(torch.stack([box_codes[:, axis] for axis in (0, 1, 4)], -1), lower, upper)


def _true_indices(mask: Tensor, count: int) -> Tensor:
    """Places where a mask is true, whose `count` is known."""
    return (~mask).to(torch.uint8).argsort(stable=True)[:count]
