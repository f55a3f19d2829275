"""A golden set of a camera network: how its inputs are made, and what the official code made of them."""

import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Final, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor

from adapters.extensions.golden_sets.own_rounding import Run
from adapters.models import Model, resolve
from benchmark.errors import InputError
from benchmark.machine.devices import single_precision
from benchmark.machine.storage import read_json
from benchmark.records.store import validated
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.filled_networks import fill, same_names_and_shapes
from benchmark.verification.golden import GoldenArrays, golden_directory
from benchmark.verification.synthetic_weights import WeightsRecipe, read_shapes, seeded_normal

COARSE = 32
"""Pixels along a side of the squares that synthetic images have in common with the published code."""
LARGEST_IMAGES = 2**27
"""Numbers in the images of one frame; more than that is a damaged manifest."""

FRAMES: Final = 1000
"""More of them are a damaged set."""

T = TypeVar("T")
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
    def read(cls, folder: Path) -> "ParitySet":
        """Read a set.

        Args:
            folder: With ``manifest.json``, ``inputs.npz`` and ``outputs_frame0.npz`` and so on; ``keys.json`` is in it
                or in the folder above.

        Returns:
            The set.

        Raises:
            InputError: If anything in it is absent or damaged.
        """
        return read_sets(folder, lambda raw, _: [ParityManifest.model_validate(raw)])[0]

    def camera_images(self, frame: int, cameras: int) -> Tensor:
        """As `images`, for a network.

        Args:
            frame: From 0.
            cameras: That the network has.

        Returns:
            (cameras, 3, H, W) float32.

        Raises:
            InputError: As `images`, and if the set's images are those of another network.
        """
        images = self.images(frame)
        if images.shape[:2] != (cameras, 3):
            raise InputError(
                f"{self.folder / 'manifest.json'} asks for images of shape {tuple(images.shape)}, and the network "
                f"takes {cameras} cameras with 3 channels; pass the set of this model"
            )
        return images

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
        return recorded_images(single, recipe.sha256[frame] if len(recipe.sha256) > frame else None, frame, path)

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


def read_sets(folder: Path, manifests: Callable[[Any, int], Sequence[ParityManifest]]) -> list[ParitySet]:
    """A golden set, seen with each of several manifests; outputs are those of all frames in each case.

    Args:
        folder: As for `ParitySet.read`.
        manifests: Makes them of the raw manifest and the number of frames.

    Returns:
        A set for each manifest.

    Raises:
        InputError: If anything in it is absent or damaged.
    """
    golden_directory(folder, "dev", "manifest.json", "inputs.npz", "outputs_frame0.npz")
    keys, path = keys_file(folder, "beside"), folder / "manifest.json"
    count = next(n for n in range(1, FRAMES + 1) if n == FRAMES or not (folder / f"outputs_frame{n}.npz").is_file())
    found = described(path, lambda raw: manifests(raw, count))
    if len(found[0].scene_tokens) < count:
        raise InputError(
            f"{path} names the scenes of {len(found[0].scene_tokens)} frames and there are outputs of {count}; "
            "fetch or make the set again"
        )
    outputs = [GoldenArrays.read(folder / f"outputs_frame{frame}.npz") for frame in range(count)]
    inputs, shapes = GoldenArrays.read(folder / "inputs.npz"), read_shapes(keys)
    return [ParitySet(folder, manifest, shapes, inputs, outputs) for manifest in found]


def described(path: Path, parse: Callable[[Any], T]) -> T:
    """What a JSON file of a golden set says; an `InputError` where it is not of the form that `parse` wants."""
    return validated(
        parse,
        read_json(path),
        lambda where, why: f"{path} does not describe a golden set: {where or 'the whole file'}: {why}",
    )


def keys_file(folder: Path, where: str) -> Path:
    """Names and shapes of a network's tensors: in a set's folder or in the one above, which messages call `where`."""
    keys = folder / "keys.json" if (folder / "keys.json").is_file() else folder.parent / "keys.json"
    if not keys.is_file():
        raise InputError(f"the golden set {folder} has no keys.json in it or {where} it; copy it there")
    return keys


def recorded_images(images: NDArray[np.float32], sha256: str | None, frame: int, path: Path) -> Tensor:
    """Images as a tensor; an `InputError` if they are not those that a set was made with, where it says."""
    if sha256 is not None and hashlib.sha256(images.tobytes()).hexdigest() != sha256:
        raise InputError(
            f"the images of frame {frame} made here are not those whose SHA-256 is in {path}; fetch the set again"
        )
    return torch.from_numpy(images)


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


def compare_sets(
    model: Model,
    golden: Path,
    device: str,
    read: Callable[[Path], list[ParitySet]],
    compare: Callable[[Comparison, Any, list[ParitySet]], None],
    run: Run | None = None,
) -> list[Check]:
    """Fill a network for each golden set and compare it; errors as of `verify_model`.

    Args:
        model: Whose network.
        golden: A set's folder, or a model's folder whose sets are all compared.
        device: What the network runs on.
        read: Reads a set.
        compare: Compares a network, already filled, with what was read.
        run: How it is run; plainly by default.

    Returns:
        One check for each quantity; the first alone if names or shapes differ, since weights cannot be filled then.
    """
    run = run or Run()
    comparison = run.comparison
    for folder in set_folders(golden):
        sets = read(folder)
        shapes, manifest = sets[0].shapes, sets[0].manifest
        network = resolve(model.net.build)(model.configuration(shapes)).to(device)
        if not same_names_and_shapes(comparison, network, shapes):
            break
        fill(comparison, network, manifest, shapes, manifest.weights_sha256, folder / "manifest.json")
        with single_precision(), run.varied(network):
            compare(comparison, network, sets)
    return comparison.checks()
