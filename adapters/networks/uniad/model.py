"""UniAD: six images, camera matrices and motion in; a plan, tracks, forecasts, occupancy and a road map out."""

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from adapters.networks.layers.ego_motion import CAN_BUS, BEVMotion
from adapters.networks.layers.front_reader import FRONT
from adapters.networks.layers.resnet import EXPANSION, FeaturePyramid, ResNet
from adapters.networks.uniad.collision_optimiser import MovedPlan, Solver, move_plan
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.map_head import MapHead, MapMasks
from adapters.networks.uniad.map_masks import PastedMasks, paste_masks, rank_masks
from adapters.networks.uniad.motion import MotionHead
from adapters.networks.uniad.occupancy import OccupancyHead
from adapters.networks.uniad.planning import PlanningHead, UniADInputs, UniADOutputs, UniADPredictions
from adapters.networks.uniad.track_memory import MemoryBank, QueryInteraction
from adapters.networks.uniad.tracking import (
    DetectionHead,
    Instances,
    Pose,
    convert_yaws,
    decode_instances,
    move_references,
    select_tracks,
    update_tracks,
)

__all__ = ["UniAD", "UniADInputs", "UniADOutputs"]

VEHICLE_CLASSES = (0, 1, 2, 3, 4, 6, 7)
"""Classes of the occupancy: all but barriers, pedestrians and cones."""


@dataclass(frozen=True, slots=True)
class UniADMemory:
    """Memory of a frame for the next one of its scene."""

    scene_token: str
    bev: Tensor
    instances: Instances
    pose: Pose


class LossWeights(nn.Module):
    """Weights of training losses; nothing reads them here, but published checkpoints hold them."""

    def __init__(self) -> None:
        super().__init__()
        self.code_weights = nn.Parameter(torch.tensor([1.0] * 8 + [0.2] * 2), requires_grad=False)


