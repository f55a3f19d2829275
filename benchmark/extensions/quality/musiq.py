"""MUSIQ, the image quality transformer of Ke et al. (ICCV 2021), as VBench runs it; loads the public weights by name.

A picture is seen at three sizes: longer side 224, 384, and as it is. Each is cut into patches of 32 x 32 pixels, which
a small residual network turns into tokens with their place (in a 10 x 10 grid that every picture is hashed to) and
size. A transformer over all tokens ends in one number, 0 to 100 for weights trained on SPAQ.

Three choices follow the PyTorch version that VBench calls and not the original: pictures are resized by bicubic
interpolation (originally Gaussian), weights are standardised by the unbiased deviation, and the GELU is the exact one.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Self

import torch
from torch import Tensor, nn
from torch.nn import functional

from benchmark.errors import InputError
from benchmark.weights.folders import read_checkpoint

PATCH_PX: Final = 32
LONGER_SIDES_PX: Final = (224, 384)
"""Sizes at which a picture is seen beside its own."""
_GROUPS: Final = 32
_HEAD_WIDTH: Final = 64
_STEM_STRIDE: Final = 4


@dataclass(frozen=True, slots=True)
class MusiqConfig:
    """Sizes of the network; the defaults are those of the published weights. There is a head for each 64 of `hidden`.

    `stem` is the width of the residual network before its last step, a multiple of 32; `grid` is the side of the grid.
    """

    hidden: int = 384
    mlp: int = 1152
    layers: int = 14
    stem: int = 64
    grid: int = 10
    scales: int = len(LONGER_SIDES_PX) + 1

    @classmethod
    def of(cls, tensors: Mapping[str, Tensor], path: Path) -> Self:
        """Read the sizes from the tensors of MUSIQ's weights."""
        encoder = "transformer_encoder"
        try:
            return cls(
                hidden=tensors["embedding.weight"].shape[0],
                mlp=tensors[f"{encoder}.transformer.encoderblock_0.mlp.fc1.weight"].shape[0],
                layers=sum(name.endswith(".norm1.weight") for name in tensors),
                stem=tensors["conv_root.weight"].shape[0],
                grid=math.isqrt(tensors[f"{encoder}.posembed_input.position_emb"].shape[1]),
                scales=tensors[f"{encoder}.scaleembed_input.scale_emb"].shape[0],
            )
        except (KeyError, IndexError) as error:
            raise InputError(
                f"{path} does not hold the weights of MUSIQ ({error} is missing or has another shape); fetch the file "
                "that challenger-bench weights list names"
            ) from error


@dataclass(frozen=True, slots=True)
class Patches:
    """A picture as the network sees it: (N, 3, 32, 32), -1 to 1, with the (N,) cell of the grid and size of each."""

    pixels: Tensor
    position: Tensor
    scale: Tensor


def cut_multiscale_patches(picture: Tensor, grid: int = 10) -> Patches:
    """Cut a (3, height, width) picture, -1 to 1, into patches at all sizes, the smallest first, in reading order."""
    height, width = picture.shape[1:]
    pixels, position, scale = [], [], []
    for index, longer_px in enumerate((*LONGER_SIDES_PX, None)):
        scaled = picture[None]
        if longer_px is not None:
            ratio = longer_px / max(height, width)
            size = max(round(height * ratio), 1), max(round(width * ratio), 1)
            scaled = functional.interpolate(scaled, size, mode="bicubic", align_corners=False)
        rows, columns = math.ceil(scaled.shape[2] / PATCH_PX), math.ceil(scaled.shape[3] / PATCH_PX)
        padded = functional.pad(scaled, _same_padding(scaled.shape[2:], PATCH_PX, PATCH_PX))
        cut = padded.reshape(3, rows, PATCH_PX, columns, PATCH_PX).permute(1, 3, 0, 2, 4)
        pixels.append(cut.reshape(-1, 3, PATCH_PX, PATCH_PX))
        position.append(
            (grid * _hash_positions(rows, grid)[:, None] + _hash_positions(columns, grid)[None]).reshape(-1)
        )
        scale.append(torch.full((rows * columns,), index))
    return Patches(torch.cat(pixels), torch.cat(position).to(picture.device), torch.cat(scale).to(picture.device))


