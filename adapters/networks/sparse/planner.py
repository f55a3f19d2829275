"""``sparsedrive`` and ``diffusiondrive`` under test: from an observation to inputs, from outputs to a plan."""

from dataclasses import replace
from pathlib import Path
from typing import Any, Final, Self

import torch

from adapters.camera_inputs import (
    NUSCENES_IMAGE,
    ImageFormat,
    Normalisation,
    camera_images,
    lidar_pose,
    lidar_to_image,
)
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import DiffusionDrive, SparseDrive, SparseInputs, SparseNetwork
from adapters.networks.sparse.selection import SparseOutputs
from adapters.planner import NativePlanner, Weights, forecasts_of, numbers
from adapters.verification.example_inputs import example_images, example_projections
from benchmark.machine.devices import Precision
from benchmark.planning import Command, Observation, Plan, PlanFrame, SceneInfo

VARIANTS: Final = {"sparsedrive": SparseConfig.sparsedrive, "diffusiondrive": SparseConfig.diffusiondrive}


class SparsePlanner(NativePlanner[SparseNetwork]):
    """SparseDrive or DiffusionDrive with given weights; arguments and errors as in `NativePlanner`.

    Every scene starts without a past, whatever the configuration says: what a plan is must not depend on which scene
    a process happened to see before. The published evaluation lets memory outlive a change of scene. Modes of the
    command that were refused because they hit a forecast have the score 0.

    Attributes:
        seed: Of the noise that DiffusionDrive plans from. SparseDrive has none.
    """

    def __init__(
        self,
        network: SparseNetwork,
        *,
        name: str,
        normalisation: Normalisation,
        weights_sha256: str | None = None,
        settings: dict[str, Any] | None = None,
        device: str = "auto",
        precision: Precision = "float32",
    ) -> None:
        super().__init__(
            network,
            name=name,
            image_format=image_format(network.config),
            normalisation=normalisation,
            weights_sha256=weights_sha256,
            settings={**(settings or {}), "memory_crosses_scenes": False},
            device=device,
            precision=precision,
        )
        self.native_protocol = "diffusiondrive" if isinstance(network, DiffusionDrive) else "sparsedrive"
        self.seed = network.seed

    @classmethod
    def from_checkpoint(
        cls,
        name: str,
        checkpoint: Path | None,
        *,
        seed: int = 0,
        device: str = "auto",
        precision: Precision = "float32",
    ) -> Self:
        """A published model with weights from a file or from what has been imported.

        Args:
            name: ``sparsedrive`` or ``diffusiondrive``.
            checkpoint: See `resolve_checkpoint`.
            seed: Of the noise; SparseDrive has none.
            device: See the class.
            precision: See the class.

        Returns:
            The planner.

        Raises:
            InputError: If there are no weights, they are refused, or they are for another model.
        """
        network = sparse_network(name, seed)
        weights = Weights.load(network, name, checkpoint)
        return cls(network, name=name, **weights.as_arguments(), device=device, precision=precision)

    def reset(self, scene: SceneInfo) -> None:
        """Forget the previous scene."""
        self._network.reset()

    def _computed(self, observation: Observation) -> Plan:
        return _plan(self._network(self.inputs(observation)), int(observation.command))

    def inputs(self, observation: Observation) -> SparseInputs:
        """What the network is given for a sample; errors as in `plan`."""
        images = camera_images(observation, self._format, self._normalisation)
        return SparseInputs(
            images=torch.from_numpy(images).to(self._device),
            projections=torch.from_numpy(lidar_to_image(observation, self._format)),
            timestamp_s=observation.timestamp_us / 1e6,
            global_T_lidar=torch.from_numpy(lidar_pose(observation)),
            command=int(observation.command),
            scene_token=observation.scene,
        )


def sparsedrive(
    checkpoint: Path | None = None, device: str = "auto", precision: Precision = "float32"
) -> SparsePlanner:
    """SparseDrive-S; see `SparsePlanner.from_checkpoint`."""
    return SparsePlanner.from_checkpoint("sparsedrive", checkpoint, device=device, precision=precision)


def diffusiondrive(
    checkpoint: Path | None = None, seed: int = 0, device: str = "auto", precision: Precision = "float32"
) -> SparsePlanner:
    """DiffusionDrive for nuScenes; see `SparsePlanner.from_checkpoint`."""
    return SparsePlanner.from_checkpoint("diffusiondrive", checkpoint, seed=seed, device=device, precision=precision)


def sparse_network(name: str, seed: int = 0) -> SparseNetwork:
    """A network as it is evaluated, with random weights.

    Args:
        name: ``sparsedrive`` or ``diffusiondrive``.
        seed: Of DiffusionDrive's noise.

    Returns:
        The network; a change of scene makes it forget.
    """
    config = replace(VARIANTS[name](), memory_crosses_scenes=False)
    return DiffusionDrive(config, seed) if name == "diffusiondrive" else SparseDrive(config)


def image_format(config: SparseConfig) -> ImageFormat:
    """How images of 1600 x 900 become those of a network: scaled to its width, cut off at the top.

    The miniatures see the whole images instead, brought to their size.

    Args:
        config: Of the network.

    Returns:
        The format; `adapters.camera_inputs.SPARSE_DRIVE_IMAGE` for the published sizes.
    """
    if config.image_resize == "linear":
        return ImageFormat(config.image_width_px, config.image_height_px)
    width, height = NUSCENES_IMAGE
    rows = height * config.image_width_px // width
    return ImageFormat(config.image_width_px, rows, crop_top=max(rows - config.image_height_px, 0), resize="bicubic")


def example_frame(config: SparseConfig) -> SparseInputs:
    """Made-up inputs of one key frame, the same every time.

    Args:
        config: Sizes of the network.

    Returns:
        Inputs on the processor.
    """
    form = image_format(config)
    return SparseInputs(
        images=torch.from_numpy(example_images(form)),
        projections=torch.from_numpy(example_projections(form)),
        timestamp_s=0.0,
        global_T_lidar=torch.eye(4, dtype=torch.float64),
        command=int(Command.STRAIGHT),
        scene_token="example",
    )


def _plan(outputs: SparseOutputs, command: int) -> Plan:
    likely = outputs.trajectory_scores.double()
    # The network scores each mode for itself; as shares they are the probabilities that a forecast has.
    shares = likely / likely.sum(-1, keepdim=True).clamp_min(1e-12)
    return Plan(
        waypoints=numbers(outputs.plan),
        frame=PlanFrame.LIDAR,
        modes=numbers(outputs.plan_modes[command]),
        mode_scores=numbers(outputs.plan_scores[command]),
        forecasts=forecasts_of(outputs.boxes, outputs.box_scores, outputs.trajectories, shares),
    )
