"""How UniAD learns from clips: tracks follow the annotated agents, and every head has its loss."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor, nn

from adapters.extensions.training.dense_targets import dense_loss
from adapters.extensions.training.frames import TrainingFrame, mask_ego_status, rotate_can_bus
from adapters.extensions.training.front import mean_front_losses
from adapters.extensions.training.losses import Matches, lateral_loss, plan_loss
from adapters.extensions.training.plan_room import agent_constraint, boundary_constraint, room_loss
from adapters.extensions.training.uniad.losses import (
    AgentTargets,
    MapTargets,
    box_targets,
    detection_losses,
    ego_box,
    forecast_losses,
    map_losses,
    match_agents,
    match_elements,
    network_inputs,
    occupancy_loss,
    occupancy_targets,
)
from adapters.networks.layers.ego_motion import BEVMotion
from adapters.networks.layers.front_reader import FRONT
from adapters.networks.uniad.model import UniAD, UniADMemory
from adapters.networks.uniad.motion import MotionForecasts
from adapters.networks.uniad.planning import UniADInputs, UniADPlan
from adapters.networks.uniad.tracking import NO_TRACK, Boxes, Detections, Instances, Pose, decode_instances

TrainingStage = Literal["perception", "all"]
"""``perception``: tracks and map. ``all``: forecasts, occupancy and plan too."""
PLAN_WEIGHT, ASIDE_WEIGHT, CONSTRAINT_WEIGHT, ROOM_WEIGHT = 1.5, 6.0, 0.4, 3.0
DENSE_WEIGHT = 6.0
TRACK_DROPOUT = 0.1
"""Share of tracks that are dropped between frames, so that their agents are found anew."""
FALSE_FROM = 0.25
"""Confidence above which an unmatched query is passed on as a track, as it would be when the network runs
(the published training draws some of them, ``fp_ratio``)."""
MOST_FALSE = 12
"""Of them, the most certain."""
FROZEN = ("img_backbone.conv1", "img_backbone.bn1", "img_backbone.layer1", "img_backbone.layer2")
"""Parts frozen after pre-training: their gradients would be half of a frame's cost."""
BEV_MODULES = (
    "img_backbone",
    "img_neck",
    "pts_bbox_head.bev_embedding",
    "pts_bbox_head.positional_encoding",
    "pts_bbox_head.transformer.encoder",
    "pts_bbox_head.transformer.can_bus_mlp",
    "pts_bbox_head.transformer.level_embeds",
    "pts_bbox_head.transformer.cams_embeds",
)
"""Modules that make the bird's-eye view."""
MOST_FORECAST = 8
"""Agents of a frame whose forecasts are learned."""
OCCUPANCY_SHARE = 0.6
"""Of clips, in which the occupancy is learned; it is the dearest head."""
MOST_OCCUPYING = 8
"""Vehicles of a frame whose occupancy is learned."""


@dataclass(frozen=True, slots=True)
class FrameFeatures:
    """(cells, C) bird's-eye view, (1, C, h, w) finest front map, and (18,) float32 ego motion as far as it is told."""

    bev: Tensor
    finest_front: Tensor
    can_bus: Tensor


