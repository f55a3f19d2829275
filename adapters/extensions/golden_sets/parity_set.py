"""Golden sets of camera networks: inputs and official outputs, and how far rounding alone moves our outputs.

For the latter our network runs again with images that hardly differ, and other threads.
"""

import hashlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Final, Generic, Protocol, Self, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field
from torch import Tensor, nn

from adapters.extensions.golden_sets.tensors import Quantity, TensorDifferences, compare_tensor, have_same_lengths
from adapters.models import Model, resolve
from benchmark.geometry import Floats
from benchmark.machine.devices import single_precision
from benchmark.verification.checks import ROUNDING, Check, Comparison
from benchmark.verification.filled_networks import fill_network, have_same_names_and_shapes
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder, find_golden_directory, raise_input_error
from benchmark.verification.synthetic_weights import WeightsRecipe, draw_seeded_normal, read_shapes

IMAGE_NOISE: Final = 1e-7
"""Noise added to images: about the last bit of numbers around one, the scale of normalised images."""
NOTABLE: Final = 0.5
"""A quantity that rounding moves by more than this share of its tolerance is told of."""


@dataclass(frozen=True, slots=True)
class VerificationRun:
    """One way of running a network while it is compared; images are changed by `image_noise`."""

    comparison: Comparison = field(default_factory=Comparison)
    image_noise: float = 0.0
    threads: int | None = None

    @contextmanager
    def varied(self, network: Any) -> Iterator[None]:
        """Run a network, which has an ``img_backbone``, so within the context."""
        generator, usual = torch.Generator().manual_seed(0), torch.get_num_threads()

        def changed(_module: nn.Module, inputs: tuple[Tensor, ...]) -> tuple[Tensor, ...]:
            images = inputs[0]
            noise = torch.randn(images.shape, generator=generator).to(images)
            return (images + self.image_noise * noise, *inputs[1:])

        handle = network.img_backbone.register_forward_pre_hook(changed) if self.image_noise else None
        try:
            torch.set_num_threads(self.threads or usual)
            yield
        finally:
            torch.set_num_threads(usual)
            if handle is not None:
                handle.remove()


def choose_other_thread_count() -> int:
    """Another number of threads than the present one."""
    return 2 if torch.get_num_threads() == 1 else 1


def add_floating_point_noise(verify: Callable[[VerificationRun], Sequence[Check]]) -> list[Check]:
    """Checks of the plain run, each with the larger of the two movements by the network's own rounding.

    Notes name movements past the tolerance, and quantities that rounding moves by half of it or more.
    """
    plain, images, threads = (
        VerificationRun(),
        VerificationRun(image_noise=IMAGE_NOISE),
        VerificationRun(threads=choose_other_thread_count()),
    )
    for run in (plain, images, threads):
        run.comparison.remembers = True
    checks = list(verify(plain))
    verify(images)
    verify(threads)
    by_images = plain.comparison.moved_by(images.comparison)
    by_threads = plain.comparison.moved_by(threads.comparison)
    return [
        _add_note(check, by_images.get(check.quantity, 0.0), by_threads.get(check.quantity, 0.0)) for check in checks
    ]


def _add_note(check: Check, by_images: float, by_threads: float) -> Check:
    moved = replace(check, moved=max(by_images, by_threads))
    assert moved.moved is not None
    if moved.ok and moved.moved <= NOTABLE * moved.tolerance:
        return moved
    sentence = (
        f"images changed by {IMAGE_NOISE:g} move it by {by_images:.3g}, another number of threads by {by_threads:.3g}"
    )
    verdict = f"{ROUNDING}: " if moved.rounding else ""
    return replace(moved, note="; ".join(part for part in (f"{verdict}{sentence}", moved.note) if part))


COARSE = 32
"""Pixels along a side of the squares that synthetic images have in common with the published code."""
FILES: Final = ("manifest.json", "inputs.npz", "outputs_frame0.npz")
SAMPLED: Final = "__sub"
STATISTICS: Final = "__stats"
Length = Annotated[int, Field(gt=0, le=4096)]


