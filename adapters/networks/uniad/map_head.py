"""The map head (Panoptic SegFormer, Li et al., 2022): road elements, their masks, and the published sampling order."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.attention import Attention, ResidualFeedForward, plain_branch, sine_grid_encoding
from adapters.networks.layers.deformable_attention import DeformableAttention, Shapes, deformable_sampling
from adapters.networks.layers.deformable_decoder import logit, select_strongest
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.map_masks import MaskDecoder

LEVEL_EMBEDDINGS = 4
"""Published networks have as many and use the first."""


class PublishedOrderAttention(DeformableAttention):
    """Deformable attention to one map with parameters for `levels`; arguments as for `DeformableAttention`."""

    def forward(
        self, tokens: Tensor, positions: Tensor, references: Tensor, features: Tensor, shapes: Shapes
    ) -> Tensor:
        """Tokens, (Q, C), that have looked at (S, C) cells of the only map; `positions` are for the pattern only.

        `references` are (Q, 2) x, y with offsets in cells, or (Q, 4) x, y, width, height with offsets in shares of half
        the size; both 0 to 1 over the map.
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
    """Deformable attention of a map to itself, then a feed-forward block; each is normalised after its addition."""

    def __init__(self, channels: int, heads: int, hidden: int, levels: int, points: int) -> None:
        super().__init__()
        self.attentions = nn.ModuleList([PublishedOrderAttention(channels, heads, levels, points)])
        self.ffns = nn.ModuleList([ResidualFeedForward(channels, hidden)])
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
        self.attentions = nn.ModuleList(
            [Attention(channels, heads), PublishedOrderAttention(channels, heads, levels, points)]
        )
        self.ffns = nn.ModuleList([ResidualFeedForward(channels, hidden)])
        self.norms = nn.ModuleList([nn.LayerNorm(channels) for _ in range(3)])

    def forward(
        self, tokens: Tensor, positions: Tensor, references: Tensor, cells: Tensor, shape: tuple[int, int]
    ) -> Tensor:
        """Arguments and result as in `PublishedOrderAttention`."""
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
    """An encoder of the bird's-eye view for the map, and a decoder of map elements with rectangles."""

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
        """Map elements: for K layers, (K, M, C) states and (K, M, 4) rectangles, centre x, y, width, height, 0 to 1.

        `queries` are (M, 2 C) positions and then contents, `cells` (cells, C); `branches` take (M, C) to (M, 4)
        corrections.
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


RECTANGLE = 4
UNUSED_LAYERS = 4
"""Of branches that published checkpoints hold and no prediction uses."""


@dataclass(frozen=True, slots=True)
class MapElements:
    """M map elements; K layers.

    `cells` (cells, C) is the bird's-eye view after the map head's encoder; `queries` (M, C) after the last layer;
    `query_positions` (M, C); `class_logits` (K, M, map classes); `rectangles` (K, M, 4) centre x, y, width, height, 0
    to 1 over the view.
    """

    cells: Tensor
    queries: Tensor
    query_positions: Tensor
    class_logits: Tensor
    rectangles: Tensor


@dataclass(frozen=True, slots=True)
class MapMasks:
    """Masks of the N most certain map elements, and of the drivable area; above a half is inside.

    `rectangles` (N, 4) are centre x, y, width, height, 0 to 1 over the bird's-eye view; `scores` (N,) falling; `values`
    (N, rows, columns); `drivable_values` (rows, columns).
    """

    rectangles: Tensor
    scores: Tensor
    labels: Tensor
    values: Tensor
    drivable_values: Tensor


class MapHead(nn.Module):
    """Map elements from the bird's-eye view."""

    positions: Tensor
    centres: Tensor

    def __init__(self, config: UniADConfig) -> None:
        super().__init__()
        self.config = config
        channels, layers, classes = config.channels, config.map_layers, config.map_classes
        encoding = sine_grid_encoding(config.bev_rows, config.bev_columns, channels // 2)
        self.register_buffer("positions", encoding, persistent=False)
        self.register_buffer("centres", config.grid.centres(), persistent=False)
        self.transformer = MapTransformer(
            channels, config.heads, config.feedforward_channels, config.map_levels, config.bev_points, layers
        )
        self.bev_embedding = nn.Embedding(config.grid.cells, channels)
        self.cls_branches = nn.ModuleList([nn.Linear(channels, classes) for _ in range(layers)])
        self.reg_branches = nn.ModuleList([plain_branch(channels, RECTANGLE) for _ in range(layers)])
        self.query_embedding = nn.Embedding(config.map_queries, 2 * channels)
        self.stuff_query = nn.Embedding(1, 2 * channels)
        self.reg_branches2 = nn.ModuleList([plain_branch(channels, RECTANGLE) for _ in range(UNUSED_LAYERS)])
        self.cls_thing_branches = nn.ModuleList([nn.Linear(channels, classes) for _ in range(UNUSED_LAYERS)])
        self.cls_stuff_branches = nn.ModuleList([nn.Linear(channels, 1) for _ in range(config.stuff_mask_layers)])
        self.things_mask_head = MaskDecoder(channels, config.heads, config.thing_mask_layers, attend_each_other=False)
        self.stuff_mask_head = MaskDecoder(channels, config.heads, config.stuff_mask_layers, attend_each_other=True)

    def forward(self, bev: Tensor) -> MapElements:
        """Map elements in a bird's-eye view of (cells, C)."""
        shape, queries = self.config.grid.shape, self.query_embedding.weight
        cells = self.transformer.encode(bev, self.positions.to(bev.dtype), self.centres, shape)
        states, rectangles = self.transformer.decode(queries, cells, shape, self.reg_branches)
        logits = [branch(state).float() for branch, state in zip(self.cls_branches, states, strict=True)]
        return MapElements(cells, states[-1], queries[:, : self.config.channels], torch.stack(logits), rectangles)

    def masks(self, elements: MapElements) -> MapMasks:
        """Masks of the most certain map elements; the plan does not need them."""
        scores, labels, chosen = select_strongest(elements.class_logits[-1], self.config.max_lines)
        # Unlike the queries of elements, this one has its contents first.
        contents, positions = self.stuff_query.weight.chunk(2, -1)
        values = self.things_mask_head(elements.queries[chosen], None, elements.cells)
        drivable = self.stuff_mask_head(contents, positions, elements.cells)
        shape = self.config.grid.shape
        return MapMasks(
            rectangles=elements.rectangles[-1, chosen],
            scores=scores,
            labels=labels,
            values=values.float().view(-1, *shape),
            drivable_values=drivable.float().view(shape),
        )
