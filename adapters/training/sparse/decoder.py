"""The decoders of boxes and lines on several key frames at once, as training needs them."""

from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from adapters.networks.sparse.boxes import BoxSampling
from adapters.networks.sparse.decoder import DECAY, PAST, PRESENT, REFINE, SAMPLE, BoxDecoder, SparseDecoder
from adapters.networks.sparse.keyframe_pose import USUAL_INTERVAL_S
from adapters.networks.sparse.lines import LineSampling
from adapters.training.sparse.views import KeyframeMotions, Views, rows_of


@dataclass(frozen=True, slots=True)
class LearnedStage:
    """What a stage says about N instances of B key frames.

    Attributes:
        anchors: (B, N, D).
        logits: (B, N, classes).
        qualities: (B, N, 2) of boxes only.
    """

    anchors: Tensor
    logits: Tensor
    qualities: Tensor | None


@dataclass(frozen=True, slots=True)
class Kept:
    """The K most certain instances, for the next key frames; nothing is learned through them.

    Attributes:
        features: (B, K, C).
        anchors: (B, K, D).
        confidence: (B, K) 0 to 1.
        rows: (B, K) which instances they are.
    """

    features: Tensor
    anchors: Tensor
    confidence: Tensor
    rows: Tensor


@dataclass(frozen=True, slots=True)
class Learned:
    """N instances of B key frames after the last stage.

    Attributes:
        stages: One after the other.
        features: (B, N, C).
        embeddings: (B, N, C).
        kept: What to remember of them.
    """

    stages: tuple[LearnedStage, ...]
    features: Tensor
    embeddings: Tensor
    kept: Kept

    @property
    def anchors(self) -> Tensor:
        """(B, N, D) places."""
        return self.stages[-1].anchors

    @property
    def scores(self) -> Tensor:
        """(B, N) 0 to 1, of the most likely class."""
        return self.stages[-1].logits.amax(-1).sigmoid()

    @classmethod
    def decoded(cls, decoder: SparseDecoder, views: Views, past: Kept | None, motions: KeyframeMotions | None) -> Self:
        """Decode B key frames.

        Gradients stop between stages, at the places of instances: each stage learns how to correct what it is given.

        Args:
            decoder: Of boxes or of lines.
            views: What the cameras saw.
            past: What is remembered.
            motions: Since then.

        Returns:
            The instances.
        """
        batch = len(views.projections)
        anchors: Tensor = decoder.instance_bank.anchor.expand(batch, -1, -1)
        features: Tensor = decoder.instance_bank.instance_feature.expand(batch, -1, -1)
        embeddings: Tensor = decoder.anchor_encoder(anchors)
        count = anchors.shape[1]
        carried, key = None, None
        if past and motions:
            moved = motions.carry_boxes(past.anchors, True) if isinstance(decoder, BoxDecoder) else None
            carried = motions.carry_lines(past.anchors) if moved is None else moved
            key = past.features, decoder.anchor_encoder(carried)
        stages: list[LearnedStage] = []
        for operation, layer in zip(decoder.operations, decoder.layers, strict=True):
            if operation == PAST:
                features = decoder.attend(layer, features, embeddings, key)
            elif operation == PRESENT:
                features = decoder.attend(layer, features, embeddings, (features, embeddings))
            elif operation == SAMPLE:
                features = _sampled(layer, features, anchors, embeddings, views)
            elif operation == REFINE:
                stages.append(_refined(layer, features, anchors, embeddings, motions))
                anchors = stages[-1].anchors.detach()
                if len(stages) == 1 and past and carried is not None:
                    best = stages[0].logits.detach().amax(-1)
                    rows = best.topk(count - decoder.remembered, dim=1).indices
                    features = torch.cat([past.features, rows_of(features, rows)], 1)
                    anchors = torch.cat([carried, rows_of(anchors, rows)], 1)
                embeddings = decoder.anchor_encoder(anchors)
                if len(stages) > 1 and key:
                    key = key[0], embeddings[:, : decoder.remembered]
            else:
                features = layer(features)
        return cls(tuple(stages), features, embeddings, _kept(decoder, stages[-1], features, past))


def _sampled(layer: object, features: Tensor, anchors: Tensor, embeddings: Tensor, views: Views) -> Tensor:
    assert isinstance(layer, BoxSampling | LineSampling)
    batch, count = features.shape[:2]
    points = layer.kps_generator(features.flatten(0, 1), anchors.flatten(0, 1)).unflatten(0, (batch, count))
    return torch.cat([views.sample(layer, features + embeddings, points), features], -1)


def _refined(
    layer: torch.nn.Module, features: Tensor, anchors: Tensor, embeddings: Tensor, motions: KeyframeMotions | None
) -> LearnedStage:
    batch, count = features.shape[:2]
    interval_s = motions.seconds.expand(-1, count, -1).flatten(0, 1) if motions else USUAL_INTERVAL_S
    refined = layer(features.flatten(0, 1), anchors.flatten(0, 1), embeddings.flatten(0, 1), interval_s)
    places, logits, qualities = (None if each is None else each.unflatten(0, (batch, count)) for each in refined)
    assert places is not None and logits is not None
    return LearnedStage(places, logits, qualities)


def _kept(decoder: SparseDecoder, last: LearnedStage, features: Tensor, past: Kept | None) -> Kept:
    confidence = last.logits.detach().amax(-1).sigmoid()
    if past:
        old = torch.maximum(past.confidence * DECAY, confidence[:, : decoder.remembered])
        confidence = torch.cat([old, confidence[:, decoder.remembered :]], 1)
    best, rows = confidence.topk(decoder.remembered, dim=1)
    return Kept(rows_of(features.detach(), rows), rows_of(last.anchors.detach(), rows), best, rows)
