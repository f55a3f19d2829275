"""Deformable aggregation (Sparse4D v2, Lin et al., 2023), and small networks under indices of published checkpoints."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from adapters.networks.layers.attention import sine_features


def normalised_layers(inputs: int, channels: int, linears: int, norms: int) -> list[nn.Module]:
    """Groups of linear layers, each followed by a ReLU, with a normalisation after every group."""
    layers: list[nn.Module] = []
    for _ in range(norms):
        for _ in range(linears):
            layers += [nn.Linear(inputs, channels), nn.ReLU()]
            inputs = channels
        layers.append(nn.LayerNorm(channels))
    return layers


def encoder(inputs: int, channels: int, norms: int) -> nn.Sequential:
    """`norms` linear layers, each with ReLU and normalisation."""
    return nn.Sequential(*normalised_layers(inputs, channels, 1, norms))


def point_encoder(inputs: int, channels: int) -> nn.Sequential:
    """A hidden layer with normalisation, and a linear one."""
    return nn.Sequential(*normalised_layers(inputs, channels, 1, 1), nn.Linear(channels, channels))


def class_branch(channels: int, outputs: int) -> nn.Sequential:
    """Two hidden layers with normalisation, and a linear one."""
    return nn.Sequential(*normalised_layers(channels, channels, 1, 2), nn.Linear(channels, outputs))


class Scale(nn.Module):
    """A learned factor for each channel."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.scale = nn.Parameter(torch.ones(channels))

    def forward(self, numbers: Tensor) -> Tensor:
        """(..., channels) to the same."""
        return numbers * self.scale


def correction_branch(channels: int, outputs: int) -> nn.Sequential:
    """Four hidden layers with two normalisations, a linear one and a factor for each number."""
    return nn.Sequential(*normalised_layers(channels, channels, 2, 2), nn.Linear(channels, outputs), Scale(outputs))


class AsymmetricFeedForward(nn.Module):
    """Two linear layers beside a third, all of them on the normalised input."""

    def __init__(self, inputs: int, channels: int, hidden: int) -> None:
        super().__init__()
        self.pre_norm = nn.LayerNorm(inputs)
        self.layers = nn.Sequential(
            nn.Sequential(nn.Linear(inputs, hidden), nn.ReLU()),
            nn.Linear(hidden, channels),
        )
        self.identity_fc = nn.Linear(inputs, channels)

    def forward(self, tokens: Tensor) -> Tensor:
        """(..., inputs) to (..., channels)."""
        tokens = self.pre_norm(tokens)
        result: Tensor = self.identity_fc(tokens) + self.layers(tokens)
        return result


def decoupled_attention(
    layer: nn.Module,
    widen: nn.Linear,
    narrow: nn.Linear,
    query: tuple[Tensor, Tensor],
    key: tuple[Tensor, Tensor] | None,
    allowed: Tensor | None = None,
) -> Tensor:
    """Attention, (..., Q, C), with features and embeddings of anchors side by side instead of added.

    `layer` has twice the width of the features; there is no way round `narrow`. `query` and `key` are features and
    embeddings, (..., Q, C) and (..., K, C); without `key` queries look at each other, and values are the queries as
    they are, not widened by `widen`.
    """
    tokens = torch.cat(query, -1)
    keys = tokens if key is None else torch.cat(key, -1)
    values = tokens if key is None else widen(key[0])
    result: Tensor = narrow(layer(tokens, tokens, keys, values, allowed))
    return result