class UniADObjective:
    """`frames.Objective` of UniAD; drawn numbers are of PyTorch's generator.

    `network` stays as in inference but for the normalisation of the occupancy, which learns. Gradients pass through
    the last `learned_frames` of a clip; earlier ones only leave a past. In a share `unaware` of the clips the network
    is not told how the ego moves, so that it looks. The bird's-eye view has to say what stands where only if
    `view_learns`.
    """

    def __init__(
        self,
        network: UniAD,
        stage: TrainingStage = "all",
        clip_frames: int = 2,
        learned_frames: int | None = None,
        unaware: float = 1 / 3,
        *,
        sees_already: bool = False,
    ) -> None:
        self.unaware, self.view_learns = unaware, not sees_already
        self.network, self.stage, self.clip_frames = network, stage, clip_frames
        self.learned_frames = clip_frames if learned_frames is None else learned_frames
        for name, parameter in network.named_parameters():
            if name.startswith(BEV_MODULES):
                parameter.requires_grad_(not sees_already and not name.startswith(FROZEN))

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """Weighted losses of a clip; the map and all that follows from it are learned from its last frame."""
        turn, aware = torch.rand(2).tolist()
        return self.clip_losses(clip, 2 * math.pi * turn, aware >= self.unaware)

    def clip_losses(self, clip: Sequence[TrainingFrame], turn_rad: float, aware: bool) -> dict[str, Tensor]:
        """Losses of a clip whose world is turned by `turn_rad` under the ego: no image shows where north is.

        Unless `aware`, the network is not told how the ego moves; its past view is aligned all the same.
        """
        network = self.network
        if network.training:
            network.eval()
        inputs = [network_inputs(frame) for frame in clip]
        inputs = [replace(entry, can_bus=rotate_can_bus(entry.can_bus, turn_rad)) for entry in inputs]
        views = self._encode_frames(inputs, aware)
        past: UniADMemory | None = None
        learned_losses: list[dict[str, Tensor]] = []
        for number, (frame, frame_inputs) in enumerate(zip(clip, inputs, strict=True)):
            learned = number >= self._first_learned_frame(len(clip))
            with torch.set_grad_enabled(learned):
                past, losses = self._frame(frame, frame_inputs, next(views), past, last=number == len(clip) - 1)
            if learned:
                learned_losses.append(losses)
        return {
            name: torch.stack([entry[name] for entry in learned_losses if name in entry]).mean()
            for name in learned_losses[-1]
        }

    def _first_learned_frame(self, frames: int) -> int:
        """The first frame of a clip with gradients."""
        return max(frames - self.learned_frames, 0)

    def _encode_frames(self, inputs: Sequence[UniADInputs], aware: bool) -> Iterator[FrameFeatures]:
        """Views of the frames of a clip, one after the other; the images of those with gradients together."""
        network, config = self.network, self.network.config
        learned = self._first_learned_frame(len(inputs))
        previous: Tensor | None = None
        maps: list[Tensor] = []
        for number, current in enumerate(inputs):
            if number in (0, learned):
                batch = inputs[number : learned if number < learned else len(inputs)]
                images = torch.cat([frame_inputs.images for frame_inputs in batch])
                maps = network.img_neck(network.img_backbone(images.contiguous(memory_format=torch.channels_last)))
            place = number - (learned if number >= learned else 0)
            frame_maps = [level[place * config.cameras : (place + 1) * config.cameras] for level in maps]
            previous_can_bus = inputs[number - 1].can_bus if number else None
            motion = BEVMotion.between(previous_can_bus, current.can_bus, config.grid, config.rotation_centre)
            motion = motion.to(current.images.device)
            if not aware:
                motion = mask_ego_status(motion)
            previous = network.pts_bbox_head.encode(
                frame_maps, current.images, current.lidar2img.float(), motion, previous
            )
            yield FrameFeatures(previous, frame_maps[0][FRONT : FRONT + 1], motion.can_bus)

    def _frame(
        self, frame: TrainingFrame, inputs: UniADInputs, view: FrameFeatures, past: UniADMemory | None, *, last: bool
    ) -> tuple[UniADMemory, dict[str, Tensor]]:
        network, config, bev = self.network, self.network.config, view.bev
        pose = Pose.of(inputs.l2g_r_mat, inputs.l2g_t, inputs.timestamp, bev.device)
        entering, _ = network.entering_queries(past, pose)
        detections = network.pts_bbox_head.detect(bev, entering.queries, entering.reference_logits)
        agents = AgentTargets.of(frame, config)
        matches = match_agents(detections, agents, entering.track_ids[config.queries + 1 :], config.queries)
        ego_codes = box_targets(ego_box(frame), config)
        losses = detection_losses(detections, agents, matches, ego_codes, config.queries)
        if self.view_learns:
            losses["dense"] = dense_loss(bev, frame, config.grid, DENSE_WEIGHT)
        instances = _assign_track_ids(entering, detections, agents, matches)
        memory = UniADMemory(frame.scene, bev, self._next_queries(instances, matches), pose)
        if last:
            losses |= self._map_and_plan_losses(frame, view, instances, agents, matches)
        return memory, losses

    def _next_queries(self, instances: Instances, matches: Matches) -> Instances:
        """Queries of the next frame: fresh ones, tracks of most of the agents, and tracks of none."""
        network = self.network
        surviving = matches.queries[torch.rand(len(matches.queries)) >= TRACK_DROPOUT]
        surviving = torch.cat([surviving, self._false_tracks(instances, matches)])
        return network.fresh_queries().then(network.query_interact(network.memory_bank(instances).kept(surviving)))

    def _false_tracks(self, instances: Instances, matches: Matches) -> Tensor:
        """Fresh queries and tracks that stand for no agent and would be tracks all the same: to be given up."""
        scores = instances.scores.detach().index_fill(0, matches.queries, 0.0)
        scores[self.network.config.queries] = 0.0
        count = min(int((scores >= FALSE_FROM).sum()), MOST_FALSE)
        return scores.topk(count).indices

    def _map_and_plan_losses(
        self,
        frame: TrainingFrame,
        view: FrameFeatures,
        instances: Instances,
        agents: AgentTargets,
        matches: Matches,
    ) -> dict[str, Tensor]:
        network, config, bev = self.network, self.network.config, view.bev
        elements = network.seg_head(bev)
        road = MapTargets.of(frame, config)
        lines = match_elements(elements, road)
        head = network.seg_head
        contents, positions = head.stuff_query.weight.chunk(2, -1)
        masks = elements.cells.new_zeros(0, len(elements.cells))
        if len(lines.queries):
            masks = head.things_mask_head(elements.queries[lines.queries], None, elements.cells)
        losses = map_losses(elements, road, lines, masks, head.stuff_mask_head(contents, positions, elements.cells))
        if self.stage == "perception":
            return losses
        nearest = agents.boxes[matches.wanted, :2].norm(dim=-1).argsort()[:MOST_FORECAST]
        agent_rows = matches.wanted[nearest]
        tracks = decode_instances(instances.kept(matches.queries[nearest]))
        ego = decode_instances(instances.kept(slice(config.queries, config.queries + 1)))
        forecasts = network.motion_head(tracks.then(ego), elements, bev)
        losses |= forecast_losses(forecasts, *_futures(frame, agents, agent_rows))
        plan = network.planning_head(
            bev,
            network.pts_bbox_head.positional_encoding(),
            forecasts.queries[-1, -1],
            ego.states[0],
            frame.command,
            view.finest_front,
            view.can_bus,
        )
        losses |= plan_losses(plan, frame)
        return losses | self._occupancy_losses(bev, tracks, agents, agent_rows, forecasts)

    def _occupancy_losses(
        self, bev: Tensor, tracks: Boxes, agents: AgentTargets, agent_rows: Tensor, forecasts: MotionForecasts
    ) -> dict[str, Tensor]:
        network, config = self.network, self.network.config
        vehicles = network.vehicle_classes[agents.labels[agent_rows]].nonzero()[:MOST_OCCUPYING, 0]
        if len(vehicles) == 0 or float(torch.rand(())) >= OCCUPANCY_SHARE:
            return {"occupancy": bev.sum() * 0}
        for module in network.occ_head.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.train()
        occupancy = network.occ_head(
            bev,
            forecasts.queries[-1, :-1][vehicles],
            tracks.states[vehicles],
            forecasts.positions[:-1][vehicles],
            tracks.scores[vehicles],
        )
        return {"occupancy": occupancy_loss(occupancy, *occupancy_targets(agents, agent_rows[vehicles], config))}


