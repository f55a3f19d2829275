"""Occupancy of the ground by vehicles, now and two seconds on (OccFormer, section 3.3 of the paper)."""

from collections import OrderedDict
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from adapters.networks.layers.attention import ResidualAttention, ResidualFeedForward
from adapters.networks.uniad.config import UniADConfig

CELL_M = 0.5
"""Side of a cell of the occupancy grid."""
ATTENDED_ABOVE = 0.3
"""Cells attend to the vehicles whose mask is not lower there."""


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Occupancy by V vehicles over T steps of 0.5 s, the first of which is now; rows along y, columns along x.

    The centre of cell i is at (i + 0.5) * 0.5 m from the least corner. `logits` (V, T, rows, columns); `mask_logits`
    (V, T, rows / 8, columns / 8) where cells may attend to vehicles; `occupied` (T, rows, columns); `margin` (T, rows,
    columns), how far the decisive probability is from the limit, signed.
    """

    logits: Tensor
    mask_logits: Tensor
    occupied: Tensor
    margin: Tensor


class MLP(nn.Module):
    """Linear layers of one width with rectifiers between."""

    def __init__(self, channels: int, layers: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList([nn.Linear(channels, channels) for _ in range(layers)])

    def forward(self, tokens: Tensor) -> Tensor:
        """(..., C) to (..., C)."""
        for layer in self.layers[:-1]:
            tokens = F.relu(layer(tokens))
        result: Tensor = self.layers[-1](tokens)
        return result


class ConvolutionBlock(nn.Module):
    """A 3 x 3 convolution, normalised and rectified."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.bn = nn.BatchNorm2d(channels)

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, h, w) to (B, C, h, w)."""
        return F.relu(self.bn(self.conv(features)))


class LightProjection(nn.Module):
    """Three convolution blocks and a 1 x 1 convolution."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        blocks: list[nn.Module] = [ConvolutionBlock(channels) for _ in range(3)]
        self.conv_layers = nn.Sequential(*blocks, nn.Conv2d(channels, channels, 1))

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, h, w) to (B, C, h, w)."""
        result: Tensor = self.conv_layers(features)
        return result


class DownBlock(nn.Module):
    """A residual block that halves the grid."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        half = channels // 2

        def normalised(width: int) -> nn.Sequential:
            return nn.Sequential(nn.BatchNorm2d(width), nn.ReLU())

        self.layers = nn.Sequential(
            OrderedDict(
                [
                    ("conv_down_project", nn.Conv2d(channels, half, 1, bias=False)),
                    ("abn_down_project", normalised(half)),
                    ("conv", nn.Conv2d(half, half, 3, 2, padding=1, bias=False)),
                    ("abn", normalised(half)),
                    ("conv_up_project", nn.Conv2d(half, channels, 1, bias=False)),
                    ("abn_up_project", normalised(channels)),
                ]
            )
        )
        self.projection = nn.Sequential(
            OrderedDict(
                [
                    ("conv_skip_proj", nn.Conv2d(channels, channels, 1, bias=False)),
                    ("bn_skip_proj", nn.BatchNorm2d(channels)),
                ]
            )
        )

    def forward(self, features: Tensor) -> Tensor:
        """(B, C, h, w) to (B, C, ceil(h / 2), ceil(w / 2))."""
        rows, columns = features.shape[-2:]
        padded = F.pad(features, (0, columns % 2, 0, rows % 2))
        result: Tensor = self.layers(features) + self.projection(F.max_pool2d(padded, 2))
        return result


