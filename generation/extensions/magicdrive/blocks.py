"""Transformer blocks of MagicDriveDiT (section 7 of the specification) and the tokens that describe a clip to it.

Tokens are (b, V, t, S, C): scenes, views, latent frames, places in a frame row by row, channels. Modulations are
(b, 1, 1 or t, 1, C): one for all latent frames, or one for each where some frames are given.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.layers import (
    Mlp,
    RootMeanSquareNorm,
    RotaryRotation,
    SequenceSelfAttention,
    modulate,
    split_axis,
)


@dataclass(frozen=True, slots=True)
class ConditionTokens:
    """Tokens of every view and latent frame (section 4), or keys and values made of them, (b, V, t, n, C).

    An axis of length one means the same for all views or frames, so that linear layers see no token twice: `ego` is
    (b, 1, t, 1, C), `camera` (b, V, 1, 1, C), `text` (b, 1, 1, L, C). Each box token stands `box_repeats` times in the
    sequence; what a layer makes of equal tokens is made once.
    """

    ego: Tensor
    camera: Tensor
    text: Tensor
    boxes: Tensor
    box_repeats: int = 1

    def map(self, layer: Callable[[Tensor], Tensor]) -> Self:
        """Apply what works on each token alone, for example a linear layer."""
        return type(self)(layer(self.ego), layer(self.camera), layer(self.text), layer(self.boxes), self.box_repeats)

    def sequence(self) -> Tensor:
        """All tokens in the model's order, (b, V, t, 2 + L + n, C): ego motion, camera, text, boxes."""
        batch, views, frames = self.boxes.shape[:3]
        repeated = self.boxes if self.box_repeats == 1 else self._repeat_boxes()
        kinds = [kind.expand(batch, views, frames, -1, -1) for kind in (self.ego, self.camera, self.text)]
        return torch.cat([*kinds, repeated], 3)

    @property
    def length(self) -> int:
        """Length of the sequence."""
        return 2 + self.text.shape[3] + self.boxes.shape[3] * self.box_repeats

    @classmethod
    def batch(cls, parts: Sequence[Self]) -> Self:
        """Several scenes or branches of equal token numbers as one batch; repeats are kept where all have the same."""
        same = len({part.box_repeats for part in parts}) == 1
        boxes = [part.boxes if same else part._repeat_boxes() for part in parts]
        lengths = {(part.text.shape[3], tuple(own.shape[1:])) for part, own in zip(parts, boxes, strict=True)}
        if len(lengths) != 1:
            raise ValueError(f"conditions of different sizes cannot be one batch: {sorted(lengths)}")
        return cls(
            ego=torch.cat([part.ego for part in parts]),
            camera=torch.cat([part.camera for part in parts]),
            text=torch.cat([part.text for part in parts]),
            boxes=torch.cat(boxes),
            box_repeats=parts[0].box_repeats if same else 1,
        )

    def _repeat_boxes(self) -> Tensor:
        batch, views, frames, boxes, _ = self.boxes.shape
        return self.boxes[..., None, :].expand(batch, views, frames, boxes, self.box_repeats, -1).flatten(3, 4)


