"""Time and memory of a scene before anything is loaded (section 18).

Floating-point operations are counted by formula; how fast the device does them is measured on one layer, or given.
"""

import functools
import math
import time
from dataclasses import dataclass
from typing import Final

import torch
from torch import nn

from benchmark.scene import Scene
from generation.extensions.magicdrive.bev_map import MAP_CELLS
from generation.extensions.magicdrive.clip import SMALL_HEIGHT_PX, pad_frames
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.encoders import CORNERS, EGO_COLUMNS, MAP_PADDINGS, MAP_STRIDES
from generation.extensions.magicdrive.layers import FOURIER_CHANNELS, LatentSize, modulate
from generation.extensions.magicdrive.model import MagicDriveDiT
from generation.extensions.magicdrive.sensor_frames import ImageGeometry
from generation.pipeline.estimate import format_duration


@dataclass(frozen=True, slots=True)
class ClipWorkload:
    """Sizes that the cost of a clip depends on; ``boxes`` are slots, ``map_cells`` lie along the map's sides."""

    frames: int
    size: LatentSize
    text_tokens: int
    boxes: int
    map_cells: tuple[int, int] = (200, 200)


@dataclass(frozen=True, slots=True)
class OperationCounts:
    """Floating-point operations of one evaluation of one branch.

    The four kinds of attention, products over places (spatial) or latent frames (temporal), are parts of `base` and
    `control`; `encoders` count once for a branch.
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
        """Operations of a clip with guidance, 2 * steps evaluations; ``as_published`` encodes conditions at each."""
        return 2 * (steps * self.transformer + (steps if as_published else 1) * self.encoders)


def count_operations(config: MagicDriveConfig, clip: ClipWorkload, *, as_published: bool = False) -> OperationCounts:
    """Operations of one evaluation of the network.

    ``as_published`` counts keys and values of every condition token of every view and frame, and projections between
    views once for each neighbour.
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
    return OperationCounts(
        base=config.depth * (pair + views) + 2 * patches,
        control=config.control_depth * (pair + skips) + patches,
        spatial_attention=pairs * spatial,
        temporal_attention=pairs * temporal,
        cross_attention=2 * pairs * cross,
        between_views=config.depth * views,
        encoders=_count_boxes(config, clip)
        + _count_ego(config, clip)
        + _count_text(config, clip)
        + _count_map(config, clip),
    )


def _count_boxes(config: MagicDriveConfig, clip: ClipWorkload) -> float:
    corners, wide = CORNERS * FOURIER_CHANNELS, config.box_hidden
    layers = config.hidden * (corners + 2 * wide + wide) + wide**2
    return config.views * clip.boxes * _count_over_time(config, clip.frames, layers)


def _count_ego(config: MagicDriveConfig, clip: ClipWorkload) -> float:
    return _count_over_time(config, clip.frames, EGO_COLUMNS * FOURIER_CHANNELS * config.hidden)


def _count_over_time(config: MagicDriveConfig, frames: int, layers: int) -> float:
    """Of a sequence: a block and the projection after it, and the layers before."""
    return 2.0 * frames * (layers + 13 * config.hidden**2) + 4.0 * frames**2 * config.hidden


def _count_text(config: MagicDriveConfig, clip: ClipWorkload) -> float:
    return 2.0 * clip.text_tokens * config.hidden * (config.caption_channels + config.hidden)