class UpsampleAdd(nn.Module):
    """Twice as many rows and columns, and a sum with what has as many."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.upsample_layer = nn.Sequential(
            nn.Upsample(scale_factor=2, mode="bilinear", align_corners=False),
            nn.Conv2d(channels, channels, 1, bias=False),
            nn.BatchNorm2d(channels),
        )

    def forward(self, coarse: Tensor, fine: Tensor) -> Tensor:
        """(B, C, h, w) and (B, C, H, W), of which h, w are half, to (B, C, H, W)."""
        result: Tensor = self.upsample_layer(coarse)[..., : fine.shape[-2], : fine.shape[-1]] + fine
        return result


class DenseBlock(nn.Module):
    """Twice as many rows and columns, with a shortcut from the coarsest grid."""

    def __init__(self, channels: int, rectified: bool) -> None:
        super().__init__()
        half = channels // 2
        self.conv = nn.Sequential(
            nn.Upsample(scale_factor=2, mode="bilinear", align_corners=True),
            nn.Conv2d(channels, half, 3, padding=1, bias=False),
            nn.BatchNorm2d(half),
            nn.ReLU(),
            nn.Conv2d(half, channels, 1, bias=False),
            nn.BatchNorm2d(channels),
        )
        self.up = nn.Conv2d(channels, channels, 1)
        self.rectified = rectified

    def forward(self, features: Tensor, coarsest: Tensor) -> Tensor:
        """(B, C, h, w) and (B, C, h0, w0) to (B, C, 2 h, 2 w)."""
        finer = self.conv(features)
        result: Tensor = finer + F.interpolate(self.up(coarsest), size=finer.shape[-2:], mode="nearest")
        return F.relu(result) if self.rectified else result


class DenseDecoder(nn.Module):
    """Two `DenseBlock`s."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList([DenseBlock(channels, rectified) for rectified in (True, False)])

    def forward(self, coarsest: Tensor) -> Tensor:
        """(B, C, h, w) to (B, C, 4 h, 4 w)."""
        features = coarsest
        for layer in self.layers:
            features = layer(features, coarsest)
        return features


class OccupancyLayer(nn.Module):
    """Cells look at each other and then at vehicles."""

    def __init__(self, channels: int, heads: int, hidden: int) -> None:
        super().__init__()
        self.attentions = nn.ModuleList([ResidualAttention(channels, heads) for _ in range(2)])
        self.ffns = nn.ModuleList([ResidualFeedForward(channels, hidden)])
        self.norms = nn.ModuleList([nn.LayerNorm(channels) for _ in range(3)])

    def forward(self, cells: Tensor, vehicles: Tensor, allowed: Tensor) -> Tensor:
        """(cells, C), (V, C) and (cells, V) booleans to (cells, C)."""
        cells = self.norms[0](self.attentions[0](cells, cells, cells, cells))
        cells = self.norms[1](self.attentions[1](cells, cells, vehicles, vehicles, allowed))
        result: Tensor = self.norms[2](self.ffns[0](cells))
        return result