class Musiq(nn.Module):
    """MUSIQ's network."""

    def __init__(self, config: MusiqConfig | None = None) -> None:
        super().__init__()
        config = config or MusiqConfig()
        self.config = config
        self.conv_root = _StandardisedConv(3, config.stem, 7, stride=2, bias=False)
        self.gn_root = nn.GroupNorm(_GROUPS, config.stem, eps=1e-6)
        self.block1 = _Bottleneck(config.stem, 4 * config.stem)
        self.embedding = nn.Linear(4 * config.stem * (PATCH_PX // _STEM_STRIDE) ** 2, config.hidden)
        self.transformer_encoder = _Encoder(config)
        self.head = nn.Linear(config.hidden, 1)

    @classmethod
    def load(cls, path: Path) -> Self:
        """Network in evaluation mode with a bare state dict, read without running anything in the file."""
        tensors = read_checkpoint(path).tensors
        network = cls(MusiqConfig.of(tensors, path))
        try:
            network.load_state_dict(tensors, strict=True)
        except RuntimeError as error:
            reason = str(error).splitlines()[-1].strip()
            raise InputError(f"the weights in {path} do not fit MUSIQ: {reason}; fetch the published file") from error
        return network.eval()

    def forward(self, pictures: Sequence[Patches]) -> Tensor:
        """(B,) scores of pictures of any sizes; each depends on its own picture only."""
        lengths = [len(picture.pixels) for picture in pictures]
        tokens = self._tokens(torch.cat([picture.pixels for picture in pictures]))
        tokens = tokens + self.transformer_encoder.posembed_input(torch.cat([p.position for p in pictures]))
        tokens = tokens + self.transformer_encoder.scaleembed_input(torch.cat([p.scale for p in pictures]))
        padded = nn.utils.rnn.pad_sequence(list(tokens.split(lengths)), batch_first=True)
        counts = torch.tensor(lengths, device=padded.device)
        there = torch.arange(padded.shape[1], device=padded.device) < counts[:, None]
        scores: Tensor = self.head(self.transformer_encoder(padded, there))
        return scores[:, 0]

    def _tokens(self, patches: Tensor) -> Tensor:
        features = functional.relu(self.gn_root(self.conv_root(patches)))
        features = functional.max_pool2d(functional.pad(features, _same_padding(features.shape[2:], 3, 2)), 3, 2)
        features = self.block1(features)
        # Channels last, as in training.
        tokens: Tensor = self.embedding(features.permute(0, 2, 3, 1).flatten(1))
        return tokens


class _StandardisedConv(nn.Conv2d):
    """A convolution whose kernels have mean 0 and deviation 1; pictures are padded as TensorFlow's ``SAME``."""

    def forward(self, input: Tensor) -> Tensor:
        weight = self.weight - self.weight.mean((1, 2, 3), keepdim=True)
        weight = weight / (weight.std((1, 2, 3), keepdim=True) + 1e-5)
        padded = functional.pad(input, _same_padding(input.shape[2:], self.kernel_size[0], self.stride[0]))
        return functional.conv2d(padded, weight, self.bias, self.stride)


class _Bottleneck(nn.Module):
    def __init__(self, width: int, wide: int) -> None:
        super().__init__()
        self.conv1 = _StandardisedConv(width, width, 1, bias=False)
        self.gn1 = nn.GroupNorm(_GROUPS, width, eps=1e-4)
        self.conv2 = _StandardisedConv(width, width, 3, bias=False)
        self.gn2 = nn.GroupNorm(_GROUPS, width, eps=1e-4)
        self.conv3 = _StandardisedConv(width, wide, 1, bias=False)
        self.gn3 = nn.GroupNorm(_GROUPS, wide, eps=1e-4)
        self.conv_proj = _StandardisedConv(width, wide, 1, bias=False)
        self.gn_proj = nn.GroupNorm(_GROUPS, wide, eps=1e-4)

    def forward(self, features: Tensor) -> Tensor:
        past = self.gn_proj(self.conv_proj(features))
        features = functional.relu(self.gn1(self.conv1(features)))
        features = functional.relu(self.gn2(self.conv2(features)))
        return functional.relu(self.gn3(self.conv3(features)) + past)


class _PositionEmbedding(nn.Module):
    def __init__(self, cells: int, width: int) -> None:
        super().__init__()
        self.position_emb = nn.Parameter(torch.randn(1, cells, width) * 0.02)

    def forward(self, position: Tensor) -> Tensor:
        return self.position_emb[0, position]


class _ScaleEmbedding(nn.Module):
    def __init__(self, scales: int, width: int) -> None:
        super().__init__()
        self.scale_emb = nn.Parameter(torch.randn(scales, width) * 0.02)

    def forward(self, scale: Tensor) -> Tensor:
        return self.scale_emb[scale]


class _Attention(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.heads = max(width // _HEAD_WIDTH, 1)
        self.query, self.key, self.value, self.out = (nn.Linear(width, width) for _ in range(4))

    def forward(self, tokens: Tensor, there: Tensor) -> Tensor:
        count, length, width = tokens.shape
        query, key, value = (
            layer(tokens).view(count, length, self.heads, -1).transpose(1, 2)
            for layer in (self.query, self.key, self.value)
        )
        attended = functional.scaled_dot_product_attention(query, key, value, attn_mask=there[:, None, None])
        mixed: Tensor = self.out(attended.transpose(1, 2).reshape(count, length, width))
        return mixed


class _FeedForward(nn.Module):
    def __init__(self, width: int, inside: int) -> None:
        super().__init__()
        self.fc1, self.fc2 = nn.Linear(width, inside), nn.Linear(inside, width)

    def forward(self, tokens: Tensor) -> Tensor:
        transformed: Tensor = self.fc2(functional.gelu(self.fc1(tokens)))
        return transformed


class _TransformerLayer(nn.Module):
    def __init__(self, config: MusiqConfig) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(config.hidden, eps=1e-6)
        self.attention = _Attention(config.hidden)
        self.norm2 = nn.LayerNorm(config.hidden, eps=1e-6)
        self.mlp = _FeedForward(config.hidden, config.mlp)

    def forward(self, tokens: Tensor, there: Tensor) -> Tensor:
        tokens = tokens + self.attention(self.norm1(tokens), there)
        transformed: Tensor = tokens + self.mlp(self.norm2(tokens))
        return transformed


class _Encoder(nn.Module):
    def __init__(self, config: MusiqConfig) -> None:
        super().__init__()
        self.posembed_input = _PositionEmbedding(config.grid**2, config.hidden)
        self.scaleembed_input = _ScaleEmbedding(config.scales, config.hidden)
        self.cls = nn.Parameter(torch.zeros(1, 1, config.hidden))
        self.transformer = nn.ModuleDict(
            {f"encoderblock_{index}": _TransformerLayer(config) for index in range(config.layers)}
        )
        self.encoder_norm = nn.LayerNorm(config.hidden, eps=1e-6)

    def forward(self, tokens: Tensor, there: Tensor) -> Tensor:
        """(B, hidden) of the token that stands for the picture."""
        count = len(tokens)
        tokens = torch.cat([self.cls.expand(count, -1, -1), tokens], dim=1)
        there = torch.cat([there.new_ones(count, 1), there], dim=1)
        for layer in self.transformer.values():
            tokens = layer(tokens, there)
        encoded: Tensor = self.encoder_norm(tokens[:, 0])
        return encoded


def _hash_positions(count: int, grid: int) -> Tensor:
    """(count,) which row or column of the grid each of so many patches falls into."""
    cells = torch.arange(grid, dtype=torch.float32)[None, None]
    return functional.interpolate(cells, count, mode="nearest")[0, 0].long()


def _same_padding(size: Sequence[int], kernel: int, stride: int) -> tuple[int, int, int, int]:
    """Left, right, top, bottom: the odd pixel goes to the right and the bottom."""
    rows, columns = (max((math.ceil(side / stride) - 1) * stride + kernel - side, 0) for side in size)
    return columns // 2, columns - columns // 2, rows // 2, rows - rows // 2
