"""Gaussian preconditioner, the linear part of the noise prediction, and a small residual network for the rest."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final, cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from benchmark.errors import InputError
from benchmark.geometry import Floats
from generation.diffusion.kinematics import STEP_S
from generation.diffusion.schedule import ALPHA_BARS
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS

LEVEL_FEATURES = 64
"""Width of the noise level's features."""
PRESENT_FEATURES: Final = 4
"""Numbers that say how the vehicle moves now (`compute_present_features`)."""
FASTEST_M_S: Final = 40.0
SHARPEST_RAD: Final = 0.5
"""Largest speed and turn per half second that a network is told; recordings hold nothing beyond."""


def compute_present_features(previous: Tensor) -> Tensor:
    """Motion of a vehicle now, (..., 4) of order one, from its (..., 3) pose half a second ago in its frame now.

    Speed, closeness to standing still, turn of the last half second, and a one that says that they are known. A vehicle
    of which nothing is said has zeros instead.
    """
    speed = (-previous[..., 0] / STEP_S).clamp(0.0, FASTEST_M_S)
    turn = (-previous[..., 2]).clamp(-SHARPEST_RAD, SHARPEST_RAD)
    return torch.stack([speed / 10.0, torch.exp(-0.5 * speed), 5.0 * turn, torch.ones_like(speed)], dim=-1)


def decode_known_speed(present: Tensor) -> tuple[Tensor, Tensor]:
    """Speed out of (B, 4) `compute_present_features`: (B,) m/s, and (B,) whether it is known."""
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
    """Predicts what `GaussianPreconditioner` leaves open; ``level_features`` turns noise levels (B,) into (B, 64)."""

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
        """(B, 16, 3) prediction of order one, zero before training, at (1,) or (B,) levels in the unit of the sinusoid.

        ``present`` are (1, 4) or (B, 4) `compute_present_features`; ``None`` says nothing of how the vehicles move now.
        """
        return self.answer(noisy, self.shifts(level), present)

    def answer(self, noisy: Tensor, shifts: tuple[Tensor, ...], present: Tensor | None = None) -> Tensor:
        """`forward` where the `shifts` of the noise level are known."""
        known = noisy.flatten(1)
        if self.conditioned:
            condition = noisy.new_zeros(1, PRESENT_FEATURES) if present is None else present
            known = torch.cat([known, condition.expand(len(noisy), -1)], dim=1)
        features = self.encoder(known)
        for block, shift in zip(self.blocks, shifts, strict=True):
            features = block(features, shift)
        answer: Tensor = self.decoder(features)
        return answer.view_as(noisy)


ACTIONS = WAYPOINTS * CHANNELS
SPEED_EDGES_M_S: Final = (0.3, 1.0, 2.0, 4.0, 7.0, 12.0)
"""Present speeds between which vehicles have Gaussians of their own: a standing car cannot brake, nor turn at once."""
LEAST_VARIANCE: Final = 1e-10


@dataclass(frozen=True, slots=True)
class _Gaussian:
    """Of each row, or one for all: mean (..., 48), axes as columns (..., 48, 48), variance along each (..., 48)."""

    mean: Tensor
    axes: Tensor
    variances: Tensor

    def along(self, flat: Tensor) -> Tensor:
        """(B, 48) components along the axes."""
        return (flat[:, None] @ self.axes)[:, 0] if self.axes.ndim == 3 else flat @ self.axes

    def from_axes(self, components: Tensor) -> Tensor:
        """(B, 48) from components along the axes."""
        turned = self.axes.mT
        return (components[:, None] @ turned)[:, 0] if turned.ndim == 3 else components @ turned


