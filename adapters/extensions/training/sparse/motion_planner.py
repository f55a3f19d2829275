"""Sparse planners over several key frames at once, as training needs them: ego motion, perception and plans."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import torch
import torch.nn.functional as F
from torch import Tensor

from adapters.extensions.training.frames import TrainingFrame
from adapters.networks.layers.front_reader import FRONT, FrontReader
from adapters.networks.sparse.aggregation import CameraFeatures
from adapters.networks.sparse.boxes import KeyframeMotion, KeyframePose, RigidMotion, carry_boxes
from adapters.networks.sparse.decoder import DecodedInstances, DecoderStage, InstanceMemory, gather_rows
from adapters.networks.sparse.diffusion import BLOCKS, TIMESTEPS, DiffusionPlanner, PlanContext
from adapters.networks.sparse.model import SparseNetwork
from adapters.networks.sparse.motion_planner import MotionPlanner
from adapters.networks.sparse.queue import CERTAIN_SCORE, FORWARD_SPEED, VELOCITY, VELOCITY_Y


@dataclass(frozen=True, slots=True)
class KeyframeMotions(RigidMotion):
    """Motions, (B, 1, 4, 4), between key frames, all fresh; `seconds` (B, 1, 1), `interval_s` where there is none."""

    seconds: Tensor

    @classmethod
    def between(cls, then: Sequence[KeyframePose], now: Sequence[KeyframePose], device: torch.device) -> Self:
        """Motions between pairs of poses."""
        motions = [KeyframeMotion.between(*pair, device) for pair in zip(then, now, strict=True)]
        seconds = torch.tensor([motion.interval_s for motion in motions], device=device)
        return cls(torch.stack([motion.now_T_then for motion in motions])[:, None], seconds[:, None, None])

    @property
    def ego_velocity(self) -> Tensor:
        """(B, 1, 2) m/s, how the origins of the lidar frames have moved, seen from the present ones."""
        return -self.now_T_then[..., :2, 3] / self.seconds


@dataclass(frozen=True, slots=True)
class BatchQueue:
    """N agents and, in the last row, the ego of B key frames over the last L ones (`networks.sparse.queue`).

    `features` are (L, B, N + 1, C), `boxes` (L, B, N + 1, 11) in the present lidar frames, `periods` (B, N + 1) int64.
    """

    features: Tensor
    boxes: Tensor
    periods: Tensor

    def allowed(self) -> Tensor:
        """Frames that each agent may look at, (B, N + 1, 1, L)."""
        age = torch.arange(len(self.features), 0, -1, device=self.periods.device)
        return (age <= self.periods[..., None])[:, :, None]


@dataclass(frozen=True, slots=True)
class BatchQueueMemory:
    """Memory that key frames leave for the next ones; nothing is learned through it.

    `queue` has the ego as it was after it had looked around; `confidence` (B, N) is of the agents, `status` (B, 10) of
    the ego, as predicted; `front` (B, numbers) is from the front cameras, if plans look there.
    """

    queue: BatchQueue
    kept: InstanceMemory
    confidence: Tensor
    status: Tensor
    front: Tensor | None


@dataclass(frozen=True, slots=True)
class BatchInteraction:
    """Tokens, (B, N + 1, C), of B key frames after agents and the ego, last, have looked at each other.

    Features and embeddings are added in `tokens`; `watched` has both, (B, W + 1, C), of the most certain agents and
    the ego as they were; `front` (B, numbers) is from the front cameras, if plans look there.
    """

    tokens: Tensor
    ego_embedding: Tensor
    watched: tuple[Tensor, Tensor]
    status: Tensor
    left: BatchQueueMemory
    front: Tensor | None

    @property
    def ego(self) -> Tensor:
        """(B, 1, C) tokens."""
        return self.tokens[:, -1:]


def extend_queue(
    planner: MotionPlanner,
    agents: DecodedInstances,
    front: Tensor,
    past: BatchQueueMemory | None,
    motions: KeyframeMotions | None,
) -> BatchQueue:
    """Queue with these key frames as the last; `front` are (B, C, h, w) coarsest feature maps of the front cameras."""
    batch = len(front)
    encoded = planner.instance_queue.ego_feature_encoder(front).flatten(1)[:, None]
    ego_box = planner.instance_queue.ego_anchor.expand(batch, 1, -1)
    features = torch.cat([agents.features, encoded], 1)[None]
    if past is None or motions is None:
        boxes = torch.cat([agents.anchors.detach(), ego_box], 1)[None]
        return BatchQueue(features, boxes, torch.ones(boxes.shape[1:3], dtype=torch.int64, device=front.device))
    ego_box = ego_box.clone()
    if planner.instance_queue.speed_from_poses:
        ego_box[..., VELOCITY] = motions.ego_velocity
    else:
        ego_box[..., VELOCITY_Y] = past.status[:, FORWARD_SPEED, None]
    boxes = torch.cat([agents.anchors.detach(), ego_box], 1)[None]
    old = _align_past(past, agents, motions)
    oldest = max(0, len(old.features) + 1 - planner.instance_queue.frames)
    return BatchQueue(
        torch.cat([old.features, features])[oldest:],
        torch.cat([old.boxes, boxes])[oldest:],
        (old.periods + 1).clamp(max=planner.instance_queue.frames),
    )


def _align_past(past: BatchQueueMemory, agents: DecodedInstances, motions: KeyframeMotions) -> BatchQueue:
    """The past in the order of the present agents: the first of them are those that were remembered."""
    batch, count = agents.features.shape[:2]
    remembered = past.kept.rows
    known = past.confidence.gather(1, remembered) > CERTAIN_SCORE
    rows = torch.cat([remembered, remembered.new_zeros(batch, count - remembered.shape[1])], 1)
    known = torch.cat([known, known.new_zeros(batch, count - known.shape[1]), known.new_ones(batch, 1)], 1)
    rows = torch.cat([rows, rows.new_full((batch, 1), past.confidence.shape[1])], 1)
    absent = ~known[..., None]
    features = [gather_rows(past_frame, rows).masked_fill(absent, 0) for past_frame in past.queue.features]
    boxes = [carry_boxes(gather_rows(past_frame, rows), motions, 0.0) for past_frame in past.queue.boxes]
    return BatchQueue(
        torch.stack(features),
        torch.stack([past_frame.masked_fill(absent, 0) for past_frame in boxes]),
        past.queue.periods.gather(1, rows).masked_fill(~known, 0),
    )


def interact(
    planner: MotionPlanner,
    box_encoder: torch.nn.Module,
    agents: DecodedInstances,
    lines: DecodedInstances,
    queue: BatchQueue,
    kept: InstanceMemory,
    finest_front: Tensor,
    front_before: Tensor | None,
) -> BatchInteraction:
    """Tokens after agents and egos have looked at their past, the most certain agents, the maps and the front cameras.

    `finest_front` are (B, C, h, w) maps, `front_before` (B, numbers) earlier readings; the next frames know `kept`
    again.
    """
    config = planner.config
    features = queue.features[-1]
    embeddings = torch.cat([agents.embeddings, box_encoder(queue.boxes[-1][:, -1:])], 1)
    past = queue.features.permute(1, 2, 0, 3), box_encoder(queue.boxes.permute(1, 2, 0, 3))
    allowed = queue.allowed()
    certain = agents.scores.detach().topk(config.watched_agents, dim=1).indices
    rows = torch.cat([certain, certain.new_full((len(certain), 1), features.shape[1] - 1)], 1)
    watched = gather_rows(features, rows), gather_rows(embeddings, rows)
    line_rows = lines.scores.detach().topk(config.watched_lines, dim=1).indices
    lanes, places = gather_rows(lines.features, line_rows), gather_rows(lines.embeddings, line_rows)
    features = planner.attend_to_scene(features, embeddings, past, allowed, watched, (lanes, places))
    tokens = features + embeddings
    ego, front = planner.add_front(tokens[:, -1:], finest_front, front_before)
    tokens = torch.cat([tokens[:, :-1], ego], 1)
    status: Tensor = planner.refinement.plan_status_branch(tokens[:, -1])
    newest = torch.cat([queue.features[-1][:, :-1], features[:, -1:]], 1)
    after = BatchQueue(torch.cat([queue.features[:-1], newest[None]]).detach(), queue.boxes.detach(), queue.periods)
    front_left = None if front is None else FrontReader.left(front.detach(), front_before)
    queue_left = BatchQueueMemory(after, kept, agents.scores.detach(), status.detach(), front_left)
    return BatchInteraction(tokens, embeddings[:, -1:], watched, status, queue_left, front)


@dataclass(frozen=True, slots=True)
class DenoisedPlans:
    """Plans of B key frames after a diffusion block: (B, M) logits, (B, M, steps, 2) metres from step to step."""

    logits: Tensor
    offsets: Tensor


def denoise(
    planner: DiffusionPlanner, views: CameraFeatures, found: BatchInteraction, commands: Tensor, noise: Tensor
) -> list[DenoisedPlans]:
    """Noise anchored plans of the given commands and clean them again: of each block in each step, the last last.

    Gradients stop between the steps. `noise` are (B, M, steps, 2) standard normal numbers.
    """
    starts = planner.plan_queries(found.ego[:, None])[torch.arange(len(commands), device=commands.device), commands]
    context = PlanContext(views, found.ego_embedding, found.watched, starts)
    _, _, steps = planner.denoise(context, planner.plan_anchor[commands], noise)
    return [
        DenoisedPlans(steps[f"logits {block} {step}"], steps[f"offsets {block} {step}"])
        for step in range(len(TIMESTEPS))
        for block in range(BLOCKS)
    ]


@dataclass(frozen=True, slots=True)
class BatchPerception:
    """Perception of B key frames; `front` is the coarsest (B, C, h, w) front map, `finest_front` the one plans see."""

    poses: tuple[KeyframePose, ...]
    views: CameraFeatures
    agents: DecodedInstances
    lines: DecodedInstances
    kept_agents: InstanceMemory
    kept_lines: InstanceMemory
    front: Tensor
    finest_front: Tensor


def perceive(
    network: SparseNetwork,
    maps: Sequence[Tensor],
    finest_front: Tensor,
    frames: Sequence[TrainingFrame],
    past: BatchPerception | None,
) -> BatchPerception:
    """See key frames of several clips side by side; `past` is of the key frames before, in the same order.

    `maps` are (B * cameras, C, h, w) for each level, fine to coarse, `finest_front` (B, C, h, w) the front map plans
    see.
    """
    config, head, device = network.config, network.head, maps[0].device
    projections = torch.stack([frame.lidar2img for frame in frames]).to(device, torch.float32)
    views = CameraFeatures.of(maps, projections, config.image_height_px, config.image_width_px)
    poses = tuple(KeyframePose(frame.timestamp_s, frame.global_T_lidar, frame.scene) for frame in frames)
    motions = KeyframeMotions.between(past.poses, poses, device) if past else None
    agents, kept_agents = head.det_head(views, past.kept_agents if past else None, motions)
    lines, kept_lines = head.map_head(views, past.kept_lines if past else None, motions)
    front = maps[-1][FRONT :: config.cameras]
    return BatchPerception(poses, views, agents, lines, kept_agents, kept_lines, front, finest_front)


def compress_for_cache(seen: BatchPerception, cameras: int) -> BatchPerception:
    """Last stages without box qualities, and `cameras` of them in half precision: small enough to keep of thousands."""
    views = replace(
        seen.views,
        values=seen.views.values[:cameras].half(),
        projections=seen.views.projections[:, :cameras].clone(),
    )
    finest, coarsest = seen.finest_front.half(), seen.front.half()
    return replace(
        seen,
        views=views,
        agents=_last_stage(seen.agents),
        lines=_last_stage(seen.lines),
        front=coarsest,
        finest_front=finest,
    )


def stack_perceptions(seen: Sequence[BatchPerception]) -> BatchPerception:
    """Several key frames of `compress_for_cache` as one batch, in single precision."""
    views = seen[0].views
    return BatchPerception(
        poses=tuple(pose for perception in seen for pose in perception.poses),
        views=replace(
            views,
            values=torch.cat([perception.views.values for perception in seen]).float(),
            projections=torch.cat([perception.views.projections for perception in seen]),
        ),
        agents=_stack_instances([perception.agents for perception in seen]),
        lines=_stack_instances([perception.lines for perception in seen]),
        kept_agents=_stack_memories([perception.kept_agents for perception in seen]),
        kept_lines=_stack_memories([perception.kept_lines for perception in seen]),
        front=torch.cat([perception.front for perception in seen]).float(),
        finest_front=torch.cat([perception.finest_front for perception in seen]).float(),
    )


def apply_dropout(seen: BatchPerception, forgotten: float) -> BatchPerception:
    """The same with some numbers of agents, lines and front cameras gone, the others larger by as much (dropout)."""
    agents, lines = (replace(part, features=F.dropout(part.features, forgotten)) for part in (seen.agents, seen.lines))
    front, finest = (F.dropout(part, forgotten) for part in (seen.front, seen.finest_front))
    return replace(seen, agents=agents, lines=lines, front=front, finest_front=finest)


def _last_stage(decoded: DecodedInstances) -> DecodedInstances:
    return replace(decoded, stages=(replace(decoded.stages[-1], qualities=None),))


def _stack_instances(decoded: Sequence[DecodedInstances]) -> DecodedInstances:
    anchors, logits, features, embeddings = (
        torch.cat([getattr(instances, name) for instances in decoded])
        for name in ("anchors", "logits", "features", "embeddings")
    )
    return DecodedInstances((DecoderStage(anchors, logits, None),), features, embeddings)


def _stack_memories(memories: Sequence[InstanceMemory]) -> InstanceMemory:
    return InstanceMemory(
        *(torch.cat([getattr(memory, field.name) for memory in memories]) for field in fields(InstanceMemory))
    )
