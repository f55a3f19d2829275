"""Encoders of what the model is told about a clip (sections 4 and 5 of the specification)."""

from typing import Final

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.layers import (
    FOURIER_CHANNELS,
    Mlp,
    RotaryFrequencies,
    SequenceSelfAttention,
    compute_fourier_features,
    modulate,
    split_axis,
)

CLASSES: Final = 10
CORNERS: Final = 8
HIDDEN_BOX: Final = -1
"""In the masks of boxes: present, but not to be shown."""
ABSENT_BOX: Final = 0
CAMERA_COLUMNS: Final = 7
EGO_COLUMNS: Final = 4
MAP_STRIDES: Final = ((1, 1), (2, 2), (1, 1), (2, 2), (1, 1), (2, 1))
MAP_PADDINGS: Final = ((1, 1), (2, 1), (1, 1), (2, 1), (2, 1), (2, 1))


def pool_in_time(frames: Tensor) -> Tensor:
    """Average (frames, ...) in pairs, as the video autoencoder does; of an odd number the first stays alone."""
    alone = frames[: len(frames) % 2]
    return torch.cat([alone, split_axis(frames[len(frames) % 2 :], 0, -1, 2).mean(1)])


class TextEncoder(nn.Module):
    """Hidden states of the text encoder become tokens (section 4.1)."""

    def __init__(self, config: MagicDriveConfig) -> None:
        super().__init__()
        self.y_embedding: Tensor
        self.register_buffer("y_embedding", torch.randn(config.text_tokens, config.caption_channels))
        self.y_proj = Mlp(config.caption_channels, config.hidden, config.hidden)

    def forward(self, states: Tensor) -> Tensor:
        """(tokens, caption channels) to (tokens, C)."""
        out: Tensor = self.y_proj(states)
        return out