class UniAD(nn.Module):
    """The network and its memory; call it under ``torch.inference_mode()``, frame after frame.

    `anchors` are (4, 6, 12, 2) of ``motion_anchor_infos_mode6.pkl``; `MotionHead.load_anchors` sets them later. With
    `stores_anchors` they are part of the state dict; official checkpoints come without. Without a `solver` plans are
    not moved away from occupied cells.
    """

    vehicle_classes: Tensor

    def __init__(
        self,
        config: UniADConfig,
        anchors: Tensor | None = None,
        solver: Solver | None = "newton",
        masks: bool = False,
        *,
        stores_anchors: bool = False,
    ) -> None:
        super().__init__()
        self.config, self.solver, self.masks = config, solver, masks
        channels = config.channels
        self.pts_bbox_head = DetectionHead(config)
        self.img_backbone = ResNet(
            config.backbone_blocks,
            config.backbone_outputs,
            config.backbone_width,
            config.backbone_style,
            config.deformable_stages,
        )
        widths = [config.backbone_width * EXPANSION * 2**stage for stage in config.backbone_outputs]
        self.img_neck = FeaturePyramid(widths, channels, config.pyramid_levels)
        self.query_embedding = nn.Embedding(config.queries + 1, 2 * channels)
        self.reference_points = nn.Linear(channels, 3)
        self.query_interact = QueryInteraction(channels, config.heads)
        self.memory_bank = MemoryBank(channels, config.heads)
        self.criterion = LossWeights()
        self.seg_head = MapHead(config)
        self.occ_head = OccupancyHead(config)
        self.motion_head = MotionHead(config, anchors, stores_anchors=stores_anchors)
        self.planning_head = PlanningHead(config)
        vehicles = torch.tensor([label in VEHICLE_CLASSES for label in range(config.agent_classes)])
        self.register_buffer("vehicle_classes", vehicles, persistent=False)
        self.reset()
        self.eval()

    def reset(self) -> None:
        """Forget everything.

        A new scene alone forgets less, as in the published code: track numbers go on, and the ego's motion is measured
        from the last key frame of the old one (in the very first frame, from the origin).
        """
        self._memory: UniADMemory | None = None
        self._can_bus = torch.zeros(CAN_BUS, dtype=torch.float64)
        self._next_id = torch.zeros((), dtype=torch.int64)

    def forward(self, inputs: UniADInputs) -> UniADOutputs:
        """Outputs for a scene's next key frame; absent anchors, or casadi asked for but absent, are an `InputError`."""
        predictions = self.predict(inputs)
        tracks, unoptimised = predictions.tracks, predictions.plan.positions_m
        moved, plan, road = None, unoptimised, None
        if self.solver is not None:
            moved = self.collision_free(predictions, self.solver)
            plan = torch.from_numpy(moved.points).to(unoptimised)
        if self.masks:
            road = self.road(self.seg_head.masks(predictions.elements))
        count = len(tracks.scores)
        offsets = predictions.forecasts.trajectories[-1, :count, ..., :2]
        heading = convert_yaws(tracks.boxes[:, 6:7], self.config)
        return UniADOutputs(
            plan=plan,
            plan_before_optimisation=unoptimised,
            collision=moved,
            boxes=torch.cat([tracks.boxes[:, :6], heading, tracks.boxes[:, 7:]], 1),
            box_scores=tracks.scores,
            box_labels=tracks.labels,
            track_ids=tracks.track_ids,
            trajectories=tracks.boxes[:, None, None, :2] + offsets,
            trajectory_scores=predictions.forecasts.log_probabilities[-1, :count].exp(),
            occupied=predictions.occupancy.occupied,
            road=road,
        )

    def collision_free(self, predictions: UniADPredictions, solver: Solver) -> MovedPlan:
        """The plan of a frame, moved away from the cells that will be occupied."""
        return move_plan(
            predictions.plan.positions_m.double().cpu().numpy(), predictions.occupancy.occupied.cpu().numpy(), solver
        )

    def road(self, masks: MapMasks) -> PastedMasks:
        """Masks that share the ground."""
        scores, order = rank_masks(masks.values, masks.scores)
        classes = self.config.map_classes
        return paste_masks(masks.values, scores, order, masks.labels, masks.drivable_values, classes)

    def predict(self, inputs: UniADInputs) -> UniADPredictions:
        """Predictions for one key frame up to the plan; it is remembered."""
        memory = self._memory if self._memory and self._memory.scene_token == inputs.scene_token else None
        device = inputs.images.device
        pose = Pose.of(inputs.l2g_r_mat, inputs.l2g_t, inputs.timestamp, device)
        motion = self.ego_motion(inputs).to(device)
        projections = inputs.lidar2img.to(device, torch.float32)
        maps = self.img_neck(self.img_backbone(inputs.images))
        bev = self.pts_bbox_head.encode(maps, inputs.images, projections, motion, memory.bev if memory else None)

        entering, moved = self.entering_queries(memory, pose)
        detections = self.pts_bbox_head.detect(bev, entering.queries, entering.reference_logits)
        fresh = self.config.queries + 1
        instances, next_id = update_tracks(entering, detections, fresh, self._next_id.to(device), self.config)
        chosen = select_tracks(instances, self.vehicle_classes, self.config)
        tracks = decode_instances(instances.kept(chosen.reported))
        ego = decode_instances(instances.kept(slice(fresh - 1, fresh)))
        after = self.memory_bank(instances)
        surviving = self.query_interact(after.kept(chosen.surviving))
        next_instances = self.fresh_queries().then(surviving)

        elements = self.seg_head(bev)
        forecasts = self.motion_head(tracks.then(ego), elements, bev)
        vehicles = chosen.vehicles
        occupancy = self.occ_head(
            bev,
            forecasts.queries[-1, :-1][vehicles],
            tracks.states[vehicles],
            forecasts.positions[:-1][vehicles],
            tracks.scores[vehicles],
        )
        plan = self.planning_head(
            bev,
            self.pts_bbox_head.positional_encoding(),
            forecasts.queries[-1, -1],
            ego.states[0],
            inputs.command,
            maps[0][FRONT : FRONT + 1],
            motion.can_bus,
        )
        self._memory = UniADMemory(inputs.scene_token, bev, next_instances, pose)
        self._can_bus = inputs.can_bus.detach().to("cpu", torch.float64, copy=True)
        self._next_id = next_id
        return UniADPredictions(
            bev=bev,
            moved_references=moved,
            entering=entering,
            detections=detections,
            after=after,
            next_instances=next_instances,
            tracks=tracks,
            ego=ego,
            elements=elements,
            forecasts=forecasts,
            vehicles=self.vehicle_classes[tracks.labels],
            occupancy=occupancy,
            plan=plan,
        )

    def ego_motion(self, inputs: UniADInputs) -> BEVMotion:
        """Motion of the ego since the last frame, whichever scene that was of if the network was trained so."""
        config = self.config
        follows = self._memory is not None and self._memory.scene_token == inputs.scene_token
        known = follows or config.motion_across_scenes
        return BEVMotion.between(self._can_bus if known else None, inputs.can_bus, config.grid, config.rotation_centre)

    def fresh_queries(self) -> Instances:
        """Queries that know nothing, the last of which is the ego's."""
        queries = self.query_embedding.weight
        return Instances.fresh(self.config, queries, self.reference_points(queries.chunk(2, -1)[0]))

    def entering_queries(self, memory: UniADMemory | None, pose: Pose) -> tuple[Instances, Tensor]:
        """Queries for the decoder: fresh ones, and tracks where they would be now; and these places, (T, 3) logits."""
        if memory is None:
            fresh = self.fresh_queries()
            return fresh, fresh.reference_logits[:0]
        previous, count = memory.instances, self.config.queries + 1
        tracks = previous.kept(slice(count, None))
        moved = move_references(tracks, memory.pose, pose, self.config)
        # The published network drops the heights of tracks.
        heights = self.reference_points(tracks.queries.chunk(2, -1)[0]).float()[:, 2:]
        references = torch.cat([previous.reference_logits[:count], torch.cat([moved[:, :2], heights], -1)])
        return replace(previous, reference_logits=references), moved
