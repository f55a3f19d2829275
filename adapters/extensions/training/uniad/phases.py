"""Training phases of UniAD-mini, on images, cached views or cached plan inputs, and its start from data and a seed."""

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from adapters.extensions.training.frames import MEMORY_DROPOUT, CachedFrames, Frames, TrainingFrame, oversample_changes
from adapters.extensions.training.front import FRONT_BACKBONE_PREFIX, MESSAGE_LAYER_PREFIX
from adapters.extensions.training.trainer import Phase, Recipe
from adapters.extensions.training.uniad.losses import motion_anchors, network_inputs, query_places
from adapters.extensions.training.uniad.objective import FrameFeatures, UniADObjective, plan_losses
from adapters.networks.layers.deformable_attention import ring_of_offsets
from adapters.networks.layers.deformable_decoder import logit
from adapters.networks.uniad.config import UniADConfig
from adapters.networks.uniad.map_masks import MaskLogits
from adapters.networks.uniad.model import UniAD
from adapters.networks.uniad.motion import GoalAttention
from adapters.networks.uniad.planning import UniADInputs
from benchmark.errors import InputError

RARE = 0.05
"""How often an untrained network takes a query for an agent of a class."""
CAR_M = (1.9, 4.5, 1.6)
"""Width, length and height of an untrained network's boxes."""
USUAL_MOTION = {7: 3.0, 8: 3.0, 12: 0.5, 13: 5.0, 14: 5.0, 17: 10.0}
"""Places in the CAN bus vector of accelerations, m/s^2, turn rate, rad/s, speeds, m/s, and turn, degrees; and how large
they usually are."""
LOUD = 2.0
"""Gain of the plan's last layer: steps of many metres are far from what usual random weights give."""
QUIET = 0.5
"""Gain of convolutions whose normalisation has no statistics yet."""
EMBEDDING = 0.1
"""Deviation of what tells levels and cameras apart; the published start of 1 drowns small features for long."""
FIRST_VALUE = 0.2
"""Least value of untrained masks: where a mask is zero, nothing pulls at it."""
SINE = 6
"""Place of the sine of the yaw among the numbers of a box."""
_HEAD = "pts_bbox_head."
_VAD_QUERIES = f"{_HEAD}query_embedding.weight"
_LEVELS = f"{_HEAD}transformer.level_embeds"
_SHARED = tuple(
    f"{_HEAD}{name}."
    for name in (
        "bev_embedding",
        "positional_encoding",
        "transformer.encoder",
        "transformer.decoder",
        "transformer.can_bus_mlp",
        "cls_branches",
        "reg_branches",
    )
) + (f"{_HEAD}transformer.cams_embeds",)
"""How the names of parameters begin that UniAD and VAD share."""


def build_untrained(config: UniADConfig, frames: Sequence[TrainingFrame], seed: int) -> UniAD:
    """Untrained network; places of queries and anchors of forecasts, part of its state, are from hundreds of frames."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = UniAD(config, motion_anchors(frames, config), stores_anchors=True)
        _start_classes(network)
        with torch.no_grad():
            _start_motion(network)
            _start_plan(network, frames)
            if network.planning_head.front_reader is not None:
                network.planning_head.front_reader.zero_message()
            _start_places(network, query_places(frames, config))
            _start_boxes(network)
            _start_layers(network)
    return network


def transfer_from_vad(trunk: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights that UniAD shares with VAD: images, BEVFormer view and box decoder; not what VAD's front eyes feed."""
    if _VAD_QUERIES not in trunk:
        return dict(trunk)
    config = UniADConfig.miniature()
    weights = {
        name: value for name, value in trunk.items() if name.startswith(("img_backbone.", "img_neck.", *_SHARED))
    }
    weights[_LEVELS] = trunk[_LEVELS][: config.pyramid_levels]
    for layer in range(config.decoder_layers):
        for part in ("weight", "bias"):
            name = f"{_HEAD}reg_branches.{layer}.4.{part}"
            # Weights for yaws, whose sign is opposite to VAD's.
            signs = torch.ones(len(trunk[name]))
            signs[SINE] = -1.0 if config.counterclockwise_yaw else 1.0
            weights[name] = trunk[name] * signs.view(-1, *[1] * (trunk[name].dim() - 1)).to(trunk[name].dtype)
    places = {part: trunk[f"{_HEAD}transformer.reference_points.{part}"].float() for part in ("weight", "bias")}
    weights |= {f"reference_points.{part}": value for part, value in places.items()}
    low, high = (torch.tensor(config.perception_range_m[first : first + 3]) for first in (0, 3))
    ego = torch.linalg.pinv(places["weight"]) @ (logit(-low / (high - low)) - places["bias"])
    ego_query = torch.cat([ego, torch.zeros_like(ego)])[None].to(trunk[_VAD_QUERIES].dtype)
    weights["query_embedding.weight"] = torch.cat([trunk[_VAD_QUERIES], ego_query])
    if any(name.startswith(FRONT_BACKBONE_PREFIX) for name in trunk):
        # Its plan reads another map of the front camera.
        return weights
    reader = f"{_HEAD}front_reader."
    # Its output uses another plan's encoding.
    read = (
        name for name in trunk if name.startswith(reader) and not name.startswith(f"{reader}{MESSAGE_LAYER_PREFIX}")
    )
    return weights | {f"planning_head.front_reader.{name.removeprefix(reader)}": trunk[name] for name in read}