class TemporalEncoder(nn.Module):
    """Base of the encoders of boxes and ego motion: a block over frames, a projection, two poolings in time.

    They build it last: tensors have the order of the published file.
    """

    def _build_block(self, config: MagicDriveConfig) -> None:
        channels = config.hidden
        self.rounded = config.rounded
        self.scale_shift_table = nn.Parameter(torch.randn(6, channels) / channels**0.5)
        self.rope = RotaryFrequencies(channels // config.encoder_heads)
        self.attn = SequenceSelfAttention(channels, config.encoder_heads)
        self.mlp = Mlp(channels, 4 * channels, channels)
        self.final_proj = nn.Linear(channels, channels)

    def encode_over_time(self, tokens: Tensor) -> Tensor:
        """Let each sequence, (sequences, T, C), look at itself and pool it to latent frames, (sequences, t, C)."""
        shift_a, scale_a, gate_a, shift_m, scale_m, gate_m = self.scale_shift_table.unbind(0)
        rotation = self.rope.rotation(tokens.shape[1], tokens.dtype, rounded=self.rounded)
        tokens = tokens + gate_a * self.attn(modulate(tokens, shift_a, scale_a), rotation)
        tokens = tokens + gate_m * self.mlp(modulate(tokens, shift_m, scale_m))
        frames = self.final_proj(tokens).transpose(0, 1)
        return pool_in_time(pool_in_time(frames)).transpose(0, 1)


class ClipBoxEncoder(TemporalEncoder):
    """Boxes with identities become tokens (section 4.2)."""

    def __init__(self, config: MagicDriveConfig) -> None:
        super().__init__()
        channels, corners = config.hidden, CORNERS * FOURIER_CHANNELS
        self.mean_var = nn.Parameter(torch.zeros(CLASSES, 2))
        self.null_class_feature = nn.Parameter(torch.zeros(channels))
        self.null_pos_feature = nn.Parameter(torch.zeros(corners))
        self.mask_class_feature = nn.Parameter(torch.zeros(channels))
        self.mask_pos_feature = nn.Parameter(torch.zeros(corners))
        self._class_tokens: Tensor
        self.register_buffer("_class_tokens", torch.randn(CLASSES, channels))
        self.bbox_proj = nn.Linear(corners, channels)
        self.second_linear = nn.Sequential(
            nn.Linear(2 * channels, config.box_hidden),
            nn.SiLU(),
            nn.Linear(config.box_hidden, config.box_hidden),
            nn.SiLU(),
            nn.Linear(config.box_hidden, channels),
        )
        self._build_block(config)

    def forward(self, corners: Tensor, classes: Tensor, masks: Tensor, latent: Tensor) -> Tensor:
        """(t, n, C) of boxes as one view sees them: (T, n, 8, 3) metres, classes -1 where absent, latents (n, C).

        Masks, (T, n), are 1 where seen, 0 where absent or not seen, -1 where hidden.
        """
        dtype = self.bbox_proj.weight.dtype
        mean, log_variance = self.mean_var[classes % CLASSES, :, None].unbind(-2)
        content = self._class_tokens[classes % CLASSES] + latent.to(dtype) * (0.5 * log_variance).exp() + mean
        places = compute_fourier_features(corners).flatten(2).to(dtype)
        for value, place, kind in (
            (ABSENT_BOX, self.null_pos_feature, self.null_class_feature),
            (HIDDEN_BOX, self.mask_pos_feature, self.mask_class_feature),
        ):
            replaced = (masks == value)[..., None]
            places = torch.where(replaced, place, places)
            content = torch.where(replaced, kind, content)
        tokens = self.second_linear(torch.cat([F.silu(self.bbox_proj(places)), content], -1))
        return self.encode_over_time(tokens.transpose(0, 1)).transpose(0, 1)


class CameraEncoder(nn.Module):
    """Intrinsic matrix and camera->lidar transform of a view become one token (section 4.3)."""

    def __init__(self, config: MagicDriveConfig) -> None:
        super().__init__()
        self.uncond_cam = nn.Parameter(torch.randn(3, CAMERA_COLUMNS))
        self.emb2token = nn.Linear(CAMERA_COLUMNS * FOURIER_CHANNELS, config.hidden)
        self.after_proj = nn.Linear(config.hidden, config.hidden)

    def forward(self, cams: Tensor) -> Tensor:
        """(V, 3, 7) to (V, C)."""
        columns = compute_fourier_features(cams.transpose(1, 2)).flatten(1)
        out: Tensor = self.after_proj(self.emb2token(columns.to(self.emb2token.weight.dtype)))
        return out


class EgoEncoder(TemporalEncoder):
    """Motion of the lidar since the first frame becomes one token a latent frame (section 4.4)."""

    def __init__(self, config: MagicDriveConfig) -> None:
        super().__init__()
        self.uncond_cam = nn.Parameter(torch.randn(3, EGO_COLUMNS))
        self.emb2token = nn.Linear(EGO_COLUMNS * FOURIER_CHANNELS, config.hidden)
        self._build_block(config)

    def forward(self, transforms: Tensor) -> Tensor:
        """(T, 3, 4) to (t, C)."""
        columns = compute_fourier_features(transforms.transpose(1, 2)).flatten(1)
        tokens = self.emb2token(columns.to(self.emb2token.weight.dtype))
        return self.encode_over_time(tokens[None])[0]


class MapEncoder(nn.Module):
    """Bird's-eye maps become features of the latent's size, frame by frame (section 5)."""

    def __init__(self, config: MagicDriveConfig) -> None:
        super().__init__()
        first, second, third, fourth = config.map_channels
        widths = (first, first, second, second, third, third, fourth)
        self.conv_in = nn.Conv2d(config.map_layers, first, 3, padding=1)
        self.blocks = nn.ModuleList(
            nn.Conv2d(widths[i], widths[i + 1], 3, MAP_STRIDES[i], MAP_PADDINGS[i]) for i in range(len(MAP_STRIDES))
        )
        self.conv_out = nn.Conv2d(fourth, config.hidden // 2, 3, padding=1)

    def forward(self, maps: Tensor) -> Tensor:
        """(T, layers, 200, 200) to (T, C/2, 28, 50)."""
        features = F.silu(self.conv_in(maps))
        for block in self.blocks:
            features = F.silu(block(features))
        out: Tensor = self.conv_out(features)
        return out


class _FrameConvolution(nn.Module):
    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, out, 3, padding=1)

    def forward(self, frames: Tensor) -> Tensor:
        out: Tensor = self.conv(frames)
        return out


class MapTimeEncoder(nn.Module):
    """Map features of frames become those of latent frames: pooling and a convolution, twice."""

    def __init__(self, config: MagicDriveConfig) -> None:
        super().__init__()
        half = config.hidden // 2
        self.conv_blocks = nn.ModuleDict(
            {"1": _FrameConvolution(half, half), "3": _FrameConvolution(half, config.hidden)}
        )

    def forward(self, frames: Tensor) -> Tensor:
        """(T, C/2, 28, 50) to (t, C, 28, 50)."""
        for convolution in self.conv_blocks.values():
            frames = convolution(pool_in_time(frames))
        return frames
