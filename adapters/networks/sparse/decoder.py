"""The decoder of boxes and that of lines: one implementation, of which each fills in what a place in space is."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Final

import torch
from torch import Tensor, nn

from adapters.networks.layers.attention import ResidualAttention
from adapters.networks.sparse.aggregation import CameraFeatures
from adapters.networks.sparse.boxes import BOX_CODE, BoxEncoder, BoxRefinement, BoxSampling, carry_boxes
from adapters.networks.sparse.branches import FeedForward, decoupled_attention
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.keyframe_pose import USUAL_INTERVAL_S, RigidMotion
from adapters.networks.sparse.lines import LineEncoder, LineRefinement, LineSampling, carry_lines

PAST: Final = "attention to the past"
PRESENT: Final = "attention to each other"
NORM: Final = "norm"
SAMPLE: Final = "sample images"
FEED: Final = "feed forward"
REFINE: Final = "refine"
STAGE: Final = (PAST, PRESENT, NORM, SAMPLE, FEED, NORM, REFINE)
DECAY: Final = 0.6
"""What is left of the confidence in an instance that is not seen, from frame to frame."""


@dataclass(frozen=True, slots=True)
class Stage:
    """Predictions of a stage of the decoder for N instances.

    Attributes:
        anchors: (N, D) refined places.
        logits: (N, classes).
        qualities: (N, 2) logits, of boxes only.
    """

    anchors: Tensor
    logits: Tensor
    qualities: Tensor | None


@dataclass(frozen=True, slots=True)
class Decoded:
    """N instances after the last stage.

    Attributes:
        stages: One after the other. Where the past is used, the instances behind the first stage are others: those
            that were remembered, and then the most certain ones of the first stage.
        features: (N, C).
        embeddings: (N, C) of the places.
    """

    stages: tuple[Stage, ...]
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
class Remembered:
    """The K most certain instances of a frame, the most certain one first.

    Attributes:
        features: (K, C).
        anchors: (K, D) in the lidar frame of their time.
        confidence: (K,) 0 to 1.
        rows: (K,) which instances of their frame they are.
    """

    features: Tensor
    anchors: Tensor
    confidence: Tensor
    rows: Tensor


def most_certain(scores: Tensor, count: int) -> Tensor:
    """(..., N) to the rows of the `count` greatest, falling; of equals the first comes first, on every device."""
    return scores.sort(descending=True, stable=True).indices[..., :count]


def rows_of(tokens: Tensor, rows: Tensor) -> Tensor:
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
    """Instances look at the past, at each other and at images, and are refined, stage after stage.

    Where the cameras are of B key frames side by side, all tensors have a leading B.
    """

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
        self, cameras: CameraFeatures, past: Remembered | None, motion: RigidMotion | None
    ) -> tuple[Decoded, Remembered]:
        """Instances of a key frame, and what to remember of them.

        Gradients stop between stages, at the places of instances: each stage learns how to correct what it is given.
        `motion` is from the remembered frame to this one; absent where nothing is remembered.
        """
        frames = cameras.projections.shape[:-3]
        anchors: Tensor = self.instance_bank.anchor.expand(*frames, -1, -1)
        features: Tensor = self.instance_bank.instance_feature.expand(*frames, -1, -1)
        embeddings: Tensor = self.anchor_encoder(anchors)
        interval_s = motion.interval_s if motion else USUAL_INTERVAL_S
        carried = replace(past, anchors=self.carry(past.anchors, motion)) if past and motion else None
        fresh = carried if motion and motion.fresh else None
        key = (carried.features, self.anchor_encoder(carried.anchors)) if carried else None
        stages: list[Stage] = []
        for operation, layer in zip(self.operations, self.layers, strict=True):
            if operation == PAST:
                features = self.attend(layer, features, embeddings, key)
            elif operation == PRESENT:
                features = self.attend(layer, features, embeddings, (features, embeddings))
            elif operation == SAMPLE:
                features = layer(features, anchors, embeddings, cameras)
            elif operation == REFINE:
                stages.append(Stage(*layer(features, anchors, embeddings, interval_s)))
                anchors = stages[-1].anchors.detach()
                if len(stages) == 1 and fresh:
                    rows = most_certain(stages[0].logits.detach().amax(-1), anchors.shape[-2] - self.remembered)
                    features = torch.cat([fresh.features, rows_of(features, rows)], -2)
                    anchors = torch.cat([fresh.anchors, rows_of(anchors, rows)], -2)
                embeddings = self.anchor_encoder(anchors)
                if len(stages) > 1 and key:
                    # Also where the first rows are not what is remembered: the published models do so.
                    key = (key[0], embeddings[..., : self.remembered, :])
            else:
                features = layer(features)
        decoded = Decoded(tuple(stages), features, embeddings)
        return decoded, self.remember(decoded, fresh)

    def remember(self, decoded: Decoded, past: Remembered | None, rows: Tensor | None = None) -> Remembered:
        """The (K,) `rows` of instances for the next frame, by default the most certain ones.

        Their confidence falls slowly where an instance is not seen; nothing is learned through them. `past` is what
        the first of them were remembered with; absent where no instance is from an earlier frame.
        """
        confidence = decoded.scores.detach()
        if past:
            kept = torch.maximum(past.confidence * DECAY, confidence[..., : self.remembered])
            confidence = torch.cat([kept, confidence[..., self.remembered :]], -1)
        if rows is None:
            rows = most_certain(confidence, self.remembered)
        features, anchors = decoded.features.detach(), decoded.anchors.detach()
        return Remembered(rows_of(features, rows), rows_of(anchors, rows), confidence.gather(-1, rows), rows)


class BoxDecoder(SparseDecoder):
    """The decoder of boxes; arguments as `SparseConfig`, and how many levels of image features there are."""

    def __init__(self, config: SparseConfig, levels: int) -> None:
        super().__init__(config.remembered_anchors, STAGE[3:] + STAGE * (config.stages - 1))
        channels = config.channels
        self.instance_bank = InstanceBank(config.anchors, BOX_CODE, channels, handled=True)
        self.anchor_encoder = BoxEncoder(channels)
        make: dict[str, Callable[[], nn.Module]] = {
            PAST: lambda: ResidualAttention(2 * channels, config.heads),
            PRESENT: lambda: ResidualAttention(2 * channels, config.heads),
            NORM: lambda: nn.LayerNorm(channels),
            SAMPLE: lambda: BoxSampling(config, levels),
            FEED: lambda: FeedForward(2 * channels, channels, config.hidden_channels),
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
        super().__init__(config.remembered_lines, STAGE[1:] + STAGE * (config.stages - 1))
        channels = config.channels
        self.instance_bank = InstanceBank(config.lines, 2 * config.points_per_line, channels, handled=False)
        self.anchor_encoder = LineEncoder(channels, config.points_per_line)
        make: dict[str, Callable[[], nn.Module]] = {
            PAST: lambda: ResidualAttention(channels, config.heads),
            PRESENT: lambda: ResidualAttention(channels, config.heads),
            NORM: lambda: nn.LayerNorm(channels),
            SAMPLE: lambda: LineSampling(config, levels),
            FEED: lambda: FeedForward(2 * channels, channels, config.hidden_channels),
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
        others, places = key or (features, embeddings)
        result: Tensor = layer(features, features + embeddings, others + places, others)
        return result
