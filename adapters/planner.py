"""Base of all native networks as planners: device, precision, and the identity of a run."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Generic, TypeVar

import numpy as np
import torch
from torch import nn

from adapters.as_published import CAN_AFTER, CROSS_SCENES
from adapters.camera_inputs import NetworkImageFormat, PixelNormalisation, require_views
from adapters.networks.layers.reporting import ReportingRules, find_distinct, limit_steering
from adapters.networks.layers.resnet import fold_normalisation, use_channels_last
from benchmark.constants import FARTHEST_WAYPOINT_M, PLAN_STEPS
from benchmark.geometry import Floats
from benchmark.machine.devices import Precision, require_precision, select_device, single_precision
from benchmark.planning import Forecasts, Observation, Plan, SceneInfo

Network = TypeVar("Network", bound=nn.Module)


class NativePlanner(ABC, Generic[Network]):
    """A network with given weights; subclasses turn observations into its inputs and its outputs into plans.

    Args:
        network: The network, its weights loaded; its configuration says how images become those that it reads.
        name: Shown in tables.
        normalisation: What the weights were trained with.
        weights_sha256: Of the weights file, if there is one.
        settings: What else identifies the run.
        native_protocol: Protocol of the repository that it comes from.
        device: ``cpu``, ``cuda``, ``cuda:1``; ``auto`` is the first GPU where there is one.
        precision: ``bfloat16`` computes the matrix products in half the bytes.
        as_published: What is done as in the published runs (`adapters.as_published`); the network has to be built for
            it (`adapters.models.Model.build`).

    Attributes:
        memory_crosses_scenes: Whether `reset` leaves what is remembered; `begin_run` does not.
        reads_message_after: Whether it is given the CAN message after the sample.

    Raises:
        InputError: If there is no such device or precision.
    """

    def __init__(
        self,
        network: Network,
        *,
        name: str,
        normalisation: PixelNormalisation,
        weights_sha256: str | None = None,
        settings: dict[str, Any] | None = None,
        native_protocol: str | None = None,
        device: str = "auto",
        precision: Precision = "float32",
        as_published: Sequence[str] = (),
    ) -> None:
        require_precision(precision)
        self.memory_crosses_scenes = not CROSS_SCENES.isdisjoint(as_published)
        self.reads_message_after = CAN_AFTER in as_published
        self.name = name
        self.weights_sha256 = weights_sha256
        self.native_protocol = native_protocol
        self._device = select_device(device)
        self._half = precision == "bfloat16"
        self._network = network.eval().to(self._device)
        if self._device.type == "cpu":
            use_channels_last(fold_normalisation(self._network))
        config: Any = network.config
        self._format: NetworkImageFormat = config.image_format
        self._reporting: ReportingRules = config.reporting
        self._normalisation = normalisation
        self.settings = {
            **(settings or {}),
            **self._own_settings(),
            "normalisation": normalisation.name,
            "device": self._device.type,
            "precision": precision,
            "forecast_score": self._reporting.least_score,
            **({"forecasts_apart": self._reporting.apart} if self._reporting.apart else {}),
            **({"steered_from_m": self._reporting.steered_from_m} if self._reporting.steered_from_m else {}),
            **({"as_published": "+".join(as_published)} if as_published else {}),
        }

    def reset(self, scene: SceneInfo) -> None:
        """Forget the previous scene, unless memory outlives it as in the published runs.

        A scene some of whose views have no camera is refused (`require_views`).
        """
        require_views(self.name, scene)
        if not self.memory_crosses_scenes:
            self.begin_run()

    def begin_run(self) -> None:
        """Forget everything."""
        network: Any = self._network
        network.reset()

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
            plan = self._compute_plan(observation)
        least_m = self._reporting.steered_from_m
        if not least_m:
            return plan
        modes = None if plan.modes is None else limit_steering(plan.modes, least_m)
        return replace(plan, waypoints=limit_steering(plan.waypoints, least_m), modes=modes)

    def _own_settings(self) -> dict[str, Any]:
        """Settings that identify a run, beside those that all networks have."""
        return {}

    @abstractmethod
    def _compute_plan(self, observation: Observation) -> Plan:
        """The plan, inside the precision that was asked for."""


def to_array(tensor: torch.Tensor) -> Floats:
    """Numbers of any network as arrays of the benchmark."""
    return np.asarray(tensor.double().cpu().numpy(), np.float64)


def select_forecasts(
    boxes: torch.Tensor,
    scores: torch.Tensor,
    trajectories: torch.Tensor,
    shares: torch.Tensor,
    reporting: ReportingRules,
) -> Forecasts:
    """Forecasts of the boxes that count, in their order.

    A box with a number that is not finite, a side that is not above zero, or a place 10 km away is left out like one
    with a low score: it would make the whole plan unusable. `boxes` are (N, 7 or more) centre x, y, z, width, length,
    height, yaw; `trajectories` (N, modes, steps, 2) centres, at least as many steps as a plan has; `shares` (N, modes)
    probabilities.
    """
    rows = (scores >= reporting.least_score).nonzero()[:, 0]
    rows = rows[find_distinct(boxes[rows][:, :2], boxes[rows][:, 4], scores[rows], reporting.apart)]
    # Length before width, as boxes are everywhere here; networks have them the other way round.
    listed, paths = to_array(boxes[rows][:, [0, 1, 4, 3, 6]]), to_array(trajectories[rows][:, :, :PLAN_STEPS])
    likely = to_array(shares[rows])
    plausible = (np.abs(listed) <= FARTHEST_WAYPOINT_M).all(1) & (np.abs(paths) <= FARTHEST_WAYPOINT_M).all((1, 2, 3))
    sound = plausible & (listed[:, 2:4] > 0).all(1) & np.isfinite(likely).all(1)
    return Forecasts(boxes=listed[sound], trajectories=paths[sound], scores=likely[sound])