def _count_map(config: MagicDriveConfig, clip: ClipWorkload) -> float:
    first, second, third, fourth = config.map_channels
    widths = (first, first, second, second, third, third, fourth)
    rows, columns = clip.map_cells
    total = clip.frames * _count_convolution(config.map_layers, first, rows, columns)
    for i, ((down, across), (above, beside)) in enumerate(zip(MAP_STRIDES, MAP_PADDINGS, strict=True)):
        rows, columns = (rows + 2 * above - 3) // down + 1, (columns + 2 * beside - 3) // across + 1
        total += clip.frames * _count_convolution(widths[i], widths[i + 1], rows, columns)
    half = config.hidden // 2
    total += clip.frames * _count_convolution(fourth, half, rows, columns)
    total += -(-clip.frames // 2) * _count_convolution(half, half, rows, columns)
    total += clip.size.frames * _count_convolution(half, config.hidden, rows, columns)
    return total + 10.0 * config.hidden**2 * clip.size.frames * clip.size.tokens


def _count_convolution(channels: int, out: int, rows: int, columns: int) -> float:
    return 2.0 * 9 * channels * out * rows * columns


T5_NUMBERS: Final = 4.76e9
"""Numbers of the published text encoder; a token costs twice as many operations."""
_DECODER_BYTES: Final = 0.72 * 2**30
_DECODER_BYTES_A_PIXEL: Final = 49_100
"""In bfloat16: a line through the sizes that the model's authors measured, 4.82 GiB at 224x400, 16.24 at 424x800."""
_CHUNK_OPERATIONS: Final = 13.3e12
_FIRST_CHUNK_OPERATIONS: Final = 15.2e12
"""Of decoding 2, or at the start of an odd number 3, latent frames of a view of 224x400."""
_COUNTED_PIXELS: Final = 224 * 400
_LIVE_TENSORS: Final = 16
"""Tensors of the size of all tokens that live at the same time in an evaluation: 13 measured, and some air."""
_TOKENS_A_WORD: Final = 1.5
_PROBE_TOKENS: Final = {"cuda": 1 << 15, "cpu": 1 << 7}
_GIB: Final = 2**30


@dataclass(frozen=True, slots=True)
class RenderingStage:
    """One network at work, after the stage before; ``gib`` is memory of the device, weights included."""

    name: str
    operations: float
    gib: float


@dataclass(frozen=True, slots=True)
class RenderingEstimate:
    """Cost of a scene; ``size`` is height and width as drawn, ``tera_operations`` a second are measured or given."""

    frames: int
    size: tuple[int, int]
    stages: tuple[RenderingStage, ...]
    device: str
    tera_operations: float
    measured: bool

    @property
    def seconds(self) -> float:
        """About how long a scene takes, without reading weights."""
        return sum(stage.operations for stage in self.stages) / (self.tera_operations * 1e12)

    def plain(self) -> str:
        """A few lines for people."""
        height, width = self.size
        known = "measured on one of its layers" if self.measured else "as given"
        lines = [
            f"a scene of {self.frames} frames and six views at {height}x{width}: about {format_duration(self.seconds)} "
            f"on {self.device} at {self.tera_operations:.3g} TFLOP/s ({known}), without reading weights"
        ]
        for stage in self.stages:
            seconds = stage.operations / (self.tera_operations * 1e12)
            lines.append(
                f"  {stage.name:<12} {stage.operations / 1e15:>8.3f} PFLOP {format_duration(seconds):>8} "
                f"{stage.gib:>6.1f} GiB"
            )
        return "\n".join(lines)


def estimate_rendering_stages(
    scene: Scene,
    geometry: ImageGeometry,
    config: MagicDriveConfig,
    *,
    steps: int,
    words: str,
    dtype: torch.dtype,
) -> tuple[RenderingStage, ...]:
    """Stages of a scene's cost, in their order; ``dtype`` is the precision of transformer and decoder."""
    frames = len(pad_frames(range(len(scene.timestamps_us))))
    size = LatentSize.of(frames, geometry.height, geometry.width, config.rows_multiple)
    cells = MAP_CELLS if geometry.height <= SMALL_HEIGHT_PX else 2 * MAP_CELLS
    text_tokens = min(math.ceil(_TOKENS_A_WORD * len(words.split())) + 2, config.text_tokens)
    clip = ClipWorkload(frames, size, text_tokens, max(len(scene.agents), 1), (cells, cells))
    number_bytes = torch.finfo(dtype).bits // 8
    tokens = config.views * size.frames * size.tokens
    pixels = geometry.height * geometry.width
    decoding = size.frames // 2 * _CHUNK_OPERATIONS
    if size.frames % 2:
        decoding += _FIRST_CHUNK_OPERATIONS - _CHUNK_OPERATIONS * (size.frames > 1)
    live = _LIVE_TENSORS * tokens * config.hidden
    return (
        RenderingStage("words", 2 * T5_NUMBERS * config.text_tokens, T5_NUMBERS * 4 / _GIB + 1),
        RenderingStage(
            "transformer",
            count_operations(config, clip).scene(steps),
            number_bytes * (live + count_parameters(config)) / _GIB,
        ),
        RenderingStage(
            "decoder",
            config.views * decoding * pixels / _COUNTED_PIXELS,
            (_DECODER_BYTES + _DECODER_BYTES_A_PIXEL * pixels) * number_bytes / 2 / _GIB,
        ),
    )


@functools.cache
def count_parameters(config: MagicDriveConfig) -> int:
    """Numbers of the transformer."""
    with torch.device("meta"):
        network = MagicDriveDiT(config)
    return sum(tensor.numel() for tensor in network.state_dict().values())


@functools.cache
def measure_speed(device: torch.device, dtype: torch.dtype, channels: int) -> float:
    """10^12 operations a second of a device at the network's main work on tokens: norm, modulation and an MLP."""
    tokens = _PROBE_TOKENS["cuda" if device.type == "cuda" else "cpu"]
    layer = nn.Sequential(nn.Linear(channels, 4 * channels), nn.GELU("tanh"), nn.Linear(4 * channels, channels))
    layer = layer.to(device, dtype)
    x = torch.ones(tokens, channels, device=device, dtype=dtype)
    shift = torch.zeros(channels, device=device, dtype=dtype)

    @torch.no_grad()
    def seconds(times: int) -> float:
        started = _read_clock(device)
        for _ in range(times):
            x.add(layer(modulate(x, shift, shift)))
        return _read_clock(device) - started

    seconds(1)
    times = 10 if device.type == "cuda" else 1
    return times * 16.0 * tokens * channels**2 / seconds(times) / 1e12


def _read_clock(device: torch.device) -> float:
    if device.type != "cuda":
        return time.process_time()
    torch.cuda.synchronize(device)
    return time.perf_counter()