class OccupancyDecoder(nn.Module):
    """One layer per step; the last normalisation is held by published checkpoints and not applied."""

    def __init__(self, channels: int, heads: int, hidden: int, layers: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList([OccupancyLayer(channels, heads, hidden) for _ in range(layers)])
        self.post_norm = nn.LayerNorm(channels)


class OccupancyHead(nn.Module):
    """Occupancy from the bird's-eye view and the tracks of vehicles."""

    places: Tensor

    def __init__(self, config: UniADConfig) -> None:
        super().__init__()
        self.config = config
        channels, steps = config.channels, range(config.occupancy_steps)
        self.register_buffer("places", self._places(), persistent=False)
        self.bev_light_proj = LightProjection(channels)
        self.base_downscale = nn.Sequential(DownBlock(channels), DownBlock(channels))
        self.transformer_decoder = OccupancyDecoder(
            channels, config.heads, config.occupancy_feedforward_channels, config.occupancy_steps
        )
        self.temporal_mlps = nn.ModuleList([MLP(channels, 2) for _ in steps])
        self.downscale_convs = nn.ModuleList([DownBlock(channels) for _ in steps])
        self.upsample_adds = nn.ModuleList([UpsampleAdd(channels) for _ in steps])
        self.dense_decoder = DenseDecoder(channels)
        self.mode_fuser = nn.Sequential(nn.Linear(channels, channels), nn.LayerNorm(channels), nn.ReLU())
        self.multi_query_fuser = nn.Sequential(
            nn.Linear(3 * channels, 2 * channels),
            nn.LayerNorm(2 * channels),
            nn.ReLU(),
            nn.Linear(2 * channels, channels),
        )
        self.query_to_occ_feat = MLP(channels, 3)
        self.temporal_mlp_for_mask = MLP(channels, 3)

    def _places(self) -> Tensor:
        """(1, side, side, 2) x, y of the occupancy grid's centres as shares of the bird's-eye view, for sampling."""
        config = self.config
        side = round(2 * config.occupancy_half_m / CELL_M)
        centres = (torch.arange(side, dtype=torch.float32) + 0.5) * CELL_M - config.occupancy_half_m
        x_low, y_low, _, x_high, y_high, _ = config.perception_range_m
        # The centres of the outermost cells are at -1 and 1.
        x = centres / ((x_high - x_low) * (1 - 1 / config.bev_columns) / 2)
        y = centres / ((y_high - y_low) * (1 - 1 / config.bev_rows) / 2)
        return torch.stack([x[None].expand(side, side), y[:, None].expand(side, side)], -1)[None]

    def forward(
        self, bev: Tensor, mode_queries: Tensor, states: Tensor, positions: Tensor, scores: Tensor
    ) -> Occupancy:
        """Occupancy by V vehicles; all is free where there is none.

        `mode_queries` are (V, modes, C) forecast states, `states` (V, C) tracks, `positions` (V, C) encoded places,
        `scores` (V,).
        """
        if len(states) == 0:
            steps, side = self.config.occupancy_steps, self.places.shape[1]
            nothing = torch.zeros(0, steps, side, side, device=bev.device)
            free = torch.zeros(steps, side, side, device=bev.device)
            return Occupancy(nothing, nothing, free.bool(), free - self.config.occupied_above)
        modes = self.mode_fuser(mode_queries).amax(1)
        vehicles = self.multi_query_fuser(torch.cat([modes, states, positions], -1))
        futures, masks, queries = self._futures(self._resample(bev), vehicles)
        features = self.dense_decoder(torch.stack(futures))
        logits = torch.einsum("tvc,tchw->vthw", self.query_to_occ_feat(torch.stack(queries)), features).float()
        probability = (logits.sigmoid() * scores[:, None, None, None]).amax(0)
        level = self.config.occupied_above
        return Occupancy(logits, torch.stack(masks, 1).float(), probability > level, probability - level)

    def _resample(self, bev: Tensor) -> Tensor:
        """(cells, C) to (1, C, side / 4, side / 4) on the occupancy grid."""
        rows, columns = self.config.grid.shape
        image = bev.view(1, rows, columns, -1).permute(0, 3, 1, 2)
        places = self.places.to(image.dtype) if image.device.type == "cpu" else self.places
        sampled = F.grid_sample(
            image.to(places.dtype), places, mode="bilinear", padding_mode="zeros", align_corners=True
        )
        result: Tensor = self.base_downscale(self.bev_light_proj(sampled.to(bev.dtype)))
        return result

    def _futures(self, present: Tensor, vehicles: Tensor) -> tuple[list[Tensor], list[Tensor], list[Tensor]]:
        """Step after step: (C, h, w) states, (V, h / 2, w / 2) mask logits, (V, C) queries of masks."""
        states, masks, queries, last = [], [], [], present
        for step in range(self.config.occupancy_steps):
            coarse = self.downscale_convs[step](last)
            query = self.temporal_mlps[step](vehicles)
            query_of_mask = self.temporal_mlp_for_mask(query)
            mask = torch.einsum("vc,chw->vhw", query_of_mask, coarse[0])
            allowed = (mask.sigmoid() >= ATTENDED_ABOVE).flatten(1).T
            allowed = allowed | ~allowed.any(1, keepdim=True)
            cells = coarse[0].flatten(1).T
            cells = self.transformer_decoder.layers[step](cells, query, allowed)
            last = self.upsample_adds[step](cells.T.reshape(coarse.shape), last)
            states.append(last[0])
            masks.append(mask)
            queries.append(query_of_mask)
        return states, masks, queries
