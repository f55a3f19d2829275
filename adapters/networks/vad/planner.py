"""``vad-tiny`` and ``vad-base`` under test: from an observation to the network's inputs, from its outputs to a plan."""

import torch

from adapters.camera_inputs import camera_images, can_bus_vector, lidar_to_image
from adapters.networks.example_inputs import example_images, example_projections
from adapters.networks.layers.reporting import ReportingRules
from adapters.networks.vad.config import VADConfig
from adapters.networks.vad.model import VAD, VADInputs
from adapters.networks.vad.selection import VADOutputs
from adapters.planner import NativePlanner, select_forecasts, to_array
from benchmark.planning import Command, Observation, Plan, PlanFrame


class VADPlanner(NativePlanner[VAD]):
    """VAD with given weights; arguments and errors as in `NativePlanner`."""

    def _compute_plan(self, observation: Observation) -> Plan:
        return _plan(self._network(self._inputs(observation)), self._reporting)

    def _inputs(self, observation: Observation) -> VADInputs:
        images = camera_images(observation, self._format, self._normalisation)
        return VADInputs(
            images=torch.from_numpy(images).to(self._device),
            lidar2img=torch.from_numpy(lidar_to_image(observation, self._format)),
            can_bus=torch.from_numpy(can_bus_vector(observation.ego, after=self.reads_message_after)),
            command=int(observation.command),
            scene_token=observation.scene,
        )


def example_frame(config: VADConfig) -> VADInputs:
    """Made-up inputs of one key frame, the same every time."""
    image_format = config.image_format
    return VADInputs(
        images=torch.from_numpy(example_images(image_format)),
        lidar2img=torch.from_numpy(example_projections(image_format)),
        can_bus=torch.zeros(18, dtype=torch.float64),
        command=int(Command.STRAIGHT),
        scene_token="example",
    )


def _plan(outputs: VADOutputs, reporting: ReportingRules) -> Plan:
    return Plan(
        waypoints=to_array(outputs.plan),
        frame=PlanFrame.LIDAR,
        modes=to_array(outputs.plan_modes),
        forecasts=select_forecasts(
            outputs.boxes, outputs.box_scores, outputs.trajectories, outputs.trajectory_scores, reporting
        ),
    )