class ConditionCrossAttention(nn.Module):
    """Every token asks the condition tokens of its view and latent frame."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.q_linear = nn.Linear(channels, channels)
        self.kv_linear = nn.Linear(channels, 2 * channels)
        self.proj = nn.Linear(channels, channels)

    def keys_values(self, tokens: ConditionTokens) -> ConditionTokens:
        """Keys and values of condition tokens; they do not depend on the timestep."""
        return tokens.map(self.kv_linear)

    def forward(self, x: Tensor, keys_values: ConditionTokens) -> Tensor:
        """Attention of (b, V, t, S, C) tokens, not normalised, to conditions; `keys_values` gives ``keys_values``."""
        q = split_axis(self.q_linear(x).flatten(0, 2), -1, self.heads, -1).transpose(1, 2)
        joined = split_axis(keys_values.sequence().flatten(0, 2), -1, 2, self.heads, -1)
        k, v = joined.permute(2, 0, 3, 1, 4).unbind(0)
        attended = F.scaled_dot_product_attention(q, k, v).transpose(1, 2).flatten(2)
        out: Tensor = self.proj(attended).view_as(x)
        return out


class CrossViewAttention(nn.Module):
    """Every view asks its two neighbours, each on its own, at the same latent frame; the two answers are added."""

    def __init__(self, channels: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(channels, 3 * channels, bias=False)
        self.q_norm = RootMeanSquareNorm(channels // heads)
        self.k_norm = RootMeanSquareNorm(channels // heads)
        self.proj = nn.Linear(channels, channels)

    def forward(self, x: Tensor) -> Tensor:
        """Attention of (b, V, t, S, C) tokens, normalised, to those of other views."""
        q, k, v = split_axis(self.qkv(x), -1, 3, self.heads, -1).transpose(3, 5).unbind(4)
        q, k = self.q_norm(q), self.k_norm(k)
        views = x.shape[1]
        sums = []
        for view in range(views):
            own = q[:, view].flatten(0, 1)
            left, right = (
                F.scaled_dot_product_attention(own, k[:, near].flatten(0, 1), v[:, near].flatten(0, 1))
                for near in ((view - 1) % views, (view + 1) % views)
            )
            sums.append((left + right).transpose(1, 2).flatten(2))
        summed = split_axis(torch.stack(sums), 1, x.shape[0], -1).transpose(0, 1)
        # The bias belongs to each of the two answers.
        return F.linear(summed, self.proj.weight, 2 * self.proj.bias)


class MagicDriveBlock(nn.Module):
    """Self-attention, cross-attention to the conditions, attention between views where there is one, and an MLP."""

    def __init__(self, config: MagicDriveConfig, *, temporal: bool, between_views: bool, skip: bool) -> None:
        """`temporal` blocks run over latent frames, others over places; `skip` projects to the base stream."""
        super().__init__()
        channels, heads = config.hidden, config.heads
        self.temporal = temporal
        self.scale_shift_table = nn.Parameter(torch.randn(6, channels) / channels**0.5)
        if between_views:
            self.scale_shift_table_mva = nn.Parameter(torch.randn(3, channels) / channels**0.5)
        self.attn = SequenceSelfAttention(channels, heads)
        self.cross_attn = ConditionCrossAttention(channels, heads)
        self.mlp = Mlp(channels, 4 * channels, channels)
        self.cross_view_attn = CrossViewAttention(channels, heads) if between_views else None
        if between_views:
            self.mva_proj = nn.Linear(channels, channels)
        if skip:
            self.after_proj = nn.Linear(channels, channels)

    def forward(
        self, x: Tensor, modulation: Tensor, keys_values: ConditionTokens, rotation: RotaryRotation | None = None
    ) -> Tensor:
        """One block on (b, V, t, S, C) tokens; ``modulation``, (b, 1 or t, 6C), is that of the time and frame rate."""
        rows = self.scale_shift_table + split_axis(modulation, -1, 6, -1)
        shift_a, scale_a, gate_a, shift_m, scale_m, gate_m = rows[:, None, :, None].unbind(-2)
        x = torch.addcmul(x, gate_a, self._attend(modulate(x, shift_a, scale_a), rotation))
        x = x + self.cross_attn(x, keys_values)
        if self.cross_view_attn is not None:
            # The published network takes the first three numbers of the modulation, not its first three rows.
            shift, scale, gate = (self.scale_shift_table_mva + modulation[..., :3, None])[:, None, :, None].unbind(-2)
            x = x + self.mva_proj(gate * self.cross_view_attn(modulate(x, shift, scale)))
        return torch.addcmul(x, gate_m, self.mlp(modulate(x, shift_m, scale_m)))

    def _attend(self, x: Tensor, rotation: RotaryRotation | None) -> Tensor:
        if self.temporal:
            frames_last = x.transpose(2, 3)
            over_time: Tensor = self.attn(frames_last.flatten(0, 2), rotation).view(frames_last.shape).transpose(2, 3)
            return over_time
        out: Tensor = self.attn(x.flatten(0, 2)).view_as(x)
        return out
