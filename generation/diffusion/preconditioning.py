"""What a Gaussian of the training data already knows about the noise, so that a small network learns only the rest."""

import torch
from torch import Tensor, nn

from benchmark.geometry import Floats
from generation.diffusion.schedule import ALPHA_BARS
from generation.diffusion.standardiser import CHANNELS, WAYPOINTS

ACTIONS = WAYPOINTS * CHANNELS


class GaussianPreconditioner(nn.Module):
    """Input, skip and output scaling of a noise predictor, per principal axis of the data.

    With data of mean m and covariance V diag(l) V' and noisy x = sqrt(ab) x0 + s eps, along each axis the variance of
    x is v = ab l + s^2, the best linear guess of the noise is s (x - sqrt(ab) m) / v and the variance left to explain
    is ab l / v (the preconditioning of Karras et al. 2022, section 5, with a full covariance). Axes along which
    driving hardly varies keep their smoothness whatever the network says.

    Attributes:
        mean: (48,) mean action.
        axes: (48, 48) principal axes as columns.
        variances: (48,) variance along each axis.
    """

    mean: Tensor
    axes: Tensor
    variances: Tensor
    alpha_bars: Tensor

    def __init__(self) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(ACTIONS))
        self.register_buffer("axes", torch.eye(ACTIONS))
        self.register_buffer("variances", torch.ones(ACTIONS))
        self.register_buffer("alpha_bars", torch.tensor(ALPHA_BARS, dtype=torch.float32), persistent=False)

    def fit(self, actions: Floats) -> None:
        """Take mean and covariance from data.

        Args:
            actions: (N, 16, 3) standardised training actions.
        """
        flat = torch.tensor(actions.reshape(len(actions), ACTIONS), dtype=torch.float64)
        mean = flat.mean(0)
        covariance = (flat - mean).T @ (flat - mean) / len(flat)
        variances, axes = torch.linalg.eigh(covariance)
        # The sign of an axis is arbitrary; fixing it keeps the file the same on every machine that agrees on the axis.
        axes = axes * torch.sign(axes.gather(0, axes.abs().argmax(0, keepdim=True)))
        self.mean.copy_(mean)
        self.axes.copy_(axes)
        self.variances.copy_(variances.clamp_min(1e-10))

    def split(self, noisy: Tensor, timesteps: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Network input, noise already explained, and the scale of what is left.

        Args:
            noisy: (B, 16, 3) noisy actions.
            timesteps: (1,) or (B,) 0..99.

        Returns:
            (B, 16, 3) whitened input; (B, 48) linear guess along the axes; (1 or B, 48) standard deviation left.
        """
        alpha_bar = self.alpha_bars[timesteps.long()][:, None]
        variance = alpha_bar * self.variances + (1.0 - alpha_bar)
        along = (noisy.flatten(1) - alpha_bar.sqrt() * self.mean) @ self.axes
        whitened = (along * variance.rsqrt()) @ self.axes.T
        guess = (1.0 - alpha_bar).sqrt() * along / variance
        left = (alpha_bar * self.variances / variance).sqrt()
        return whitened.view_as(noisy), guess, left

    def join(self, answer: Tensor, guess: Tensor, left: Tensor) -> Tensor:
        """Predicted noise from the network's answer.

        Args:
            answer: (B, 16, 3) of order one.
            guess: (B, 48) from `split`.
            left: (1 or B, 48) from `split`.

        Returns:
            (B, 16, 3) predicted noise.
        """
        return ((guess + left * (answer.flatten(1) @ self.axes)) @ self.axes.T).view_as(answer)

    def residual(self, noise: Tensor, guess: Tensor, left: Tensor) -> Tensor:
        """What the network should answer, the inverse of `join`; of unit variance along every axis.

        Args:
            noise: (B, 16, 3) the noise that was added.
            guess: (B, 48) from `split`.
            left: (1 or B, 48) from `split`.

        Returns:
            (B, 16, 3).
        """
        return (((noise.flatten(1) @ self.axes - guess) / left) @ self.axes.T).view_as(noise)

    def start(self, noise: Tensor) -> Tensor:
        """Draw of the last forward step's distribution, which keeps signal and is far from standard normal.

        Args:
            noise: (B, 16, 3) standard normal.

        Returns:
            (B, 16, 3) actions at timestep 99.
        """
        alpha_bar = self.alpha_bars[-1]
        spread = (alpha_bar * self.variances + 1.0 - alpha_bar).sqrt()
        flat = (noise.flatten(1) * spread) @ self.axes.T + alpha_bar.sqrt() * self.mean
        return flat.view_as(noise)