def _start_classes(network: UniAD) -> None:
    rare = -math.log((1 - RARE) / RARE)
    for branch in (*network.pts_bbox_head.cls_branches, *network.seg_head.cls_branches):
        nn.init.constant_(_last_linear(branch).bias, rare)


def _start_places(network: UniAD, places: Tensor) -> None:
    """Move the queries' encodings as little as it takes for them to look at places, the ego's at the ego."""
    config = network.config
    low, high = torch.tensor(config.perception_range_m[:3]), torch.tensor(config.perception_range_m[3:])
    targets = torch.cat([places, torch.zeros(1, 3)]).clamp(low + 0.5, high - 0.5)
    layer = network.reference_points
    nn.init.xavier_uniform_(layer.weight)
    nn.init.zeros_(layer.bias)
    encodings = network.query_embedding.weight[:, : config.channels]
    missing = logit((targets - low) / (high - low)) - layer(encodings)
    encodings += missing @ torch.linalg.pinv(layer.weight).T


def _start_motion(network: UniAD) -> None:
    """Of the CAN bus only what tells how the ego moves is read, all of order one; the rest drowns it for long."""
    layer = _last_linear(network.pts_bbox_head.transformer.can_bus_mlp[0])
    read = torch.zeros(layer.in_features)
    for number, usual in USUAL_MOTION.items():
        read[number] = 1 / usual
    nn.init.normal_(layer.weight)
    layer.weight *= read
    nn.init.uniform_(layer.bias, -1, 1)


def _start_boxes(network: UniAD) -> None:
    width, length, height = (math.log(size) for size in CAR_M)
    bias = torch.tensor([0.0, 0.0, width, length, 0.0, height, 0.0, 0.0, 0.0, 0.0])
    for branch in network.pts_bbox_head.reg_branches:
        nn.init.zeros_(_last_linear(branch).weight)
        _last_linear(branch).bias.copy_(bias)


def _start_plan(network: UniAD, frames: Sequence[TrainingFrame]) -> None:
    """First plans are the mean of what was driven."""
    complete = [frame.ego_future for frame in frames if bool(frame.ego_future_valid.all())]
    if not complete:
        raise InputError("no training frame is followed by three recorded seconds; give a split with longer scenes")
    driven, last = torch.stack(complete), _last_linear(network.planning_head.reg_branch)
    last.weight *= LOUD
    last.bias.copy_(driven.diff(dim=1, prepend=torch.zeros(len(driven), 1, 2)).mean(0).flatten())


def _start_layers(network: UniAD) -> None:
    transformer = network.pts_bbox_head.transformer
    for embedding in (transformer.level_embeds, transformer.cams_embeds, network.seg_head.transformer.level_embeds):
        nn.init.normal_(embedding, std=EMBEDDING)
    for module in network.occ_head.modules():
        if isinstance(module, nn.Conv2d):
            nn.init.xavier_normal_(module.weight, QUIET)
    for module in network.modules():
        if isinstance(module, GoalAttention):
            nn.init.zeros_(module.sampling_offsets.weight)
            module.sampling_offsets.bias.copy_(ring_of_offsets(module.heads, module.steps, module.points))
        if isinstance(module, MaskLogits):
            mixture, last = _first_linear(module.linear_l1), _first_linear(module.linear)
            mixture.weight.copy_(torch.eye(module.heads))
            nn.init.zeros_(mixture.bias)
            nn.init.constant_(last.weight, 1 / module.heads)
            nn.init.constant_(last.bias, FIRST_VALUE)


def _first_linear(branch: nn.Sequential) -> nn.Linear:
    layer = branch[0]
    assert isinstance(layer, nn.Linear)
    return layer


def _last_linear(branch: nn.Module) -> nn.Linear:
    layer = list(branch.children())[-1] if isinstance(branch, nn.Sequential) else branch
    assert isinstance(layer, nn.Linear)
    return layer


@dataclass(frozen=True, slots=True)
class PlanInputs:
    """Plan inputs in half precision: forecast states (modes, C), ego track (C,), the rest as in `FrameFeatures`."""

    bev: Tensor
    mode_queries: Tensor
    state: Tensor
    finest_front: Tensor
    can_bus: Tensor


