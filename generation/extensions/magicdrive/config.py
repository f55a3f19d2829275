"""Sizes of MagicDriveDiT's network, and how it computes."""

from dataclasses import dataclass
from typing import Self


@dataclass(frozen=True, slots=True)
class MagicDriveConfig:
    """Sizes of the network; the defaults are the published ones (section 1 of the specification).

    `depth` counts pairs of a spatial and a temporal block in the base stream; `text_tokens` are of the stored null
    prompt; `map_channels` come before the map encoder's last layer. `rounded` rounds inputs and all frequencies to
    bfloat16 even in higher precision, because the published weights were trained so (section 13). Rows of tokens are
    padded to `rows_multiple` where rows times columns are no multiple, as on the four processors that the published
    weights were tuned and are used on (section 12); 1 never pads.
    """

    hidden: int = 1152
    heads: int = 16
    encoder_heads: int = 8
    depth: int = 28
    control_depth: int = 13
    caption_channels: int = 4096
    text_tokens: int = 300
    box_hidden: int = 512
    map_channels: tuple[int, int, int, int] = (16, 32, 96, 256)
    map_layers: int = 8
    views: int = 6
    latent_channels: int = 16
    rounded: bool = True
    rows_multiple: int = 4

    def __post_init__(self) -> None:
        if self.hidden % (4 * self.heads) or self.hidden % (2 * self.encoder_heads):
            raise ValueError(f"{self.hidden} channels do not part into {self.heads} heads of whole pairs")
        if self.control_depth > self.depth:
            raise ValueError(f"{self.control_depth} control blocks do not fit beside {self.depth} base blocks")

    @property
    def packed_channels(self) -> int:
        """Channels of the latents of all views together."""
        return self.latent_channels * self.views

    @classmethod
    def full(cls) -> Self:
        """The published network: 2.04 billion parameters."""
        return cls()
