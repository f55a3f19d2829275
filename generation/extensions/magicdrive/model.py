"""MagicDriveDiT: latents of six videos, and what is known about the scene, to the velocity of rectified flow.

Written from the specification of `MagicDriveSTDiT3-XL/2`; names and shapes of tensors are those of its weights file.
Everything independent of the timestep is computed once for a scene and branch (`encode`), the rest at every step
(`forward`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Self

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from generation.extensions.magicdrive.blocks import ConditionTokens, MagicDriveBlock
from generation.extensions.magicdrive.conditions import ClipConditions
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.encoders import (
    CameraEncoder,
    ClipBoxEncoder,
    EgoEncoder,
    MapEncoder,
    MapTimeEncoder,
    TextEncoder,
)
from generation.extensions.magicdrive.layers import (
    LatentSize,
    PatchEmbedding,
    RotaryFrequencies,
    RotaryRotation,
    ScalarEmbedding,
    compute_grid_embedding,
    modulate,
    pack_views,
    round_to_bfloat16,
    unpack_views,
    unpatch,
)


@dataclass(frozen=True, slots=True)
class EncodedConditions:
    """Conditions of a clip, or of a batch of clips of one size, as the transformer needs them.

    `control` (b, 1, t, S, C) are map features and positions, with which the control stream starts; `position` (S, C)
    embeds places, `rate` (b, C) the frame rate; `keys_values` are in the order of `MagicDriveDiT.blocks`, if they are
    cached.
    """

    tokens: ConditionTokens
    control: Tensor
    position: Tensor
    rate: Tensor
    size: LatentSize
    keys_values: tuple[ConditionTokens, ...] | None = None

    @classmethod
    def batch(cls, parts: Sequence[Self]) -> Self:
        """Clips of one size, or guidance branches, of equal token numbers as one batch without kept keys, values."""
        first = parts[0]
        if any(part.size != first.size or not torch.equal(part.position, first.position) for part in parts):
            raise ValueError("clips of different sizes cannot be one batch")
        return cls(
            tokens=ConditionTokens.batch([part.tokens for part in parts]),
            control=torch.cat([part.control for part in parts]),
            position=first.position,
            rate=torch.cat([part.rate for part in parts]),
            size=first.size,
        )


class FinalLayer(nn.Module):
    """Tokens become velocities of latent cells."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.scale_shift_table = nn.Parameter(torch.randn(2, channels) / channels**0.5)
        self.linear = nn.Linear(channels, out)

    def forward(self, x: Tensor, time: Tensor, time_of_given: Tensor, given: Tensor | None) -> Tensor:
        """(b, V, t, S, numbers of a patch) of tokens; (b, C) times of the step and of (b, t) given frames."""
        out = self._modulate(x, time)
        if given is not None:
            # The published network modulates given frames twice; the sampler discards the result.
            out = torch.where(given[:, None, :, None, None], self._modulate(out, time_of_given), out)
        velocity: Tensor = self.linear(out)
        return velocity

    def _modulate(self, x: Tensor, time: Tensor) -> Tensor:
        shift, scale = (self.scale_shift_table + time[:, None])[:, None, None, None].unbind(-2)
        return modulate(x, shift, scale)