class UniADPlannerObjective:
    """The plan alone; all before it runs over each scene once as when the network drives, its own tracks included.

    In clips of `UniADObjective` tracks are a few frames old, and stand for whom they should. A small network would
    know the frames by heart: some of the ego's forecast and track is forgotten anew in each step, the planner has its
    dropout, and what is read in the front camera stays as it is.
    """

    clip_frames = 1

    def __init__(self, network: UniAD) -> None:
        self.network = network
        network.requires_grad_(False)
        head = network.planning_head.requires_grad_(True)
        if head.front_reader is not None:
            head.front_reader.freeze_reading()
        self._memory: dict[tuple[str, int], PlanInputs] = {}

    def look(self, store: Frames, frames: Sequence[int]) -> tuple[Frames, Sequence[int]]:
        """As `adapters.extensions.training.frames.CachingObjective` describes."""
        cached_frames = CachedFrames(store, frames, self._cache_scene)
        return cached_frames, oversample_changes(cached_frames, frames)

    def _cache_scene(self, scene: Sequence[TrainingFrame]) -> None:
        network = self.network.eval()
        network.reset()
        captured: list[PlanInputs] = []
        head = network.planning_head
        hook = head.register_forward_pre_hook(lambda _, arguments: captured.append(_copy_plan_inputs(*arguments)))
        with hook, torch.no_grad(), _skip_occupancy(network):
            for frame in scene:
                network.predict(network_inputs(frame))
                self._memory[frame.scene, frame.index] = captured.pop()
        network.reset()

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """Losses of the last frame of a clip; weighted scalars by name."""
        network, frame = self.network, clip[-1]
        sights = self._memory[frame.scene, frame.index]
        modes, state = sights.mode_queries.float(), sights.state.float()
        if network.training:
            network.eval().planning_head.train()
        if network.planning_head.training:
            modes, state = F.dropout(modes, MEMORY_DROPOUT), F.dropout(state, MEMORY_DROPOUT)
        plan = network.planning_head(
            sights.bev.float(),
            network.pts_bbox_head.positional_encoding(),
            modes,
            state,
            frame.command,
            sights.finest_front.float(),
            sights.can_bus,
        )
        return plan_losses(plan, frame)


@contextmanager
def _skip_occupancy(network: UniAD) -> Iterator[None]:
    """Leave out occupancy, which is nearly half of a frame's cost and which no plan reads: no track is a vehicle."""
    vehicles = network.vehicle_classes
    network.vehicle_classes = torch.zeros_like(vehicles)
    try:
        yield
    finally:
        network.vehicle_classes = vehicles


def _copy_plan_inputs(
    bev: Tensor, _: Tensor, mode_queries: Tensor, state: Tensor, __: int, finest_front: Tensor, can_bus: Tensor
) -> PlanInputs:
    """Inputs of `adapters.networks.uniad.planning.PlanningHead`; copies, so that nothing else is kept."""
    return PlanInputs(bev.half(), mode_queries.half(), state.half(), finest_front.half(), can_bus)


class HeadsObjective(UniADObjective):
    """Tracks, map, forecasts, occupancy and plan on cached views; all frames of a clip have gradients."""

    def __init__(self, network: UniAD, clip_frames: int) -> None:
        super().__init__(network, clip_frames=clip_frames, unaware=0.0, sees_already=True)
        self._memory: dict[tuple[str, float], FrameFeatures] = {}

    def look(self, store: Frames, frames: Sequence[int]) -> tuple[Frames, Sequence[int]]:
        """As `adapters.extensions.training.frames.CachingObjective` describes."""
        looked = CachedFrames(store, frames, self._cache_scene)
        return looked, oversample_changes(looked, frames)

    def _cache_scene(self, scene: Sequence[TrainingFrame]) -> None:
        inputs = [network_inputs(frame) for frame in scene]
        with torch.no_grad():
            for frame_inputs, view in zip(inputs, super()._encode_frames(inputs, aware=True), strict=True):
                cached = FrameFeatures(view.bev.half(), view.finest_front.half(), view.can_bus)
                self._memory[frame_inputs.scene_token, frame_inputs.timestamp] = cached

    def _encode_frames(self, inputs: Sequence[UniADInputs], aware: bool) -> Iterator[FrameFeatures]:
        for frame_inputs in inputs:
            cached = self._memory[frame_inputs.scene_token, frame_inputs.timestamp]
            yield FrameFeatures(cached.bev.float(), cached.finest_front.float(), cached.can_bus)


def phases() -> tuple[Phase, ...]:
    """The parts of the training of UniAD-mini."""
    # What it sees is seen already (`transfer_from_vad`): first what follows from it is learned, then everything
    # together.
    heads = Recipe(steps=3000, learning_rate=1e-3, warmup=100, average=0.998, clips=6, check_every=1000)
    clips = Recipe(steps=3000, learning_rate=4e-4, encoder_rate=0.3, warmup=100, average=0.998)
    planner = Recipe(steps=4000, learning_rate=6e-4, warmup=100, average=0.998, clips=24, check_every=1000)
    return (
        Phase("heads", partial(HeadsObjective, clip_frames=4), heads),
        Phase("clips", partial(UniADObjective, clip_frames=4, learned_frames=2), clips),
        Phase("planner", UniADPlannerObjective, planner),
    )
