"""Golden frames of SparseDrive and DiffusionDrive with the state carried along: outputs of modules, call by call."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Final, Self, TypeVar

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter
from torch import Tensor, nn

from adapters.extensions.golden_sets.parity_set import GoldenNetwork, require_recorded_images
from adapters.extensions.golden_sets.sparse_quantities import (
    OTHERS,
    SHARE_OF_SPREAD,
    RowOrder,
    frame_quantities,
    map_quantities,
    reorder_memory,
)
from adapters.extensions.golden_sets.tensors import Quantity, TensorDifferences, compare_tensor, hook_modules
from adapters.models import Model, resolve
from adapters.networks.sparse.boxes import KeyframeMotion
from adapters.networks.sparse.config import SparseConfig, image_length_fits
from adapters.networks.sparse.model import DiffusionDrive, SparseInputs, SparseNetwork, pose_of
from benchmark.geometry import Floats
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder
from benchmark.verification.synthetic_weights import WeightsRecipe, draw_seeded_normal, read_shapes

COARSE = 16
"""Pixels along a side of the squares of synthetic images."""
RIGID = 1e-4
"""By how much the rotation of a pose may fail to be one."""

T = TypeVar("T")


def _length(pixels: int) -> int:
    if not image_length_fits(pixels):
        raise ValueError(f"the networks cannot take images {pixels} pixels high or wide")
    return pixels


Length = Annotated[int, Field(le=4096), AfterValidator(_length)]


class SetManifest(BaseModel):
    """Manifest of a set; `image_hw` is rows and columns.

    `salt` is of weights and images; a set without weights has those of the set of that name beside it. `image_sha256`
    is of the float32 images ``frame0`` and so on, or of the only frame.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    model: str
    salt: str
    image_hw: tuple[Length, Length]
    n_frames: Annotated[int, Field(ge=1, le=1000)] = 1
    image_sha256: dict[str, str] | str = Field(default_factory=dict)


