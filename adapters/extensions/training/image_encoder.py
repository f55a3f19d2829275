"""Image encoder that all miniatures start from: its training, and its targets cell by cell of each image.

Published networks start from ImageNet or FCOS3D weights; this one learns centres, depth, size and yaw of boxes and
drivable or painted ground from single images (after CenterNet, FCOS3D and inverse perspective mapping).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import cv2
import numpy as np
import torch
import torch.nn.functional as F
from numpy.typing import NDArray
from torch import Tensor, nn

from adapters.camera_inputs import RGB_MEAN_STD
from adapters.extensions.training.frames import DRIVABLE_HALF_M, TrainingFrame
from adapters.networks.layers.front_reader import FRONT
from adapters.networks.layers.resnet import FeaturePyramid, ResNet
from benchmark.constants import DETECTION_CLASSES
from benchmark.geometry import Bools, Floats

CELL_PX: Final = 8
"""Side of the square of pixels that one cell of the coarse maps stands for."""
GROUND_PX: Final = 4
"""The same for the maps of the ground."""
GROUND_KINDS: Final = ("drivable", "divider", "crossing", "boundary")
"""Targets of a ground cell; the last three are lines."""
BOX_NUMBERS: Final = 8
"""Offset of the centre in cells (2), log depth, log length, width, height, sine and cosine of the angle of view."""
NEAREST_M: Final = 1.0
FARTHEST_M: Final = 60.0
"""Depths between which boxes are asked for."""
_DRIVABLE_WITHIN_M: Final = 40.0
_ASIDE_M, _AHEAD_M, _LINE_CELL_M = 15.0, 30.0, 0.2
_LINE_WIDTH_CELLS: Final = 3
_LEAST_SPREAD_CELLS: Final = 0.6
_SHARE_OF_CENTRE: Final = 0.6
_UNIT_CORNERS: Final = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])


@dataclass(frozen=True, slots=True)
class ImageTargets:
    """Targets of C images.

    `heat` (C, classes, h, w) is 1 at centres of boxes and falls around them; `boxes` (C, 8, h, w) are `BOX_NUMBERS` of
    the nearest centre, asked for where `has_box`; `ground` (C, kinds, 2 h, 2 w) is 0 or 1, asked for where
    `sees_ground`.
    """

    heat: NDArray[np.float32]
    boxes: NDArray[np.float32]
    has_box: Bools
    ground: NDArray[np.float32]
    sees_ground: Bools


@dataclass(frozen=True, slots=True)
class _VisibleBoxes:
    """S pairs of image and box, the farthest first; `corner_*` are of the least upright rectangle, pixels.

    `numbers` are (S, 6) log depth, log length, width, height, sine and cosine of the angle of view.
    """

    image: NDArray[np.int64]
    label: NDArray[np.int64]
    centre: Floats
    corner_low: Floats
    corner_high: Floats
    numbers: Floats


def image_targets(frame: TrainingFrame) -> ImageTargets:
    """Targets of the images of a frame."""
    height, width = frame.images.shape[-2:]
    seen_boxes = _find_visible_boxes(frame, width, height)
    heat, boxes, has_box = _box_maps(seen_boxes, len(frame.images), height // CELL_PX, width // CELL_PX)
    ground, sees_ground = _ground_maps(frame, seen_boxes, height // GROUND_PX, width // GROUND_PX)
    return ImageTargets(heat, boxes, has_box, ground, sees_ground)


def front_heat(frame: TrainingFrame) -> NDArray[np.float32]:
    """Centres of boxes in the front camera's image alone: (classes, h, w) as `ImageTargets.heat`."""
    front = replace(frame, images=frame.images[FRONT : FRONT + 1], lidar2img=frame.lidar2img[FRONT : FRONT + 1])
    height, width = frame.images.shape[-2:]
    heat, _, _ = _box_maps(_find_visible_boxes(front, width, height), 1, height // CELL_PX, width // CELL_PX)
    return np.asarray(heat[0], np.float32)


def _find_visible_boxes(frame: TrainingFrame, width: int, height: int) -> _VisibleBoxes:
    boxes = frame.boxes.double().cpu().numpy()
    matrices = frame.lidar2img.numpy()
    cos, sin = np.cos(boxes[:, 6]), np.sin(boxes[:, 6])
    turns = np.zeros((len(boxes), 3, 3))
    turns[:, 0, 0], turns[:, 0, 1], turns[:, 1, 0], turns[:, 1, 1], turns[:, 2, 2] = cos, -sin, sin, cos, 1
    corners = np.einsum("nij,nkj->nki", turns, _UNIT_CORNERS * boxes[:, None, 3:6]) + boxes[:, None, :3]
    points = np.concatenate([boxes[:, None, :3], corners], axis=1)
    projected = np.einsum("cij,nkj->cnki", matrices[:, :3, :3], points) + matrices[:, None, None, :3, 3]
    depth = projected[..., 2]
    pixels = projected[..., :2] / np.maximum(depth, 1e-3)[..., None]
    centre = pixels[:, :, 0]
    inside = ((centre >= 0) & (centre < [width, height])).all(-1)
    visible = inside & (depth[:, :, 0] > NEAREST_M) & (depth[:, :, 0] < FARTHEST_M) & (depth.min(-1) > 0.2)
    image, box = np.nonzero(visible)
    order = np.argsort(-depth[image, box, 0], kind="stable")
    image, box = image[order], box[order]
    eyes = -np.linalg.solve(matrices[:, :3, :3], matrices[:, :3, 3:])[..., 0]
    ray = boxes[box, :2] - eyes[image, :2]
    angle = boxes[box, 6] - np.arctan2(ray[:, 1], ray[:, 0])
    numbers = np.column_stack(
        [np.log(depth[image, box, 0]), np.log(np.maximum(boxes[box, 3:6], 1e-2)), np.sin(angle), np.cos(angle)]
    )
    outline = pixels[image, box, 1:].clip([0, 0], [width, height])
    label = frame.labels.cpu().numpy()[box]
    return _VisibleBoxes(image, label, centre[image, box], outline.min(1), outline.max(1), numbers)


def _box_maps(
    seen_boxes: _VisibleBoxes, images: int, rows: int, columns: int
) -> tuple[NDArray[np.float32], NDArray[np.float32], Bools]:
    heat = np.zeros((images, len(DETECTION_CLASSES), rows, columns), np.float32)
    boxes = np.zeros((images, BOX_NUMBERS, rows, columns), np.float32)
    has_box = np.zeros((images, rows, columns), bool)
    across, down = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    for number in range(len(seen_boxes.image)):
        centre = seen_boxes.centre[number] / CELL_PX
        size = (seen_boxes.corner_high[number] - seen_boxes.corner_low[number]) / CELL_PX
        spread = np.maximum(size / 6, _LEAST_SPREAD_CELLS)
        # Measured from the middle of the cell that holds the centre, so that there is a cell of 1.
        middle = np.floor(centre) + 0.5
        bump = np.exp(-(((across - middle[0]) / spread[0]) ** 2 + ((down - middle[1]) / spread[1]) ** 2) / 2)
        image, label = seen_boxes.image[number], seen_boxes.label[number]
        np.maximum(heat[image, label], bump, out=heat[image, label])
        near = bump >= _SHARE_OF_CENTRE
        boxes[image, 0][near] = (centre[0] - across)[near]
        boxes[image, 1][near] = (centre[1] - down)[near]
        boxes[image, 2:, near] = seen_boxes.numbers[number]
        has_box[image] |= near
    return heat, boxes, has_box


def _ground_maps(
    frame: TrainingFrame, seen_boxes: _VisibleBoxes, rows: int, columns: int
) -> tuple[NDArray[np.float32], Bools]:
    """Kinds of ground where rays through the cells meet it; asked for where no box is in the way."""
    matrices = frame.lidar2img.numpy()
    inverse = np.linalg.inv(matrices[:, :3, :3])
    eyes = -np.einsum("cij,cj->ci", inverse, matrices[:, :3, 3])
    across, down = np.meshgrid((np.arange(columns) + 0.5) * GROUND_PX, (np.arange(rows) + 0.5) * GROUND_PX)
    pixels = np.stack([across, down, np.ones_like(across)], -1)
    rays = np.einsum("cij,hwj->chwi", inverse, pixels)
    ground_z_m = -float(frame.global_T_lidar[2, 3])
    falls = rays[..., 2] < -1e-6
    reach = (ground_z_m - eyes[:, None, None, 2]) / np.where(falls, rays[..., 2], -1.0)
    points = eyes[:, None, None, :2] + reach[..., None] * rays[..., :2]
    falls &= reach > 0
    for number in range(len(seen_boxes.image)):
        low = np.floor(seen_boxes.corner_low[number] / GROUND_PX).astype(int)
        high = np.ceil(seen_boxes.corner_high[number] / GROUND_PX).astype(int)
        falls[seen_boxes.image[number], low[1] : high[1], low[0] : high[0]] = False
    near = falls & (np.abs(points) < _DRIVABLE_WITHIN_M).all(-1)
    within = falls & (np.abs(points[..., 0]) < _ASIDE_M) & (np.abs(points[..., 1]) < _AHEAD_M)
    drivable = frame.drivable.cpu().numpy()
    cell_m = 2 * DRIVABLE_HALF_M / len(drivable)
    kinds = [_look_up(drivable, points, -DRIVABLE_HALF_M, -DRIVABLE_HALF_M, cell_m)]
    kinds += [_look_up(lines, points, -_ASIDE_M, -_AHEAD_M, _LINE_CELL_M) for lines in _line_rasters(frame)]
    sees = np.stack([near, within, within, within], axis=1)
    return (np.stack(kinds, axis=1) & sees).astype(np.float32), sees


def _look_up(raster: Bools, points: Floats, low_x_m: float, low_y_m: float, cell_m: float) -> Bools:
    rows, columns = raster.shape
    column = np.floor((points[..., 0].clip(-100, 100) - low_x_m) / cell_m).astype(np.int64).clip(0, columns - 1)
    row = np.floor((points[..., 1].clip(-100, 100) - low_y_m) / cell_m).astype(np.int64).clip(0, rows - 1)
    return np.asarray(raster[row, column])


def _line_rasters(frame: TrainingFrame) -> list[Bools]:
    """Cells that the dividers, the crossings and the boundaries pass through; rows along y, columns along x."""
    size = (round(2 * _AHEAD_M / _LINE_CELL_M), round(2 * _ASIDE_M / _LINE_CELL_M))
    places = np.rint((frame.lines.double().cpu().numpy() + [_ASIDE_M, _AHEAD_M]) / _LINE_CELL_M - 0.5).astype(np.int32)
    rasters = []
    for kind in range(len(GROUND_KINDS) - 1):
        drawn = np.zeros(size, np.uint8)
        cv2.polylines(drawn, list(places[frame.line_labels.cpu().numpy() == kind]), False, (1,), _LINE_WIDTH_CELLS)
        rasters.append(drawn > 0)
    return rasters


BLOCKS = (1, 1, 1, 1)
WIDTH = 16
"""Residual blocks of each stage and channels after the first convolution, of all miniatures."""
_STAGES = (1, 2, 3)
_CHANNELS = 64
_LINE_WEIGHT = 4.0
RARE = -4.0
"""Bias of outputs that are nearly always 0: their sigmoid begins at 0.018."""


def miniature_images(images: Tensor) -> Tensor:
    """Images, (..., 3, H, W) uint8, red green blue, as miniatures read them: float32, normalised (`RGB_MEAN_STD`)."""
    mean = torch.tensor(RGB_MEAN_STD.mean, device=images.device)[:, None, None]
    std = torch.tensor(RGB_MEAN_STD.std, device=images.device)[:, None, None]
    return (images.float() - mean) / std


class ImageEncoder(nn.Module):
    """A residual network with a head that is thrown away after training."""

    def __init__(self) -> None:
        super().__init__()
        self.img_backbone = ResNet(BLOCKS, _STAGES, WIDTH)
        inputs = [4 * WIDTH * 2**stage for stage in _STAGES]
        self.pyramid = FeaturePyramid(inputs, _CHANNELS, len(inputs))
        self.shared = nn.Conv2d(_CHANNELS, _CHANNELS, 3, padding=1)
        self.heat = nn.Conv2d(_CHANNELS, len(DETECTION_CLASSES), 1)
        self.boxes = nn.Conv2d(_CHANNELS, BOX_NUMBERS, 1)
        self.ground = nn.Conv2d(_CHANNELS, 4 * len(GROUND_KINDS), 1)
        with torch.no_grad():
            for rare in (self.heat, self.ground):
                # Much of the ground is drivable, little of it is a line.
                bias = next(value for name, value in rare.named_parameters() if name == "bias")
                bias[4 if rare is self.ground else 0 :] = RARE

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Centre logits and box numbers at 1/8 of the size of normalised images, and ground logits at 1/4."""
        features = F.relu(self.shared(self.pyramid(self.img_backbone(images))[0]))
        return self.heat(features), self.boxes(features), F.pixel_shuffle(self.ground(features), 2)


class ImageEncoderObjective:
    """Objective of the image encoder; clips are of any frames and only give the normalisation its statistics."""

    clip_frames = 4

    def __init__(self, network: ImageEncoder) -> None:
        self.network = network

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """Losses of frames that need not belong together; about half of them are mirrored."""
        # The networks keep their statistics still; these are the weights that the statistics come from.
        for module in self.network.img_backbone.modules():
            if isinstance(module, nn.BatchNorm2d):
                module.training = True
        device = next(self.network.parameters()).device
        images = torch.cat([frame.images for frame in clip])
        targets = [image_targets(frame) for frame in clip]
        by_name = {
            name: torch.from_numpy(_join_targets(targets, name)).to(device)
            for name in ImageTargets.__dataclass_fields__
        }
        mirrored = torch.rand(len(images)) < 0.5
        images, by_name = _mirror(images, by_name, mirrored.to(device))
        brightness = torch.empty(len(images), 1, 1, 1).uniform_(-0.3, 0.3).to(device)
        contrast = torch.empty(len(images), 1, 1, 1).uniform_(0.8, 1.2).to(device)
        heat, boxes, ground = self.network(miniature_images(images) * contrast + brightness)
        return _losses(heat, boxes, ground, by_name)


def _join_targets(targets: Sequence[ImageTargets], name: str) -> NDArray[np.generic]:
    return np.concatenate([getattr(target, name) for target in targets])


def _losses(heat: Tensor, boxes: Tensor, ground: Tensor, targets: dict[str, Tensor]) -> dict[str, Tensor]:
    has_box = targets["has_box"][:, None]
    count = float(has_box.sum().clamp(min=1))
    error = (boxes - targets["boxes"]).abs() * has_box
    entropy = F.binary_cross_entropy_with_logits(ground, targets["ground"], reduction="none")
    weight = torch.where(targets["ground"] > 0, _LINE_WEIGHT, 1.0)
    weight[:, 0] = 1.0
    counted = targets["sees_ground"] * weight
    return {
        "heat": centre_loss(heat, targets["heat"]),
        "place": 0.5 * error[:, :2].sum() / count,
        "depth": error[:, 2].sum() / count,
        "size": 0.5 * error[:, 3:6].sum() / count,
        "turn": 0.5 * error[:, 6:].sum() / count,
        "ground": 2.0 * (entropy * counted).sum() / counted.sum().clamp(min=1),
    }


def centre_loss(logits: Tensor, heat: Tensor) -> Tensor:
    """Focal loss, per centre, that forgives what is near a centre (CornerNet, ECCV 2018); `heat` is 1 at centres."""
    shares = logits.sigmoid()
    centres = heat >= 1
    positive = -F.logsigmoid(logits) * (1 - shares) ** 2 * centres
    negative = -F.logsigmoid(-logits) * shares**2 * (1 - heat) ** 4 * ~centres
    return (positive + negative).sum() / centres.sum().clamp(min=1)


def _mirror(images: Tensor, targets: dict[str, Tensor], chosen: Tensor) -> tuple[Tensor, dict[str, Tensor]]:
    """Left and right exchanged in the chosen images and in what is asked of them."""
    flipped = {name: value.flip(-1) for name, value in targets.items()}
    # The offset to the right and the angle of view turn round.
    sign = torch.ones(BOX_NUMBERS, device=images.device)
    sign[[0, 6]] = -1
    flipped["boxes"] = flipped["boxes"] * sign[:, None, None]
    mixed = {}
    for name, value in targets.items():
        mixed[name] = torch.where(chosen.view(-1, *[1] * (value.dim() - 1)), flipped[name], value)
    return torch.where(chosen[:, None, None, None], images.flip(-1), images), mixed
