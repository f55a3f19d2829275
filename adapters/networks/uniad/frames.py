"""What UniAD is given for one key frame, everything that it computes, and what it reports."""

from dataclasses import dataclass

from torch import Tensor

from adapters.networks.uniad.bev import Detections
from adapters.networks.uniad.collision_optimiser import MovedPlan
from adapters.networks.uniad.map_head import MapElements
from adapters.networks.uniad.map_masks import RoadMap
from adapters.networks.uniad.motion import Forecasts
from adapters.networks.uniad.occupancy import Occupancy
from adapters.networks.uniad.planning import UniADPlan
from adapters.networks.uniad.tracking import Boxes, Instances


@dataclass(frozen=True, slots=True)
class UniADInputs:
    """One key frame.

    Attributes:
        images: (6, 3, H, W), normalised and padded; front, front right, front left, back, back left, back right.
        lidar2img: (6, 4, 4), lidar frame in metres to pixels of the padded images.
        can_bus: (18,) float64, absolute, as the data set gives it.
        l2g_r_mat: (3, 3), for rows: global = lidar @ l2g_r_mat + l2g_t.
        l2g_t: (3,) metres.
        timestamp: Seconds.
        command: 0 right, 1 left, 2 straight.
        scene_token: A change forgets the past, but for what `UniAD.reset` says.
    """

    images: Tensor
    lidar2img: Tensor
    can_bus: Tensor
    l2g_r_mat: Tensor
    l2g_t: Tensor
    timestamp: float
    command: int
    scene_token: str


@dataclass(frozen=True, slots=True)
class UniADOutputs:
    """Outputs for one key frame; lidar frame, x right, y forward, metres and radians.

    Attributes:
        plan: (6, 2) float32 positions of the lidar origin 0.5 s to 3 s ahead.
        plan_before_optimisation: (6, 2) the same before it is moved away from occupied cells.
        collision: How it was moved; ``None`` if that is switched off.
        boxes: (N, 9) centre x, y, z, width, length, height, yaw, velocity x, y of tracks. Yaw is that of the heading,
            counter-clockwise from the x axis; length lies along it.
        box_scores: (N,) 0 to 1, falling.
        box_labels: (N,) index into `benchmark.constants.DETECTION_CLASSES`.
        track_ids: (N,) the same for the same agent from frame to frame.
        trajectories: (N, 6 modes, 12 steps, 2) forecast centres 0.5 s to 6 s ahead.
        trajectory_scores: (N, 6) probabilities of the modes, sum 1.
        occupied: (5, 200, 200) booleans, now and every 0.5 s, as `adapters.networks.uniad.occupancy.Occupancy`.
        road: Masks of map elements and of the drivable area; ``None`` if they are switched off.
    """

    plan: Tensor
    plan_before_optimisation: Tensor
    collision: MovedPlan | None
    boxes: Tensor
    box_scores: Tensor
    box_labels: Tensor
    track_ids: Tensor
    trajectories: Tensor
    trajectory_scores: Tensor
    occupied: Tensor
    road: RoadMap | None


@dataclass(frozen=True, slots=True)
class UniADPredictions:
    """Everything that the network computes for one key frame.

    Attributes:
        bev: (cells, C) bird's-eye view.
        moved_references: (T, 3) where the T tracks were expected, logits of shares of the perception range.
        entering: Queries that went into the decoder.
        detections: What it made of them.
        after: The same instances after the life cycle and the memory.
        next_instances: Queries of the next key frame.
        tracks: The N that are reported, falling scores.
        ego: The ego as a track, one.
        elements: Of the map.
        forecasts: For the tracks and then the ego.
        vehicles: (N,) which tracks the occupancy is of.
        occupancy: Of these.
        plan: Before it is moved away from occupied cells.
    """

    bev: Tensor
    moved_references: Tensor
    entering: Instances
    detections: Detections
    after: Instances
    next_instances: Instances
    tracks: Boxes
    ego: Boxes
    elements: MapElements
    forecasts: Forecasts
    vehicles: Tensor
    occupancy: Occupancy
    plan: UniADPlan
