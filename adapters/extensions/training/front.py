"""Front-camera pretraining of miniatures (where their lane is), and first weights of the plan's own backbone."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn

from adapters.extensions.training.dense_targets import LANE_NUMBERS, lane_loss
from adapters.extensions.training.frames import TrainingFrame
from adapters.extensions.training.image_encoder import RARE, centre_loss, front_heat, miniature_images
from adapters.extensions.training.losses import lateral_loss
from adapters.extensions.training.trainer import Phase, Recipe
from adapters.networks.layers.front_reader import FRONT, FrontReader
from benchmark.constants import DETECTION_CLASS_OF_CATEGORY, DETECTION_CLASSES, VEHICLE_CATEGORIES
from benchmark.planning import Command

GAP_UNIT_M: Final = 10.0
FARTHEST_GAP_M: Final = 40.0
"""Metres of a number's 1, and beyond which nothing ahead matters yet."""
OWN_HALF_WIDTH_M: Final = 1.0
STANDING_M: Final = 0.05
"""Motion in half a second below which an object counts as standing."""
STRIPS_M: Final = (-6.0, -3.0, -1.0, 1.0, 3.0, 6.0)
"""Edges of the strips along the ego, to its right, in each of which the nearest walker matters."""
WALKER_REACH_M: Final = 25.0
"""Walkers farther ahead than this do not matter yet."""
WEIGHTS: Final = {"lane": 1.0, "ahead": 3.0, "gap": 1.0, "walkers": 5.0}
"""Weights of the losses of the front readings."""
HEAT_WEIGHT: Final = 0.3
"""Weight of the loss of the front encoder's maps."""
RARE_WALKER: Final = 4.0
"""Extra weight of a strip with a pedestrian in it: most are empty."""
_WALKER: Final = DETECTION_CLASSES.index("pedestrian")
_VEHICLES: Final = tuple(
    DETECTION_CLASSES.index(name)
    for name in dict.fromkeys(DETECTION_CLASS_OF_CATEGORY.get(category) for category in VEHICLE_CATEGORIES)
    if name is not None
)
HEAT_CLASSES: Final = ((_WALKER,), _VEHICLES)
"""Classes of what the first channels of own eyes' maps stand for."""


@dataclass(frozen=True, slots=True)
class FrontEncoder:
    """Encoder of the map of the front camera that a plan looks at.

    `encode` takes normalised images (B, 3, H, W) to maps (B, channels, h, w). If it is the plan's `own`, the first
    channels have to say where things are (`object_heat_loss`).
    """

    encode: Callable[[Tensor], Tensor]
    own: bool = False


class FrontObjective:
    """`frames.Objective` for what the plan takes from the front camera: where lines are ahead.

    A whole frame of the network costs fifty times one image, and four frames a step learn this too slowly.
    """

    clip_frames = 32

    def __init__(self, network: nn.Module, reader: FrontReader, eyes: FrontEncoder) -> None:
        self.network, self.reader, self._eyes = network, reader, eyes

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """Weighted mean `front_losses` of unrelated frames at random brightness, and ``things`` where maps say them."""
        images = miniature_images(torch.stack([frame.images[FRONT] for frame in clip]))
        brightness = torch.empty(len(images), 1, 1, 1, device=images.device).uniform_(-0.3, 0.3)
        contrast = torch.empty(len(images), 1, 1, 1, device=images.device).uniform_(0.8, 1.2)
        images = images * contrast + brightness
        maps = self._eyes.encode(images.contiguous(memory_format=torch.channels_last))
        losses = mean_front_losses(self.reader(maps), clip)
        return losses | {"things": HEAT_WEIGHT * object_heat_loss(maps, clip)} if self._eyes.own else losses


def shared_front_encoder(network: nn.Module, kept: tuple[str, ...]) -> FrontEncoder:
    """Finest map of the all-camera encoder; `img_backbone` and `img_neck` names that begin with `kept` stay frozen."""
    backbone, neck = network.get_submodule("img_backbone"), network.get_submodule("img_neck")
    for name, parameter in neck.named_parameters():
        if name.startswith(kept):
            parameter.requires_grad_(False)

    def see(images: Tensor) -> Tensor:
        with torch.no_grad():
            stages = backbone(images)
        features: Tensor = neck(stages)[0]
        return features

    return FrontEncoder(see)


