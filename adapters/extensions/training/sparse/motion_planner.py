"""The planners on several key frames at once, as training needs them."""

from dataclasses import dataclass

import torch
from torch import Tensor

from adapters.extensions.training.sparse.keyframe_motions import KeyframeMotions
from adapters.networks.layers.front_reader import FrontReader
from adapters.networks.sparse.aggregation import CameraFeatures
from adapters.networks.sparse.boxes import carry_boxes
from adapters.networks.sparse.decoder import Decoded, Remembered, rows_of
from adapters.networks.sparse.diffusion import BLOCKS, DiffusionPlanner, PlanContext
from adapters.networks.sparse.motion_planner import Planner
from adapters.networks.sparse.noise_schedule import TIMESTEPS
from adapters.networks.sparse.queue import FORWARD_SPEED, SURE, VELOCITY, VELOCITY_Y


@dataclass(frozen=True, slots=True)
class LearnedQueue:
    """N agents and, in the last row, the ego of B key frames over the last L ones (`networks.sparse.queue`).

    Attributes:
        features: (L, B, N + 1, C).
        boxes: (L, B, N + 1, 11) in the present lidar frames.
        periods: (B, N + 1) int64.
    """

    features: Tensor
    boxes: Tensor
    periods: Tensor

    def allowed(self) -> Tensor:
        """Frames that each agent may look at, (B, N + 1, 1, L)."""
        age = torch.arange(len(self.features), 0, -1, device=self.periods.device)
        return (age <= self.periods[..., None])[:, :, None]


@dataclass(frozen=True, slots=True)
class QueueLeft:
    """Memory that key frames leave for the next ones; nothing is learned through it.

    Attributes:
        queue: With the ego as it was after it had looked around.
        kept: Which agents the next frames know again.
        confidence: (B, N) 0 to 1, of the agents.
        status: (B, 10) of the ego, as predicted.
        front: (B, numbers) of what plans took from the front cameras, if they look there.
    """

    queue: LearnedQueue
    kept: Remembered
    confidence: Tensor
    status: Tensor
    front: Tensor | None


@dataclass(frozen=True, slots=True)
class Interacted:
    """Tokens of B key frames after agents and the ego have looked at each other.

    Attributes:
        tokens: (B, N + 1, C) features and embeddings added; the ego is in the last row.
        ego_embedding: (B, 1, C).
        watched: Features and embeddings, (B, W + 1, C) each, of the most certain agents and the ego as they were.
        status: (B, 10) of the ego.
        front: (B, numbers) that plans took from the front cameras, if they look there.
    """

    tokens: Tensor
    ego_embedding: Tensor
    watched: tuple[Tensor, Tensor]
    status: Tensor
    left: QueueLeft
    front: Tensor | None

    @property
    def ego(self) -> Tensor:
        """(B, 1, C) tokens."""
        return self.tokens[:, -1:]


def queued(
    planner: Planner, agents: Decoded, front: Tensor, past: QueueLeft | None, motions: KeyframeMotions | None
) -> LearnedQueue:
    """Queue with these key frames as the last.

    `front` are (B, C, h, w) coarsest feature maps of the front cameras.
    """
    batch = len(front)
    encoded = planner.instance_queue.ego_feature_encoder(front).flatten(1)[:, None]
    ego_box = planner.instance_queue.ego_anchor.expand(batch, 1, -1)
    features = torch.cat([agents.features, encoded], 1)[None]
    if past is None or motions is None:
        boxes = torch.cat([agents.anchors.detach(), ego_box], 1)[None]
        return LearnedQueue(features, boxes, torch.ones(boxes.shape[1:3], dtype=torch.int64, device=front.device))
    ego_box = ego_box.clone()
    if planner.instance_queue.speed_from_poses:
        ego_box[..., VELOCITY] = motions.ego_velocity
    else:
        ego_box[..., VELOCITY_Y] = past.status[:, FORWARD_SPEED, None]
    boxes = torch.cat([agents.anchors.detach(), ego_box], 1)[None]
    old = _followed(past, agents, motions)
    oldest = max(0, len(old.features) + 1 - planner.instance_queue.frames)
    return LearnedQueue(
        torch.cat([old.features, features])[oldest:],
        torch.cat([old.boxes, boxes])[oldest:],
        (old.periods + 1).clamp(max=planner.instance_queue.frames),
    )


