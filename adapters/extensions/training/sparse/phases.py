"""Training phases of the SparseDrive and DiffusionDrive miniatures; planners learn from cached perception."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import torch
from torch import Tensor, nn

from adapters.extensions.training.frames import MEMORY_DROPOUT, CachedFrames, Frames, TrainingFrame, oversample_changes
from adapters.extensions.training.front import FrontEncoder, front_phase, mean_front_losses, shared_front_encoder
from adapters.extensions.training.image_encoder import miniature_images
from adapters.extensions.training.losses import Matches
from adapters.extensions.training.sparse.losses import (
    average_losses,
    decoder_losses,
    forecast_losses,
    match_stage_boxes,
    plan_losses,
    status_loss,
)
from adapters.extensions.training.sparse.motion_planner import (
    BatchInteraction,
    BatchPerception,
    DenoisedPlans,
    KeyframeMotions,
    apply_dropout,
    compress_for_cache,
    denoise,
    extend_queue,
    interact,
    perceive,
    stack_perceptions,
)
from adapters.extensions.training.sparse.targets import Targets
from adapters.extensions.training.trainer import Phase, Recipe
from adapters.networks.layers.front_reader import FrontReader
from adapters.networks.sparse.aggregation import CameraFeatures
from adapters.networks.sparse.decoder import DecodedInstances, DecoderStage
from adapters.networks.sparse.diffusion import DiffusionPlanner
from adapters.networks.sparse.model import SparseInputs, SparseNetwork
from benchmark.machine.storage import content_seed

STREAM_FRAMES: Final = 4
"""Key frames that are seen one after the other, the first of them without a past."""
FROZEN: Final = ("img_backbone.conv1", "img_backbone.bn1", "img_backbone.layer1")
"""Layers of the image network that stay as its own training left them: to change them would cost most."""


@dataclass(frozen=True, slots=True)
class BatchPredictions:
    """Predictions of a network for B key frames; `cleaned` is of the diffusion planner."""

    perceived: BatchPerception
    planned: BatchInteraction
    denoised: tuple[DenoisedPlans, ...]


class SparseObjective:
    """All tasks at once, as in the second published stage; memory goes from frame to frame, gradients do not."""

    def __init__(self, network: SparseNetwork) -> None:
        self.network: nn.Module = network
        self.clip_frames = STREAM_FRAMES
        self._sparse = network
        network.img_neck.requires_grad_(True)
        for name in FROZEN:
            network.get_submodule(name).requires_grad_(False)

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """Losses of one clip; weighted scalars by name, means over the key frames."""
        return self.losses_of([clip])

    def losses_of(self, clips: Sequence[Sequence[TrainingFrame]]) -> dict[str, Tensor]:
        """Weighted losses, means over key frames; clips of one length are seen together, which costs less."""
        frames = sum(map(len, clips))
        alike: dict[int, list[Sequence[TrainingFrame]]] = {}
        for clip in clips:
            alike.setdefault(len(clip), []).append(clip)
        parts = [
            {name: loss * (length * len(same) / frames) for name, loss in self._losses_together(same).items()}
            for length, same in sorted(alike.items())
        ]
        return {name: torch.stack([part[name] for part in parts]).sum() for name in parts[0]}

    def _losses_together(self, clips: Sequence[Sequence[TrainingFrame]]) -> dict[str, Tensor]:
        config = self._sparse.config
        frames = [frame for together in zip(*clips, strict=True) for frame in together]
        device = next(self._sparse.parameters()).device
        targets = Targets.of(frames, config.points_per_line, device)
        predictions = self.seen(frames, len(clips), targets)
        losses, matches = self._perception_losses([prediction.perceived for prediction in predictions], targets)
        planner = self._sparse.head.motion_plan_head
        agents = _flatten([prediction.perceived.agents for prediction in predictions])
        tokens = torch.cat([prediction.planned.tokens[:, :-1] for prediction in predictions]).flatten(0, 1)
        last = DecoderStage(agents.anchors[matches.queries], agents.logits[matches.queries], None)
        matched = DecodedInstances((last,), last.anchors, last.anchors)
        losses |= forecast_losses(
            *planner.forecast(matched, tokens[matches.queries]),
            planner.rotate_anchors(matched),
            targets.futures[matches.wanted],
            targets.futures_valid[matches.wanted],
        )
        fronts = [prediction.planned.front for prediction in predictions if prediction.planned.front is not None]
        if fronts:
            losses |= mean_front_losses(torch.cat(fronts), frames)
        losses["status"] = status_loss(torch.cat([prediction.planned.status for prediction in predictions]), targets)
        anchors = planner.plan_anchor[targets.commands]
        if isinstance(planner, DiffusionPlanner):
            blocks = zip(*(prediction.denoised for prediction in predictions), strict=True)
            cleaned = [
                DenoisedPlans(torch.cat([one.logits for one in same]), torch.cat([one.offsets for one in same]))
                for same in blocks
            ]
            return losses | average_losses(
                [plan_losses(prediction.logits, prediction.offsets, anchors, targets) for prediction in cleaned]
            )
        queries = planner.plan_queries(torch.cat([prediction.planned.ego for prediction in predictions])[:, None])
        queries = queries[torch.arange(len(frames), device=device), targets.commands]
        logits = planner.refinement.plan_cls_branch(queries)[..., 0]
        offsets = planner.refinement.plan_reg_branch(queries).unflatten(-1, (-1, 2))
        return losses | plan_losses(logits, offsets, anchors, targets)

    def _perception_losses(
        self, perceived: Sequence[BatchPerception], targets: Targets
    ) -> tuple[dict[str, Tensor], Matches]:
        """Losses of boxes and lines, and which boxes stand for which."""
        return decoder_losses(
            [perception.agents for perception in perceived], [perception.lines for perception in perceived], targets
        )

    def seen(self, frames: Sequence[TrainingFrame], batch: int, targets: Targets) -> list[BatchPredictions]:
        """Predictions of a key frame of each clip after the other: of all first frames, then of all second ones."""
        head, device = self._sparse.head, targets.plans.device
        planner = head.motion_plan_head
        predictions: list[BatchPredictions] = []
        for start, now in zip(range(0, len(frames), batch), self._perceive(frames, batch, device), strict=True):
            past = predictions[-1] if predictions else None
            motions = KeyframeMotions.between(past.perceived.poses, now.poses, device) if past else None
            queue_left = past.planned.left if past else None
            queue = extend_queue(planner, now.agents, now.front, queue_left, motions)
            planned = interact(
                planner,
                head.det_head.anchor_encoder,
                now.agents,
                now.lines,
                queue,
                now.kept_agents,
                now.finest_front,
                queue_left.front if queue_left else None,
            )
            present = slice(start, start + batch)
            cleaned = self._denoise(now.views, planned, targets.commands[present], frames[present])
            predictions.append(BatchPredictions(now, planned, cleaned))
        return predictions

    def _perceive(self, frames: Sequence[TrainingFrame], batch: int, device: torch.device) -> Iterator[BatchPerception]:
        """Perception of one key frame of each clip after the other; arguments as of `seen`."""
        network = self._sparse
        images = miniature_images(torch.stack([frame.images for frame in frames]).flatten(0, 1).to(device))
        maps = network.img_neck(network.img_backbone(images))
        fronts = network.finest_front(maps[0], images)
        past: BatchPerception | None = None
        for start in range(0, len(frames), batch):
            rows = slice(start * network.config.cameras, (start + batch) * network.config.cameras)
            now = slice(start, start + batch)
            past = perceive(network, [level[rows] for level in maps], fronts[now], frames[now], past)
            yield past

    def _denoise(
        self, views: CameraFeatures, planned: BatchInteraction, commands: Tensor, frames: Sequence[TrainingFrame]
    ) -> tuple[DenoisedPlans, ...]:
        planner = self._sparse.head.motion_plan_head
        if not isinstance(planner, DiffusionPlanner):
            return ()
        noise = torch.stack([self.draw_noise(frame) for frame in frames])
        return tuple(denoise(planner, views, planned, commands, noise.to(commands.device)))

    def draw_noise(self, frame: TrainingFrame) -> Tensor:
        """(modes, steps, 2) standard normal numbers that the plans of a key frame start with."""
        config = self._sparse.config
        return torch.randn((config.modes, config.steps, 2), generator=_generator(frame, "noise"))


def network_inputs(frame: TrainingFrame) -> SparseInputs:
    """Inputs that the planner would give the network for a key frame."""
    return SparseInputs(
        images=miniature_images(frame.images),
        projections=frame.lidar2img,
        timestamp_s=frame.timestamp_s,
        global_T_lidar=frame.global_T_lidar,
        command=frame.command,
        scene_token=frame.scene,
    )


def _generator(frame: TrainingFrame, purpose: str) -> torch.Generator:
    return torch.Generator().manual_seed(content_seed("sparse lesson", purpose, frame.scene, frame.index))


def _flatten(agents: Sequence[DecodedInstances]) -> DecoderStage:
    """The last stages of several key frames, (F * N, ...)."""
    anchors = torch.cat([instances.anchors.detach() for instances in agents]).flatten(0, 1)
    return DecoderStage(anchors, torch.cat([instances.stages[-1].logits for instances in agents]).flatten(0, 1), None)


PERCEPTION: Final = ("img_backbone", "img_neck", "head.det_head", "head.map_head")
"""Frozen parts."""


class SparsePlannerObjective(SparseObjective):
    """Forecasts and plans alone; boxes and lines, nine tenths of a step of `SparseObjective`, are found once.

    A small network would know the frames by heart: some of what is remembered is forgotten anew in each step. No plan
    is learned where the past that the network has when it drives is missing, as in the first frame of a clip.
    """

    def __init__(self, network: SparseNetwork) -> None:
        super().__init__(network)
        for name in PERCEPTION:
            network.get_submodule(name).requires_grad_(False)
        if network.front_eyes is not None:
            network.front_eyes.requires_grad_(False)
        plans_look = isinstance(network.head.motion_plan_head, DiffusionPlanner)
        self._cameras = network.config.cameras if plans_look else 0
        self._memory: dict[tuple[str, int], BatchPerception] = {}

    def look(self, store: Frames, frames: Sequence[int]) -> tuple[Frames, Sequence[int]]:
        """As `adapters.extensions.training.frames.CachingObjective` describes."""
        looked = CachedFrames(store, frames, self._cache_scene)
        return looked, oversample_changes(looked, frames)

    def _cache_scene(self, scene: Sequence[TrainingFrame]) -> None:
        device = next(self.network.parameters()).device
        with torch.no_grad():
            for frame, perception in zip(scene, super()._perceive(scene, 1, device), strict=True):
                self._memory[frame.scene, frame.index] = compress_for_cache(perception, self._cameras)

    def losses_of(self, clips: Sequence[Sequence[TrainingFrame]]) -> dict[str, Tensor]:
        """As `SparseObjective.losses_of`."""
        return super().losses_of([[_mask_plan(clip[0]), *clip[1:]] for clip in clips])

    def _perceive(self, frames: Sequence[TrainingFrame], batch: int, device: torch.device) -> Iterator[BatchPerception]:
        for start in range(0, len(frames), batch):
            batched = stack_perceptions(
                [self._memory[frame.scene, frame.index] for frame in frames[start : start + batch]]
            )
            yield apply_dropout(batched, MEMORY_DROPOUT) if self.network.training else batched

    def _perception_losses(
        self, perceived: Sequence[BatchPerception], targets: Targets
    ) -> tuple[dict[str, Tensor], Matches]:
        anchors, logits = (
            torch.cat([getattr(perception.agents, name) for perception in perceived]) for name in ("anchors", "logits")
        )
        return {}, match_stage_boxes(DecoderStage(anchors, logits, None), targets)


def _mask_plan(frame: TrainingFrame) -> TrainingFrame:
    """The first frame of a clip: of its plan nothing is learned if it is not the first of its scene as well."""
    return replace(frame, ego_future_valid=frame.ego_future_valid & (frame.index == 0))


_ALL: Final = Recipe(
    steps=2600, learning_rate=1e-3, encoder_rate=0.3, warmup=60, average=0.995, clips=2, gradient_norm=10.0
)
_PLANNER: Final = Recipe(
    steps=1500, learning_rate=6e-4, warmup=100, average=0.995, clips=16, gradient_norm=10.0, check_every=500
)


def find_front_reader(network: SparseNetwork) -> FrontReader | None:
    """The part of a network that reads the front camera for its plan, if it has one."""
    return network.head.motion_plan_head.front_reader


def build_front_encoder(network: SparseNetwork) -> FrontEncoder:
    """Eyes that make the maps for the front phase."""
    if network.front_eyes is not None:
        return FrontEncoder(network.front_eyes, own=True)
    # The detectors of boxes and lines read the same maps, which stay frozen until everything is trained.
    return shared_front_encoder(network, ("",))


def phases() -> tuple[Phase, ...]:
    """The parts of the training of SparseDrive-mini."""
    return (
        front_phase(find_front_reader, build_front_encoder),
        Phase("all", SparseObjective, _ALL),
        Phase("planner", SparsePlannerObjective, _PLANNER),
    )


def diffusion_phases() -> tuple[Phase, ...]:
    """Phases of DiffusionDrive-mini: it starts from what SparseDrive sees (``--start-from``) and learns to plan."""
    return (Phase("planner", SparsePlannerObjective, _PLANNER),)
