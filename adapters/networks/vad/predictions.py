"""Everything that a VAD network computes for one key frame, before selection."""

from dataclasses import dataclass

from torch import Tensor


@dataclass(frozen=True, slots=True)
class VADPredictions:
    """Raw predictions; K decoder layers, A agents, M map elements of P points, C channels.

    Positions "as shares" are 0 to 1 over the perception range; metres are in the lidar frame.

    Attributes:
        bev: (cells, C) bird's-eye view, which is also what the next frame remembers.
        agent_states: (K, A, C).
        agent_first_references: (A, 3) as shares.
        agent_references: (K, A, 3) as shares.
        class_logits: (K, A, classes).
        box_codes: (K, A, 10) as `adapters.networks.layers.coders.box_codes`, x, y, z in metres.
        mode_offsets: (A, modes, steps, 2) metres from step to step.
        mode_logits: (A, modes).
        map_states: (K, M * P, C).
        map_first_references: (M * P, 2) as shares.
        map_references: (K, M * P, 2) as shares.
        map_class_logits: (K, M, map classes).
        map_extents: (K, M, 4) centre x, y, width, height as shares.
        map_points: (K, M, P, 2) as shares.
        plan_offsets: (commands, steps, 2) metres from step to step.
        front: (1, numbers) what the plan takes from the front camera, where it does.
    """

    bev: Tensor
    agent_states: Tensor
    agent_first_references: Tensor
    agent_references: Tensor
    class_logits: Tensor
    box_codes: Tensor
    mode_offsets: Tensor
    mode_logits: Tensor
    map_states: Tensor
    map_first_references: Tensor
    map_references: Tensor
    map_class_logits: Tensor
    map_extents: Tensor
    map_points: Tensor
    plan_offsets: Tensor
    front: Tensor | None = None


@dataclass(frozen=True, slots=True)
class VADSights:
    """Inputs of the forecasts and the plan of one key frame.

    Attributes:
        agent_states: (A, C) after the last layer.
        agent_places: (A, 2) as shares.
        map_states: (M * P, C) after the last layer.
        map_points: (M, P, 2) as shares.
        map_scores: (M,) of the most likely class.
        finest_front: (1, C, h, w) feature map of the front camera that the plan looks at.
        can_bus: (18,) float32, as `adapters.networks.layers.ego_motion.EgoMotion` has it.
        front_before: (1, numbers) what the frames before have left of what their plans took from the front camera.
    """

    agent_states: Tensor
    agent_places: Tensor
    map_states: Tensor
    map_points: Tensor
    map_scores: Tensor
    finest_front: Tensor
    can_bus: Tensor
    front_before: Tensor | None = None


@dataclass(frozen=True, slots=True)
class VADOutlook:
    """Forecasts and plan; the attributes are those of `VADPredictions`."""

    mode_offsets: Tensor
    mode_logits: Tensor
    plan_offsets: Tensor
    front: Tensor | None
