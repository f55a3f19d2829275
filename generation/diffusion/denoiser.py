"""The trajectory denoiser: 16 waypoint tokens in a transformer that predicts the noise in them.

At its default configuration it has the parameter names and shapes of the published checkpoint and its behaviour,
including what looks like slips there: it was trained with them, so they are part of the weights.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

from benchmark.errors import InputError
from generation.diffusion.preconditioning import (
    LEVEL_FEATURES,
    GaussianPreconditioner,
    NoiseLevelScaling,
    ResidualNetwork,
)
from generation.diffusion.schedule import STEPS
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS

HISTORY_CHANNELS = 7


@dataclass(frozen=True, slots=True)
class DenoiserConfig:
    """Shape and habits of the network; the defaults are the published checkpoint's.

    Attributes:
        history_tokens: Constant tokens in front of the waypoints, made from a history that is always zero.
        far_logit_bias: Added to the attention logit of tokens more than one apart. The reference adds its boolean mask
            as a number, so distant tokens attract each other a little instead of being hidden.
        noise_level_scale: Factor on timestep/100 before the sinusoid.
        preconditioned: Whether a Gaussian of the data carries the linear part (`GaussianPreconditioner`).
        attention: Whether waypoints are tokens of a transformer; otherwise they are one vector
            (`generation.diffusion.preconditioning`), and heads, history and logits play no part.
        conditioned: Whether the network can be told how the vehicle moves now (`compute_present_features`), so that no
            vehicle brakes into reverse. The published network cannot; one that can answers without where it is not
            told.
    """

    feature_dim: int = 256
    heads: int = 8
    layers: int = 8
    feedforward_dim: int = 1024
    history_tokens: int = 5
    far_logit_bias: float = 1.0
    noise_level_scale: float = 1.0
    dropout: float = 0.1
    preconditioned: bool = False
    attention: bool = True
    conditioned: bool = False

    def __post_init__(self) -> None:
        if min(self.feature_dim, self.heads, self.layers, self.feedforward_dim) < 1 or self.history_tokens < 0:
            raise InputError("a denoiser needs positive sizes; check the configuration in the weights file")
        if self.feature_dim % (2 * self.heads):
            raise InputError(
                f"a denoiser's width must be an even multiple of its heads, got {self.feature_dim} and {self.heads}"
            )
        if self.conditioned and self.attention:
            raise InputError("only a network without attention can take the vehicle's motion as input; turn one off")


PACKAGED = DenoiserConfig(
    feature_dim=192,
    heads=1,
    layers=3,
    feedforward_dim=192,
    history_tokens=0,
    far_logit_bias=0.0,
    noise_level_scale=float(STEPS),
    dropout=0.1,
    preconditioned=True,
    attention=False,
    conditioned=True,
)
"""The small network whose weights are in the package."""


class NoiseLevelSinusoid(nn.Module):
    """Noise level to features: sine and cosine at geometric frequencies from 1 to 1e-4."""

    frequencies: Tensor

    def __init__(self, feature_dim: int) -> None:
        super().__init__()
        half = feature_dim // 2
        exponents = torch.arange(half, dtype=torch.float32, device="cpu") * -(math.log(1e4) / (half - 1))
        self.register_buffer("frequencies", exponents.exp(), persistent=False)

    def forward(self, level: Tensor) -> Tensor:
        """(B,) levels to (B, feature_dim)."""
        angles = level[:, None] * self.frequencies
        return torch.cat([angles.sin(), angles.cos()], dim=-1)


class RotarySelfAttention(nn.Module):
    """Self-attention with rotary positions on the full width, so that every head turns with frequencies of its own."""

    def __init__(self, feature_dim: int, heads: int, dropout: float) -> None:
        super().__init__()
        self.heads, self.dropout = heads, dropout
        self.in_proj_weight = nn.Parameter(torch.empty(3 * feature_dim, feature_dim))
        self.in_proj_bias = nn.Parameter(torch.zeros(3 * feature_dim))
        self.out_proj = nn.Linear(feature_dim, feature_dim)
        nn.init.xavier_uniform_(self.in_proj_weight)

    def forward(self, tokens: Tensor, types: Tensor, turns: Tensor, bias: Tensor | None) -> Tensor:
        """Self-attention over (B, S, D) tokens; ``types`` (S, D) are added to queries and keys only.

        ``turns`` are (S, 1, D / 2) complex unit numbers of `compute_rotary_angles`; ``bias`` (S, S) goes on the logits.
        """
        width = tokens.shape[-1]
        query_key = functional.linear(tokens + types, self.in_proj_weight[: 2 * width], self.in_proj_bias[: 2 * width])
        value = functional.linear(tokens, self.in_proj_weight[2 * width :], self.in_proj_bias[2 * width :])
        rotated = _rotate_pairs(query_key.unflatten(-1, (2, width)), turns)  # type: ignore[no-untyped-call]
        query, key = self._split_heads(rotated[..., 0, :]), self._split_heads(rotated[..., 1, :])
        dropout = self.dropout if self.training else 0.0
        mixed = functional.scaled_dot_product_attention(
            query, key, self._split_heads(value), attn_mask=bias, dropout_p=dropout
        )
        projected: Tensor = self.out_proj(mixed.transpose(1, 2).flatten(2))
        return projected

    def _split_heads(self, features: Tensor) -> Tensor:
        """(B, S, D) to (B, heads, S, D / heads)."""
        batch, sequence, width = features.shape
        return features.reshape(batch, sequence, self.heads, width // self.heads).transpose(1, 2)


def _rotate_pairs(features: Tensor, turns: Tensor) -> Tensor:
    """Turn the pairs (2i, 2i+1) of (B, S, 2, D) features; as complex numbers, which is one pass over memory."""
    pairs = torch.view_as_complex(features.unflatten(-1, (-1, 2)))  # type: ignore[no-untyped-call]
    return torch.view_as_real(pairs * turns).flatten(-2)


def compute_rotary_angles(tokens: int, feature_dim: int) -> Tensor:
    """(S, D / 2) angles, radians: token index times 1e4^(-2i/D)."""
    frequencies = torch.exp(torch.arange(0, feature_dim, 2, dtype=torch.float32) * (-math.log(1e4) / feature_dim))
    return torch.arange(tokens, dtype=torch.float32)[:, None] * frequencies


class DenoiserLayer(nn.Module):
    """Attention and feed-forward, each followed by residual and normalisation."""

    def __init__(self, config: DenoiserConfig) -> None:
        super().__init__()
        width = config.feature_dim
        self.sa1 = RotarySelfAttention(width, config.heads, config.dropout)
        self.dropout = nn.Dropout(config.dropout)
        self.norm_1 = nn.LayerNorm(width)
        self.ffn_12 = nn.Sequential(
            nn.Linear(width, config.feedforward_dim),
            nn.ReLU(inplace=True),
            nn.Dropout(config.dropout),
            nn.Linear(config.feedforward_dim, width),
            nn.Dropout(config.dropout),
        )
        self.norm_122 = nn.LayerNorm(width)

    def forward(self, tokens: Tensor, types: Tensor, turns: Tensor, bias: Tensor | None) -> Tensor:
        """(B, S, D) to (B, S, D)."""
        tokens = self.norm_1(tokens + self.dropout(self.sa1(tokens, types, turns, bias)))
        normed: Tensor = self.norm_122(tokens + self.ffn_12(tokens))
        return normed


@dataclass(frozen=True, slots=True)
class DenoiserStep:
    """Parts of a prediction that do not depend on the noisy actions. ``timesteps`` are (1,) or (B,), 0..99."""

    timesteps: Tensor
    shares: NoiseLevelScaling | None
    shifts: tuple[Tensor, ...] | None


class TrajectoryDenoiser(nn.Module):
    """Predicts the noise in standardised actions (paper, Diffusion Trajectory Generator).

    Neither scene nor history reaches it; present speed and turn do where the configuration says so.
    """

    rotary_turns: Tensor
    logit_bias: Tensor | None

    def __init__(self, config: DenoiserConfig | None = None) -> None:
        super().__init__()
        self.config = config = config or DenoiserConfig()
        self.preconditioner = GaussianPreconditioner(conditioned=config.conditioned) if config.preconditioned else None
        if config.attention:
            self._build_transformer(config)
            return
        level = NoiseLevelSinusoid(LEVEL_FEATURES)
        size = (config.feature_dim, config.feedforward_dim, config.layers)
        self.residual_network = ResidualNetwork(*size, config.dropout, level, conditioned=config.conditioned)

    def _build_transformer(self, config: DenoiserConfig) -> None:
        width = config.feature_dim
        if config.history_tokens:
            self.history_encoder = nn.Sequential(nn.Linear(HISTORY_CHANNELS, width), nn.ReLU(), nn.Linear(width, width))
        self.sigma_encoder = nn.Sequential(
            NoiseLevelSinusoid(width), nn.Linear(width, width), nn.ReLU(), nn.Linear(width, width)
        )
        self.sigma_proj_layer = nn.Linear(2 * width, width)
        self.trajectory_encoder = nn.Linear(CHANNELS, width)
        self.type_embedding = nn.Embedding(3, width)
        self.global_attention_layers = nn.ModuleList(DenoiserLayer(config) for _ in range(config.layers))
        self.decoder_mlp = nn.Sequential(nn.Linear(width, width), nn.ReLU(), nn.Linear(width, CHANNELS))

        sequence = config.history_tokens + WAYPOINTS
        angles, index = compute_rotary_angles(sequence, width), torch.arange(sequence)
        far = ((index[:, None] - index).abs() > 1).to(torch.float32)
        turns = torch.polar(torch.ones_like(angles), angles)[:, None]
        self.register_buffer("rotary_turns", turns, persistent=False)
        bias = config.far_logit_bias * far if config.far_logit_bias else None
        self.register_buffer("logit_bias", bias, persistent=False)

    def forward(
        self, noisy: Tensor, timesteps: Tensor, present: Tensor | None = None, step: DenoiserStep | None = None
    ) -> Tensor:
        """Predict the standard normal noise, (B, 16, 3), in noisy standardised actions at (1,) or (B,) timesteps 0..99.

        ``present`` are (1, 4) or (B, 4) `compute_present_features`, which a network that cannot be told ignores;
        ``None`` says nothing. ``step`` is the output of `step` for these timesteps and conditions, if already computed.
        """
        step = step or self.step(timesteps, present)
        if step.shares is None:
            return self._answer(noisy, step, present)
        split = step.shares.split(noisy)
        return split.join(self._answer(split.whitened, step, present))

    def step(self, timesteps: Tensor, present: Tensor | None = None) -> DenoiserStep:
        """Parts of `forward` that need no actions, to use for many of them; arguments as there."""
        shares = None if self.preconditioner is None else self.preconditioner.shares(timesteps, present)
        return DenoiserStep(timesteps, shares, None if self.config.attention else self._compute_shifts(timesteps))

    def network(self, tokens_in: Tensor, timesteps: Tensor, present: Tensor | None = None) -> Tensor:
        """The network without its preconditioner: (B, 16, 3) to (B, 16, 3)."""
        shifts = None if self.config.attention else self._compute_shifts(timesteps)
        return self._answer(tokens_in, DenoiserStep(timesteps, None, shifts), present)

    def _scale_levels(self, timesteps: Tensor, dtype: torch.dtype) -> Tensor:
        return timesteps.to(dtype) * (self.config.noise_level_scale / STEPS)

    def _compute_shifts(self, timesteps: Tensor) -> tuple[Tensor, ...]:
        return self.residual_network.shifts(self._scale_levels(timesteps, self.residual_network.encoder.weight.dtype))

    def _answer(self, tokens_in: Tensor, step: DenoiserStep, present: Tensor | None) -> Tensor:
        if step.shifts is not None:
            return self.residual_network.answer(tokens_in, step.shifts, present)
        tokens: Tensor = self.trajectory_encoder(tokens_in)
        kinds = [1] * WAYPOINTS
        if self.config.history_tokens:
            silence = tokens_in.new_zeros(1, self.config.history_tokens, HISTORY_CHANNELS)
            history = self.history_encoder(silence).expand(len(tokens), -1, -1)
            tokens = torch.cat([history, tokens], dim=1)
            kinds = [0] * self.config.history_tokens + kinds
        types = self.type_embedding.weight[kinds]
        sigma = self.sigma_encoder(self._scale_levels(step.timesteps, tokens_in.dtype))
        width, weight = self.config.feature_dim, self.sigma_proj_layer.weight
        level = functional.linear(sigma, weight[:, width:], self.sigma_proj_layer.bias)
        tokens = functional.linear(tokens, weight[:, :width]) + level[:, None, :]
        for layer in self.global_attention_layers:
            tokens = layer(tokens, types, self.rotary_turns, self.logit_bias)
        noise: Tensor = self.decoder_mlp(tokens[:, -WAYPOINTS:])
        return noise

    def start(self, noise: Tensor, present: Tensor | None = None) -> Tensor:
        """(B, 16, 3) actions at timestep 99, with which the full reverse process begins, from standard normal noise.

        The reference begins at standard normal noise although its forward process ends at 0.72 of that; a
        preconditioned network begins where its forward process ends.
        """
        return noise if self.preconditioner is None else self.preconditioner.start(noise, present)