class NetworkNumbers(Protocol):
    """Common parts of golden sets of networks."""

    @property
    def recipe(self) -> WeightsRecipe:
        """Recipe of the weights."""

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the network's tensors by name."""


S = TypeVar("S", bound=NetworkNumbers)


@dataclass(frozen=True, slots=True)
class GoldenNetwork(Generic[S]):
    """One family of networks and the form of its golden sets; `compare` is of a network already filled."""

    read: Callable[[GoldenFolder, Model], S]
    build: Callable[[Model, S], nn.Module]
    compare: Callable[[Comparison, Any, S], None]

    def verify(
        self, model: Model, golden: Path, device: str = "cpu", run: VerificationRun | None = None
    ) -> list[Check]:
        """Compare a network with a set, or all of a model's folder; the first check alone if names differ."""
        run = run or VerificationRun()
        comparison = run.comparison
        for folder in _set_folders(golden):
            find_golden_directory(folder, "dev", *FILES)
            with raise_input_error(folder, model.name):
                golden_set = self.read(GoldenFolder(folder), model)
                network = self.build(model, golden_set).to(device)
                if not have_same_names_and_shapes(comparison, network, golden_set.shapes):
                    break
                fill_network(
                    comparison,
                    network,
                    golden_set.recipe,
                    golden_set.shapes,
                    getattr(golden_set.recipe, "weights_sha256", None),
                )
                with single_precision(), torch.inference_mode(), run.varied(network):
                    self.compare(comparison, network, golden_set)
        return comparison.checks()


def _set_folders(golden: Path) -> list[Path]:
    """A set's folder, or those in a model's folder that hold a set."""
    if (golden / FILES[0]).exists() or not golden.is_dir():
        return [golden]
    return sorted(path.parent for path in golden.glob(f"*/{FILES[0]}")) or [golden]


class ImageRecipe(BaseModel):
    """Recipe of a set's images; hashes are of the float32 images by frame, rows from `valid_rows` on are padding."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    shape: tuple[Length, Length, Length, Length]
    valid_rows: Length
    sha256: list[str] = Field(default_factory=list)


class TensorLayout(BaseModel):
    """Stored form of a quantity: shape of the tensor, and stride of its flat numbers where only a part of them is."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    shape: list[Annotated[int, Field(gt=0)]]
    stride: Annotated[int, Field(gt=0)] = 1


