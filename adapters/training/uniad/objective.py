"""How UniAD learns from clips: tracks follow the annotated agents, and every head has its loss."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import torch
from torch import Tensor

from adapters.networks.layers.ego_motion import EgoMotion
from adapters.networks.layers.front_reader import FRONT
from adapters.networks.uniad.bev import Detections
from adapters.networks.uniad.frames import UniADInputs
from adapters.networks.uniad.model import Memory, UniAD
from adapters.networks.uniad.motion import Forecasts
from adapters.networks.uniad.planning import UniADPlan
from adapters.networks.uniad.tracking import NO_TRACK, Boxes, Instances, Pose, decoded
from adapters.training.dense_targets import dense_loss
from adapters.training.frames import TrainingFrame
from adapters.training.front import mean_front_losses
from adapters.training.losses import Matches, aside_loss, plan_loss
from adapters.training.phases import Phase
from adapters.training.plan_constraints import agent_constraint, boundary_constraint
from adapters.training.trainer import Recipe
from adapters.training.turned_worlds import turned_can_bus, untold
from adapters.training.uniad.losses import (
    detection_losses,
    forecast_losses,
    map_losses,
    matched_agents,
    matched_elements,
    occupancy_loss,
)
from adapters.training.uniad.targets import (
    Agents,
    Road,
    box_targets,
    ego_box,
    network_inputs,
    occupancy_targets,
)

Stage = Literal["perception", "all"]
"""``perception``: tracks and map. ``all``: forecasts, occupancy and plan too."""
PLAN_WEIGHT, ASIDE_WEIGHT, CONSTRAINT_WEIGHT = 1.5, 6.0, 0.4
DENSE_WEIGHT = 6.0
LOST = 0.1
"""Share of tracks that are dropped between frames, so that their agents are found anew."""
FALSE_TRACKS = 0.3
"""For each track that is handed on, how often one that follows nothing, or what another follows, is as well (UniAD's
``fp_ratio``)."""
FROZEN = ("img_backbone.conv1", "img_backbone.bn1", "img_backbone.layer1", "img_backbone.layer2")
"""What stays as the pre-training left it: half of a frame's cost would be its gradients."""
SEES = (
    "img_backbone",
    "img_neck",
    "pts_bbox_head.bev_embedding",
    "pts_bbox_head.positional_encoding",
    "pts_bbox_head.transformer.encoder",
    "pts_bbox_head.transformer.can_bus_mlp",
    "pts_bbox_head.transformer.level_embeds",
    "pts_bbox_head.transformer.cams_embeds",
)
"""What the bird's-eye view is made with."""
MOST_FORECAST = 8
"""Agents of a frame whose forecasts are learned."""
OCCUPANCY_SHARE = 0.3
"""Of clips, in which the occupancy is learned; it is the dearest head."""
MOST_OCCUPYING = 6
"""Vehicles of a frame whose occupancy is learned."""


@dataclass(frozen=True, slots=True)
class _Past:
    """What a frame of a clip leaves for the next."""

    memory: Memory
    can_bus: Tensor


