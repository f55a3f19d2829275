"""The decoder of boxes and that of lines in one implementation, and the sparse networks' map elements."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import torch
from torch import Tensor, nn

from adapters.networks.layers.attention import ResidualAttention
from adapters.networks.sparse.aggregation import (
    AsymmetricFeedForward,
    CameraFeatures,
    CameraSampling,
    camera_encoder,
    class_branch,
    correction_branch,
    decoupled_attention,
    encoder,
)
from adapters.networks.sparse.boxes import (
    BOX_CODE,
    USUAL_INTERVAL_S,
    BoxEmbedding,
    BoxRefinement,
    BoxSampling,
    RigidMotion,
    carry_boxes,
)
from adapters.networks.sparse.config import SparseConfig

GROUND_Z_M = -1.84023
"""In the lidar frame."""
HEIGHTS_M = (0.0, 0.5, -0.5, 1.0, -1.0)
"""Above the ground, at which images are sampled over points on it."""


def carry_lines(lines: Tensor, motion: RigidMotion) -> Tensor:
    """(..., N, 2 P) lines of a remembered frame, seen from the present one."""
    return motion.move(lines.reshape(*lines.shape[:-2], -1, 2)).view_as(lines)


def at_heights(ground: Tensor) -> Tensor:
    """Points on the ground, (..., H, S, 2) x, y in metres, with each of `HEIGHTS_M`: (..., H, S, 3)."""
    heights = GROUND_Z_M + ground.new_tensor(HEIGHTS_M)[:, None, None]
    return torch.cat([ground, heights.expand(*ground.shape[:-1], 1)], -1)


class LineEmbedding(nn.Module):
    """Embedding of lines."""

    def __init__(self, channels: int, points: int) -> None:
        super().__init__()
        self.pos_fc = encoder(2 * points, channels, 2)

    def forward(self, lines: Tensor) -> Tensor:
        """(..., 2 P) to (..., C)."""
        result: Tensor = self.pos_fc(lines)
        return result


class LinePoints(nn.Module):
    """Points around those of a line at which images are sampled."""

    def __init__(self, channels: int, points: int, samples: int) -> None:
        super().__init__()
        self.shape = (points, len(HEIGHTS_M), samples, 2)
        self.learnable_fc = nn.Linear(channels, points * len(HEIGHTS_M) * samples * 2)

    def forward(self, features: Tensor, lines: Tensor) -> Tensor:
        """Points of (..., N, 2 P) map elements with (..., N, C) features, (..., N, P * heights * samples, 3) metres."""
        offsets = self.learnable_fc(features).float().view(*features.shape[:-1], *self.shape)
        ground = lines.view(*lines.shape[:-1], self.shape[0], 1, 1, 2) + offsets
        return at_heights(ground).flatten(-4, -2)


class LineSampling(CameraSampling):
    """Features of images around the points of lines."""

    def __init__(self, config: SparseConfig, levels: int) -> None:
        super().__init__(config.heads)
        channels, points = config.channels, config.points_per_line
        self.kps_generator = LinePoints(channels, points, config.samples_per_height)
        self.output_proj = nn.Linear(channels, channels)
        self.camera_encoder = camera_encoder(channels)
        samples = points * len(HEIGHTS_M) * config.samples_per_height
        self.weights_fc = nn.Linear(channels, levels * samples * config.heads)

    def forward(self, features: Tensor, lines: Tensor, embeddings: Tensor, cameras: CameraFeatures) -> Tensor:
        """(..., N, C), (..., N, 2 P) lines, (..., N, C) embeddings to (..., N, 2 C): what was sampled, and features."""
        sampled = self.sample(features + embeddings, self.kps_generator(features, lines), cameras)
        return torch.cat([sampled, features], -1)


class LineRefinement(nn.Module):
    """Corrected lines and their classes."""

    def __init__(self, config: SparseConfig) -> None:
        super().__init__()
        self.layers = correction_branch(config.channels, 2 * config.points_per_line)
        self.cls_layers = class_branch(config.channels, config.map_classes)

    def forward(
        self, features: Tensor, lines: Tensor, embeddings: Tensor, interval_s: Tensor | float
    ) -> tuple[Tensor, Tensor, Tensor | None]:
        """Refined (..., N, 2 P) lines, (..., N, classes) logits and no quality; time does not matter to lines."""
        refined = self.layers(features + embeddings).float() + lines
        return refined, self.cls_layers(features).float(), None


PAST: Final = "attention to the past"
PRESENT: Final = "attention to each other"
NORM: Final = "norm"
SAMPLE: Final = "sample images"
FEED: Final = "feed forward"
REFINE: Final = "refine"
STAGE_OPERATIONS: Final = (PAST, PRESENT, NORM, SAMPLE, FEED, NORM, REFINE)
DECAY: Final = 0.6
"""Decay of an unseen instance's confidence, from frame to frame."""