@dataclass(frozen=True, slots=True)
class PreconditionedInput:
    """Question to a network, (B, 16, 3), and the part of the answer that is known without it.

    ``guess`` is the (B, 48) noise already explained, ``left`` the (1 or B, 48) standard deviation left, along the axes.
    """

    whitened: Tensor
    guess: Tensor
    left: Tensor
    gaussian: _Gaussian

    def join(self, answer: Tensor) -> Tensor:
        """Predicted noise (B, 16, 3) from the network's answer (B, 16, 3) of order one."""
        along = self.guess + self.left * self.gaussian.along(answer.flatten(1))
        return self.gaussian.from_axes(along).view_as(answer)

    def compute_residual(self, noise: Tensor) -> Tensor:
        """Right answer of the network to the added noise, along the axes: (B, 48), of unit variance.

        The inverse of `join` but for the axes.
        """
        return (self.gaussian.along(noise.flatten(1)) - self.guess) / self.left

    def along(self, answer: Tensor) -> Tensor:
        """(B, 48) the network's answer along the axes, to compare with `compute_residual`."""
        return self.gaussian.along(answer.flatten(1))


@dataclass(frozen=True, slots=True)
class NoiseLevelScaling:
    """Knowledge at one noise level, for all actions: (1 or B, 48) each, along the axes of the Gaussian.

    ``offset`` is the mean action there, ``whitening`` scales components to unit variance, ``spread`` is the noise's
    standard deviation, ``left`` the one left to explain, ``variance`` that of the noisy actions.
    """

    gaussian: _Gaussian
    offset: Tensor
    whitening: Tensor
    spread: Tensor
    variance: Tensor
    left: Tensor

    def split(self, noisy: Tensor) -> PreconditionedInput:
        """Take (B, 16, 3) noisy actions apart."""
        along = self.gaussian.along(noisy.flatten(1) - self.offset)
        whitened = self.gaussian.from_axes(along * self.whitening)
        return PreconditionedInput(
            whitened.view_as(noisy), self.spread * along / self.variance, self.left, self.gaussian
        )


