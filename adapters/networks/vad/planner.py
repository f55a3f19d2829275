"""``vad-tiny`` and ``vad-base`` under test: from an observation to the network's inputs, from its outputs to a plan."""

from pathlib import Path
from typing import Any, Final, Self

import torch

from adapters.camera_inputs import (
    Normalisation,
    camera_images,
    can_bus_vector,
    lidar_to_image,
)
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD, VADInputs
from adapters.networks.vad.selection import VADOutputs
from adapters.planner import NativePlanner, Weights, forecasts_of, numbers
from adapters.verification.example_inputs import example_images, example_projections
from benchmark.machine.devices import Precision
from benchmark.planning import Command, Observation, Plan, PlanFrame, SceneInfo

VARIANTS: Final = {"vad-tiny": VADConfig.tiny, "vad-base": VADConfig.base}


class VADPlanner(NativePlanner[VAD]):
    """VAD with given weights; arguments and errors as in `NativePlanner`."""

    native_protocol = "vad"

    def __init__(
        self,
        network: VAD,
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
            image_format=network.config.image_format,
            normalisation=normalisation,
            weights_sha256=weights_sha256,
            settings=settings,
            device=device,
            precision=precision,
        )

    @classmethod
    def from_checkpoint(
        cls, name: str, checkpoint: Path | None, *, device: str = "auto", precision: Precision = "float32"
    ) -> Self:
        """A published variant with weights from a file or from what has been imported.

        Args:
            name: ``vad-tiny`` or ``vad-base``.
            checkpoint: See `resolve_checkpoint`.
            device: See the class.
            precision: See the class.

        Returns:
            The planner.

        Raises:
            InputError: If there are no weights, they are refused, or they are for another model.
        """
        network = VAD(VARIANTS[name]())
        weights = Weights.load(network, name, checkpoint)
        return cls(network, name=name, **weights.as_arguments(), device=device, precision=precision)

    def reset(self, scene: SceneInfo) -> None:
        """Forget the previous scene."""
        self._network.reset()

    def _computed(self, observation: Observation) -> Plan:
        return _plan(self._network(self._inputs(observation)))

    def _inputs(self, observation: Observation) -> VADInputs:
        images = camera_images(observation, self._format, self._normalisation)
        return VADInputs(
            images=torch.from_numpy(images).to(self._device),
            lidar2img=torch.from_numpy(lidar_to_image(observation, self._format)),
            can_bus=torch.from_numpy(can_bus_vector(observation.ego)),
            command=int(observation.command),
            scene_token=observation.scene,
        )


def vad_tiny(checkpoint: Path | None = None, device: str = "auto", precision: Precision = "float32") -> VADPlanner:
    """VAD-tiny; see `VADPlanner.from_checkpoint`."""
    return VADPlanner.from_checkpoint("vad-tiny", checkpoint, device=device, precision=precision)


def vad_base(checkpoint: Path | None = None, device: str = "auto", precision: Precision = "float32") -> VADPlanner:
    """VAD-base; see `VADPlanner.from_checkpoint`."""
    return VADPlanner.from_checkpoint("vad-base", checkpoint, device=device, precision=precision)


def example_frame(config: VADConfig) -> VADInputs:
    """Made-up inputs of one key frame, the same every time.

    Args:
        config: Sizes of the network.

    Returns:
        Inputs on the processor.
    """
    image_format = config.image_format
    return VADInputs(
        images=torch.from_numpy(example_images(image_format)),
        lidar2img=torch.from_numpy(example_projections(image_format)),
        can_bus=torch.zeros(18, dtype=torch.float64),
        command=int(Command.STRAIGHT),
        scene_token="example",
    )


def _plan(outputs: VADOutputs) -> Plan:
    return Plan(
        waypoints=numbers(outputs.plan),
        frame=PlanFrame.LIDAR,
        modes=numbers(outputs.plan_modes),
        forecasts=forecasts_of(outputs.boxes, outputs.box_scores, outputs.trajectories, outputs.trajectory_scores),
    )
