"""The planner of DiffusionDrive (Liao et al., CVPR 2025), which denoises anchored plans, and its noise schedule."""

import math
from dataclasses import dataclass
from typing import Final

import torch
from torch import Tensor, nn

from adapters.networks.layers.attention import ResidualAttention, plain_branch
from adapters.networks.sparse.aggregation import (
    AsymmetricFeedForward,
    CameraFeatures,
    CameraSampling,
    camera_encoder,
    class_branch,
    point_encoder,
    sine_of_points,
)
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.decoder import HEIGHTS_M, at_heights
from adapters.networks.sparse.motion_planner import (
    MotionPlanner,
    MotionPlannerInputs,
    PlannerPredictions,
    interaction_layers,
)

STEPS: Final = 1000
NOISED_AT: Final = 8
"""Plans start with the noise of this step, although the first step of the way back is a later one."""
TIMESTEPS: Final = (20, 0)
"""Of the way back."""
LATERAL_M: Final = 3.0
"""Steps to the side lie between minus this and this."""
BACKWARD_M: Final = 0.5
"""Steps go back by this at most, ..."""
FORWARD_SPAN_M: Final = 8.1
"""... and forward by what is left of this."""


def signal_shares() -> list[float]:
    """Share of the variance that is signal, for every step (Ho et al., 2020, with betas linear in their roots)."""
    betas = torch.linspace(math.sqrt(1e-4), math.sqrt(2e-2), STEPS, dtype=torch.float32) ** 2
    shares: list[float] = (1 - betas).cumprod(0).tolist()
    return shares


SIGNAL_SHARES: Final = tuple(signal_shares())


def normalise(offsets: Tensor) -> Tensor:
    """(..., 2) metres from step to step, x right and y forward, to -1 ... 1; what is longer is cut."""
    x, y = offsets.unbind(-1)
    across = (x / LATERAL_M).clamp(-1, 1)
    along = ((y + BACKWARD_M) / FORWARD_SPAN_M).clamp(0, 1) * 2 - 1
    return torch.stack([across, along], -1)


def denormalise(numbers: Tensor) -> Tensor:
    """The inverse of `normalise`, of what was not cut."""
    x, y = numbers.unbind(-1)
    return torch.stack([x * LATERAL_M, (y + 1) / 2 * FORWARD_SPAN_M - BACKWARD_M], -1)


def add_noise(clean: Tensor, noise: Tensor) -> Tensor:
    """A plan with the noise that all plans start with; both of one shape."""
    share = SIGNAL_SHARES[NOISED_AT]
    return math.sqrt(share) * clean + math.sqrt(1 - share) * noise


def previous_sample(sample: Tensor, clean: Tensor, timestep: int) -> Tensor:
    """Sample one step before, without new noise (DDIM, Song et al., 2021); `clean` is cut to -1 ... 1."""
    share = SIGNAL_SHARES[timestep]
    previous_share = SIGNAL_SHARES[timestep - 1] if timestep > 0 else 1.0
    clean = clean.clamp(-1, 1)
    noise = (sample - math.sqrt(share) * clean) / math.sqrt(1 - share)
    return math.sqrt(previous_share) * clean + math.sqrt(1 - previous_share) * noise


BLOCKS: Final = 2
LAYERS_OF_A_BLOCK: Final = 11
TIME_EXPANSION: Final = 4


class PathSampling(CameraSampling):
    """Features of images along plans, added to the tokens of the plans."""

    def __init__(self, config: SparseConfig, levels: int) -> None:
        super().__init__(config.heads)
        channels = config.channels
        self.camera_encoder = camera_encoder(channels)
        self.weights_fc = nn.Linear(channels, levels * config.steps * len(HEIGHTS_M) * config.heads)
        self.output_proj = nn.Linear(channels, channels)

    def forward(self, tokens: Tensor, offsets: Tensor, cameras: CameraFeatures) -> Tensor:
        """(..., M, C) tokens and (..., M, steps, 2) metres from step to step to (..., M, C)."""
        ground = offsets.cumsum(-2)[..., None, None, :].expand(*offsets.shape[:-1], len(HEIGHTS_M), -1, -1)
        return tokens + self.sample(tokens, at_heights(ground).flatten(-4, -2), cameras)


class Modulation(nn.Module):
    """Tokens scaled and shifted by what the time says."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.scale_shift_mlp = nn.Sequential(nn.Mish(), nn.Linear(channels, 2 * channels))

    def forward(self, tokens: Tensor, time: Tensor) -> Tensor:
        """(..., M, C) tokens and (C,) embedding of the time to (..., M, C)."""
        scale, shift = self.scale_shift_mlp(time).chunk(2, -1)
        result: Tensor = tokens * (1 + scale) + shift
        return result


class PlanRefinement(nn.Module):
    """Plans and how likely they are."""

    def __init__(self, config: SparseConfig) -> None:
        super().__init__()
        self.plan_cls_branch = class_branch(config.channels, 1)
        self.plan_reg_branch = plain_branch(config.channels, config.steps * 2)

    def forward(self, tokens: Tensor) -> tuple[Tensor, Tensor]:
        """(..., M, C) to (..., M) logits and (..., M, steps, 2) metres from step to step."""
        offsets = self.plan_reg_branch(tokens).float().unflatten(-1, (-1, 2))
        return self.plan_cls_branch(tokens)[..., 0].float(), offsets


class TimeEmbedding(nn.Module):
    """Sines, then cosines, of the time at falling frequencies."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.channels = channels

    def forward(self, time: Tensor) -> Tensor:
        """(...) to (..., C)."""
        half = self.channels // 2
        steps = torch.arange(half, device=time.device, dtype=torch.float32)
        angles = time[..., None].float() * torch.exp(steps * (-math.log(10000.0) / (half - 1)))
        return torch.cat([angles.sin(), angles.cos()], -1)


