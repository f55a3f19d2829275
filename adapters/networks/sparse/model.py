"""SparseDrive (Sun et al., 2024) and DiffusionDrive: images and matrices in; plan, boxes, forecasts and map out."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from adapters.networks.layers.front_reader import FRONT, FrontBackbone, compute_front_maps
from adapters.networks.layers.resnet import EXPANSION, FeaturePyramid, ResNet
from adapters.networks.sparse.aggregation import CameraFeatures
from adapters.networks.sparse.boxes import KeyframeMotion, KeyframePose
from adapters.networks.sparse.config import STAGES, SparseConfig
from adapters.networks.sparse.decoder import BoxDecoder, InstanceMemory, LineDecoder
from adapters.networks.sparse.diffusion import DiffusionPlanner
from adapters.networks.sparse.motion_planner import (
    MotionPlanner,
    MotionPlannerInputs,
    PlannerPredictions,
    interaction_layers,
)
from adapters.networks.sparse.queue import QueueMemory
from adapters.networks.sparse.selection import SparseOutputs, SparsePredictions, select
from benchmark.machine.storage import content_seed


@dataclass(frozen=True, slots=True)
class TrackIds:
    """Numbers, never used twice, of the (K,) remembered instances, most certain first, and of the next new one."""

    ids: Tensor
    next_id: Tensor


def number_instances(past: TrackIds | None, fresh: bool, rows: Tensor, instances: int) -> tuple[Tensor, TrackIds]:
    """Numbers, (instances,) int64, for every instance of a frame, and the tracks to leave.

    `fresh`: the first instances of this frame are those of the earlier one; `rows` are the (K,) that the next frame
    gets.
    """
    known = past.ids if past and fresh else rows.new_zeros(0)
    first = past.next_id if past else rows.new_zeros(())
    new = instances - len(known)
    ids = torch.cat([known, first + torch.arange(new, device=rows.device)])
    return ids, TrackIds(ids[rows], first + new)


class RegressionPlanner(MotionPlanner):
    """One plan for each mode and driving command, in one go."""

    def __init__(self, config: SparseConfig) -> None:
        super().__init__(config, {"layers": interaction_layers(config, plans=True)})

    def forward(self, scene: MotionPlannerInputs, noise: Tensor | None = None) -> PlannerPredictions:
        """Forecasts and plans of a key frame; only the other planner has noise."""
        queue = self.instance_queue(scene.past, scene.motion, scene.agents, scene.ids, scene.front)
        interaction = self.interact(scene, queue)
        ego, front = self.add_front(interaction.tokens[-1:], scene.finest_front, scene.front_before)
        queries = self.plan_queries(ego)
        motion_logits, motion_offsets = self.forecast(scene.agents, interaction.tokens[:-1])
        status = self.refinement.plan_status_branch(ego)[0].float()
        return PlannerPredictions(
            motion_logits,
            motion_offsets,
            self.refinement.plan_cls_branch(queries)[..., 0].float(),
            self.refinement.plan_reg_branch(queries).float().unflatten(-1, (-1, 2)),
            status,
            queue,
            self.remember(scene, queue, interaction.features[-1:], status, front),
            {},
            front,
        )


DEPTH_LEVELS = 3


@dataclass(frozen=True, slots=True)
class SparseInputs:
    """One key frame. The status of the ego is no input: the published models predict it and look at no other.

    `images` are (6, 3, H, W), normalised: front, front right, front left, back, back left, back right; `projections`
    (6, 4, 4), lidar frame in metres to pixels; `global_T_lidar` (4, 4) float64; `command` 0 right, 1 left, 2 straight.
    Whether a change of scene forgets the past, the configuration says.
    """

    images: Tensor
    projections: Tensor
    timestamp_s: float
    global_T_lidar: Tensor
    command: int
    scene_token: str


@dataclass(frozen=True, slots=True)
class SparseMemory:
    """Memory that a frame leaves for the next one: the most certain agents and lines, and the queue of the planner."""

    pose: KeyframePose
    agents: InstanceMemory
    lines: InstanceMemory
    tracks: TrackIds
    queue: QueueMemory


def pose_of(inputs: SparseInputs) -> KeyframePose:
    """When and where a key frame was taken."""
    pose = inputs.global_T_lidar.detach().to("cpu", torch.float64, copy=True)
    return KeyframePose(inputs.timestamp_s, pose, inputs.scene_token)


class DepthBranch(nn.Module):
    """Layers of a training loss; nothing reads them here, but published checkpoints hold them."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.depth_layers = nn.ModuleList([nn.Conv2d(channels, 1, 1) for _ in range(DEPTH_LEVELS)])