def object_heat_loss(seen: Tensor, frames: Sequence[TrainingFrame]) -> Tensor:
    """`centre_loss` of walkers and of vehicles per mean frame; (F, channels, h, w) maps begin with their logits."""
    heats = torch.from_numpy(np.stack([front_heat(frame) for frame in frames])).to(seen.device)
    targets = torch.stack([heats[:, list(kinds)].amax(1) for kinds in HEAT_CLASSES], 1)
    return centre_loss(seen[:, : len(HEAT_CLASSES)], targets)


def mean_front_losses(said: Tensor, frames: Sequence[TrainingFrame]) -> dict[str, Tensor]:
    """`front_losses` of F key frames, from (F, numbers): weighted means over the frames."""
    frame_losses = [front_losses(numbers, frame) for numbers, frame in zip(said, frames, strict=True)]
    return {
        name: weight * torch.stack([losses[name] for losses in frame_losses]).mean() for name, weight in WEIGHTS.items()
    }


def front_losses(front: Tensor, frame: TrainingFrame) -> dict[str, Tensor]:
    """Losses ``lane``, ``ahead``, ``gap``, ``walkers`` of the first numbers that plans take from the front camera.

    `front` holds metres to lines left and right (`lane_loss`), metres to the right at each step of driving straight
    on, room ahead in `GAP_UNIT_M`, and walkers' nearness by strip (`walkers_ahead`). ``ahead``, in squared metres, is 0
    where the command is to turn, ``gap`` where it is not known which way the ego goes; ``walkers`` are squares.
    """
    steps = len(frame.ego_future)
    aside, predicted_gap = front[LANE_NUMBERS : LANE_NUMBERS + steps], front[LANE_NUMBERS + steps]
    walkers, nearness = front[LANE_NUMBERS + steps + 1 :][: len(STRIPS_M) - 1], walkers_ahead(frame)
    counted = frame.ego_future_valid & (frame.command == Command.STRAIGHT)
    gap_m = gap_ahead(frame)
    return {
        "gap": predicted_gap * 0 if gap_m is None else (predicted_gap - gap_m / GAP_UNIT_M).abs(),
        "lane": lane_loss(front[:LANE_NUMBERS], frame),
        "ahead": lateral_loss(aside, frame.ego_future[:, 0], counted),
        "walkers": ((walkers - nearness).square() * (1 + RARE_WALKER * (nearness > 0))).sum(),
    }


def walkers_ahead(frame: TrainingFrame) -> Tensor:
    """(strips,) nearness of the nearest walker ahead along the ego: 1 beside the lidar, 0 from `WALKER_REACH_M` on."""
    right, ahead = frame.boxes[frame.labels == _WALKER, :2].unbind(-1)
    edges = frame.boxes.new_tensor(STRIPS_M)
    inside = (right >= edges[:-1, None]) & (right < edges[1:, None]) & (ahead > 0)
    nearness = (1 - ahead / WALKER_REACH_M).clamp(min=0) * inside
    return torch.cat([nearness, nearness.new_zeros(len(nearness), 1)], 1).amax(1)