@dataclass(frozen=True, slots=True)
class DecoderStage:
    """Predictions of a stage: (N, D) refined places, (N, classes) logits and, of boxes, (N, 2) quality logits."""

    anchors: Tensor
    logits: Tensor
    qualities: Tensor | None


@dataclass(frozen=True, slots=True)
class DecodedInstances:
    """N instances after the last stage; features and embeddings of places are (N, C).

    With a past, the instances behind the first stage are others: the remembered, then its most certain ones.
    """

    stages: tuple[DecoderStage, ...]
    features: Tensor
    embeddings: Tensor

    @property
    def anchors(self) -> Tensor:
        """(N, D) places."""
        return self.stages[-1].anchors

    @property
    def logits(self) -> Tensor:
        """(N, classes)."""
        return self.stages[-1].logits

    @property
    def scores(self) -> Tensor:
        """(N,) 0 to 1, of the most likely class."""
        return self.logits.amax(-1).sigmoid()


@dataclass(frozen=True, slots=True)
class InstanceMemory:
    """The K most certain instances of a frame, the most certain one first.

    `features` (K, C); `anchors` (K, D) in the lidar frame of their time; `confidence` (K,) 0 to 1; `rows` (K,) of their
    frame.
    """

    features: Tensor
    anchors: Tensor
    confidence: Tensor
    rows: Tensor


def find_most_certain(scores: Tensor, count: int) -> Tensor:
    """(..., N) to the rows of the `count` greatest, falling; of equals the first comes first, on every device."""
    return scores.sort(descending=True, stable=True).indices[..., :count]


def gather_rows(tokens: Tensor, rows: Tensor) -> Tensor:
    """(..., N, D) tokens and (..., K) rows to (..., K, D)."""
    return tokens.gather(-2, rows[..., None].expand(*rows.shape, tokens.shape[-1]))


class HandleScale(nn.Module):
    """A constant that nothing reads here, but published checkpoints hold it."""

    def __init__(self) -> None:
        super().__init__()
        self.fix_scale = nn.Parameter(torch.zeros(1, 3), requires_grad=False)


class InstanceBank(nn.Module):
    """Bank of instances: their first places and features."""

    def __init__(self, instances: int, numbers: int, channels: int, handled: bool) -> None:
        super().__init__()
        self.anchor = nn.Parameter(torch.empty(instances, numbers))
        self.instance_feature = nn.Parameter(torch.empty(instances, channels))
        nn.init.normal_(self.anchor)
        nn.init.xavier_uniform_(self.instance_feature)
        if handled:
            self.anchor_handler = HandleScale()


class SparseDecoder(nn.Module, ABC):
    """Refinement of instances by the past, each other and images; B key frames give all tensors a leading B."""

    instance_bank: InstanceBank
    anchor_encoder: nn.Module
    layers: nn.ModuleList

    def __init__(self, remembered: int, operations: tuple[str, ...]) -> None:
        super().__init__()
        self.remembered, self.operations = remembered, operations

    @abstractmethod
    def carry(self, anchors: Tensor, motion: RigidMotion) -> Tensor:
        """Places of a remembered frame, seen from the present one."""

    @abstractmethod
    def attend(
        self, layer: nn.Module, features: Tensor, embeddings: Tensor, key: tuple[Tensor, Tensor] | None
    ) -> Tensor:
        """Attention to `key`, features and embeddings, or without it, as on the first frame, to each other."""

    def forward(
        self, cameras: CameraFeatures, past: InstanceMemory | None, motion: RigidMotion | None
    ) -> tuple[DecodedInstances, InstanceMemory]:
        """Instances of a key frame, and their memory for the next.

        Gradients stop between stages, at the places of instances: each stage learns how to correct what it is given.
        `motion` is from the remembered frame to this one.
        """
        frames = cameras.projections.shape[:-3]
        anchors: Tensor = self.instance_bank.anchor.expand(*frames, -1, -1)
        features: Tensor = self.instance_bank.instance_feature.expand(*frames, -1, -1)
        embeddings: Tensor = self.anchor_encoder(anchors)
        interval_s = motion.interval_s if motion else USUAL_INTERVAL_S
        carried = replace(past, anchors=self.carry(past.anchors, motion)) if past and motion else None
        fresh = carried if motion and motion.fresh else None
        key = (carried.features, self.anchor_encoder(carried.anchors)) if carried else None
        stages: list[DecoderStage] = []
        for operation, layer in zip(self.operations, self.layers, strict=True):
            if operation == PAST:
                features = self.attend(layer, features, embeddings, key)
            elif operation == PRESENT:
                features = self.attend(layer, features, embeddings, (features, embeddings))
            elif operation == SAMPLE:
                features = layer(features, anchors, embeddings, cameras)
            elif operation == REFINE:
                stages.append(DecoderStage(*layer(features, anchors, embeddings, interval_s)))
                anchors = stages[-1].anchors.detach()
                if len(stages) == 1 and fresh:
                    rows = find_most_certain(stages[0].logits.detach().amax(-1), anchors.shape[-2] - self.remembered)
                    features = torch.cat([fresh.features, gather_rows(features, rows)], -2)
                    anchors = torch.cat([fresh.anchors, gather_rows(anchors, rows)], -2)
                embeddings = self.anchor_encoder(anchors)
                if len(stages) > 1 and key:
                    # Also if the first rows are not the remembered ones, as in the published models.
                    key = (key[0], embeddings[..., : self.remembered, :])
            else:
                features = layer(features)
        decoded = DecodedInstances(tuple(stages), features, embeddings)
        return decoded, self.remember(decoded, fresh)

    def remember(
        self, decoded: DecodedInstances, past: InstanceMemory | None, rows: Tensor | None = None
    ) -> InstanceMemory:
        """The (K,) `rows` of instances for the next frame, by default the most certain ones, without gradients.

        Their confidence falls slowly where an instance is not seen; `past` is what the first of them were remembered
        with.
        """
        confidence = decoded.scores.detach()
        if past:
            remembered_confidence = torch.maximum(past.confidence * DECAY, confidence[..., : self.remembered])
            confidence = torch.cat([remembered_confidence, confidence[..., self.remembered :]], -1)
        if rows is None:
            rows = find_most_certain(confidence, self.remembered)
        features, anchors = decoded.features.detach(), decoded.anchors.detach()
        return InstanceMemory(
            gather_rows(features, rows), gather_rows(anchors, rows), confidence.gather(-1, rows), rows
        )


