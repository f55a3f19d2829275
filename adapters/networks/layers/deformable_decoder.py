"""A decoder whose queries look at points of feature maps and move their points from layer to layer."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.attention import Attention, FeedForward
from adapters.networks.layers.coders import logit
from adapters.networks.layers.deformable_attention import DeformableAttention
from adapters.networks.layers.sampling import Shapes


class DeformableDecoderLayer(nn.Module):
    """Self-attention, deformable attention to maps, feed-forward; each is normalised after its addition.

    `points` are looks per head and map.
    """

    def __init__(self, channels: int, heads: int, hidden: int, levels: int, points: int) -> None:
        super().__init__()
        self.attentions = nn.ModuleList(
            [Attention(channels, heads), DeformableAttention(channels, heads, levels, points)]
        )
        self.ffns = nn.ModuleList([FeedForward(channels, hidden)])
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
class Decoded:
    """Results of the K layers of a decoder.

    Attributes:
        states: (K, Q, C) tokens after each layer.
        first_references: (Q, R) where the first layer looked, 0 to 1.
        references: (K, Q, R) the same after each layer's correction; the last axis starts with x, y.
        corrections: (K, Q, D) what the layers' branches predicted.
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
    ) -> Decoded:
        """Decode (Q, C) tokens against (S, C) cells of all maps; the result holds all that happened on the way.

        `references` are (Q, R), R at least 2: x, y first, 0 to 1. `branches` predict (Q, D) corrections from tokens,
        one for each layer; `moved` says for each of the R coordinates which of the D corrections is added to its
        logit.
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
        return Decoded(torch.stack(states), first, torch.stack(moved_references), torch.stack(corrections))