def gap_ahead(frame: TrainingFrame) -> float | None:
    """Metres from the lidar along the ego's way to the nearest box now, up to `FARTHEST_GAP_M`; ``None`` if unknown."""
    if not frame.ego_future_valid.all():
        return None
    way = torch.cat([torch.zeros(1, 2), frame.ego_future])
    far = way[-1] - way[-2] if float((way[-1] - way[-2]).norm()) > STANDING_M else torch.tensor([0.0, 1.0])
    way = torch.cat([way, way[-1:] + FARTHEST_GAP_M * far / far.norm()])
    pieces = way.diff(dim=0)
    lengths = pieces.norm(dim=-1)
    moving = lengths > STANDING_M
    starts, pieces, lengths = way[:-1][moving], pieces[moving], lengths[moving]
    begun = lengths.cumsum(0) - lengths
    to_boxes = frame.boxes[:, None, :2] - starts
    along = ((to_boxes * pieces).sum(-1) / lengths).clamp(min=0).minimum(lengths)
    beside = (to_boxes - along[..., None] * (pieces / lengths[:, None])).norm(dim=-1)
    nearest = beside.argmin(1)
    rows = torch.arange(len(frame.boxes))
    station = (begun + along)[rows, nearest]
    # A box of any heading is as wide as its width and as long as its length: near enough for what is driven behind.
    on_way = (beside[rows, nearest] < OWN_HALF_WIDTH_M + frame.boxes[:, 4] / 2) & (station > STANDING_M)
    gaps = (station - frame.boxes[:, 3] / 2)[on_way]
    return min(FARTHEST_GAP_M, max(0.0, float(gaps.min()))) if len(gaps) else FARTHEST_GAP_M


def front_phase(reader_of: Callable[[Any], FrontReader | None], eyes_of: Callable[[Any], FrontEncoder]) -> Phase:
    """First training phase of a miniature whose plan sees the front camera; `eyes_of` may freeze parameters."""

    def objective(network: Any) -> FrontObjective:
        reader = reader_of(network)
        assert reader is not None, "a network whose plan sees the front camera"
        return FrontObjective(network, reader, eyes_of(network))

    recipe = Recipe(steps=2000, learning_rate=1e-3, warmup=50, average=0.99, scattered=True)
    return Phase("front", objective, recipe)


FRONT_BACKBONE_PREFIX: Final = "front_eyes."
"""How the names of their layers begin, in all networks."""
SHARED_LAYER_PREFIXES: Final = {
    "img_backbone.": f"{FRONT_BACKBONE_PREFIX}backbone.",
    "img_neck.lateral_convs.0.conv.": f"{FRONT_BACKBONE_PREFIX}fine.",
    "img_neck.lateral_convs.1.conv.": f"{FRONT_BACKBONE_PREFIX}coarse.",
    "img_neck.fpn_convs.0.conv.": f"{FRONT_BACKBONE_PREFIX}joined.",
}
"""How names of layers begin that own eyes start from, and of theirs."""
SPARSE_READER_PREFIX: Final = "head.motion_plan_head.front_reader."
"""How the names begin of what reads their map in the sparse miniatures."""
MESSAGE_LAYER_PREFIX: Final = "tell"
"""How names go on of what tells the plan of it: the numbers are those of one plan, and mean nothing to another."""


def add_front_backbone(trunk: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Add front eyes to a trunk: copies of the layers that made its maps, with object logits that see nothing."""
    if any(name.startswith(FRONT_BACKBONE_PREFIX) for name in trunk):
        return dict(trunk)
    eyes = {
        begun + name.removeprefix(learned): value.clone()
        for name, value in trunk.items()
        for learned, begun in SHARED_LAYER_PREFIXES.items()
        if name.startswith(learned)
    }
    for part, least in (("weight", 0.0), ("bias", RARE)):
        joined = eyes.get(f"{FRONT_BACKBONE_PREFIX}joined.{part}")
        if joined is not None:
            joined[: len(HEAT_CLASSES)] = least
    return dict(trunk) | eyes


def transfer_sparse_front_backbone(trunk: Mapping[str, Tensor], reader: str) -> dict[str, Tensor]:
    """Front eyes and reader of a sparse miniature under the prefix `reader`; empty if the trunk has no such eyes."""
    read = {
        reader + name.removeprefix(SPARSE_READER_PREFIX): value
        for name, value in trunk.items()
        if name.startswith(SPARSE_READER_PREFIX)
        and not name.startswith(f"{SPARSE_READER_PREFIX}{MESSAGE_LAYER_PREFIX}")
    }
    eyes = {name: value for name, value in trunk.items() if name.startswith(FRONT_BACKBONE_PREFIX)}
    return eyes | read if eyes and read else {}
