"""`challenger-bench verify model --model uniad`: UniAD against numbers of its official code, with synthetic weights."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from pydantic import ValidationError
from torch import Tensor, nn

from adapters.models import Model, resolve
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.model import UniAD, UniADInputs
from adapters.verification.parity_set import ParityManifest, ParitySet, StoredTensor, set_folders
from adapters.verification.quantities import SAMPLED, STATISTICS, Quantity, compare_frame
from adapters.verification.uniad_optimiser import compare_optimiser
from adapters.verification.uniad_quantities import frame_quantities
from benchmark.errors import InputError
from benchmark.machine.devices import single_precision
from benchmark.machine.storage import read_json
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.filled_networks import fill, same_names_and_shapes
from benchmark.verification.golden import GoldenArrays, golden_directory
from benchmark.verification.synthetic_weights import read_shapes

FRAMES: Final = 1000
"""More of them are a damaged set."""
ELSEWHERE: Final = ("sdc_traj", "col_optim_cells")
"""What `compare_optimiser` compares."""


def verify_uniad(model: Model, golden: Path, device: str = "cpu") -> list[Check]:
    """Compare UniAD with golden sets; arguments and errors as of `adapters.verification.models.verify_model`."""
    comparison = Comparison()
    for folder in set_folders(golden):
        frames = read_frames(folder)
        network = resolve(model.net.build)(model.configuration(frames[0].shapes)).to(device)
        if not same_names_and_shapes(comparison, network, frames[0].shapes):
            break
        manifest = frames[0].manifest
        fill(comparison, network, manifest, frames[0].shapes, manifest.weights_sha256, folder / "manifest.json")
        with single_precision():
            compare_uniad(comparison, network, frames)
    return comparison.checks()


def compare_uniad(comparison: Comparison, network: UniAD, frames: list[ParitySet]) -> None:
    """Run the frames of a golden set with carried state and compare each.

    Args:
        comparison: Gets the errors.
        network: Already filled.
        frames: From `read_frames`.

    Raises:
        InputError: If the set is damaged or not one of this network.
    """
    network.reset()
    device, config = next(network.parameters()).device, network.config
    inputs = _Inputs.of(frames[0], config)
    network.motion_head.load_anchors(inputs.anchors)
    for number, frame in enumerate(frames):
        where, stored = f"{frame.folder.name}, frame {number}", _booleans_as_numbers(frame, number)
        key_frame = inputs.frame(frame, number, device)
        with torch.inference_mode(), _tapped(network) as taps:
            seen = network.ego_motion(key_frame).can_bus
            predictions = network.predict(key_frame)
            ours = frame_quantities(network, predictions, seen, taps, stored)
        compare_frame(comparison, frame, stored, _comparable(comparison, frame, ours, where), where)
        compare_optimiser(comparison, predictions, frame.outputs[number], where)


def _comparable(comparison: Comparison, frame: ParitySet, ours: dict[str, Quantity], where: str) -> dict[str, Quantity]:
    """What has the golden shape; the rest, which depends on how many tracks there are, counts as infinitely wrong."""
    found = {}
    for name, quantity in ours.items():
        layout = frame.manifest.tensors.get(name)
        own = [length for length in quantity.values.shape if length != 1]
        if layout is None or quantity.listed or own == [length for length in layout.shape if length != 1]:
            found[name] = quantity
        else:
            comparison.errors(f"shape of {name}", np.array([np.inf]), 0.0, where=where)
    return found


def read_frames(folder: Path) -> list[ParitySet]:
    """A golden set of UniAD, whose quantities have shapes of their own in every frame.

    Args:
        folder: With ``manifest.json``, ``inputs.npz`` and ``outputs_frame0.npz`` and so on; ``keys.json`` is in it or
            in the folder above.

    Returns:
        For each frame a set whose layout is that of the frame; its outputs are those of all frames.

    Raises:
        InputError: If anything in it is absent or damaged.
    """
    golden_directory(folder, "dev", "manifest.json", "inputs.npz", "outputs_frame0.npz")
    keys = folder / "keys.json" if (folder / "keys.json").is_file() else folder.parent / "keys.json"
    if not keys.is_file():
        raise InputError(f"the golden set {folder} has no keys.json in it or beside it; copy it there")
    path, raw = folder / "manifest.json", read_json(folder / "manifest.json")
    count = next(n for n in range(1, FRAMES + 1) if n == FRAMES or not (folder / f"outputs_frame{n}.npz").is_file())
    try:
        plain = ParityManifest.model_validate({**raw, "tensors": {}})
        layouts = [_layout(raw.get("tensors", {}), f"frame{number}") for number in range(count)]
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(part) for part in first["loc"]) or "the whole file"
        raise InputError(f"{path} does not describe a golden set: {place}: {first['msg']}") from error
    except (TypeError, AttributeError) as error:
        raise InputError(f"{path} does not list quantities by name and frame; fetch or make the set again") from error
    if len(plain.scene_tokens) < count:
        raise InputError(
            f"{path} names the scenes of {len(plain.scene_tokens)} frames and there are outputs of {count}; "
            "fetch or make the set again"
        )
    outputs = [GoldenArrays.read(folder / f"outputs_frame{number}.npz") for number in range(count)]
    inputs, shapes = GoldenArrays.read(folder / "inputs.npz"), read_shapes(keys)
    return [
        ParitySet(folder, plain.model_copy(update={"tensors": layout}), shapes, inputs, outputs) for layout in layouts
    ]


def _layout(tensors: dict[str, dict[str, Any]], frame: str) -> dict[str, StoredTensor]:
    """How a frame's quantities are stored."""
    return {name: StoredTensor.model_validate(kinds[frame]) for name, kinds in tensors.items() if frame in kinds}


