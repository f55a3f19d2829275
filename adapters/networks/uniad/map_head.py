"""The map head: elements of the road, masks of these and of the drivable area (Panoptic SegFormer, Li et al., 2022)."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.branches import plain_branch
from adapters.networks.layers.coders import strongest
from adapters.networks.layers.positional import sine_grid_encoding
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.map_attention import MapTransformer
from adapters.networks.uniad.map_masks import MaskDecoder

RECTANGLE = 4
UNUSED_LAYERS = 4
"""Of branches that published checkpoints hold and no prediction uses."""


@dataclass(frozen=True, slots=True)
class MapElements:
    """M map elements; K layers.

    Attributes:
        cells: (cells, C) the bird's-eye view as the map head's encoder sees it.
        queries: (M, C) states after the last layer.
        query_positions: (M, C).
        class_logits: (K, M, map classes).
        rectangles: (K, M, 4) centre x, y, width, height, 0 to 1 over the bird's-eye view.
    """

    cells: Tensor
    queries: Tensor
    query_positions: Tensor
    class_logits: Tensor
    rectangles: Tensor


@dataclass(frozen=True, slots=True)
class MapMasks:
    """Masks of the N most certain map elements, and of the drivable area.

    Attributes:
        rectangles: (N, 4) centre x, y, width, height, 0 to 1 over the bird's-eye view.
        scores: (N,) 0 to 1, falling.
        labels: (N,).
        values: (N, rows, columns); above a half is inside.
        drivable_values: (rows, columns), likewise.
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
        scores, labels, chosen = strongest(elements.class_logits[-1], self.config.max_lines)
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