class UniADObjective:
    """An objective as `adapters.training.frames.Objective` describes; drawn numbers are of PyTorch's generator.

    Attributes:
        network: What learns. It stays as in inference: no dropout, normalisation as stored.
        clip_frames: Frames of a clip.
        learned_frames: The last frames of a clip, through which gradients pass; earlier ones only leave a past.
        unaware: Share of clips in which the network is not told how the ego moves, so that it looks.
        stage: What is learned.

    Args:
        sees_already: Whether what makes the bird's-eye view stays as it is.
    """

    def __init__(
        self,
        network: UniAD,
        stage: Stage = "all",
        clip_frames: int = 2,
        learned_frames: int | None = None,
        unaware: float = 1 / 3,
        *,
        sees_already: bool = False,
    ) -> None:
        self.unaware = unaware
        self.network, self.stage, self.clip_frames = network, stage, clip_frames
        self.learned_frames = clip_frames if learned_frames is None else learned_frames
        for name, parameter in network.named_parameters():
            if name.startswith(SEES):
                parameter.requires_grad_(not sees_already and not name.startswith(FROZEN))

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """Losses of a clip; the map and all that follows from it are learned from its last frame.

        Args:
            clip: Consecutive key frames of one scene.

        Returns:
            Weighted scalars by name.

        Raises:
            InputError: If predictions are not finite.
        """
        turn, aware = torch.rand(2).tolist()
        return self.clip_losses(clip, 2 * math.pi * turn, aware >= self.unaware)

    def clip_losses(self, clip: Sequence[TrainingFrame], turn_rad: float, aware: bool) -> dict[str, Tensor]:
        """As `losses`, with what is drawn there.

        Args:
            clip: Consecutive key frames of one scene.
            turn_rad: By how much the world is turned under the ego: no image shows where north is.
            aware: Whether the network is told how the ego moves. Its past view is aligned all the same.

        Returns:
            Weighted scalars by name.

        Raises:
            InputError: If predictions are not finite.
        """
        network, cameras = self.network, self.network.config.cameras
        if network.training:
            network.eval()
        inputs = [network_inputs(frame) for frame in clip]
        inputs = [replace(each, can_bus=turned_can_bus(each.can_bus, turn_rad)) for each in inputs]
        past: _Past | None = None
        found: list[dict[str, Tensor]] = []
        for first, end in self._parts(len(clip)):
            with torch.set_grad_enabled(end == len(clip)):
                images = torch.cat([each.images for each in inputs[first:end]])
                maps = network.img_neck(network.img_backbone(images.contiguous(memory_format=torch.channels_last)))
                for number in range(first, end):
                    place = slice((number - first) * cameras, (number - first + 1) * cameras)
                    own = [level[place] for level in maps]
                    last = number == len(clip) - 1
                    past, losses = self._frame(clip[number], inputs[number], own, past, aware, last=last)
                    if end == len(clip):
                        found.append(losses)
        return {name: torch.stack([each[name] for each in found if name in each]).mean() for name in found[-1]}

    def _parts(self, frames: int) -> list[tuple[int, int]]:
        """First and end of the frames without and of those with gradients."""
        learned = max(frames - self.learned_frames, 0)
        return [part for part in ((0, learned), (learned, frames)) if part[0] < part[1]]

    def _frame(
        self,
        frame: TrainingFrame,
        inputs: UniADInputs,
        maps: list[Tensor],
        past: _Past | None,
        aware: bool,
        *,
        last: bool,
    ) -> tuple[_Past, dict[str, Tensor]]:
        network, config = self.network, self.network.config
        before = None if past is None else past.can_bus
        motion = EgoMotion.between(before, inputs.can_bus, config.grid, config.rotation_centre)
        motion = motion.to(inputs.images.device)
        if not aware:
            motion = untold(motion)
        bev = network.pts_bbox_head.encode(
            maps, inputs.images, inputs.lidar2img.float(), motion, None if past is None else past.memory.bev
        )
        pose = Pose.of(inputs.l2g_r_mat, inputs.l2g_t, inputs.timestamp, inputs.images.device)
        entering, _ = network.entering_queries(None if past is None else past.memory, pose)
        detections = network.pts_bbox_head.detect(bev, entering.queries, entering.reference_logits)
        agents = Agents.of(frame, config)
        matches = matched_agents(detections, agents, entering.track_ids[config.queries + 1 :], config.queries)
        ego_codes = box_targets(ego_box(frame), config)
        losses = detection_losses(detections, agents, matches, ego_codes, config.queries)
        losses["dense"] = dense_loss(bev, frame, config.grid, DENSE_WEIGHT)
        instances = _followed(entering, detections, agents, matches)
        memory = Memory(frame.scene, bev, self._handed_on(instances, matches), pose)
        if last:
            losses |= self._road_and_plan(frame, bev, instances, agents, matches, maps[0][FRONT : FRONT + 1])
        return _Past(memory, inputs.can_bus), losses

    def _handed_on(self, instances: Instances, matches: Matches) -> Instances:
        """Queries of the next frame: fresh ones, and tracks of most of the agents."""
        network = self.network
        kept = matches.queries[torch.rand(len(matches.queries)) >= LOST]
        kept = torch.cat([kept, self._false_tracks(instances, matches)])
        return network.fresh_queries().then(network.query_interact(network.memory_bank(instances).kept(kept)))

    def _false_tracks(self, instances: Instances, matches: Matches) -> Tensor:
        """The most certain of the fresh queries and tracks that stand for nobody, which are to be given up."""
        wrong = torch.ones(len(instances.scores), dtype=torch.bool)
        wrong[matches.queries] = False
        wrong[self.network.config.queries] = False
        count = min(int((torch.rand(len(matches.queries)) < FALSE_TRACKS).sum()), int(wrong.sum()))
        return instances.scores.detach().masked_fill(~wrong, -1.0).topk(count).indices

    def _road_and_plan(
        self,
        frame: TrainingFrame,
        bev: Tensor,
        instances: Instances,
        agents: Agents,
        matches: Matches,
        finest_front: Tensor,
    ) -> dict[str, Tensor]:
        network, config = self.network, self.network.config
        elements = network.seg_head(bev)
        road = Road.of(frame, config)
        lines = matched_elements(elements, road)
        head = network.seg_head
        contents, positions = head.stuff_query.weight.chunk(2, -1)
        masks = elements.cells.new_zeros(0, len(elements.cells))
        if len(lines.queries):
            masks = head.things_mask_head(elements.queries[lines.queries], None, elements.cells)
        losses = map_losses(elements, road, lines, masks, head.stuff_mask_head(contents, positions, elements.cells))
        if self.stage == "perception":
            return losses
        near = agents.boxes[matches.wanted, :2].norm(dim=-1).argsort()[:MOST_FORECAST]
        wanted = matches.wanted[near]
        tracks = decoded(instances.kept(matches.queries[near]))
        ego = decoded(instances.kept(slice(config.queries, config.queries + 1)))
        forecasts = network.motion_head(tracks.then(ego), elements, bev)
        losses |= forecast_losses(forecasts, *_futures(frame, agents, wanted))
        plan = network.planning_head(
            bev,
            network.pts_bbox_head.positional_encoding(),
            forecasts.queries[-1, -1],
            ego.states[0],
            frame.command,
            finest_front,
        )
        losses |= _plan_losses(plan, frame)
        return losses | self._occupancy(bev, tracks, agents, wanted, forecasts)

    def _occupancy(
        self, bev: Tensor, tracks: Boxes, agents: Agents, wanted: Tensor, forecasts: Forecasts
    ) -> dict[str, Tensor]:
        network, config = self.network, self.network.config
        vehicles = network.vehicle_classes[agents.labels[wanted]].nonzero()[:MOST_OCCUPYING, 0]
        if len(vehicles) == 0 or float(torch.rand(())) >= OCCUPANCY_SHARE:
            return {"occupancy": bev.sum() * 0}
        occupancy = network.occ_head(
            bev,
            forecasts.queries[-1, :-1][vehicles],
            tracks.states[vehicles],
            forecasts.positions[:-1][vehicles],
            tracks.scores[vehicles],
        )
        return {"occupancy": occupancy_loss(occupancy, *occupancy_targets(agents, wanted[vehicles], config))}


