"""What all native networks share as planners: weights, device, precision, and what identifies a run."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

import numpy as np
import torch
from torch import nn

from adapters.camera_inputs import ImageFormat, Normalisation, normalisation_of
from adapters.checkpoints.cache import load_weights
from adapters.checkpoints.importing import resolve_checkpoint
from benchmark.constants import FARTHEST_WAYPOINT_M, PLAN_STEPS
from benchmark.geometry import Floats
from benchmark.machine.devices import Precision, device_of, require_precision, single_precision
from benchmark.machine.storage import file_sha256
from benchmark.planning import Forecasts, Observation, Plan

FORECAST_SCORE: Final = 0.3
"""Boxes of a lower score are not counted as what a model expects: it always reports a hundred or more."""
Network = TypeVar("Network", bound=nn.Module)


@dataclass(frozen=True, slots=True)
class Weights:
    """Where the weights of a network came from.

    Attributes:
        normalisation: What they were trained with.
        sha256: Of the weights file.
        settings: What a run record says of them.
    """

    normalisation: Normalisation
    sha256: str
    settings: dict[str, Any]

    @classmethod
    def load(cls, network: nn.Module, name: str, checkpoint: Path | None) -> "Weights":
        """Fill a network from a file or from what has been imported.

        Args:
            network: Of the model.
            name: Of the model.
            checkpoint: See `resolve_checkpoint`.

        Returns:
            Where the weights came from.

        Raises:
            InputError: If there are no weights, they are refused, or they are for another model.
        """
        path = resolve_checkpoint(name, checkpoint)
        provenance = load_weights(network, path)
        settings = {"weights": provenance.model_dump(mode="json")}
        return cls(normalisation_of(provenance.normalisation), file_sha256(path), settings)

    def as_arguments(self) -> dict[str, Any]:
        """What a `NativePlanner` is told of its weights, by the names of its arguments."""
        return {"normalisation": self.normalisation, "weights_sha256": self.sha256, "settings": self.settings}


class NativePlanner(ABC, Generic[Network]):
    """A network with given weights; subclasses turn observations into its inputs and its outputs into plans.

    Args:
        network: The network, its weights loaded.
        name: Shown in tables.
        image_format: How images of the cameras become those of the network.
        normalisation: What the weights were trained with.
        weights_sha256: Of the weights file, if there is one.
        settings: What else identifies the run.
        device: ``cpu``, ``cuda``, ``cuda:1``; ``auto`` is the first GPU where there is one.
        precision: ``bfloat16`` computes the matrix products in half the bytes.

    Raises:
        InputError: If there is no such device or precision.
    """

    def __init__(
        self,
        network: Network,
        *,
        name: str,
        image_format: ImageFormat,
        normalisation: Normalisation,
        weights_sha256: str | None,
        settings: dict[str, Any] | None,
        device: str,
        precision: Precision,
    ) -> None:
        require_precision(precision)
        self.name = name
        self.weights_sha256 = weights_sha256
        self._device = device_of(device)
        self._half = precision == "bfloat16"
        self._network = network.eval().to(self._device)
        self._format = image_format
        self._normalisation = normalisation
        self.settings = {
            **(settings or {}),
            "normalisation": normalisation.name,
            "device": self._device.type,
            "precision": precision,
            "forecast_score": FORECAST_SCORE,
        }

    def plan(self, observation: Observation) -> Plan:
        """Plan from what is observed; earlier samples of the scene are remembered.

        Args:
            observation: The next sample of the scene.

        Returns:
            Waypoints, modes and forecasts; lidar frame.

        Raises:
            InputError: If an image is missing or broken.
        """
        half = torch.autocast(self._device.type, torch.bfloat16, enabled=self._half)
        with torch.inference_mode(), single_precision(), half:
            return self._computed(observation)

    @abstractmethod
    def _computed(self, observation: Observation) -> Plan:
        """The plan, inside the precision that was asked for."""


def numbers(tensor: torch.Tensor) -> Floats:
    """Numbers of any network as arrays of the benchmark."""
    return np.asarray(tensor.double().cpu().numpy(), np.float64)


def forecasts_of(
    boxes: torch.Tensor, scores: torch.Tensor, trajectories: torch.Tensor, shares: torch.Tensor
) -> Forecasts:
    """What a network expects of the others.

    What is no box (a number that is not finite, a side that is not above zero, a place 10 km away) is left out like a
    box with a low score: it means nothing, and would make the whole plan unusable.

    Args:
        boxes: (N, 7 or more) centre x, y, z, width, length, height, yaw.
        scores: (N,) 0 to 1.
        trajectories: (N, modes, steps, 2) centres, at least as many steps as a plan has.
        shares: (N, modes) probabilities.

    Returns:
        Boxes with a score of `FORECAST_SCORE` or more.
    """
    kept = scores >= FORECAST_SCORE
    # Length before width, as boxes are everywhere here; networks have them the other way round.
    listed, paths = numbers(boxes[kept][:, [0, 1, 4, 3, 6]]), numbers(trajectories[kept][:, :, :PLAN_STEPS])
    likely = numbers(shares[kept])
    near = (np.abs(listed) <= FARTHEST_WAYPOINT_M).all(1) & (np.abs(paths) <= FARTHEST_WAYPOINT_M).all((1, 2, 3))
    sound = near & (listed[:, 2:4] > 0).all(1) & np.isfinite(likely).all(1)
    return Forecasts(boxes=listed[sound], trajectories=paths[sound], scores=likely[sound])
