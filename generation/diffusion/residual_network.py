"""The small noise predictor: all waypoints as one vector through residual blocks.

Forty-eight numbers need no attention. At the packaged size a call costs a tenth of the packaged-size transformer's.
"""

from torch import Tensor, nn

from generation.diffusion.standardiser import CHANNELS, WAYPOINTS

LEVEL_FEATURES = 64
"""Width of the noise level's features."""


class ResidualBlock(nn.Module):
    """Normalise, one hidden layer shifted by the noise level, add; silent before training."""

    def __init__(self, width: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.norm = nn.LayerNorm(width)
        self.widen = nn.Linear(width, hidden)
        self.level = nn.Linear(LEVEL_FEATURES, hidden)
        self.active = nn.Sequential(nn.SiLU(), nn.Dropout(dropout))
        self.narrow = nn.Linear(hidden, width)
        nn.init.zeros_(self.narrow.weight)
        nn.init.zeros_(self.narrow.bias)

    def forward(self, features: Tensor, level: Tensor) -> Tensor:
        """(B, width) and (1 or B, 64) to (B, width)."""
        answer: Tensor = self.narrow(self.active(self.widen(self.norm(features)) + self.level(level)))
        return features + answer


class ResidualNetwork(nn.Module):
    """Predicts what a Gaussian of the data leaves open (`GaussianPreconditioner`).

    Args:
        width: Features between blocks.
        hidden: Features inside a block.
        blocks: How many.
        dropout: Active in training mode only.
        level_features: Noise level (B,) to (B, 64).
    """

    def __init__(self, width: int, hidden: int, blocks: int, dropout: float, level_features: nn.Module) -> None:
        super().__init__()
        self.level_encoder = nn.Sequential(level_features, nn.Linear(LEVEL_FEATURES, LEVEL_FEATURES), nn.SiLU())
        self.encoder = nn.Linear(WAYPOINTS * CHANNELS, width)
        self.blocks = nn.ModuleList(ResidualBlock(width, hidden, dropout) for _ in range(blocks))
        self.decoder = nn.Linear(width, WAYPOINTS * CHANNELS)
        nn.init.zeros_(self.decoder.weight)
        nn.init.zeros_(self.decoder.bias)

    def forward(self, noisy: Tensor, level: Tensor) -> Tensor:
        """Ask.

        Args:
            noisy: (B, 16, 3).
            level: (1,) or (B,) noise levels, in the unit the sinusoid expects.

        Returns:
            (B, 16, 3) of order one; zero before training.
        """
        features, level = self.encoder(noisy.flatten(1)), self.level_encoder(level)
        for block in self.blocks:
            features = block(features, level)
        answer: Tensor = self.decoder(features)
        return answer.view_as(noisy)
