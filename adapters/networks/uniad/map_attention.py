"""The deformable attention of the map head, which reads its sampling pattern as the published kernel does.

Published weights have parameters for four feature maps, and the map head gives one. Its kernel takes the number of maps
from what it is given and walks on through the pattern, so query q samples where (and as strongly as) query q // 4
asked, head h at level (8 q + h) % 4 of head (8 q + h) % 32 // 4. Weights trained like this must be read like this. With
parameters for one map, as in later weights, the walk is the ordinary reading.
"""

import torch
from torch import Tensor, nn

from adapters.networks.layers.attention import Attention, FeedForward
from adapters.networks.layers.coders import logit
from adapters.networks.layers.deformable_attention import DeformableAttention
from adapters.networks.layers.sampling import Shapes, deformable_sampling

LEVEL_EMBEDDINGS = 4
"""Published networks have as many and use the first."""


class WalkedAttention(DeformableAttention):
    """Deformable attention to one map with parameters for `levels`; arguments as for `DeformableAttention`."""

    def forward(
        self, tokens: Tensor, positions: Tensor, references: Tensor, features: Tensor, shapes: Shapes
    ) -> Tensor:
        """Tokens, (Q, C), that have looked at (S, C) cells of the only map.

        `references` are (Q, 2) x, y, or (Q, 4) x, y, width, height, 0 to 1 over the map. Offsets are in cells in the
        one case, and in shares of half the size in the other. `positions` are added for the prediction of the pattern
        only.
        """
        ((rows, columns),) = shapes
        count, asking = len(tokens), -(-len(tokens) // self.levels)
        query = tokens[:asking] + positions[:asking]
        offsets, weights = self.offsets(query).float(), self.weights(query)
        if references.shape[-1] == 4:
            width, height = references[:asking, None, None, None, 2:].unbind(-1)
            offsets = offsets / self.points * (torch.stack([width * columns, height * rows], -1) / 2)
        walked = (count, self.heads, 1, self.points)
        used = count * self.heads * self.points
        places = references[:asking, :2].repeat_interleave(self.levels, 0)[:count]
        sampled = deformable_sampling(
            self.values(features)[None],
            shapes,
            places[:, None, None, None],
            offsets.reshape(-1)[: 2 * used].view(*walked, 2),
            weights.reshape(-1)[:used].view(walked),
        )
        attended: Tensor = self.output_proj(sampled)
        return tokens + attended


class MapEncoderLayer(nn.Module):
    """Deformable attention of a map to itself, then a feed-forward block; each is normalised after its addition.

    `levels` are those for which there are parameters, `points` looks per head and level.
    """

    def __init__(self, channels: int, heads: int, hidden: int, levels: int, points: int) -> None:
        super().__init__()
        self.attentions = nn.ModuleList([WalkedAttention(channels, heads, levels, points)])
        self.ffns = nn.ModuleList([FeedForward(channels, hidden)])
        self.norms = nn.ModuleList([nn.LayerNorm(channels) for _ in range(2)])

    def forward(self, cells: Tensor, positions: Tensor, centres: Tensor, shape: tuple[int, int]) -> Tensor:
        """(cells, C) to (cells, C); `centres` (cells, 2) are 0 to 1 over the map."""
        cells = self.norms[0](self.attentions[0](cells, positions, centres, cells, (shape,)))
        result: Tensor = self.norms[1](self.ffns[0](cells))
        return result


class MapDecoderLayer(nn.Module):
    """Self-attention, deformable attention to a map, feed-forward; arguments as for `MapEncoderLayer`."""

    def __init__(self, channels: int, heads: int, hidden: int, levels: int, points: int) -> None:
        super().__init__()
        self.attentions = nn.ModuleList([Attention(channels, heads), WalkedAttention(channels, heads, levels, points)])
        self.ffns = nn.ModuleList([FeedForward(channels, hidden)])
        self.norms = nn.ModuleList([nn.LayerNorm(channels) for _ in range(3)])

    def forward(
        self, tokens: Tensor, positions: Tensor, references: Tensor, cells: Tensor, shape: tuple[int, int]
    ) -> Tensor:
        """Arguments and result as in `WalkedAttention`."""
        tokens = self.norms[0](self.attentions[0](tokens, positions))
        tokens = self.norms[1](self.attentions[1](tokens, positions, references, cells, (shape,)))
        result: Tensor = self.norms[2](self.ffns[0](tokens))
        return result


class LayerStack(nn.Module):
    """Layers under the name that published checkpoints have for them."""

    def __init__(self, layers: list[nn.Module]) -> None:
        super().__init__()
        self.layers = nn.ModuleList(layers)


class MapTransformer(nn.Module):
    """An encoder of the bird's-eye view for the map, and a decoder of map elements with rectangles.

    `levels` are those for which there are parameters, `points` looks per head and level, `layers` those of each.
    """

    def __init__(self, channels: int, heads: int, hidden: int, levels: int, points: int, layers: int) -> None:
        super().__init__()
        sizes = (channels, heads, hidden, levels, points)
        self.level_embeds = nn.Parameter(torch.randn(LEVEL_EMBEDDINGS, channels))
        self.encoder = LayerStack([MapEncoderLayer(*sizes) for _ in range(layers)])
        self.decoder = LayerStack([MapDecoderLayer(*sizes) for _ in range(layers)])
        self.reference_points = nn.Linear(channels, 2)

    def encode(self, bev: Tensor, positions: Tensor, centres: Tensor, shape: tuple[int, int]) -> Tensor:
        """(cells, C) to (cells, C); arguments as in `MapEncoderLayer`."""
        positions = positions + self.level_embeds[0]
        for layer in self.encoder.layers:
            bev = layer(bev, positions, centres, shape)
        return bev

    def decode(
        self, queries: Tensor, cells: Tensor, shape: tuple[int, int], branches: nn.ModuleList
    ) -> tuple[Tensor, Tensor]:
        """Map elements: for K layers, (K, M, C) states and (K, M, 4) rectangles.

        Rectangles are centre x, y, width, height, 0 to 1 over the map. `queries` are (M, 2 C) positions and then
        contents, `cells` (cells, C); `branches` take (M, C) to (M, 4) corrections, one for each layer.
        """
        positions, tokens = queries.chunk(2, -1)
        references = self.reference_points(positions).float().sigmoid()
        states, rectangles = [], []
        for layer, branch in zip(self.decoder.layers, branches, strict=True):
            tokens = layer(tokens, positions, references, cells, shape)
            correction, known = branch(tokens).float(), references.shape[-1]
            moved = correction[:, :known] + logit(references)
            references = torch.cat([moved, correction[:, known:]], -1).sigmoid()
            states.append(tokens)
            rectangles.append(references)
        return torch.stack(states), torch.stack(rectangles)
