"""``uniad`` under test: from an observation to the network's inputs, from its outputs to a plan."""

from pathlib import Path
from typing import Any, Final, Self

import torch

from adapters.camera_inputs import (
    Normalisation,
    camera_images,
    can_bus_vector,
    lidar_pose,
    lidar_to_image,
)
from adapters.checkpoints.cache import read_shapes
from adapters.checkpoints.importing import resolve_checkpoint
from adapters.networks.uniad.collision_optimiser import Solver
from adapters.networks.uniad.collision_solvers import require_casadi
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.frames import UniADInputs, UniADOutputs
from adapters.networks.uniad.model import UniAD
from adapters.planner import NativePlanner, Weights, forecasts_of, numbers
from adapters.verification.example_inputs import example_images, example_projections
from benchmark.machine.devices import Precision
from benchmark.planning import Command, Observation, Plan, PlanFrame, SceneInfo

WEIGHTS: Final = "uniad"
"""The one set of weights of all variants."""
SOLVERS: Final[dict[str, Solver | None]] = {"uniad": "newton", "uniad-unoptimised": None, "uniad-ipopt": "ipopt"}
"""Variants by name, and what moves their plans away from occupied cells."""


class UniADPlanner(NativePlanner[UniAD]):
    """UniAD with given weights; arguments and errors as in `NativePlanner`.

    Every scene starts without a past, as the first one of a published run does: what a plan is must not depend on which
    scene a process happened to see before. The published evaluation goes on numbering tracks, and measures the ego's
    motion into a new scene from where the old one ended.

    A plan has two modes, before and after it is moved away from occupied cells; one where that is switched off.

    Attributes:
        seen: What the network reported for the last sample, tracks, occupancy and (with `UniAD.masks`) road map
            included, for diagnosis and pictures (`adapters.networks.uniad.pictures`); ``None`` before the first.
    """

    native_protocol = "uniad"

    def __init__(
        self,
        network: UniAD,
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
            settings={
                **(settings or {}),
                "memory_crosses_scenes": False,
                "collision_optimisation": network.solver or "off",
            },
            device=device,
            precision=precision,
        )
        self.seen: UniADOutputs | None = None

    @classmethod
    def from_checkpoint(
        cls,
        name: str,
        checkpoint: Path | None,
        *,
        device: str = "auto",
        precision: Precision = "float32",
        masks: bool = False,
    ) -> Self:
        """The published network with weights from a file or from what has been imported.

        Args:
            name: One of `SOLVERS`.
            checkpoint: See `resolve_checkpoint`.
            device: See the class.
            precision: See the class.
            masks: Whether the road map is drawn for `seen`; the plan is the same.

        Returns:
            The planner.

        Raises:
            InputError: If there are no weights, they are refused or for another model, or casadi is wanted and absent.
        """
        if SOLVERS[name] == "ipopt":
            require_casadi()
        path = resolve_checkpoint(WEIGHTS, checkpoint)
        config = UniADConfig.base_of(read_shapes(path))
        network = UniAD(config, solver=SOLVERS[name], masks=masks, stores_anchors=True)
        weights = Weights.load(network, WEIGHTS, path)
        return cls(network, name=name, **weights.as_arguments(), device=device, precision=precision)

    @property
    def config(self) -> UniADConfig:
        """Of the network."""
        return self._network.config

    def reset(self, scene: SceneInfo) -> None:
        """Forget the previous scene."""
        self._network.reset()
        self.seen = None

    def inputs(self, observation: Observation) -> UniADInputs:
        """What the network is given for a sample.

        Args:
            observation: The sample.

        Returns:
            Images on the planner's device, the rest on the processor.

        Raises:
            InputError: If an image is missing or broken.
        """
        images = camera_images(observation, self._format, self._normalisation)
        global_T_lidar = torch.from_numpy(lidar_pose(observation))
        return UniADInputs(
            images=torch.from_numpy(images).to(self._device),
            lidar2img=torch.from_numpy(lidar_to_image(observation, self._format)),
            can_bus=torch.from_numpy(can_bus_vector(observation.ego)),
            l2g_r_mat=global_T_lidar[:3, :3].T.float(),
            l2g_t=global_T_lidar[:3, 3].float(),
            timestamp=observation.timestamp_us / 1e6,
            command=int(observation.command),
            scene_token=observation.scene,
        )

    def _computed(self, observation: Observation) -> Plan:
        self.seen = self._network(self.inputs(observation))
        return _plan(self.seen)


def uniad(checkpoint: Path | None = None, device: str = "auto", precision: Precision = "float32") -> UniADPlanner:
    """UniAD with our own solver; see `UniADPlanner.from_checkpoint`."""
    return UniADPlanner.from_checkpoint("uniad", checkpoint, device=device, precision=precision)


def uniad_unoptimised(
    checkpoint: Path | None = None, device: str = "auto", precision: Precision = "float32"
) -> UniADPlanner:
    """UniAD whose plans stay where the network puts them; see `UniADPlanner.from_checkpoint`."""
    return UniADPlanner.from_checkpoint("uniad-unoptimised", checkpoint, device=device, precision=precision)


def uniad_ipopt(checkpoint: Path | None = None, device: str = "auto", precision: Precision = "float32") -> UniADPlanner:
    """UniAD with the published solver, which needs casadi; see `UniADPlanner.from_checkpoint`."""
    return UniADPlanner.from_checkpoint("uniad-ipopt", checkpoint, device=device, precision=precision)


def example_frame(config: UniADConfig) -> UniADInputs:
    """Made-up inputs of one key frame, the same every time.

    Args:
        config: Sizes of the network.

    Returns:
        Inputs on the processor.
    """
    image_format = config.image_format
    return UniADInputs(
        images=torch.from_numpy(example_images(image_format)),
        lidar2img=torch.from_numpy(example_projections(image_format)),
        can_bus=torch.zeros(18, dtype=torch.float64),
        l2g_r_mat=torch.eye(3),
        l2g_t=torch.zeros(3),
        timestamp=0.0,
        command=int(Command.STRAIGHT),
        scene_token="example",
    )


def _plan(outputs: UniADOutputs) -> Plan:
    planned = [outputs.plan_before_optimisation, outputs.plan][: 1 if outputs.collision is None else 2]
    return Plan(
        waypoints=numbers(outputs.plan),
        frame=PlanFrame.LIDAR,
        modes=numbers(torch.stack(planned)),
        forecasts=forecasts_of(outputs.boxes, outputs.box_scores, outputs.trajectories, outputs.trajectory_scores),
    )
