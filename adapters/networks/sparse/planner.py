"""``sparsedrive`` and ``diffusiondrive`` under test: from an observation to inputs, from outputs to a plan."""

from typing import Any

import torch

from adapters.camera_inputs import camera_images, lidar_pose, lidar_to_image
from adapters.networks.example_inputs import example_images, example_projections
from adapters.networks.layers.reporting import ReportingRules
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.model import SparseInputs, SparseNetwork
from adapters.networks.sparse.selection import SparseOutputs
from adapters.planner import NativePlanner, select_forecasts, to_array
from benchmark.planning import Command, Observation, Plan, PlanFrame


class SparsePlanner(NativePlanner[SparseNetwork]):
    """SparseDrive or DiffusionDrive with given weights; arguments and errors as in `NativePlanner`.

    Every scene starts without a past: a plan must not depend on which scene a process happened to see before. The
    published evaluation lets memory outlive a change of scene, and so does this where `adapters.as_published` asks for
    it. Modes of the command that were refused because they hit a forecast have the score 0.
    """

    @property
    def seed(self) -> int:
        """Seed of the noise that DiffusionDrive plans from; SparseDrive has none."""
        return self._network.seed

    def _own_settings(self) -> dict[str, Any]:
        return {"memory_crosses_scenes": self.memory_crosses_scenes}

    def _compute_plan(self, observation: Observation) -> Plan:
        return _plan(self._network(self.inputs(observation)), int(observation.command), self._reporting)

    def inputs(self, observation: Observation) -> SparseInputs:
        """Inputs of the network for a sample; errors as in `plan`."""
        images = camera_images(observation, self._format, self._normalisation)
        return SparseInputs(
            images=torch.from_numpy(images).to(self._device),
            projections=torch.from_numpy(lidar_to_image(observation, self._format)),
            timestamp_s=observation.timestamp_us / 1e6,
            global_T_lidar=torch.from_numpy(lidar_pose(observation)),
            command=int(observation.command),
            scene_token=observation.scene,
        )


def example_frame(config: SparseConfig) -> SparseInputs:
    """Made-up inputs of one key frame, the same every time."""
    form = config.image_format
    return SparseInputs(
        images=torch.from_numpy(example_images(form)),
        projections=torch.from_numpy(example_projections(form)),
        timestamp_s=0.0,
        global_T_lidar=torch.eye(4, dtype=torch.float64),
        command=int(Command.STRAIGHT),
        scene_token="example",
    )


def _plan(outputs: SparseOutputs, command: int, reporting: ReportingRules) -> Plan:
    likely = outputs.trajectory_scores.double()
    # The network scores each mode separately; normalised, the scores are the probabilities of a forecast.
    shares = likely / likely.sum(-1, keepdim=True).clamp_min(1e-12)
    return Plan(
        waypoints=to_array(outputs.plan),
        frame=PlanFrame.LIDAR,
        modes=to_array(outputs.plan_modes[command]),
        mode_scores=to_array(outputs.plan_scores[command]),
        forecasts=select_forecasts(outputs.boxes, outputs.box_scores, outputs.trajectories, shares, reporting),
    )