class GaussianPreconditioner(nn.Module):
    """Input, skip and output scaling of a noise predictor, per principal axis of the data.

    With data of mean m and covariance V diag(l) V' and noisy x = sqrt(ab) x0 + s eps, along each axis the variance of x
    is v = ab l + s^2, the best linear guess of the noise is s (x - sqrt(ab) m) / v and the variance left to explain is
    ab l / v (the preconditioning of Karras et al. 2022, section 5, with a full covariance). Axes along which driving
    hardly varies keep their smoothness at any answer of the network.

    Mean (48,), principal axes (48, 48) as columns and variances (48,) are of all actions; (7, ...) the same, ``told``,
    of vehicles by present speed (`SPEED_EDGES_M_S`), where it can be told.
    """

    mean: Tensor
    axes: Tensor
    variances: Tensor
    alpha_bars: Tensor
    edges: Tensor
    told_mean: Tensor
    told_axes: Tensor
    told_variances: Tensor

    def __init__(self, *, conditioned: bool = False) -> None:
        super().__init__()
        self.conditioned = conditioned
        self.register_buffer("mean", torch.zeros(ACTIONS))
        self.register_buffer("axes", torch.eye(ACTIONS, device="cpu"))
        self.register_buffer("variances", torch.ones(ACTIONS))
        self.register_buffer("alpha_bars", torch.tensor(ALPHA_BARS, dtype=torch.float32), persistent=False)
        if conditioned:
            kinds = len(SPEED_EDGES_M_S) + 1
            self.register_buffer("told_mean", torch.zeros(kinds, ACTIONS))
            self.register_buffer("told_axes", torch.eye(ACTIONS, device="cpu").repeat(kinds, 1, 1))
            self.register_buffer("told_variances", torch.ones(kinds, ACTIONS))
            self.register_buffer("edges", torch.tensor(SPEED_EDGES_M_S), persistent=False)

    def fit(self, actions: Floats, present: Tensor | None = None) -> None:
        """Take means and covariances from (N, 16, 3) standardised training actions.

        ``present`` are (N, 4) `compute_present_features`, which a preconditioner that can be told needs.
        """
        flat = torch.tensor(actions.reshape(len(actions), ACTIONS), dtype=torch.float64)
        for buffer, value in zip((self.mean, self.axes, self.variances), _compute_moments(flat), strict=True):
            buffer.copy_(value)
        if not self.conditioned:
            return
        if present is None:
            raise InputError("a speed-conditioned preconditioner needs the speed of every window")
        speed, _ = decode_known_speed(present)
        kinds = torch.bucketize(speed, self.edges, right=True)
        for kind in range(len(SPEED_EDGES_M_S) + 1):
            part = flat[kinds == kind]
            # With too few windows at a speed, statistics of all windows are more reliable.
            values = _compute_moments(part if len(part) > 4 * ACTIONS else flat)
            for buffer, value in zip((self.told_mean, self.told_axes, self.told_variances), values, strict=True):
                buffer[kind].copy_(value)

    def split(self, noisy: Tensor, timesteps: Tensor, present: Tensor | None = None) -> PreconditionedInput:
        """Take apart what is known of (B, 16, 3) noisy actions at (1,) or (B,) timesteps, 0..99.

        ``present`` are (1, 4) or (B, 4) `compute_present_features`; ``None`` says nothing of how the vehicles move now.
        """
        return self.shares(timesteps, present).split(noisy)

    def shares(self, timesteps: Tensor, present: Tensor | None = None) -> NoiseLevelScaling:
        """Parts of `split` that need no actions; arguments as there."""
        gaussian, alpha_bar = self._select_gaussian(present), self.alpha_bars[timesteps.long()][:, None]
        variance = alpha_bar * gaussian.variances + (1.0 - alpha_bar)
        return NoiseLevelScaling(
            gaussian,
            offset=alpha_bar.sqrt() * gaussian.mean,
            whitening=variance.rsqrt(),
            spread=(1.0 - alpha_bar).sqrt(),
            variance=variance,
            left=(alpha_bar * gaussian.variances / variance).sqrt(),
        )

    def kind(self, present: Tensor | None) -> int | None:
        """Which Gaussian speaks for all rows, as a number; ``None`` where rows may have several."""
        if present is None or not self.conditioned:
            return -1
        if len(present) > 1:
            return None
        speed, known = decode_known_speed(present)
        return int(torch.bucketize(speed, self.edges, right=True)) if bool(known) else -1

    def start(self, noise: Tensor, present: Tensor | None = None) -> Tensor:
        """(B, 16, 3) standard normal noise as actions at timestep 99, where the forward process keeps some signal."""
        gaussian, alpha_bar = self._select_gaussian(present), self.alpha_bars[-1]
        spread = (alpha_bar * gaussian.variances + 1.0 - alpha_bar).sqrt()
        return (gaussian.from_axes(noise.flatten(1) * spread) + alpha_bar.sqrt() * gaussian.mean).view_as(noise)

    def _select_gaussian(self, present: Tensor | None) -> _Gaussian:
        """Of all vehicles, or of those of each row's speed; of all where a row says nothing."""
        if present is None or not self.conditioned:
            return _Gaussian(self.mean, self.axes, self.variances)
        speed, known = decode_known_speed(present)
        kinds = torch.bucketize(speed, self.edges, right=True)
        of_speed = (self.told_mean[kinds], self.told_axes[kinds], self.told_variances[kinds])
        if len(present) == 1 and bool(known):
            return _Gaussian(*(part[0] for part in of_speed))
        of_all = (self.mean, self.axes, self.variances)
        return _Gaussian(
            *(
                torch.where(known.view(-1, *[1] * overall.ndim), part, overall)
                for part, overall in zip(of_speed, of_all, strict=True)
            )
        )


def _compute_moments(flat: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Mean, principal axes and variances of (N, 48) actions."""
    mean = flat.mean(0)
    covariance = (flat - mean).T @ (flat - mean) / len(flat)
    variances, axes = torch.linalg.eigh(covariance)
    # The sign of an axis is arbitrary; fixing it keeps the file the same on every machine that agrees on the axis.
    axes = axes * torch.sign(axes.gather(0, axes.abs().argmax(0, keepdim=True)))
    return mean, axes, variances.clamp_min(LEAST_VARIANCE)
