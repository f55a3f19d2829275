"""A golden set of MagicDriveDiT: a network of reduced size, its inputs, and what the official code made of them."""

from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

import torch
from pydantic import BaseModel, ConfigDict, Field, TypeAdapter
from torch import Tensor

from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder
from benchmark.verification.synthetic_weights import WeightsRecipe, read_shapes
from generation.extensions.magicdrive.conditions import ClipConditions, TextStates
from generation.extensions.magicdrive.config import MagicDriveConfig
from generation.extensions.magicdrive.layers import LatentSize

Length = Annotated[int, Field(gt=0, le=4096)]


class _NetworkSizes(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")

    depth: Length
    control_depth: Length
    hidden_size: Length
    num_heads: Length
    caption_channels: Length
    model_max_length: Length
    in_channels: Length


class _BoxSizes(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")

    proj_dims: tuple[Length, Length, Length, Length]


class _MapSizes(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")

    conditioning_size: tuple[Length, Length, Length]
    block_out_channels: tuple[Length, Length, Length, Length]


class _Overrides(BaseModel):
    model_config = ConfigDict(frozen=True, extra="ignore")

    bbox_embedder_param: _BoxSizes
    map_embedder_param: _MapSizes


class _GoldenManifest(WeightsRecipe):
    reduced_config: _NetworkSizes
    overrides: _Overrides

    def config(self) -> MagicDriveConfig:
        """The network of the set, in single precision and without padded rows."""
        sizes, boxes = self.reduced_config, self.overrides.bbox_embedder_param
        return MagicDriveConfig(
            hidden=sizes.hidden_size,
            heads=sizes.num_heads,
            depth=sizes.depth,
            control_depth=sizes.control_depth,
            caption_channels=sizes.caption_channels,
            text_tokens=sizes.model_max_length,
            latent_channels=sizes.in_channels,
            box_hidden=boxes.proj_dims[1],
            map_channels=self.overrides.map_embedder_param.block_out_channels,
            map_layers=self.overrides.map_embedder_param.conditioning_size[0],
            rounded=False,
            rows_multiple=1,
        )


class TimestepSchedule(BaseModel):
    """Timesteps, from 1000 down, for one size of video. ``kwargs_dtype`` is what the size was computed with in."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    height: Length
    width: Length
    num_frames: Length
    kwargs_dtype: Literal["float32", "bfloat16"]
    timesteps: list[float] = Field(min_length=1, max_length=4096)


@dataclass(frozen=True, slots=True)
class GoldenClip:
    """One clip of the set; only some quantities use its negative prompt. (1, 96, t, h, w) noise, (1,) timestep."""

    conditions: ClipConditions
    latent: Tensor
    timestep: Tensor


@dataclass(frozen=True, slots=True)
class MagicDriveGoldenSet:
    """A golden set; `inner` are outputs of blocks for clip A, if it has them, `published_shapes` if it lists them."""

    recipe: WeightsRecipe
    config: MagicDriveConfig
    shapes: dict[str, tuple[int, ...]]
    published_shapes: dict[str, tuple[int, ...]] | None
    inputs: GoldenArrays
    outputs: GoldenArrays
    inner: GoldenArrays | None
    schedules: list[TimestepSchedule]

    @classmethod
    def read(cls, folder: GoldenFolder) -> Self:
        """Read a set, some files of which are in its folder or the one above."""

        def beside(name: str) -> Any:
            return folder.read_json_nearby(name) if folder.has(name) or folder.has(f"../{name}") else None

        published, schedules, recipe = beside("keys.json"), beside("timesteps_30.json"), folder.facts("manifest.json")
        manifest = _GoldenManifest.model_validate(recipe)
        return cls(
            manifest,
            manifest.config(),
            read_shapes(folder.read_json_nearby("keys_reduced.json")),
            None if published is None else read_shapes(published),
            folder.arrays("inputs.npz"),
            folder.arrays("outputs.npz"),
            folder.arrays("taps.npz") if folder.has("taps.npz") else None,
            [] if schedules is None else TypeAdapter(list[TimestepSchedule]).validate_python(schedules),
        )

    def case(self, name: str) -> GoldenClip:
        """Stored clip of that letter."""
        stored, config = self.inputs, self.config
        views, caption = config.views, config.caption_channels
        prefix = f"{name}.in."
        masks = _read_integers(stored, f"{prefix}bbox_masks", 1, None, views, None)[0].transpose(0, 1)
        frames, boxes = masks.shape[1:]
        words = _read_integers(stored, f"{prefix}text_mask", 1, None)[0].bool()
        high, wide, rate = (float(stored.floats(f"{prefix}{part}", 1)[0]) for part in ("height", "width", "fps"))
        size = LatentSize.of(frames, round(high), round(wide))
        conditions = ClipConditions(
            bboxes=self.numbers(f"{prefix}bbox_bboxes", 1, frames, 1, boxes, 8, 3)[0].transpose(0, 1),
            classes=_read_integers(stored, f"{prefix}bbox_classes", 1, frames, 1, boxes)[0].transpose(0, 1),
            masks=masks,
            box_latent=self.numbers(f"{prefix}bbox_latent_per_box", boxes, config.hidden),
            cams=self.numbers(f"{prefix}cams", 1, frames, views, 3, 7)[0].transpose(0, 1)[:, :, None],
            rel_pos=self.numbers(f"{prefix}rel_pos", 1, frames, 4, 4)[0],
            maps=self.numbers(f"{prefix}maps", 1, frames, config.map_layers, None, None)[0],
            text=TextStates(self.numbers(f"{prefix}y", 1, 1, len(words), caption)[0, 0], words),
            fps=rate,
            height=round(high),
            width=round(wide),
            negative_text=TextStates(self.numbers(f"{prefix}y_neg", 1, 1, len(words), caption)[0, 0], words),
        )
        return GoldenClip(
            conditions,
            self.numbers(f"{prefix}z", 1, config.packed_channels, size.frames, size.rows, size.columns),
            self.numbers(f"{prefix}timestep", 1),
        )

    def numbers(self, name: str, *shape: int | None) -> Tensor:
        """An input in single precision; arguments as in `GoldenArrays.floats`."""
        return torch.from_numpy(self.inputs.floats(name, *shape)).float()


def _read_integers(stored: GoldenArrays, name: str, *shape: int | None) -> Tensor:
    return torch.from_numpy(stored.integers(name, *shape))