def _booleans_as_numbers(frame: ParitySet, number: int) -> GoldenArrays:
    """The numbers of a frame but for moved plans; booleans become 0 and 1."""
    stored = frame.outputs[number]
    arrays: dict[str, Any] = {}
    for name in sorted(stored.names):
        quantity = name.removesuffix(SAMPLED).removesuffix(STATISTICS)
        if quantity in ELSEWHERE:
            continue
        if name.endswith(STATISTICS):
            arrays[name] = stored.floats(name, 3)
            continue
        shape: list[int | None] = [None] if name.endswith(SAMPLED) else list(frame.stored(quantity).shape)
        try:
            arrays[name] = stored.floats(name, *shape)
        except InputError:
            arrays[name] = stored.verdicts(name, *shape).astype(np.uint8)
    return GoldenArrays(stored.path, arrays)


@dataclass(frozen=True, slots=True)
class _Inputs:
    """Inputs of all frames but for their images."""

    projections: Tensor
    can_bus: Tensor
    rotations: Tensor
    translations: Tensor
    timestamps_s: list[float]
    commands: list[int]
    anchors: Tensor

    @classmethod
    def of(cls, golden: ParitySet, config: UniADConfig) -> "_Inputs":
        """Those of a set; an `InputError` if it is damaged or of another network."""
        arrays, frames = golden.inputs, len(golden.outputs)
        groups = (config.motion_groups, config.modes, config.forecast_steps, 2)
        commands = arrays.integers("command", frames)
        if ((commands < 0) | (commands >= config.commands)).any():
            raise InputError(
                f"array command in {arrays.path} has numbers past {config.commands - 1}; make the set again"
            )
        return cls(
            projections=torch.from_numpy(arrays.floats("lidar2img", config.cameras, 4, 4)),
            can_bus=torch.from_numpy(arrays.floats("can_bus", frames, 18)),
            rotations=torch.from_numpy(arrays.floats("l2g_r_mat", frames, 3, 3)).float(),
            translations=torch.from_numpy(arrays.floats("l2g_t", frames, 3)).float(),
            timestamps_s=arrays.floats("timestamps", frames).tolist(),
            commands=commands.tolist(),
            anchors=torch.from_numpy(arrays.floats("motion_anchors", *groups)).float(),
        )

    def frame(self, golden: ParitySet, number: int, device: torch.device) -> UniADInputs:
        """One frame."""
        images = golden.images(number)
        if images.shape[:2] != (len(self.projections), 3):
            raise InputError(
                f"{golden.folder / 'manifest.json'} asks for images of shape {tuple(images.shape)}, and the network "
                f"takes {len(self.projections)} cameras with 3 channels; pass the set of this model"
            )
        return UniADInputs(
            images=images.to(device),
            lidar2img=self.projections.to(device),
            can_bus=self.can_bus[number],
            l2g_r_mat=self.rotations[number],
            l2g_t=self.translations[number],
            timestamp=self.timestamps_s[number],
            command=self.commands[number],
            scene_token=golden.manifest.scene_tokens[number],
        )


@contextmanager
def _tapped(network: UniAD) -> Iterator[dict[str, Tensor]]:
    """Collect the feature maps of images under the names of the set."""
    taps: dict[str, Tensor] = {}

    def levels(name: str) -> torch.utils.hooks.RemovableHandle:
        def keep(_module: nn.Module, _inputs: object, maps: list[Tensor]) -> None:
            taps.update({f"{name}{level}": features for level, features in enumerate(maps)})

        return network.get_submodule(f"img_{name}").register_forward_hook(keep)

    handles = [levels("backbone"), levels("neck")]
    try:
        yield taps
    finally:
        for handle in handles:
            handle.remove()
