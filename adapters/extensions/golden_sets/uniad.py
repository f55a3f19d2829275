"""`challenger-bench verify model --model uniad`: UniAD against numbers of its official code, with synthetic weights."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor

from adapters.extensions.golden_sets.own_rounding import Run
from adapters.extensions.golden_sets.parity_set import ParityManifest, ParitySet, StoredTensor, compare_sets, read_sets
from adapters.extensions.golden_sets.quantities import SAMPLED, STATISTICS, Quantity, compare_frame
from adapters.extensions.golden_sets.taps import tapped
from adapters.extensions.golden_sets.uniad_optimiser import compare_optimiser
from adapters.extensions.golden_sets.uniad_quantities import frame_quantities
from adapters.models import Model
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.model import UniAD, UniADInputs
from benchmark.errors import InputError
from benchmark.verification.checks import Check, Comparison
from benchmark.verification.golden import GoldenArrays

ELSEWHERE: Final = ("sdc_traj", "col_optim_cells")
"""What `compare_optimiser` compares."""


def verify_uniad(model: Model, golden: Path, device: str = "cpu", run: Run | None = None) -> list[Check]:
    """Compare UniAD with golden sets; arguments and errors as of `verify_model`."""
    return compare_sets(model, golden, device, read_frames, compare_uniad, run)


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
        with torch.inference_mode(), tapped(network) as taps:
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

    def manifests(raw: Any, count: int) -> list[ParityManifest]:
        try:
            plain = ParityManifest.model_validate({**raw, "tensors": {}})
            layouts = [_layout(raw.get("tensors", {}), f"frame{number}") for number in range(count)]
        except (TypeError, AttributeError) as error:
            raise InputError(
                f"{folder / 'manifest.json'} does not list quantities by name and frame; fetch or make the set again"
            ) from error
        return [plain.model_copy(update={"tensors": layout}) for layout in layouts]

    return read_sets(folder, manifests)


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
        return UniADInputs(
            images=golden.camera_images(number, len(self.projections)).to(device),
            lidar2img=self.projections.to(device),
            can_bus=self.can_bus[number],
            l2g_r_mat=self.rotations[number],
            l2g_t=self.translations[number],
            timestamp=self.timestamps_s[number],
            command=self.commands[number],
            scene_token=golden.manifest.scene_tokens[number],
        )
