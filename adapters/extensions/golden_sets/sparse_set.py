"""Golden sets of the sparse networks: how their inputs are made, and what the official code made of them."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Self, TypeVar

import numpy as np
import torch
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter
from torch import Tensor

from adapters.extensions.golden_sets.parity_set import recorded_images
from adapters.models import Model
from adapters.networks.sparse.config import SparseConfig, image_length_fits
from adapters.networks.sparse.model import SparseInputs
from benchmark.verification.golden import GoldenArrays, GoldenFolder
from benchmark.verification.synthetic_weights import WeightsRecipe, read_shapes, seeded_normal

COARSE = 16
"""Pixels along a side of the squares of synthetic images."""
RIGID = 1e-4
"""By how much the rotation of a pose may fail to be one."""

T = TypeVar("T")


def _length(pixels: int) -> int:
    if not image_length_fits(pixels):
        raise ValueError(f"the networks have no images that are {pixels} pixels high or wide")
    return pixels


Length = Annotated[int, Field(le=4096), AfterValidator(_length)]


class SetManifest(BaseModel):
    """The manifest of a set.

    Attributes:
        salt: Of weights and images; a set without weights of its own has those of the set of that name beside it.
        image_hw: Rows and columns of the images.
        image_sha256: Of the float32 images: of ``frame0`` and so on, or of the only frame.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    model: str
    salt: str
    image_hw: tuple[Length, Length]
    n_frames: Annotated[int, Field(ge=1, le=1000)] = 1
    image_sha256: dict[str, str] | str = Field(default_factory=dict)


class Statistic(BaseModel):
    """Statistics of a whole tensor of which a set stores a part, or nothing.

    `absmax` is the largest size, `first` the first numbers.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    shape: list[int]
    mean: float
    std: float
    absmax: float
    first: list[float]


class ModuleStatistic(Statistic):
    """Statistics of one call of a module of the official code."""

    module: str


@dataclass(frozen=True, slots=True)
class SparseSet:
    """One golden set: how images and weights are made, and for each frame what the official code computed.

    `inputs` are calibration, poses, times, commands and noise; `statistics` of whole tensors by name and `calls`,
    modules in the order of their calls, are empty where the set has none.
    """

    folder: Path
    manifest: SetManifest
    recipe: WeightsRecipe
    shapes: dict[str, tuple[int, ...]]
    inputs: GoldenArrays
    outputs: list[GoldenArrays]
    statistics: list[dict[str, Statistic]]
    calls: list[list[ModuleStatistic]]

    @classmethod
    def read(cls, folder: GoldenFolder, model: Model) -> Self:
        """Read a set of a model: ``keys.json`` is in its folder or the one above."""
        manifest = SetManifest.model_validate(folder.facts("manifest.json"))
        if manifest.model != model.name:
            raise ValueError(f"it is a golden set of {manifest.model}; pass one of {model.name}")
        shapes = read_shapes(folder.nearby("keys.json"))
        frames = [f"frame{frame}" for frame in range(manifest.n_frames)]
        statistics = _by_frame(folder, "stats_full.json", TypeAdapter(dict[str, dict[str, Statistic]]))
        calls = _by_frame(folder, "trace.json", TypeAdapter(dict[str, list[ModuleStatistic]]))
        return cls(
            folder.path,
            manifest,
            _recipe(folder, manifest.salt, shapes),
            shapes,
            folder.arrays("inputs.npz"),
            [folder.arrays(f"outputs_{frame}.npz") for frame in frames],
            [statistics.get(frame, {}) for frame in frames],
            [calls.get(frame, []) for frame in frames],
        )

    def frame(self, frame: int, config: SparseConfig) -> tuple[SparseInputs, Tensor | None]:
        """Inputs of a frame for a network, and the noise of the plans where the set has some."""
        name, inputs = f"frame{frame}", self.inputs
        cameras, commands = config.cameras, config.commands
        height, width = self.manifest.image_hw
        pose = inputs.floats(f"{name}_T_global", 4, 4)
        command = inputs.floats(f"{name}_gt_ego_fut_cmd", 1, commands)[0]
        turn = pose[:3, :3]
        if (inputs.floats(f"{name}_image_wh", 1, cameras, 2) != (width, height)).any():
            raise ValueError("inputs.npz has images of other sizes than manifest.json says")
        if not np.allclose(turn @ turn.T, np.eye(3), atol=RIGID) or not np.array_equal(pose[3], (0, 0, 0, 1)):
            raise ValueError(f"array {name}_T_global is no pose")
        noise = f"{name}_diffusion_noise"
        drawn = inputs.floats(noise, 1, config.modes, config.steps, 2)[0] if noise in inputs.names else None
        found = SparseInputs(
            images=self._images(frame, cameras),
            projections=torch.from_numpy(inputs.floats(f"{name}_projection_mat", 1, cameras, 4, 4)[0]).float(),
            timestamp_s=float(inputs.floats(f"{name}_timestamp", 1)[0]),
            global_T_lidar=torch.from_numpy(pose),
            command=int(command.argmax()),
            scene_token=name,
        )
        return found, None if drawn is None else torch.from_numpy(drawn).float()

    def _images(self, frame: int, cameras: int) -> Tensor:
        """Noise of squares, and half as much of single pixels."""
        height, width = self.manifest.image_hw
        salt, shape = self.manifest.salt, (cameras, 3, height, width)
        coarse = (cameras, 3, height // COARSE, width // COARSE)
        squares = np.kron(seeded_normal(f"input:image:coarse:frame{frame}", coarse, salt), np.ones((COARSE, COARSE)))
        images = (squares + 0.5 * seeded_normal(f"input:image:fine:frame{frame}", shape, salt)).astype(np.float32)
        recorded = self.manifest.image_sha256
        wanted = recorded if isinstance(recorded, str) else recorded.get(f"frame{frame}")
        return recorded_images(images, wanted, frame)


def _by_frame(folder: GoldenFolder, name: str, adapter: TypeAdapter[dict[str, T]]) -> dict[str, T]:
    """Contents of a file for each frame; nothing where there is no file."""
    return adapter.validate_python(folder.facts(name)) if folder.has(name) else {}


def _recipe(folder: GoldenFolder, salt: str, shapes: dict[str, tuple[int, ...]]) -> WeightsRecipe:
    """Recipe of the weights: of the set, or of the set beside it that has the name of the salt."""
    home = folder if folder.has("kept_buffers.npz") else GoldenFolder(folder.path.parent / salt)
    recipe, kept = WeightsRecipe.model_validate(home.facts("manifest.json")), home.arrays("kept_buffers.npz")
    values = {name: kept.floats(name, *shapes[name]).astype(np.float32) for name in sorted(kept.names)}
    return recipe.model_copy(update={"kept_buffers": values})
