"""The small noise predictor: all waypoints as one vector through residual blocks.

Forty-eight numbers need no attention. At the packaged size a call costs a tenth of the packaged-size transformer's.
"""

from collections.abc import Iterable
from typing import Final, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from generation.diffusion.kinematics import STEP_S
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS

LEVEL_FEATURES = 64
"""Width of the noise level's features."""
PRESENT_FEATURES: Final = 4
"""Numbers that say how the vehicle moves now (`present_features`)."""
FASTEST_M_S: Final = 40.0
SHARPEST_RAD: Final = 0.5
"""Largest speed and turn per half second that a network is told; recordings hold nothing beyond."""


def present_features(previous: Tensor) -> Tensor:
    """Motion of a vehicle now, in numbers of order one.

    Args:
        previous: (..., 3) pose half a second ago in the frame of the vehicle now, metres and radians.

    Returns:
        (..., 4): speed, closeness to standing still, turn of the last half second, and a one that says that they are
        known. A vehicle of which nothing is said has zeros instead.
    """
    speed = (-previous[..., 0] / STEP_S).clamp(0.0, FASTEST_M_S)
    turn = (-previous[..., 2]).clamp(-SHARPEST_RAD, SHARPEST_RAD)
    return torch.stack([speed / 10.0, torch.exp(-0.5 * speed), 5.0 * turn, torch.ones_like(speed)], dim=-1)


def known_speed(present: Tensor) -> tuple[Tensor, Tensor]:
    """Speed out of (B, 4) `present_features`: (B,) m/s, and (B,) whether it is known."""
    return 10.0 * present[:, 0], present[:, 3] > 0.5


class ResidualBlock(nn.Module):
    """Normalise, one hidden layer shifted by the noise level, add; silent before training."""

    def __init__(self, width: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.widen = nn.Linear(width, hidden)
        self.level = nn.Linear(LEVEL_FEATURES, hidden)
        self.dropout = dropout
        self.narrow = nn.Linear(hidden, width)
        nn.init.zeros_(self.narrow.weight)
        nn.init.zeros_(self.narrow.bias)

    def forward(self, features: Tensor, shift: Tensor) -> Tensor:
        """(B, width) and (1 or B, hidden) of `level` to (B, width)."""
        # Functions in place of modules: at this size calling a module costs a tenth of what it computes.
        norm, widen, narrow = self.norm, self.widen, self.narrow
        normal = functional.layer_norm(features, norm.normalized_shape, norm.weight, norm.bias, norm.eps)
        hidden = functional.linear(normal, widen.weight, widen.bias).add_(shift)
        hidden = functional.silu(hidden, inplace=not torch.is_grad_enabled())
        if self.training:
            hidden = functional.dropout(hidden, self.dropout)
        return functional.linear(hidden, narrow.weight, narrow.bias).add_(features)


class ResidualNetwork(nn.Module):
    """Predicts what a Gaussian of the data leaves open (`GaussianPreconditioner`).

    Args:
        width: Features between blocks.
        hidden: Features inside a block.
        dropout: Active in training mode only.
        level_features: Noise level (B,) to (B, 64).
        conditioned: Whether the network can be told how the vehicle moves now.
    """

    def __init__(
        self,
        width: int,
        hidden: int,
        blocks: int,
        dropout: float,
        level_features: nn.Module,
        *,
        conditioned: bool = False,
    ) -> None:
        super().__init__()
        self.conditioned = conditioned
        self.level_encoder = nn.Sequential(level_features, nn.Linear(LEVEL_FEATURES, LEVEL_FEATURES), nn.SiLU())
        self.encoder = nn.Linear(WAYPOINTS * CHANNELS + (PRESENT_FEATURES if conditioned else 0), width)
        self.blocks = nn.ModuleList(ResidualBlock(width, hidden, dropout) for _ in range(blocks))
        self.decoder = nn.Linear(width, WAYPOINTS * CHANNELS)
        nn.init.zeros_(self.decoder.weight)
        nn.init.zeros_(self.decoder.bias)

    def shifts(self, level: Tensor) -> tuple[Tensor, ...]:
        """Shifts by noise levels (1,) or (B,), in the unit the sinusoid expects, in each block: (1 or B, hidden)."""
        features = self.level_encoder(level)
        return tuple(block.level(features) for block in cast("Iterable[ResidualBlock]", self.blocks))

    def forward(self, noisy: Tensor, level: Tensor, present: Tensor | None = None) -> Tensor:
        """(B, 16, 3) prediction of order one; zero before training.

        Args:
            level: (1,) or (B,) noise levels, in the unit the sinusoid expects.
            present: (1, 4) or (B, 4) `present_features`; ``None`` says nothing of how the vehicles move now.
        """
        return self.answer(noisy, self.shifts(level), present)

    def answer(self, noisy: Tensor, shifts: tuple[Tensor, ...], present: Tensor | None = None) -> Tensor:
        """`forward` where the `shifts` of the noise level are known."""
        known = noisy.flatten(1)
        if self.conditioned:
            said = noisy.new_zeros(1, PRESENT_FEATURES) if present is None else present
            known = torch.cat([known, said.expand(len(noisy), -1)], dim=1)
        features = self.encoder(known)
        for block, shift in zip(self.blocks, shifts, strict=True):
            features = block(features, shift)
        answer: Tensor = self.decoder(features)
        return answer.view_as(noisy)
