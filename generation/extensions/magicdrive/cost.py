"""How much there is to compute: floating-point operations of an evaluation, counted by formula (section 18).

A product of matrices (m, k) and (k, n) is 2mkn. What is not a product or a convolution is left out.
"""

from dataclasses import dataclass

from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.encoders import CORNERS, EGO_COLUMNS, MAP_PADDINGS, MAP_STRIDES
from generation.extensions.magicdrive.latents import LatentSize
from generation.extensions.magicdrive.position import FOURIER_CHANNELS


@dataclass(frozen=True, slots=True)
class Workload:
    """Sizes that the cost of a clip depends on.

    ``text_tokens`` are those of the prompt, ``boxes`` the box slots, ``map_cells`` the cells along the map's sides.
    """

    frames: int
    size: LatentSize
    text_tokens: int
    boxes: int
    map_cells: tuple[int, int] = (200, 200)


@dataclass(frozen=True, slots=True)
class Operations:
    """Floating-point operations of one evaluation of one branch.

    Attributes:
        base: Of the base stream; the four kinds of attention are parts of it and of the control stream.
        spatial_attention: Products of queries, keys and values over places.
        temporal_attention: The same over latent frames.
        encoders: Of all condition encoders; once for a branch.
    """

    base: float
    control: float
    spatial_attention: float
    temporal_attention: float
    cross_attention: float
    between_views: float
    encoders: float

    @property
    def transformer(self) -> float:
        """Of both streams: what every evaluation costs."""
        return self.base + self.control

    def scene(self, steps: int, *, as_published: bool = False) -> float:
        """Operations of a clip with guidance, 2 * steps evaluations.

        ``as_published`` encodes conditions at every evaluation.
        """
        return 2 * (steps * self.transformer + (steps if as_published else 1) * self.encoders)


def operations(config: MagicDriveConfig, clip: Workload, *, as_published: bool = False) -> Operations:
    """Count one evaluation of the network.

    ``as_published`` counts what the published code computes: keys and values of every condition token of every view
    and frame, and projections between views once for each neighbour.
    """
    size, square = clip.size, config.hidden**2
    cells = config.views * size.frames
    tokens = cells * size.tokens
    everything = cells * (2 + clip.text_tokens + clip.boxes)
    distinct = size.frames + config.views + clip.text_tokens + cells * clip.boxes
    projected = everything if as_published else distinct
    spatial = 4.0 * tokens * size.tokens * config.hidden
    temporal = 4.0 * tokens * size.frames * config.hidden
    length = 2 + clip.text_tokens + clip.boxes
    cross = 4.0 * square * (tokens + projected) + 4.0 * tokens * length * config.hidden
    # Queries, keys, values and the answer of each neighbour, or once; then the projection that is added.
    views = (18.0 if as_published else 10.0) * square * tokens + 2 * spatial
    rest = (8.0 + 16.0) * square * tokens
    # Cross-attention and the rest are in spatial and temporal blocks alike.
    pair = 2 * (cross + rest) + spatial + temporal
    patches = 8.0 * config.latent_channels * config.hidden * tokens
    skips = 2 * 2.0 * square * tokens
    pairs = config.depth + config.control_depth
    return Operations(
        base=config.depth * (pair + views) + 2 * patches,
        control=config.control_depth * (pair + skips) + patches,
        spatial_attention=pairs * spatial,
        temporal_attention=pairs * temporal,
        cross_attention=2 * pairs * cross,
        between_views=config.depth * views,
        encoders=_of_boxes(config, clip) + _of_ego(config, clip) + _of_text(config, clip) + _of_map(config, clip),
    )


def _of_boxes(config: MagicDriveConfig, clip: Workload) -> float:
    corners, wide = CORNERS * FOURIER_CHANNELS, config.box_hidden
    layers = config.hidden * (corners + 2 * wide + wide) + wide**2
    return config.views * clip.boxes * _over_time(config, clip.frames, layers)


def _of_ego(config: MagicDriveConfig, clip: Workload) -> float:
    return _over_time(config, clip.frames, EGO_COLUMNS * FOURIER_CHANNELS * config.hidden)


def _over_time(config: MagicDriveConfig, frames: int, layers: int) -> float:
    """Of a sequence: a block and the projection after it, and the layers before."""
    return 2.0 * frames * (layers + 13 * config.hidden**2) + 4.0 * frames**2 * config.hidden


def _of_text(config: MagicDriveConfig, clip: Workload) -> float:
    return 2.0 * clip.text_tokens * config.hidden * (config.caption_channels + config.hidden)


def _of_map(config: MagicDriveConfig, clip: Workload) -> float:
    first, second, third, fourth = config.map_channels
    widths = (first, first, second, second, third, third, fourth)
    rows, columns = clip.map_cells
    total = clip.frames * _convolution(config.map_layers, first, rows, columns)
    for i, ((down, across), (above, beside)) in enumerate(zip(MAP_STRIDES, MAP_PADDINGS, strict=True)):
        rows, columns = (rows + 2 * above - 3) // down + 1, (columns + 2 * beside - 3) // across + 1
        total += clip.frames * _convolution(widths[i], widths[i + 1], rows, columns)
    half = config.hidden // 2
    total += clip.frames * _convolution(fourth, half, rows, columns)
    total += -(-clip.frames // 2) * _convolution(half, half, rows, columns)
    total += clip.size.frames * _convolution(half, config.hidden, rows, columns)
    return total + 10.0 * config.hidden**2 * clip.size.frames * clip.size.tokens


def _convolution(channels: int, out: int, rows: int, columns: int) -> float:
    return 2.0 * 9 * channels * out * rows * columns
