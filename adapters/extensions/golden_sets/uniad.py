"""`challenger-bench verify model --model uniad`: UniAD against numbers of its official code, with synthetic weights."""

from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor

from adapters.extensions.golden_sets.parity_set import GoldenNetwork, ParitySet, built, compare_frame
from adapters.extensions.golden_sets.taps import tapped
from adapters.extensions.golden_sets.uniad_optimiser import compare_optimiser
from adapters.extensions.golden_sets.uniad_quantities import frame_quantities
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.model import UniAD, UniADInputs
from benchmark.verification.checks import Comparison

ELSEWHERE: Final = ("sdc_traj", "col_optim_cells")
"""What `compare_optimiser` compares."""


def compare_uniad(comparison: Comparison, network: UniAD, golden: ParitySet) -> None:
    """Run the frames of a golden set with carried state and compare each."""
    network.reset()
    device, config = next(network.parameters()).device, network.config
    inputs = _Inputs.of(golden, config)
    network.motion_head.load_anchors(inputs.anchors)
    for number, stored in enumerate(golden.outputs):
        at, key_frame = comparison.at(f"{golden.folder.name}, frame {number}"), inputs.frame(golden, number, device)
        with tapped(network) as taps:
            seen = network.ego_motion(key_frame).can_bus
            predictions = network.predict(key_frame)
            ours = frame_quantities(network, predictions, seen, taps, stored)
        compare_frame(at, golden, number, ours, ELSEWHERE)
        compare_optimiser(at, predictions, stored)


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
        """Those of a set."""
        arrays, frames = golden.inputs, len(golden.outputs)
        groups = (config.motion_groups, config.modes, config.forecast_steps, 2)
        commands = arrays.integers("command", frames)
        if ((commands < 0) | (commands >= config.commands)).any():
            raise ValueError(f"it has commands past {config.commands - 1}")
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
            scene_token=golden.recipe.scene_tokens[number],
        )


GOLDEN: Final = GoldenNetwork(ParitySet.read, built, compare_uniad)
