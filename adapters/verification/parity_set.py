"""A golden set of a camera network: how its inputs are made, and what the official code made of them."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Self

import numpy as np
import torch
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from torch import Tensor

from benchmark.errors import InputError
from benchmark.machine.storage import read_json
from benchmark.verification.golden import GoldenArrays, golden_directory
from benchmark.verification.synthetic_weights import WeightsRecipe, read_shapes, seeded_normal

COARSE = 32
"""Pixels along a side of the squares that synthetic images have in common with the published code."""
LARGEST_IMAGES = 2**27
"""Numbers in the images of one frame; more than that is a damaged manifest."""

Length = Annotated[int, Field(gt=0)]


class ImageRecipe(BaseModel):
    """How the synthetic images of a set are made.

    Attributes:
        shape: Cameras, channels, rows, columns.
        valid_rows: Rows from this one on are padding.
        sha256: Of the float32 images of each frame.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    shape: tuple[Length, Length, Length, Length]
    valid_rows: Length
    sha256: list[str] = Field(default_factory=list)


class StoredTensor(BaseModel):
    """How a quantity is stored: shape of the tensor, and stride of its flat numbers where only a part of them is."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    shape: list[Length]
    stride: Length = 1


class ParityManifest(WeightsRecipe):
    """The manifest of such a set."""

    weights_sha256: str | None = None
    image: ImageRecipe
    scene_tokens: list[str]
    tensors: dict[str, StoredTensor] = Field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ParitySet:
    """One golden set.

    Attributes:
        folder: Where it is.
        manifest: How weights and images are made, and what is stored.
        shapes: Shapes of the network's tensors by name.
        inputs: Calibration, motion and commands.
        outputs: For each frame, what the official code computed.
    """

    folder: Path
    manifest: ParityManifest
    shapes: dict[str, tuple[int, ...]]
    inputs: GoldenArrays
    outputs: list[GoldenArrays]

    @classmethod
    def read(cls, folder: Path) -> Self:
        """Read a set.

        Args:
            folder: With ``manifest.json``, ``inputs.npz`` and ``outputs_frame0.npz`` and so on; ``keys.json`` is in it
                or in the folder above.

        Returns:
            The set.

        Raises:
            InputError: If anything in it is absent or damaged.
        """
        golden_directory(folder, "dev", "manifest.json", "inputs.npz", "outputs_frame0.npz")
        keys = folder / "keys.json" if (folder / "keys.json").is_file() else folder.parent / "keys.json"
        if not keys.is_file():
            raise InputError(f"the golden set {folder} has no keys.json in it or beside it; copy it there")
        path = folder / "manifest.json"
        try:
            manifest = ParityManifest.model_validate(read_json(path))
        except ValidationError as error:
            first = error.errors()[0]
            place = ".".join(str(part) for part in first["loc"]) or "the whole file"
            raise InputError(f"{path} does not describe a golden set: {place}: {first['msg']}") from error
        count = 0
        while (folder / f"outputs_frame{count}.npz").is_file():
            count += 1
        if len(manifest.scene_tokens) < count:
            raise InputError(
                f"{path} names the scenes of {len(manifest.scene_tokens)} frames and there are outputs of {count}; "
                "fetch or make the set again"
            )
        outputs = [GoldenArrays.read(folder / f"outputs_frame{frame}.npz") for frame in range(count)]
        inputs = GoldenArrays.read(folder / "inputs.npz")
        return cls(folder, manifest, read_shapes(keys), inputs, outputs)

    def images(self, frame: int) -> Tensor:
        """Synthetic images: noise per pixel on twice the noise of large squares.

        Args:
            frame: From 0.

        Returns:
            (cameras, 3, H, W) float32.

        Raises:
            InputError: If the set's images are not those of its own checksums, or have an impossible shape.
        """
        recipe, path = self.manifest.image, self.folder / "manifest.json"
        cameras, channels, rows, columns = recipe.shape
        if rows % COARSE or columns % COARSE or np.prod(recipe.shape, dtype=float) > LARGEST_IMAGES:
            raise InputError(
                f"{path} asks for images of shape {recipe.shape}; make the set with rows and columns "
                f"that are multiples of {COARSE}"
            )
        salt, coarse = self.manifest.salt, (cameras, channels, rows // COARSE, columns // COARSE)
        squares = np.kron(seeded_normal(f"input:image_coarse:frame{frame}", coarse, salt), np.ones((COARSE, COARSE)))
        images = seeded_normal(f"input:image:frame{frame}", recipe.shape, salt) + 2 * squares
        images[:, :, recipe.valid_rows :] = 0
        single = images.astype(np.float32)
        if len(recipe.sha256) > frame and hashlib.sha256(single.tobytes()).hexdigest() != recipe.sha256[frame]:
            raise InputError(
                f"the images of frame {frame} made here are not those whose SHA-256 is in {path}; fetch the set again"
            )
        return torch.from_numpy(single)

    def stored(self, quantity: str) -> StoredTensor:
        """How a quantity is stored.

        Raises:
            InputError: If the manifest does not say.
        """
        if quantity not in self.manifest.tensors:
            raise InputError(
                f"{self.folder / 'manifest.json'} does not say how {quantity} is stored; fetch or make the set again"
            )
        return self.manifest.tensors[quantity]


def set_folders(golden: Path) -> list[Path]:
    """Where the sets are that a golden directory holds.

    Args:
        golden: A set's folder, or a model's folder with sets in it.

    Returns:
        The folder itself, or those in it that hold a set; itself too where there is none, so that its reader says what
        is missing.
    """
    if (golden / "manifest.json").exists() or not golden.is_dir():
        return [golden]
    return sorted(path.parent for path in golden.glob("*/manifest.json")) or [golden]