def _followed(past: QueueLeft, agents: Decoded, motions: KeyframeMotions) -> LearnedQueue:
    """The past in the order of the present agents: the first of them are those that were remembered."""
    batch, count = agents.features.shape[:2]
    remembered = past.kept.rows
    known = past.confidence.gather(1, remembered) > SURE
    rows = torch.cat([remembered, remembered.new_zeros(batch, count - remembered.shape[1])], 1)
    known = torch.cat([known, known.new_zeros(batch, count - known.shape[1]), known.new_ones(batch, 1)], 1)
    rows = torch.cat([rows, rows.new_full((batch, 1), past.confidence.shape[1])], 1)
    nobody = ~known[..., None]
    features = [rows_of(each, rows).masked_fill(nobody, 0) for each in past.queue.features]
    boxes = [carry_boxes(rows_of(each, rows), motions, 0.0) for each in past.queue.boxes]
    return LearnedQueue(
        torch.stack(features),
        torch.stack([each.masked_fill(nobody, 0) for each in boxes]),
        past.queue.periods.gather(1, rows).masked_fill(~known, 0),
    )


def interacted(
    planner: Planner,
    box_encoder: torch.nn.Module,
    agents: Decoded,
    lines: Decoded,
    queue: LearnedQueue,
    kept: Remembered,
    finest_front: Tensor,
    front_before: Tensor | None,
) -> Interacted:
    """Tokens after agents and the egos have looked at their past, at the most certain agents and at the maps.

    Those of the egos with what plans take from the front cameras. `finest_front` are (B, C, h, w) feature maps of the
    front cameras, `front_before` (B, numbers) what the frames before have left of what plans took from there; `kept`
    are agents that the next frames know again.
    """
    config = planner.config
    features = queue.features[-1]
    embeddings = torch.cat([agents.embeddings, box_encoder(queue.boxes[-1][:, -1:])], 1)
    past = queue.features.permute(1, 2, 0, 3), box_encoder(queue.boxes.permute(1, 2, 0, 3))
    allowed = queue.allowed()
    certain = agents.scores.detach().topk(config.watched_agents, dim=1).indices
    rows = torch.cat([certain, certain.new_full((len(certain), 1), features.shape[1] - 1)], 1)
    watched = rows_of(features, rows), rows_of(embeddings, rows)
    seen = lines.scores.detach().topk(config.watched_lines, dim=1).indices
    lanes, places = rows_of(lines.features, seen), rows_of(lines.embeddings, seen)
    features = planner.looked(features, embeddings, past, allowed, watched, (lanes, places))
    tokens = features + embeddings
    ego, front = planner.with_front(tokens[:, -1:], finest_front, front_before)
    tokens = torch.cat([tokens[:, :-1], ego], 1)
    status: Tensor = planner.refinement.plan_status_branch(tokens[:, -1])
    newest = torch.cat([queue.features[-1][:, :-1], features[:, -1:]], 1)
    after = LearnedQueue(torch.cat([queue.features[:-1], newest[None]]).detach(), queue.boxes.detach(), queue.periods)
    front_left = None if front is None else FrontReader.left(front.detach(), front_before)
    left = QueueLeft(after, kept, agents.scores.detach(), status.detach(), front_left)
    return Interacted(tokens, embeddings[:, -1:], watched, status, left, front)


@dataclass(frozen=True, slots=True)
class Cleaned:
    """Plans of B key frames after a block of the diffusion planner.

    `logits` are (B, M), `offsets` (B, M, steps, 2) metres from step to step.
    """

    logits: Tensor
    offsets: Tensor


def denoised(
    planner: DiffusionPlanner, views: CameraFeatures, found: Interacted, commands: Tensor, noise: Tensor
) -> list[Cleaned]:
    """Put noise on the anchored plans of the given commands and clean them again, as when the network plans.

    Of each block in each step of the way back, the last one last; gradients stop between the steps. `noise` are (B, M,
    steps, 2) standard normal numbers.
    """
    starts = planner.plan_queries(found.ego[:, None])[torch.arange(len(commands), device=commands.device), commands]
    context = PlanContext(views, found.ego_embedding, found.watched, starts)
    _, _, made = planner.denoise(context, planner.plan_anchor[commands], noise)
    return [
        Cleaned(made[f"logits {block} {step}"], made[f"offsets {block} {step}"])
        for step in range(len(TIMESTEPS))
        for block in range(BLOCKS)
    ]
