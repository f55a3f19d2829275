"""Initial sparse miniatures: random weights, and anchors fitted to the training data."""

from collections.abc import Callable, Iterable, Mapping
from functools import partial
from typing import Final, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from adapters.extensions.training.frames import TrainingFrame
from adapters.extensions.training.front import add_front_backbone
from adapters.extensions.training.sparse.targets import FARTHEST_M
from adapters.networks.sparse.aggregation import CameraSampling
from adapters.networks.sparse.anchors import AnchorSamples, cluster_anchors
from adapters.networks.sparse.boxes import BoxRefinement
from adapters.networks.sparse.config import SparseConfig
from adapters.networks.sparse.decoder import LineRefinement
from adapters.networks.sparse.model import DiffusionDrive, SparseDrive, SparseNetwork
from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed

SAMPLED_GAIN: Final = 6.0
"""Samples are averaged over all cameras, of which one or two see anything."""
EGO_GAIN: Final = 3.0
"""Of each of the two convolutions that see for the ego; their normalisation stays as it is."""
PLACE_SPREAD: Final = 8.0
SPEED_SPREAD: Final = 5.0
"""Of the biases in front of the first normalisation of places and speeds, which would take all but their directions."""
INITIAL_SCORE: Final = 0.05
"""Score of all instances before anything has been learned."""
Network = TypeVar("Network", bound=SparseNetwork)


def build_untrained(config: SparseConfig, frames: Iterable[TrainingFrame], seed: int) -> SparseDrive:
    """Untrained SparseDrive: random weights, and anchors from a few hundred frames of the training data at least."""
    return _build_untrained(SparseDrive, config, frames, seed)


def build_untrained_diffusion(config: SparseConfig, frames: Iterable[TrainingFrame], seed: int) -> DiffusionDrive:
    """A DiffusionDrive before its training; arguments as of `build_untrained`, the seed is that of its noise too."""
    return _build_untrained(partial(DiffusionDrive, seed=seed), config, frames, seed)


def _build_untrained(
    make: Callable[[SparseConfig], Network], config: SparseConfig, frames: Iterable[TrainingFrame], seed: int
) -> Network:
    anchors = cluster_anchors(collect_anchor_samples_in(frames, config), config)
    with torch.random.fork_rng(devices=()):
        torch.manual_seed(content_seed("sparse miniature", seed))
        network = make(config)
        initialise(network)
    network.load_state_dict(anchors, strict=False)
    return network


def initialise(network: SparseNetwork) -> None:
    """First values that keep tokens apart and let them show the images; the head is drawn at random, anchors stay."""
    for name, parameter in network.head.named_parameters():
        if parameter.dim() > 1 and parameter.requires_grad and "instance_bank" not in name:
            nn.init.xavier_uniform_(parameter)
    with torch.no_grad():
        for name, module in network.head.named_modules():
            if isinstance(module, CameraSampling):
                module.output_proj.weight.mul_(SAMPLED_GAIN)
            elif isinstance(module, nn.Conv2d) and ".front_reader." not in f".{name}.":
                module.weight.mul_(EGO_GAIN)
    boxes, lines = network.head.det_head.anchor_encoder, network.head.map_head.anchor_encoder
    for layers, spread in ((boxes.pos_fc, PLACE_SPREAD), (boxes.vel_fc, SPEED_SPREAD), (lines.pos_fc, PLACE_SPREAD)):
        assert isinstance(layers, nn.Sequential) and isinstance(layers[0], nn.Linear)
        nn.init.uniform_(layers[0].bias, -spread, spread)
    reader = network.head.motion_plan_head.front_reader
    if reader is not None:
        reader.zero_message()
    unlikely = float(np.log(INITIAL_SCORE / (1 - INITIAL_SCORE)))
    for decoder in (network.head.det_head, network.head.map_head):
        for layer in decoder.layers:
            if isinstance(layer, BoxRefinement | LineRefinement):
                last = layer.cls_layers[-1]
                assert isinstance(last, nn.Linear)
                nn.init.constant_(last.bias, unlikely)


def transfer_from_sparsedrive(trunk: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Weights of a SparseDrive for DiffusionDrive: all but plans, with first front eyes (`add_front_backbone`)."""
    renamed = {
        name.replace("motion_plan_head.layers.", "motion_plan_head.interact_layers."): value
        for name, value in trunk.items()
    }
    shared = {
        name: value
        for name, value in renamed.items()
        if ".plan_cls_branch." not in name and ".plan_reg_branch." not in name
    }
    return add_front_backbone(shared)


def collect_anchor_samples_in(frames: Iterable[TrainingFrame], config: SparseConfig) -> AnchorSamples:
    """Sightings in training frames: boxes and lines within reach, futures and plans that are known to their ends."""
    boxes, lines = [np.zeros((0, 3))], [np.zeros((0, 2))]
    futures: list[list[Floats]] = [[np.zeros((0, config.agent_steps, 2))] for _ in range(config.agent_classes)]
    plans: list[list[Floats]] = [[np.zeros((0, config.steps, 2))] for _ in range(config.commands)]
    for frame in frames:
        centres = frame.boxes[:, :3].double().numpy()
        boxes.append(centres[np.hypot(centres[:, 0], centres[:, 1]) <= FARTHEST_M])
        lines.append(frame.lines.double().mean(1).numpy())
        known = frame.futures_valid.all(1)
        paths = _to_agent_frames(frame.boxes[known].double(), frame.futures[known].double())
        for kind, path in zip(frame.labels[known].tolist(), paths.numpy(), strict=True):
            futures[kind].append(path[None])
        if bool(frame.ego_future_valid.all()):
            plans[frame.command].append(frame.ego_future.double().numpy()[None])
    return AnchorSamples(
        box_centres=np.concatenate(boxes),
        line_centres=np.concatenate(lines),
        futures=[np.concatenate(parts) for parts in futures],
        plans=[np.concatenate(parts) for parts in plans],
    )


def _to_agent_frames(boxes: Tensor, futures: Tensor) -> Tensor:
    """(N, 9) boxes and (N, T, 3) futures to (N, T, 2) positions in the frames of the agents, x forward."""
    along, across = (futures[..., :2] - boxes[:, None, :2]).unbind(-1)
    sine, cosine = boxes[:, 6:7].sin(), boxes[:, 6:7].cos()
    return torch.stack([cosine * along + sine * across, cosine * across - sine * along], -1)