class SparseHead(nn.Module):
    """Everything after the image features, under the published names."""

    def __init__(self, config: SparseConfig, planner: RegressionPlanner | DiffusionPlanner) -> None:
        super().__init__()
        self.det_head = BoxDecoder(config, config.levels)
        self.map_head = LineDecoder(config, config.levels)
        self.motion_plan_head = planner

    def forward(
        self,
        cameras: CameraFeatures,
        front: Tensor,
        finest_front: Tensor,
        pose: KeyframePose,
        command: int,
        noise: Tensor,
        past: SparseMemory | None,
    ) -> tuple[SparsePredictions, SparseMemory]:
        """Predictions for one key frame, and the memory for the next one.

        `front` is the (1, C, h, w) coarsest feature map of the front camera, `finest_front` its finest one, or that of
        the plan's own eyes; `command` 0 right, 1 left, 2 straight; `noise` (modes, steps, 2) for the diffusion planner.
        """
        motion = KeyframeMotion.between(past.pose, pose, front.device) if past else None
        agents, kept_agents = self.det_head(cameras, past.agents if past else None, motion)
        lines, kept_lines = self.map_head(cameras, past.lines if past else None, motion)
        ids, tracks = number_instances(
            past.tracks if past else None, bool(motion and motion.fresh), kept_agents.rows, len(agents.anchors)
        )
        scene = MotionPlannerInputs(
            agents=agents,
            lines=lines,
            ids=ids,
            cameras=cameras,
            front=front,
            finest_front=finest_front,
            command=command,
            box_encoder=self.det_head.anchor_encoder,
            past=past.queue if past else None,
            motion=motion,
        )
        planned = self.motion_plan_head(scene, noise)
        memory = SparseMemory(pose, kept_agents, kept_lines, tracks, planned.memory)
        return SparsePredictions(agents, lines, ids, planned), memory


class SparseNetwork(nn.Module):
    """Base of both networks, with the memory of the last frame; call it under ``torch.inference_mode()``.

    Frames come one after the other. `seed` is of the noise, for frames that come without.
    """

    def __init__(self, config: SparseConfig, planner: RegressionPlanner | DiffusionPlanner, seed: int) -> None:
        super().__init__()
        self.config, self.seed = config, seed
        read = range(config.finest_stage, STAGES)
        self.img_backbone = ResNet(config.backbone_blocks, width=config.backbone_width, outputs=read)
        widths = [config.backbone_width * EXPANSION * 2**stage for stage in read]
        self.img_neck = FeaturePyramid(widths, config.channels, config.levels)
        self.head = SparseHead(config, planner)
        self.front_eyes = FrontBackbone(config.backbone_width, config.channels) if config.front_eyes else None
        self.depth_branch = DepthBranch(config.channels)
        self.memory: SparseMemory | None = None
        self.eval()

    def reset(self) -> None:
        """Forget the past; the next frame is a first one, and numbers of tracks start again."""
        self.memory = None

    def forward(self, inputs: SparseInputs, noise: Tensor | None = None) -> SparseOutputs:
        """Outputs for one key frame; frames come in the order of time."""
        return select(self.config, self.predict(inputs, noise), inputs.command)

    def predict(self, inputs: SparseInputs, noise: Tensor | None = None) -> SparsePredictions:
        """Predictions for one key frame before selection; it is remembered.

        `noise` is (modes, steps, 2), standard normal, of the diffusion planner; `frame_noise` by default.
        """
        config, images = self.config, inputs.images
        expected_shape = (config.cameras, 3, config.image_height_px, config.image_width_px)
        if tuple(images.shape) != expected_shape:
            raise ValueError(f"images of shape {tuple(images.shape)}, not {expected_shape}")
        past = self.memory
        if past and not config.memory_crosses_scenes and past.pose.scene_token != inputs.scene_token:
            past = None
        maps = self.img_neck(self.img_backbone(images))
        projections = inputs.projections.to(images.device, torch.float32)
        cameras = CameraFeatures.of(maps, projections, config.image_height_px, config.image_width_px)
        drawn = self.frame_noise(inputs) if noise is None else noise
        predictions: SparsePredictions
        front = maps[-1][FRONT : FRONT + 1]
        finest_front = self.finest_front(maps[0], images)
        noise = drawn.to(images.device, torch.float32)
        predictions, self.memory = self.head(cameras, front, finest_front, pose_of(inputs), inputs.command, noise, past)
        return predictions

    def finest_front(self, finest: Tensor, images: Tensor) -> Tensor:
        """Maps of the front cameras that plans look at, (B, C, h, w), as `compute_front_maps`."""
        return compute_front_maps(self.front_eyes, finest, images, self.config.cameras)

    def frame_noise(self, inputs: SparseInputs) -> Tensor:
        """Standard normal numbers, (modes, steps, 2) float32, that depend on the seed and the time of the frame alone.

        Adversarial variants of a scene then meet the same noise, and requests over HTTP name no scene.
        """
        seed = content_seed("plan noise", self.seed, inputs.timestamp_s)
        generator = torch.Generator().manual_seed(seed)
        return torch.randn((self.config.modes, self.config.steps, 2), generator=generator)


class SparseDrive(SparseNetwork):
    """SparseDrive (Sun et al., 2024), stage 2."""

    def __init__(self, config: SparseConfig) -> None:
        super().__init__(config, RegressionPlanner(config), 0)


class DiffusionDrive(SparseNetwork):
    """DiffusionDrive for nuScenes (Liao et al., CVPR 2025), stage 2."""

    def __init__(self, config: SparseConfig, seed: int = 0) -> None:
        super().__init__(config, DiffusionPlanner(config, config.levels), seed)
