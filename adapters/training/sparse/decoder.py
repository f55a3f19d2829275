"""The decoders of boxes and lines on several key frames at once, as training needs them."""

from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor

from adapters.networks.sparse.aggregation import CameraFeatures
from adapters.networks.sparse.boxes import BoxSampling, carry_boxes
from adapters.networks.sparse.decoder import (
    DECAY,
    PAST,
    PRESENT,
    REFINE,
    SAMPLE,
    BoxDecoder,
    Decoded,
    Remembered,
    SparseDecoder,
    Stage,
)
from adapters.networks.sparse.keyframe_pose import USUAL_INTERVAL_S
from adapters.networks.sparse.lines import LineSampling
from adapters.training.sparse.views import KeyframeMotions, rows_of


@dataclass(frozen=True, slots=True)
class Learned(Decoded):
    """N instances of B key frames after the last stage; all tensors have a leading B.

    Attributes:
        kept: What to remember of them; nothing is learned through it.
    """

    kept: Remembered

    @classmethod
    def decoded(
        cls, decoder: SparseDecoder, views: CameraFeatures, past: Remembered | None, motions: KeyframeMotions | None
    ) -> Self:
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
            if isinstance(decoder, BoxDecoder):
                carried = carry_boxes(past.anchors, motions, motions.seconds)
            else:
                carried = motions.carry_lines(past.anchors)
            key = past.features, decoder.anchor_encoder(carried)
        stages: list[Stage] = []
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


def _sampled(layer: object, features: Tensor, anchors: Tensor, embeddings: Tensor, views: CameraFeatures) -> Tensor:
    assert isinstance(layer, BoxSampling | LineSampling)
    batch, count = features.shape[:2]
    points = layer.kps_generator(features.flatten(0, 1), anchors.flatten(0, 1)).unflatten(0, (batch, count))
    return torch.cat([layer.sample(features + embeddings, points, views), features], -1)


def _refined(
    layer: torch.nn.Module, features: Tensor, anchors: Tensor, embeddings: Tensor, motions: KeyframeMotions | None
) -> Stage:
    batch, count = features.shape[:2]
    interval_s = motions.seconds.expand(-1, count, -1).flatten(0, 1) if motions else USUAL_INTERVAL_S
    refined = layer(features.flatten(0, 1), anchors.flatten(0, 1), embeddings.flatten(0, 1), interval_s)
    places, logits, qualities = (None if each is None else each.unflatten(0, (batch, count)) for each in refined)
    assert places is not None and logits is not None
    return Stage(places, logits, qualities)


def _kept(decoder: SparseDecoder, last: Stage, features: Tensor, past: Remembered | None) -> Remembered:
    confidence = last.logits.detach().amax(-1).sigmoid()
    if past:
        old = torch.maximum(past.confidence * DECAY, confidence[:, : decoder.remembered])
        confidence = torch.cat([old, confidence[:, decoder.remembered :]], 1)
    best, rows = confidence.topk(decoder.remembered, dim=1)
    return Remembered(rows_of(features.detach(), rows), rows_of(last.anchors.detach(), rows), best, rows)