def sine_of_points(points: Tensor, features: int) -> Tensor:
    """Sines and cosines, (..., features) with those of y first, of (..., 2) x, y in metres, which count as turns."""
    return sine_features(2 * math.pi * points.flip(-1), features // 2).flatten(-2)


NEAREST_DEPTH_M = 1e-5
"""Least depth of projection; nearer points and those behind are clamped to it, hardly ever into the image."""


@dataclass(frozen=True, slots=True)
class CameraFeatures:
    """Features of the cameras in a key frame, or in B of them side by side.

    `values` are (cameras or B * cameras, S, C) of all levels, fine to coarse, each flattened row by row: S cells;
    `projections` (cameras, 4, 4) or (B, cameras, 4, 4) float32, lidar frame in metres to pixels of the input images.
    """

    values: Tensor
    shapes: tuple[tuple[int, int], ...]
    projections: Tensor
    height_px: int
    width_px: int

    @classmethod
    def of(cls, maps: Sequence[Tensor], projections: Tensor, height_px: int, width_px: int) -> "CameraFeatures":
        """Features from maps of (cameras or B * cameras, C, h, w) for each level, fine to coarse."""
        values = torch.cat([features.flatten(2) for features in maps], -1).transpose(1, 2).contiguous()
        shapes = tuple((int(features.shape[-2]), int(features.shape[-1])) for features in maps)
        return cls(values, shapes, projections, height_px, width_px)

    def locate(self, points: Tensor) -> Tensor:
        """Places of (..., N, P, 3) metres, lidar frame, in the images: (..., N, cameras, P, 2) x, y, 0 to 1 inside."""
        # Written out, because matrix products may run in reduced precision, and one pixel changes the feature.
        x, y, z = points[..., None, :, :].float().unbind(-1)
        rows = self.projections[..., None, :, :3, :].unbind(-2)
        u, v, depth = (row[..., :1] * x + row[..., 1:2] * y + row[..., 2:3] * z + row[..., 3:] for row in rows)
        depth = depth.clamp(min=NEAREST_DEPTH_M)
        return torch.stack([u / depth / self.width_px, v / depth / self.height_px], -1)


def deformable_aggregation(
    values: Tensor,
    shapes: Sequence[tuple[int, int]],
    locations: Tensor,
    weights: Tensor,
    first_camera: Tensor | None = None,
) -> Tensor:
    """Sum of weighted bilinear samples over points, cameras and levels: (N, C), in the type of `values`.

    Samples outside the image count nothing on any level, also where a bilinear sample would still reach its border.
    `values` are (cameras, S, C) as in `CameraFeatures`; `locations` (N, cameras, P, 2) x, y where 0 to 1 spans the
    image, both ends excluded; `weights` (N, cameras, L, P, G) for G groups of neighbouring channels; `first_camera`
    (N,) a query's first row of `values`, where they are of several key frames.
    """
    queries, groups = len(locations), weights.shape[-1]
    sources, cells, channels = values.shape
    inside = ((locations > 0) & (locations < 1)).all(-1)
    query, camera, point = inside.nonzero().unbind(-1)
    if len(query) == 0:
        return values.new_zeros(queries, channels)
    x, y = locations[query, camera, point].unbind(-1)
    rows, shares = _neighbours(shapes, x, y)
    source = camera if first_camera is None else camera + first_camera[query]
    rows = rows + (source * cells).to(rows.dtype)[:, None, None]
    hit_weights = weights[query, camera, :, point].float().transpose(1, 2)
    group = torch.arange(groups, device=rows.device, dtype=rows.dtype)
    table_rows = rows[:, None] * groups + group[:, None, None]
    sampled = F.embedding_bag(
        table_rows.flatten(0, 1).flatten(1),
        values.reshape(sources * cells * groups, channels // groups),
        per_sample_weights=(shares[:, None] * hit_weights[..., None]).flatten(0, 1).flatten(1).to(values.dtype),
        mode="sum",
    )
    # Samples of a query lie together, so that they are summed in one order on every device.
    counts = inside.flatten(1).sum(1)
    order = torch.arange(len(query), device=query.device)
    return F.embedding_bag(order, sampled.view(len(query), channels), counts.cumsum(0) - counts, mode="sum")


def _neighbours(shapes: Sequence[tuple[int, int]], x: Tensor, y: Tensor) -> tuple[Tensor, Tensor]:
    """Cells of one camera around V places inside it and the shares that they have, both (V, L, 4)."""
    cells, shares, start = [], [], 0
    for rows, columns in shapes:
        across, down = x * columns - 0.5, y * rows - 0.5
        left, top = across.floor(), down.floor()
        right_share, lower_share = across - left, down - top
        column, row = left.to(torch.int32), top.to(torch.int32)
        left_share = (1 - right_share) * (column >= 0)
        right_share = right_share * (column < columns - 1)
        upper_share = (1 - lower_share) * (row >= 0)
        lower_share = lower_share * (row < rows - 1)
        # Neighbours outside have weight zero, so any cell may be used for them.
        first, second = column.clamp(min=0), (column + 1).clamp(max=columns - 1)
        above, below = row.clamp(min=0) * columns + start, (row + 1).clamp(max=rows - 1) * columns + start
        cells.append(torch.stack([above + first, above + second, below + first, below + second], -1))
        products = [upper_share * left_share, upper_share * right_share]
        products += [lower_share * left_share, lower_share * right_share]
        shares.append(torch.stack(products, -1))
        start += rows * columns
    return torch.stack(cells, 1), torch.stack(shares, 1)


class CameraSampling(nn.Module):
    """Weights of cameras, levels and points in a query; the base of modules that sample images.

    Subclasses make the modules, because the order of their names is that of the published checkpoints. `camera_encoder`
    takes the first three rows of a projection, `weights_fc` gives weights of levels, points and groups.
    """

    camera_encoder: nn.Sequential
    weights_fc: nn.Linear
    output_proj: nn.Linear

    def __init__(self, groups: int) -> None:
        super().__init__()
        self.groups = groups

    def sample(self, queries: Tensor, points: Tensor, cameras: CameraFeatures) -> Tensor:
        """Samples of the images, (..., N, C) at (..., N, P, 3) metres, lidar frame, for queries of (..., N, C)."""
        count, levels, total = points.shape[-2], len(cameras.shapes), queries.shape[:-1].numel()
        views = self.camera_encoder(cameras.projections[..., :3, :].flatten(-2))
        # The layer is linear, so queries and cameras can pass through it separately, once each.
        seen_from = F.linear(views, self.weights_fc.weight)[..., None, :, :]
        logits = (self.weights_fc(queries)[..., None, :] + seen_from).view(total, -1, self.groups).float()
        weights = logits.softmax(1).view(total, views.shape[-2], levels, count, self.groups)
        first = None
        if cameras.projections.dim() == 4:
            frames = torch.arange(len(queries), device=queries.device)
            first = frames.repeat_interleave(queries.shape[1]) * views.shape[-2]
        locations = cameras.locate(points).flatten(0, -4)
        sampled = deformable_aggregation(cameras.values, cameras.shapes, locations, weights, first)
        result: Tensor = self.output_proj(sampled.view(queries.shape))
        return result


def camera_encoder(channels: int) -> nn.Sequential:
    """Layers from the twelve numbers of a camera's projection to channels."""
    return encoder(12, channels, 2)