class MagicDriveDiT(nn.Module):
    """Diffusion transformer of MagicDrive: velocities of a video's latents under conditions."""

    def __init__(self, config: MagicDriveConfig) -> None:
        super().__init__()
        self.config = config
        channels = config.hidden
        self.base_token: Tensor
        self.register_buffer("base_token", torch.randn(channels))
        self.rope = RotaryFrequencies(channels // config.heads)
        self.x_embedder = PatchEmbedding(config.latent_channels, channels)
        self.t_embedder = ScalarEmbedding(channels)
        self.t_block = nn.Sequential(nn.SiLU(), nn.Linear(channels, 6 * channels))
        self.y_embedder = TextEncoder(config)
        self.fps_embedder = ScalarEmbedding(channels)
        self.x_control_embedder = PatchEmbedding(config.latent_channels, channels)
        self.camera_embedder = CameraEncoder(config)
        self.frame_embedder = EgoEncoder(config)
        self.bbox_embedder = ClipBoxEncoder(config)
        self.controlnet_cond_embedder = MapEncoder(config)
        self.controlnet_cond_embedder_temp = MapTimeEncoder(config)
        self.controlnet_cond_patchifier = PatchEmbedding(channels, channels)
        base, control = range(config.depth), range(config.control_depth)
        self.base_blocks_s = nn.ModuleList(
            MagicDriveBlock(config, temporal=False, between_views=True, skip=False) for _ in base
        )
        self.base_blocks_t = nn.ModuleList(
            MagicDriveBlock(config, temporal=True, between_views=False, skip=False) for _ in base
        )
        self.before_proj = nn.Linear(channels, channels)
        self.control_blocks_s = nn.ModuleList(
            MagicDriveBlock(config, temporal=False, between_views=False, skip=True) for _ in control
        )
        self.control_blocks_t = nn.ModuleList(
            MagicDriveBlock(config, temporal=True, between_views=False, skip=True) for _ in control
        )
        self.final_layer = FinalLayer(channels, 4 * config.latent_channels)

    @property
    def dtype(self) -> torch.dtype:
        """Precision of the weights, in which everything is computed that is not said to be exact."""
        return self.before_proj.weight.dtype

    @property
    def blocks(self) -> Iterator[tuple[MagicDriveBlock, bool]]:
        """All blocks in the order in which they are used, and whether each belongs to the control stream."""
        for level in range(self.config.depth):
            controlled = level < self.config.control_depth
            for base, control in (
                (self.base_blocks_s, self.control_blocks_s),
                (self.base_blocks_t, self.control_blocks_t),
            ):
                yield _get_block(base, level), False
                if controlled:
                    yield _get_block(control, level), True

    def compile_blocks(self, backend: str = "inductor") -> None:
        """Have PyTorch compile the blocks in place: once for each of their four kinds, not for each block."""
        # Scenes differ in words and boxes: each kind is compiled once for the first and once for all numbers of them.
        torch._dynamo.config.recompile_limit = max(torch._dynamo.config.recompile_limit, 32)
        for block, _ in self.blocks:
            block.compile(backend=backend, fullgraph=True)

    def compute_latent_size(self, conditions: ClipConditions, rows_multiple: int | None = None) -> LatentSize:
        """Size of the latent of a clip; ``rows_multiple`` is by default the configuration's."""
        multiple = self.config.rows_multiple if rows_multiple is None else rows_multiple
        return LatentSize.of(conditions.frames, conditions.height, conditions.width, multiple)

    def encode(
        self,
        conditions: ClipConditions,
        *,
        box_repeats: int = 1,
        rows_multiple: int | None = None,
        keep_keys_values: bool = False,
    ) -> EncodedConditions:
        """Encode all conditions of one clip that do not depend on the timestep; gives a batch of one.

        The null branch has one empty box, `box_repeats` times, in place of many equal ones. `rows_multiple` is by
        default the configuration's; `keep_keys_values` caches those of the blocks, for speed.
        """
        config = self.config
        own = (conditions.views, conditions.box_latent.shape[-1], conditions.text.hidden.shape[-1])
        if own != (config.views, config.hidden, config.caption_channels):
            raise ValueError(
                f"conditions with views, box and text channels {own} are for another network than {config}"
            )
        size = self.compute_latent_size(conditions, rows_multiple)
        tokens = ConditionTokens(
            ego=self._encode_ego(conditions)[None, None, :, None],
            camera=self._encode_cameras(conditions)[None, :, None, None],
            text=self._encode_text(conditions)[None, None, None],
            boxes=self._encode_boxes(conditions)[None],
            box_repeats=box_repeats,
        )
        keys_values = (
            tuple(block.cross_attn.keys_values(tokens) for block, _ in self.blocks) if keep_keys_values else None
        )
        rate = self._round_inputs(torch.tensor([conditions.fps], device=self.base_token.device))
        position = compute_grid_embedding(
            *size.grid,
            (conditions.height, conditions.width),
            config.hidden,
            rounded=config.rounded,
            device=self.base_token.device,
        ).to(self.dtype)
        control = self._encode_map(conditions.maps, size) + position
        return EncodedConditions(tokens, control, position, self.fps_embedder(rate), size, keys_values)

    def forward(
        self, latent: Tensor, timestep: Tensor, encoded: EncodedConditions, given: Tensor | None = None
    ) -> Tensor:
        """Velocity of the flow from noise to data.

        Args:
            latent: (b, 96, t, h, w), channel-major and view-minor.
            timestep: (b,) from 1000, pure noise, to 0.
            given: (b, t) bool, True for latent frames that are known and without noise; ``None`` if no frame is.

        Returns:
            (b, 96, t, h, w) in single precision.
        """
        size = encoded.size
        wanted = (self.config.packed_channels, size.frames, size.rows, size.columns)
        if latent.shape[1:] != wanted:
            raise ValueError(f"the latent has shape {tuple(latent.shape)}, and the conditions are for (b, {wanted})")
        cells = unpack_views(latent, self.config.views).to(self.dtype)
        cells = F.pad(cells, (0, 0, 0, size.padded_rows - size.rows))
        time = self.t_embedder(self._round_inputs(timestep)) + encoded.rate
        time_of_given = time if given is None else self.t_embedder(torch.zeros_like(timestep).float()) + encoded.rate
        if given is None:
            modulation = self.t_block(time)[:, None]
        else:
            modulation = torch.where(
                given[..., None], self.t_block(time_of_given)[:, None], self.t_block(time)[:, None]
            )
        rotation = self.rope.rotation(size.frames, self.dtype, rounded=self.config.rounded)
        x = self._transform(cells, modulation, encoded, rotation)
        patches = self.final_layer(x, time, time_of_given, given)
        return pack_views(unpatch(patches, size)).float()

    def _transform(
        self, cells: Tensor, modulation: Tensor, encoded: EncodedConditions, rotation: RotaryRotation
    ) -> Tensor:
        """Both streams; the control stream adds to the base stream after each of its blocks."""
        x: Tensor = self.x_embedder(cells) + encoded.position
        c: Tensor = self.x_control_embedder(cells) + encoded.control
        cached = encoded.keys_values
        for index, (block, of_control) in enumerate(self.blocks):
            keys_values = cached[index] if cached is not None else block.cross_attn.keys_values(encoded.tokens)
            if of_control:
                c = block(c, modulation, keys_values, rotation)
                x = x + block.after_proj(c)
            else:
                x = block(x, modulation, keys_values, rotation)
        return x

    def _encode_text(self, conditions: ClipConditions) -> Tensor:
        """(L, C) tokens of the words and, as published, of one token of padding."""
        states = conditions.text.hidden
        count = min(int(conditions.text.mask.sum()) + 1, len(states))
        tokens: Tensor = self.y_embedder(self._round_inputs(states[:count]).to(self.dtype))
        return tokens

    def _encode_boxes(self, conditions: ClipConditions) -> Tensor:
        """(V, t, n, C), view by view because a clip has many boxes."""
        latent = self._round_inputs(conditions.box_latent)
        shared = len(conditions.bboxes) == 1
        views = []
        for view, masks in enumerate(conditions.masks):
            own = 0 if shared else view
            corners = self._round_inputs(conditions.bboxes[own])
            views.append(self.bbox_embedder(corners, conditions.classes[own], masks, latent) + self.base_token)
        return torch.stack(views)

    def _encode_cameras(self, conditions: ClipConditions) -> Tensor:
        """(V, C) of the first frame."""
        tokens: Tensor = self.camera_embedder(self._round_inputs(conditions.cams[:, 0, 0])) + self.base_token
        return tokens

    def _encode_ego(self, conditions: ClipConditions) -> Tensor:
        """(t, C)."""
        tokens: Tensor = self.frame_embedder(self._round_inputs(conditions.rel_pos[:, :3])) + self.base_token
        return tokens

    def _encode_map(self, maps: Tensor, size: LatentSize) -> Tensor:
        """(1, 1, t, S, C) features of the map, the same for all views."""
        features = self.controlnet_cond_embedder_temp(self.controlnet_cond_embedder(maps.to(self.dtype)))
        features = features.transpose(0, 1)[None]
        wanted = (size.frames, size.rows, size.columns)
        if features.shape[2:] != wanted:
            features = F.interpolate(features, wanted, mode="nearest")
        features = F.pad(features, (0, 0, 0, size.padded_rows - size.rows))
        tokens: Tensor = self.before_proj(self.controlnet_cond_patchifier(features[:, None]))
        return tokens

    def _round_inputs(self, numbers: Tensor) -> Tensor:
        """Numbers in single precision, rounded as those were that the published weights saw in training."""
        return round_to_bfloat16(numbers) if self.config.rounded else numbers.float()


def _get_block(blocks: nn.ModuleList, level: int) -> MagicDriveBlock:
    block = blocks[level]
    assert isinstance(block, MagicDriveBlock)
    return block
