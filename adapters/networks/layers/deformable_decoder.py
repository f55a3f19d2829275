"""A decoder whose queries move their sampling points from layer to layer, and its codes of boxes and positions."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.attention import Attention, ResidualFeedForward
from adapters.networks.layers.deformable_attention import DeformableAttention, Shapes


def logit(shares: Tensor, closest: float = 1e-5) -> Tensor:
    """Inverse of the sigmoid, finite at both ends: numbers are clamped to `closest` ... 1 - `closest`."""
    shares = shares.clamp(0, 1)
    return torch.log(shares.clamp(min=closest) / (1 - shares).clamp(min=closest))


def to_metres(shares: Tensor, lower: Sequence[float], upper: Sequence[float]) -> Tensor:
    """Positions in metres from shares, (..., D) of 0 to 1, of a range between two corners of D coordinates."""
    axes = [shares[..., axis] * (high - low) + low for axis, (low, high) in enumerate(zip(lower, upper, strict=True))]
    return torch.stack(axes, -1)


def box_codes(centres: Tensor, corrections: Tensor) -> Tensor:
    """Codes of boxes from (..., 3) centres in metres and the (..., 10) corrections of a branch: all but 0, 1 and 4.

    (..., 10) x, y, log width, log length, z, log height, sin yaw, cos yaw, velocity x, y.
    """
    x_y, z = centres[..., :2], centres[..., 2:3]
    return torch.cat([x_y, corrections[..., 2:4], z, corrections[..., 5:]], -1)


def decode_boxes(codes: Tensor) -> Tensor:
    """Boxes, (..., 9) centre, width, length, height, yaw, velocity, from `box_codes`; sine and cosine at any scale."""
    x_y, z = codes[..., 0:2], codes[..., 4:5]
    sizes = torch.cat([codes[..., 2:4], codes[..., 5:6]], -1).exp()
    yaw = torch.atan2(codes[..., 6:7], codes[..., 7:8])
    return torch.cat([x_y, z, sizes, yaw, codes[..., 8:10]], -1)


def select_strongest(logits: Tensor, limit: int) -> tuple[Tensor, Tensor, Tensor]:
    """Falling scores, classes and queries of the best pairs in (Q, classes) logits; a query may recur."""
    scores, pairs = logits.float().sigmoid().flatten().topk(min(limit, logits.numel()))
    classes = logits.shape[-1]
    return scores, pairs % classes, pairs // classes


def line_extent(points: Tensor) -> Tensor:
    """Smallest upright rectangle, (..., 4) centre x, y, width, height, around a line of (..., P, 2)."""
    low, high = points.amin(-2), points.amax(-2)
    return torch.cat([(low + high) / 2, high - low], -1)


def extent_corners(extents: Tensor) -> Tensor:
    """(..., 4) centre x, y, width, height to (..., 4) lower x, y, upper x, y."""
    centre, size = extents[..., :2], extents[..., 2:]
    return torch.cat([centre - size / 2, centre + size / 2], -1)


def are_within(coordinates: Tensor, lower: Sequence[float], upper: Sequence[float]) -> Tensor:
    """Whether all of (..., D) coordinates lie in a closed range: (...) booleans."""
    inside = [
        (coordinates[..., axis] >= low) & (coordinates[..., axis] <= high)
        for axis, (low, high) in enumerate(zip(lower, upper, strict=True))
    ]
    return torch.stack(inside).all(0)


class DeformableDecoderLayer(nn.Module):
    """Self-attention, deformable attention to maps, feed-forward; each is normalised after its addition."""

    def __init__(self, channels: int, heads: int, hidden: int, levels: int, points: int) -> None:
        super().__init__()
        self.attentions = nn.ModuleList(
            [Attention(channels, heads), DeformableAttention(channels, heads, levels, points)]
        )
        self.ffns = nn.ModuleList([ResidualFeedForward(channels, hidden)])
        self.norms = nn.ModuleList([nn.LayerNorm(channels) for _ in range(3)])

    def forward(
        self, tokens: Tensor, positions: Tensor, references: Tensor, features: Tensor, shapes: Shapes
    ) -> Tensor:
        """Arguments and result as in `DeformableAttention`."""
        tokens = self.norms[0](self.attentions[0](tokens, positions))
        tokens = self.norms[1](self.attentions[1](tokens, positions, references, features, shapes))
        result: Tensor = self.norms[2](self.ffns[0](tokens))
        return result


@dataclass(frozen=True, slots=True)
class DecoderOutputs:
    """Results of the K layers of a decoder.

    `states` are (K, Q, C) tokens, `first_references` (Q, R) 0 to 1 where the first layer looked, `references` (K, Q, R)
    the same after each correction, x, y first, `corrections` (K, Q, D).
    """

    states: Tensor
    first_references: Tensor
    references: Tensor
    corrections: Tensor


class DeformableDecoder(nn.Module):
    """A stack of `DeformableDecoderLayer`; arguments as there, and how many layers."""

    def __init__(self, channels: int, heads: int, hidden: int, levels: int, points: int, layers: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(
            [DeformableDecoderLayer(channels, heads, hidden, levels, points) for _ in range(layers)]
        )

    def forward(
        self,
        tokens: Tensor,
        positions: Tensor,
        references: Tensor,
        features: Tensor,
        shapes: Shapes,
        branches: nn.ModuleList,
        moved: tuple[int, ...],
    ) -> DecoderOutputs:
        """Decode (Q, C) tokens against (S, C) cells of all maps.

        `references` are (Q, R), x, y first, 0 to 1. `branches` predict (Q, D) corrections, one for each layer; `moved`
        says for each of the R coordinates which correction is added to its logit.
        """
        first, columns = references.float(), list(moved)
        references = first
        states, moved_references, corrections = [], [], []
        for layer, branch in zip(self.layers, branches, strict=True):
            tokens = layer(tokens, positions, references[:, :2], features, shapes)
            correction = branch(tokens).float()
            shift = torch.stack([correction[:, column] for column in columns], -1)
            references = (shift + logit(references)).sigmoid()
            states.append(tokens)
            moved_references.append(references)
            corrections.append(correction)
        return DecoderOutputs(torch.stack(states), first, torch.stack(moved_references), torch.stack(corrections))