def _assign_track_ids(entering: Instances, detections: Detections, agents: AgentTargets, matches: Matches) -> Instances:
    """Instances after the decoder; who stands for an agent has its number as a track."""
    ids = torch.full_like(entering.track_ids, NO_TRACK)
    ids[matches.queries] = agents.instances[matches.wanted]
    logits = detections.class_logits[-1]
    return replace(
        entering,
        reference_logits=detections.reference_logits,
        track_ids=ids,
        class_logits=logits,
        box_codes=detections.box_codes[-1],
        states=detections.states[-1],
        scores=logits.sigmoid().amax(-1),
    )


def plan_losses(plan: UniADPlan, frame: TrainingFrame) -> dict[str, Tensor]:
    """Weighted losses of a plan, before it is moved, and of what it read in the front camera."""
    points, future, valid = plan.positions_m, frame.ego_future, frame.ego_future_valid
    losses = {
        "plan": PLAN_WEIGHT * plan_loss(points, future, valid),
        "plan aside": ASIDE_WEIGHT * lateral_loss(points[:, 0], future[:, 0], valid),
        "plan agents": CONSTRAINT_WEIGHT * agent_constraint(points, frame),
        "plan boundary": CONSTRAINT_WEIGHT * boundary_constraint(points, frame),
        "plan room": ROOM_WEIGHT * room_loss(points, frame),
    }
    return losses if plan.front is None else losses | mean_front_losses(plan.front, [frame])


def _futures(frame: TrainingFrame, agents: AgentTargets, agent_rows: Tensor) -> tuple[Tensor, Tensor]:
    """(A + 1, steps, 2) and (A + 1, steps): where agents and then the ego go, and whether that is known."""
    offsets = agents.futures[agent_rows][..., :2] - agents.boxes[agent_rows][:, None, :2]
    rest = offsets.shape[1] - len(frame.ego_future)
    ego_future = torch.cat([frame.ego_future, frame.ego_future.new_zeros(rest, 2)])[None]
    known = torch.cat([frame.ego_future_valid, frame.ego_future_valid.new_zeros(rest)])[None]
    return torch.cat([offsets, ego_future]), torch.cat([agents.futures_valid[agent_rows], known])
