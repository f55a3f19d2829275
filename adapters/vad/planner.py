"""``vad-tiny`` and ``vad-base`` under test: from an observation to the network's inputs, from its outputs to a plan."""

from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import torch

from adapters.camera_inputs import (
    ImageFormat,
    Normalisation,
    camera_images,
    can_bus_vector,
    lidar_to_image,
    normalisation_of,
)
from adapters.checkpoints.cache import load_weights
from adapters.checkpoints.importing import resolve_checkpoint
from adapters.devices import Precision, device_of, require_precision, single_precision
from adapters.example_inputs import example_images, example_projections
from adapters.vad.config import VADConfig
from adapters.vad.model import VAD, VADInputs
from adapters.vad.selection import VADOutputs
from benchmark.geometry import Floats
from benchmark.plan_rows import code_sha256
from benchmark.planning import Command, Forecasts, Observation, Plan, PlanFrame, SceneInfo
from benchmark.storage import file_sha256

VARIANTS: Final = {"vad-tiny": VADConfig.tiny, "vad-base": VADConfig.base}
FORECAST_SCORE: Final = 0.3
"""Boxes of a lower score are not counted as what the model expects: it always reports a hundred."""


class VADPlanner:
    """VAD with given weights.

    Args:
        network: The network, its weights loaded.
        name: Shown in tables.
        normalisation: What the weights were trained with.
        weights_sha256: Of the weights file, if there is one.
        settings: What else identifies the run.
        device: ``cpu``, ``cuda``, ``cuda:1``; ``auto`` is the first GPU where there is one.
        precision: ``bfloat16`` computes the matrix products in half the bytes.

    Raises:
        InputError: If there is no such device or precision.
    """

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
        require_precision(precision)
        self.name = name
        self.weights_sha256 = weights_sha256
        self._device = device_of(device)
        self._half = precision == "bfloat16"
        self._network = network.eval().to(self._device)
        self._format = ImageFormat.scaled(network.config.image_scale)
        self._normalisation = normalisation
        self.settings = {
            **(settings or {}),
            "normalisation": normalisation.name,
            "device": self._device.type,
            "precision": precision,
            "forecast_score": FORECAST_SCORE,
            # The network's layers and its inputs are outside this package, whose code the run's key covers already.
            "shared_code_sha256": code_sha256(ImageFormat),
        }

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
        path = resolve_checkpoint(name, checkpoint)
        network = VAD(VARIANTS[name]())
        provenance = load_weights(network, path)
        return cls(
            network,
            name=name,
            normalisation=normalisation_of(provenance.normalisation),
            weights_sha256=file_sha256(path),
            settings={"weights": provenance.model_dump(mode="json")},
            device=device,
            precision=precision,
        )

    def reset(self, scene: SceneInfo) -> None:
        """Forget the previous scene."""
        self._network.reset()

    def plan(self, observation: Observation) -> Plan:
        """Plan from six images, the ego's motion and the command; earlier samples of the scene are remembered.

        Args:
            observation: The next sample of the scene.

        Returns:
            Waypoints, one mode a command (right, left, straight), and forecasts; lidar frame.

        Raises:
            InputError: If an image is missing or broken.
        """
        half = torch.autocast(self._device.type, torch.bfloat16, enabled=self._half)
        with torch.inference_mode(), single_precision(), half:
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
    image_format = ImageFormat.scaled(config.image_scale)
    return VADInputs(
        images=torch.from_numpy(example_images(image_format)),
        lidar2img=torch.from_numpy(example_projections(image_format)),
        can_bus=torch.zeros(18, dtype=torch.float64),
        command=int(Command.STRAIGHT),
        scene_token="example",
    )


def _plan(outputs: VADOutputs) -> Plan:
    kept = outputs.box_scores >= FORECAST_SCORE
    # Length before width, as boxes are everywhere here; the network has them the other way round.
    boxes = outputs.boxes[kept][:, [0, 1, 4, 3, 6]]
    return Plan(
        waypoints=_numbers(outputs.plan),
        frame=PlanFrame.LIDAR,
        modes=_numbers(outputs.plan_modes),
        forecasts=Forecasts(
            boxes=_numbers(boxes),
            trajectories=_numbers(outputs.trajectories[kept]),
            scores=_numbers(outputs.trajectory_scores[kept]),
        ),
    )


def _numbers(tensor: torch.Tensor) -> Floats:
    return np.asarray(tensor.double().cpu().numpy(), np.float64)
