"""What the sparse networks see of several key frames at once, before they plan."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import torch
import torch.nn.functional as F
from torch import Tensor

from adapters.extensions.training.frames import TrainingFrame
from adapters.extensions.training.sparse.keyframe_motions import KeyframeMotions
from adapters.networks.layers.front_reader import FRONT
from adapters.networks.sparse.aggregation import CameraFeatures
from adapters.networks.sparse.decoder import Decoded, Remembered, Stage
from adapters.networks.sparse.keyframe_pose import KeyframePose
from adapters.networks.sparse.model import SparseNetwork


@dataclass(frozen=True, slots=True)
class Perceived:
    """Boxes and map elements seen in B key frames, and what to remember of them.

    `front` are (B, C, h, w) coarsest feature maps of the front cameras, `finest_front` their finest ones, or what
    plans look at instead.
    """

    poses: tuple[KeyframePose, ...]
    views: CameraFeatures
    agents: Decoded
    lines: Decoded
    kept_agents: Remembered
    kept_lines: Remembered
    front: Tensor
    finest_front: Tensor


def perceived(
    network: SparseNetwork,
    maps: Sequence[Tensor],
    finest_front: Tensor,
    frames: Sequence[TrainingFrame],
    past: Perceived | None,
) -> Perceived:
    """See key frames of several clips side by side.

    `maps` are (B * cameras, C, h, w) for each level, fine to coarse, `finest_front` (B, C, h, w) what plans look at of
    the front cameras; `past` is of the key frames before, in the same order.
    """
    config, head, device = network.config, network.head, maps[0].device
    projections = torch.stack([frame.lidar2img for frame in frames]).to(device, torch.float32)
    views = CameraFeatures.of(maps, projections, config.image_height_px, config.image_width_px)
    poses = tuple(KeyframePose(frame.timestamp_s, frame.global_T_lidar, frame.scene) for frame in frames)
    motions = KeyframeMotions.between(past.poses, poses, device) if past else None
    agents, kept_agents = head.det_head(views, past.kept_agents if past else None, motions)
    lines, kept_lines = head.map_head(views, past.kept_lines if past else None, motions)
    front = maps[-1][FRONT :: config.cameras]
    return Perceived(poses, views, agents, lines, kept_agents, kept_lines, front, finest_front)


def remembered(seen: Perceived, cameras: int) -> Perceived:
    """Part of key frames that a planner needs, small enough to be kept of thousands; images in half precision.

    The last stages alone, and no qualities of boxes; cameras are kept as many as asked for, none where plans do not
    look at images.
    """
    views = replace(
        seen.views,
        values=seen.views.values[:cameras].half(),
        projections=seen.views.projections[:, :cameras].clone(),
    )
    finest, coarsest = seen.finest_front.half(), seen.front.half()
    return replace(
        seen, views=views, agents=_last(seen.agents), lines=_last(seen.lines), front=coarsest, finest_front=finest
    )


def together(seen: Sequence[Perceived]) -> Perceived:
    """Several key frames of `remembered` as one batch, in single precision."""
    views = seen[0].views
    return Perceived(
        poses=tuple(pose for each in seen for pose in each.poses),
        views=replace(
            views,
            values=torch.cat([each.views.values for each in seen]).float(),
            projections=torch.cat([each.views.projections for each in seen]),
        ),
        agents=_side_by_side([each.agents for each in seen]),
        lines=_side_by_side([each.lines for each in seen]),
        kept_agents=_kept_together([each.kept_agents for each in seen]),
        kept_lines=_kept_together([each.kept_lines for each in seen]),
        front=torch.cat([each.front for each in seen]).float(),
        finest_front=torch.cat([each.finest_front for each in seen]).float(),
    )


def partly(seen: Perceived, forgotten: float) -> Perceived:
    """The same with some numbers of agents, lines and front cameras gone, the others larger by as much (dropout)."""
    agents, lines = (replace(each, features=F.dropout(each.features, forgotten)) for each in (seen.agents, seen.lines))
    front, finest = (F.dropout(each, forgotten) for each in (seen.front, seen.finest_front))
    return replace(seen, agents=agents, lines=lines, front=front, finest_front=finest)


def _last(decoded: Decoded) -> Decoded:
    return replace(decoded, stages=(replace(decoded.stages[-1], qualities=None),))


def _side_by_side(decoded: Sequence[Decoded]) -> Decoded:
    anchors, logits, features, embeddings = (
        torch.cat([getattr(each, name) for each in decoded]) for name in ("anchors", "logits", "features", "embeddings")
    )
    return Decoded((Stage(anchors, logits, None),), features, embeddings)


def _kept_together(kept: Sequence[Remembered]) -> Remembered:
    return Remembered(*(torch.cat([getattr(each, field.name) for each in kept]) for field in fields(Remembered)))