class BoxDecoder(SparseDecoder):
    """The decoder of boxes; arguments as `SparseConfig`, and how many levels of image features there are."""

    def __init__(self, config: SparseConfig, levels: int) -> None:
        super().__init__(config.remembered_anchors, STAGE_OPERATIONS[3:] + STAGE_OPERATIONS * (config.stages - 1))
        channels = config.channels
        self.instance_bank = InstanceBank(config.anchors, BOX_CODE, channels, handled=True)
        self.anchor_encoder = BoxEmbedding(channels)
        make: dict[str, Callable[[], nn.Module]] = {
            PAST: lambda: ResidualAttention(2 * channels, config.heads),
            PRESENT: lambda: ResidualAttention(2 * channels, config.heads),
            NORM: lambda: nn.LayerNorm(channels),
            SAMPLE: lambda: BoxSampling(config, levels),
            FEED: lambda: AsymmetricFeedForward(2 * channels, channels, config.hidden_channels),
            REFINE: lambda: BoxRefinement(config),
        }
        self.layers = nn.ModuleList([make[operation]() for operation in self.operations])
        self.fc_before = nn.Linear(channels, 2 * channels, bias=False)
        self.fc_after = nn.Linear(2 * channels, channels, bias=False)

    def carry(self, anchors: Tensor, motion: RigidMotion) -> Tensor:
        """(..., 11) boxes, moved on with their velocities."""
        return carry_boxes(anchors, motion, motion.seconds)

    def attend(
        self, layer: nn.Module, features: Tensor, embeddings: Tensor, key: tuple[Tensor, Tensor] | None
    ) -> Tensor:
        """As the base class says; features and embeddings stand side by side."""
        return decoupled_attention(layer, self.fc_before, self.fc_after, (features, embeddings), key)


class LineDecoder(SparseDecoder):
    """The decoder of map elements; arguments as in `BoxDecoder`."""

    def __init__(self, config: SparseConfig, levels: int) -> None:
        super().__init__(config.remembered_lines, STAGE_OPERATIONS[1:] + STAGE_OPERATIONS * (config.stages - 1))
        channels = config.channels
        self.instance_bank = InstanceBank(config.lines, 2 * config.points_per_line, channels, handled=False)
        self.anchor_encoder = LineEmbedding(channels, config.points_per_line)
        make: dict[str, Callable[[], nn.Module]] = {
            PAST: lambda: ResidualAttention(channels, config.heads),
            PRESENT: lambda: ResidualAttention(channels, config.heads),
            NORM: lambda: nn.LayerNorm(channels),
            SAMPLE: lambda: LineSampling(config, levels),
            FEED: lambda: AsymmetricFeedForward(2 * channels, channels, config.hidden_channels),
            REFINE: lambda: LineRefinement(config),
        }
        self.layers = nn.ModuleList([make[operation]() for operation in self.operations])

    def carry(self, anchors: Tensor, motion: RigidMotion) -> Tensor:
        """(..., 2 P) lines."""
        return carry_lines(anchors, motion)

    def attend(
        self, layer: nn.Module, features: Tensor, embeddings: Tensor, key: tuple[Tensor, Tensor] | None
    ) -> Tensor:
        """As the base class says; embeddings are added to queries and keys."""
        keys, places = key or (features, embeddings)
        result: Tensor = layer(features, features + embeddings, keys + places, keys)
        return result