class Statistic(BaseModel):
    """Statistics of a tensor stored in part or not at all; `absmax` is the largest size, `first` are numbers."""

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

    `inputs` are calibration, poses, times, commands and noise; `calls`, of modules in their order, and `statistics` may
    be empty.
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
        shapes = read_shapes(folder.read_json_nearby("keys.json"))
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
            raise ValueError(f"array {name}_T_global is not a pose")
        noise = f"{name}_diffusion_noise"
        drawn = inputs.floats(noise, 1, config.modes, config.steps, 2)[0] if noise in inputs.names else None
        sparse_inputs = SparseInputs(
            images=self._images(frame, cameras),
            projections=torch.from_numpy(inputs.floats(f"{name}_projection_mat", 1, cameras, 4, 4)[0]).float(),
            timestamp_s=float(inputs.floats(f"{name}_timestamp", 1)[0]),
            global_T_lidar=torch.from_numpy(pose),
            command=int(command.argmax()),
            scene_token=name,
        )
        return sparse_inputs, None if drawn is None else torch.from_numpy(drawn).float()

    def _images(self, frame: int, cameras: int) -> Tensor:
        """Noise of squares, and half as much of single pixels."""
        height, width = self.manifest.image_hw
        salt, shape = self.manifest.salt, (cameras, 3, height, width)
        coarse = (cameras, 3, height // COARSE, width // COARSE)
        squares = np.kron(
            draw_seeded_normal(f"input:image:coarse:frame{frame}", coarse, salt), np.ones((COARSE, COARSE))
        )
        images = (squares + 0.5 * draw_seeded_normal(f"input:image:fine:frame{frame}", shape, salt)).astype(np.float32)
        recorded = self.manifest.image_sha256
        sha256 = recorded if isinstance(recorded, str) else recorded.get(f"frame{frame}")
        return require_recorded_images(images, sha256, frame)


def _by_frame(folder: GoldenFolder, name: str, adapter: TypeAdapter[dict[str, T]]) -> dict[str, T]:
    """Contents of a file for each frame; nothing where there is no file."""
    return adapter.validate_python(folder.facts(name)) if folder.has(name) else {}


def _recipe(folder: GoldenFolder, salt: str, shapes: dict[str, tuple[int, ...]]) -> WeightsRecipe:
    """Recipe of the weights: of the set, or of the set beside it that has the name of the salt."""
    home = folder if folder.has("kept_buffers.npz") else GoldenFolder(folder.path.parent / salt)
    recipe, arrays = WeightsRecipe.model_validate(home.facts("manifest.json")), home.arrays("kept_buffers.npz")
    values = {name: arrays.floats(name, *shapes[name]).astype(np.float32) for name in sorted(arrays.names)}
    return recipe.model_copy(update={"kept_buffers": values})


@dataclass(frozen=True, slots=True)
class ModuleTrace:
    """Feature maps of one frame by name, and means, standard deviations, largest sizes and counts of each call."""

    maps: dict[str, list[Tensor]] = field(default_factory=dict)
    calls: dict[str, list[tuple[float, float, float, int]]] = field(default_factory=lambda: defaultdict(list))


@contextmanager
def trace_modules(network: nn.Module, calls: list[ModuleStatistic]) -> Iterator[ModuleTrace]:
    """Record a frame of the network that runs within the context; modules that it does not have are passed over."""
    trace = ModuleTrace()
    modules = {name for name, _ in network.named_modules()}

    def keep_maps(name: str) -> tuple[str, Callable[[Any], None]]:
        return name, lambda maps: trace.maps.update({name: maps})

    def keep_statistics(name: str) -> tuple[str, Callable[[Any], None]]:
        def keep(output: Any) -> None:
            numbers = _tensor_of(output).double()
            largest = float(numbers.abs().amax()) if numbers.numel() else 0.0
            deviation = float(numbers.std(correction=0))
            trace.calls[name].append((float(numbers.mean()), deviation, largest, numbers.numel()))

        return name, keep

    named = sorted({call.module for call in calls} & modules)
    with hook_modules(network, [keep_maps("img_backbone"), keep_maps("img_neck"), *map(keep_statistics, named)]):
        yield trace


def _tensor_of(output: Any) -> Tensor:
    """The tensor that stands for what a module gave: of several the first, and of plans their offsets."""
    if isinstance(output, Tensor):
        return output
    first: Tensor = output[0]
    # The refinement of plans gives logits first and offsets second; the official one has it the other way round.
    return output[1] if first.ndim == 1 else first


SWAPPED: Final = 0.03
MOVED: Final = "rows that changed places at near ties (share)"
MODULES: Final = "modules: mean and deviation of what they give (of the deviation)"
LARGEST: Final = "modules: largest number that they give (of the deviation)"


def sparse_sets(config: SparseConfig) -> GoldenNetwork[SparseSet]:
    """Golden sets of networks of other sizes, but for those of images, than the published ones."""
    return GoldenNetwork(SparseSet.read, partial(_build_network, config), _compare_frames)


def _build_network(config: SparseConfig, model: Model, golden: SparseSet) -> nn.Module:
    height, width = golden.manifest.image_hw
    sizes = replace(config, image_height_px=height, image_width_px=width)
    network: nn.Module = resolve(model.net.build)(sizes)
    return network


def _compare_frames(comparison: Comparison, network: SparseNetwork, golden: SparseSet) -> None:
    for frame in range(len(golden.outputs)):
        _compare_frame(comparison.at(f"{golden.folder.name}, frame {frame}"), network, golden, frame)


def _compare_frame(comparison: Comparison, network: SparseNetwork, golden: SparseSet, frame: int) -> None:
    """Compute a frame and compare it."""
    stored, past = golden.outputs[frame], network.memory
    inputs, noise = golden.frame(frame, network.config)
    if isinstance(network, DiffusionDrive) and noise is None:
        raise ValueError(f"no array frame{frame}_diffusion_noise")
    device = next(network.parameters()).device
    with trace_modules(network, golden.calls[frame]) as trace:
        predictions = network.predict(replace(inputs, images=inputs.images.to(device)), noise)
    order = RowOrder.of(network, predictions, stored)
    fresh = past is not None and KeyframeMotion.between(past.pose, pose_of(inputs), device).fresh
    reorder_memory(network, predictions, past if fresh else None, order, stored)
    ours = map_quantities(trace.maps["img_backbone"], trace.maps["img_neck"])
    ours |= frame_quantities(network, predictions, order, inputs.command, None if past is None else fresh)
    comparison.errors(MOVED, order.moved, SWAPPED)
    if "plan_reg" not in stored.names:
        raise ValueError("no array plan_reg")
    for name, quantity in ours.items():
        if name in stored.names:
            statistic = golden.statistics[frame].get(name)
            whole_tensor = None if statistic is None else _tensor_differences(quantity, statistic)
            compare_tensor(comparison, name, quantity, _select_stored(name, quantity.values, stored), whole_tensor)
    if unknown := sorted(stored.names - ours.keys()):
        comparison.note(MOVED, f"not compared in {comparison.where}: {', '.join(unknown)}")
    _compare_calls(comparison, trace, golden, frame)


def _tensor_differences(quantity: Quantity, statistic: Statistic) -> TensorDifferences:
    """Differences over the whole of an array, most of which may not be stored."""
    values = quantity.values.astype(np.float64)
    if values.size != math.prod(statistic.shape):
        raise ValueError(f"an array has the shape {statistic.shape}, the network's {list(values.shape)}")
    most = np.array([values.mean() - statistic.mean, values.std(ddof=1) - statistic.std])
    first = values.reshape(-1)[: len(statistic.first)] - np.array(statistic.first)
    return TensorDifferences(most, np.array([np.abs(values).max() - statistic.absmax, *first]), statistic.std or 1.0)


def _select_stored(name: str, values: NDArray[Any], stored: GoldenArrays) -> tuple[NDArray[Any], Floats]:
    """The part of our numbers that is stored, all or every n-th along an axis, and the stored ones."""
    numbers = stored.floats(name, *[None] * values.ndim)
    steps = [
        math.ceil(have / want) if want else have + 1 for have, want in zip(values.shape, numbers.shape, strict=True)
    ]
    part = values[tuple(slice(None, None, step) for step in steps)]
    if part.shape != numbers.shape:
        raise ValueError(f"array {name} has the shape {numbers.shape}, and the network gives {values.shape}")
    return part, numbers


def _compare_calls(comparison: Comparison, trace: ModuleTrace, golden: SparseSet, frame: int) -> None:
    """Compare what modules gave, in the order of their calls, as far as they are called alike here."""
    taken: dict[str, int] = {}
    compared = 0
    for call in golden.calls[frame]:
        number = taken[call.module] = taken.get(call.module, -1) + 1
        recorded = trace.calls.get(call.module, [])
        if number >= len(recorded):
            continue
        mean, deviation, largest, count = recorded[number]
        at = comparison.at(f"{call.module} of {comparison.where}")
        # The official code repeats plans and times for each mode and command.
        if math.prod(call.shape) % count:
            raise ValueError(f"{at.where} has the shape {call.shape}, the network {count} numbers")
        unit, total = call.std or 1.0, math.prod(call.shape)
        deviation *= math.sqrt(total / (total - 1)) if total > 1 else 1.0
        at.errors(MODULES, np.array([mean - call.mean, deviation - call.std]) / unit, SHARE_OF_SPREAD)
        at.errors(LARGEST, (largest - call.absmax) / unit, OTHERS)
        compared += 1
    if golden.calls[frame]:
        comparison.note(MODULES, f"{compared} of {len(golden.calls[frame])} calls in {comparison.where}")


GOLDEN: Final = sparse_sets(SparseConfig())
