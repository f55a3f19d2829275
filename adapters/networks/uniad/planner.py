"""``uniad`` under test: from an observation to the network's inputs, from its outputs to a plan."""

from typing import Any

import torch

from adapters.camera_inputs import camera_images, can_bus_vector, lidar_pose, lidar_to_image
from adapters.networks.example_inputs import example_images, example_projections
from adapters.networks.layers.reporting import ReportingRules
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.model import UniAD
from adapters.networks.uniad.planning import UniADInputs, UniADOutputs
from adapters.planner import NativePlanner, select_forecasts, to_array
from benchmark.planning import Command, Observation, Plan, PlanFrame, SceneInfo


class UniADPlanner(NativePlanner[UniAD]):
    """UniAD with given weights; arguments and errors as in `NativePlanner`.

    Every scene starts without a past: a plan must not depend on which scene a process happened to see before. The
    published evaluation goes on numbering tracks, and measures the ego's motion into a new scene from where the old one
    ended; so does this where `adapters.as_published` asks for it. A plan has two modes, before and after it is moved
    away from occupied cells; one where that is switched off. `seen` are outputs for the last sample, for diagnosis,
    with the road map if `UniAD.masks`.
    """

    seen: UniADOutputs | None = None

    def _own_settings(self) -> dict[str, Any]:
        return {
            "memory_crosses_scenes": self.memory_crosses_scenes,
            "collision_optimisation": self._network.solver or "off",
        }

    @property
    def config(self) -> UniADConfig:
        """Configuration of the network."""
        return self._network.config

    def reset(self, scene: SceneInfo) -> None:
        """Forget the previous scene."""
        super().reset(scene)
        self.seen = None

    def inputs(self, observation: Observation) -> UniADInputs:
        """Inputs of the network for a sample: images on the planner's device, the rest on the processor."""
        images = camera_images(observation, self._format, self._normalisation)
        global_T_lidar = torch.from_numpy(lidar_pose(observation))
        return UniADInputs(
            images=torch.from_numpy(images).to(self._device),
            lidar2img=torch.from_numpy(lidar_to_image(observation, self._format)),
            can_bus=torch.from_numpy(can_bus_vector(observation.ego, after=self.reads_message_after)),
            l2g_r_mat=global_T_lidar[:3, :3].T.float(),
            l2g_t=global_T_lidar[:3, 3].float(),
            timestamp=observation.timestamp_us / 1e6,
            command=int(observation.command),
            scene_token=observation.scene,
        )

    def _compute_plan(self, observation: Observation) -> Plan:
        self.seen = self._network(self.inputs(observation))
        return _plan(self.seen, self._reporting)


def example_frame(config: UniADConfig) -> UniADInputs:
    """Made-up inputs of one key frame, the same every time."""
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


def _plan(outputs: UniADOutputs, reporting: ReportingRules) -> Plan:
    planned = [outputs.plan_before_optimisation, outputs.plan][: 1 if outputs.collision is None else 2]
    return Plan(
        waypoints=to_array(outputs.plan),
        frame=PlanFrame.LIDAR,
        modes=to_array(torch.stack(planned)),
        forecasts=select_forecasts(
            outputs.boxes, outputs.box_scores, outputs.trajectories, outputs.trajectory_scores, reporting
        ),
    )