class ParityManifest(WeightsRecipe):
    """The manifest of such a set; quantities may have shapes of their own in every frame."""

    weights_sha256: str | None = None
    image: ImageRecipe
    scene_tokens: list[str]
    tensors: dict[str, TensorLayout | dict[str, TensorLayout]] = Field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class ParitySet:
    """One golden set: recipes, `inputs` (calibration, motion, commands), and official outputs of each frame."""

    folder: Path
    recipe: ParityManifest
    shapes: dict[str, tuple[int, ...]]
    inputs: GoldenArrays
    outputs: list[GoldenArrays]

    @classmethod
    def read(cls, folder: GoldenFolder, _model: Model | None = None) -> Self:
        """Read a set: ``keys.json`` is in its folder or the one above, ``outputs_frame0.npz`` and so on in its own."""
        outputs = [folder.arrays(f"outputs_frame{at}.npz") for at in range(len(folder.named("outputs_frame*.npz")))]
        recipe = ParityManifest.model_validate(folder.facts("manifest.json", gaps=True))
        return cls(
            folder.path, recipe, read_shapes(folder.read_json_nearby("keys.json")), folder.arrays("inputs.npz"), outputs
        )

    def camera_images(self, frame: int, cameras: int) -> Tensor:
        """Images as of `images`, for a network that has so many cameras."""
        images = self.images(frame)
        if images.shape[:2] != (cameras, 3):
            raise ValueError(f"its images are of shape {tuple(images.shape)}, the network has {cameras} cameras")
        return images

    def images(self, frame: int) -> Tensor:
        """(cameras, 3, H, W) synthetic images of a frame: noise per pixel on twice the noise of large squares."""
        image, salt = self.recipe.image, self.recipe.salt
        cameras, channels, rows, columns = image.shape
        coarse = (cameras, channels, rows // COARSE, columns // COARSE)
        squares = np.kron(
            draw_seeded_normal(f"input:image_coarse:frame{frame}", coarse, salt), np.ones((COARSE, COARSE))
        )
        images = draw_seeded_normal(f"input:image:frame{frame}", image.shape, salt) + 2 * squares
        images[:, :, image.valid_rows :] = 0
        return require_recorded_images(images.astype(np.float32), image.sha256[frame] if image.sha256 else None, frame)

    def stored(self, quantity: str, frame: int) -> TensorLayout:
        """Stored form of a quantity."""
        layout = self.recipe.tensors[quantity]
        return layout if isinstance(layout, TensorLayout) else layout[f"frame{frame}"]


def build_network(model: Model, golden: ParitySet) -> nn.Module:
    """The network that a set is about, whose official files may differ in shapes."""
    network: nn.Module = resolve(model.net.build)(model.configuration(golden.shapes))
    return network


def require_recorded_images(images: NDArray[np.float32], sha256: str | None, frame: int) -> Tensor:
    """Images as a tensor, if they are those that a set was made with, where it says."""
    if sha256 is not None and hashlib.sha256(images.tobytes()).hexdigest() != sha256:
        raise ValueError(f"the images of frame {frame} made here do not match the stored SHA-256")
    return torch.from_numpy(images)


def compare_frame(
    comparison: Comparison, golden: ParitySet, frame: int, ours: Mapping[str, Quantity], elsewhere: tuple[str, ...] = ()
) -> None:
    """Compare all stored quantities of one frame, by the names of the set, but for those compared `elsewhere`."""
    stored, where = golden.outputs[frame], comparison.where
    names = {name.removesuffix(SAMPLED).removesuffix(STATISTICS) for name in stored.names} - {*elsewhere}
    known = [name for name in ours if name in names]
    for name in known:
        _compare(comparison, golden, frame, name, ours[name])
    if unknown := sorted(names - ours.keys()):
        comparison.note(ours[known[0]].title(known[0]), f"not compared in {where}: {', '.join(unknown)}")


def _compare(comparison: Comparison, golden: ParitySet, frame: int, name: str, quantity: Quantity) -> None:
    stored, values, flat = golden.outputs[frame], quantity.values, quantity.values.reshape(-1)
    selection: slice | NDArray[np.int64] = slice(None)
    if quantity.listed:
        numbers = stored.floats(name, None, *values.shape[1:])
        if len(numbers) != len(values):
            where = f"{comparison.where}, where the list has another length"
            comparison.errors(quantity.title(name), np.inf, quantity.tolerance.allowed, where=where)
            return
    else:
        layout = golden.stored(name, frame)
        if not have_same_lengths(values.shape, layout.shape):
            # The number of tracks is up to the network.
            comparison.errors(f"shape of {name}", np.inf, 0.0)
            return
        sampled = f"{name}{SAMPLED}" in stored.names
        selection = slice(None, None, layout.stride if sampled else 1)
        numbers = (
            stored.floats(f"{name}{SAMPLED}", len(flat[selection])) if sampled else stored.floats(name, *layout.shape)
        )
    whole_tensor = spread = None
    if f"{name}{STATISTICS}" in stored.names and not quantity.equal:
        statistics, all_of_it = stored.floats(f"{name}{STATISTICS}", 3), values.astype(np.float64)
        differences = np.array([all_of_it.mean(), all_of_it.std(), np.abs(all_of_it).max(initial=0.0)]) - statistics
        few: Floats = differences if quantity.tolerance.share < 1 else differences[:0]
        whole_tensor = TensorDifferences(
            differences[:2] if len(few) else differences, few, spread := float(statistics[1]) or 1.0
        )
    hanging = quantity.undecided
    if hanging is not None:
        hanging = np.repeat(hanging, values.size // len(hanging))[selection] if len(hanging) else np.zeros(0, np.bool_)
    compare_tensor(comparison, name, quantity, (flat[selection], numbers.reshape(-1)), whole_tensor, spread, hanging)