@dataclass(frozen=True, slots=True)
class PlanContext:
    """Context that plans look at; with a leading B where there are several key frames.

    `ego` is the (..., 1, C) embedding of its box; `watched` are features and embeddings of agents, and of the ego in
    the last row; `anchors` (..., M, C) tokens of the anchors that the plans started from.
    """

    cameras: CameraFeatures
    ego: Tensor
    watched: tuple[Tensor, Tensor]
    anchors: Tensor


def denoising_layers(config: SparseConfig, levels: int) -> nn.ModuleList:
    """Layers of the blocks of `DiffusionPlanner.clean`."""
    channels, heads = config.channels, config.heads
    layers: list[nn.Module] = []
    for _ in range(BLOCKS):
        layers += [
            PathSampling(config, levels),
            ResidualAttention(channels, heads),
            nn.LayerNorm(channels),
            ResidualAttention(2 * channels, heads),
            nn.LayerNorm(channels),
            ResidualAttention(channels, heads),
            nn.LayerNorm(channels),
            AsymmetricFeedForward(channels, channels, config.planner_hidden_channels),
            nn.LayerNorm(channels),
            Modulation(channels),
            PlanRefinement(config),
        ]
    return nn.ModuleList(layers)


class DiffusionPlanner(MotionPlanner):
    """Plans for the given driving command only; they stand for all commands in what is returned."""

    def __init__(self, config: SparseConfig, levels: int) -> None:
        layers = {"interact_layers": interaction_layers(config, plans=False)}
        super().__init__(config, layers | {"diff_layers": denoising_layers(config, levels)})
        channels = config.channels
        self.plan_pos_encoder = point_encoder(config.steps * (channels // 2), channels)
        self.time_mlp = nn.Sequential(
            TimeEmbedding(channels),
            nn.Linear(channels, TIME_EXPANSION * channels),
            nn.Mish(),
            nn.Linear(TIME_EXPANSION * channels, channels),
        )
        self.diff_layers: nn.ModuleList

    def forward(self, scene: MotionPlannerInputs, noise: Tensor) -> PlannerPredictions:
        """Forecasts and plans of a key frame, from (modes, steps, 2) standard normal noise."""
        queue = self.instance_queue(scene.past, scene.motion, scene.agents, scene.ids, scene.front)
        interaction = self.interact(scene, queue)
        ego, front = self.add_front(interaction.tokens[-1:], scene.finest_front, scene.front_before)
        context = PlanContext(
            scene.cameras, interaction.embeddings[-1:], interaction.watched, self.plan_queries(ego)[scene.command]
        )
        logits, offsets, steps = self.denoise(context, self.plan_anchor[scene.command], noise)
        motion_logits, motion_offsets = self.forecast(scene.agents, interaction.tokens[:-1])
        status = self.refinement.plan_status_branch(ego)[0].float()
        commands = self.config.commands
        return PlannerPredictions(
            motion_logits,
            motion_offsets,
            logits.expand(commands, -1),
            offsets.expand(commands, -1, -1, -1),
            status,
            queue,
            self.remember(scene, queue, interaction.features[-1:], status, front),
            steps,
            front,
        )

    def denoise(self, context: PlanContext, anchors: Tensor, noise: Tensor) -> tuple[Tensor, Tensor, dict[str, Tensor]]:
        """Put noise on anchors, (..., M, steps, 2) positions in metres, and clean them; no gradients between blocks.

        (..., M) logits; (..., M, steps, 2) metres from step to step; and intermediate results by name.
        """
        clean = normalise(anchors.diff(dim=-2, prepend=torch.zeros_like(anchors[..., :1, :])))
        sample = add_noise(clean, noise)
        logits, offsets = sample.new_zeros(sample.shape[:-2]), anchors
        trace = {"anchors": clean, "noise": noise, "start": sample}
        for step, timestep in enumerate(TIMESTEPS):
            offsets = denormalise(sample.clamp(-1, 1))
            tokens = self.plan_pos_encoder(sine_of_points(offsets, self.config.channels // 2).flatten(-2))
            time = self.time_mlp(torch.tensor(float(timestep), device=tokens.device))
            for block in range(BLOCKS):
                tokens, logits, refined = self.clean(block, tokens, offsets, time, context)
                trace |= {f"logits {block} {step}": logits, f"offsets {block} {step}": refined}
                offsets = refined.detach()
            sample = previous_sample(sample, normalise(offsets), timestep)
            trace[f"sample {step}"] = sample
        return logits, offsets, trace

    def clean(
        self, block: int, tokens: Tensor, offsets: Tensor, time: Tensor, context: PlanContext
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Tokens (..., M, C), logits and (..., M, steps, 2) metres per step after one block; `time` is (C,)."""
        first = block * LAYERS_OF_A_BLOCK
        path, each_other, norm, agents, agents_norm, anchors, anchors_norm, feed, feed_norm, modulate, refine = list(
            self.diff_layers
        )[first : first + LAYERS_OF_A_BLOCK]
        tokens = path(tokens, offsets, context.cameras)
        tokens = norm(each_other(tokens, tokens, tokens, tokens))
        ego = context.ego.expand_as(tokens)
        tokens = agents_norm(self.attend_decoupled(agents, (tokens, ego), context.watched))
        tokens = anchors_norm(anchors(tokens, tokens, context.anchors, context.anchors))
        tokens = modulate(feed_norm(feed(tokens)), time)
        logits, offsets = refine(tokens)
        return tokens, logits, offsets