def _followed(entering: Instances, detections: Detections, agents: Agents, matches: Matches) -> Instances:
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


def _plan_losses(plan: UniADPlan, frame: TrainingFrame) -> dict[str, Tensor]:
    points, wanted, valid = plan.positions_m, frame.ego_future, frame.ego_future_valid
    losses = {
        "plan": PLAN_WEIGHT * plan_loss(points, wanted, valid),
        "plan aside": ASIDE_WEIGHT * aside_loss(points[:, 0], wanted[:, 0], valid),
        "plan agents": CONSTRAINT_WEIGHT * agent_constraint(points, frame),
        "plan boundary": CONSTRAINT_WEIGHT * boundary_constraint(points, frame),
    }
    return losses if plan.front is None else losses | mean_front_losses(plan.front, [frame])


def _futures(frame: TrainingFrame, agents: Agents, wanted: Tensor) -> tuple[Tensor, Tensor]:
    """(A + 1, steps, 2) and (A + 1, steps): where agents and then the ego go, and whether that is known."""
    offsets = agents.futures[wanted][..., :2] - agents.boxes[wanted][:, None, :2]
    rest = offsets.shape[1] - len(frame.ego_future)
    own = torch.cat([frame.ego_future, frame.ego_future.new_zeros(rest, 2)])[None]
    known = torch.cat([frame.ego_future_valid, frame.ego_future_valid.new_zeros(rest)])[None]
    return torch.cat([offsets, own]), torch.cat([agents.futures_valid[wanted], known])


def phases() -> tuple[Phase, ...]:
    """The parts of the training of UniAD-mini."""
    # What it sees is seen already (`seen_by_vad`): first what follows from it is learned, then what the past adds.
    heads = Recipe(steps=1500, learning_rate=1e-3, warmup=100, average=0.99, clips=2)
    clips = Recipe(steps=5000, learning_rate=6e-4, encoder_rate=0.3, warmup=100, average=0.998)
    return (
        Phase("heads", partial(UniADObjective, clip_frames=1, sees_already=True), heads),
        Phase("clips", partial(UniADObjective, clip_frames=4, learned_frames=2), clips),
    )
