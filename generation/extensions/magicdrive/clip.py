"""One clip of a scene as MagicDriveDiT is told about it, before chance is drawn; boxes with identities (4.2 and 9)."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.constants import DETECTION_CLASS_OF_CATEGORY, DETECTION_CLASSES, FRAME_HZ
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats, quaternion_from_yaw, rotation_matrix
from benchmark.scene import Scene
from generation.extensions.magicdrive.bev_map import MAP_CELLS, draw_clip_maps
from generation.extensions.magicdrive.conditions import ABSENT_CLASS, ClipConditions, TextStates
from generation.extensions.magicdrive.prompt import Prompt, PromptLook, build_prompt
from generation.extensions.magicdrive.sensor_frames import SensorFrames, compute_camera_parameters, compute_ego_motion

_NEARLY_PARALLEL = 1.0 - 1e-9


@dataclass(frozen=True, slots=True)
class BoxTracks:
    """(N, T, ...) centres, quaternions and length, width, height in metres of N objects at T frames, global frame."""

    position: Floats
    rotation: Floats
    size: Floats
    valid: Bools


def build_box_tracks(scene: Scene, frames: NDArray[np.int64]) -> BoxTracks:
    """Boxes at (T,) frames of a scene, in the order of ``scene.agents``.

    A recording with sweeps of its own has boxes at keyframes only; those in between are interpolated. What was
    simulated (a scene of ours, and every adversary) is known at 12 Hz and taken as it is.
    """
    agents = scene.agents
    tracks = BoxTracks(
        position=agents.position[:, frames],
        rotation=quaternion_from_yaw(agents.yaw[:, frames]),
        size=np.repeat(agents.size[:, None], len(frames), axis=1),
        valid=agents.valid[:, frames],
    )
    if scene.sweep_poses is None:
        return tracks
    between = interpolate_annotations(scene, frames)
    simulated = np.array([name in scene.adversaries for name in agents.ids], dtype=np.bool_)
    for item in fields(BoxTracks):
        getattr(between, item.name)[simulated] = getattr(tracks, item.name)[simulated]
    return between


def interpolate_annotations(scene: Scene, frames: NDArray[np.int64]) -> BoxTracks:
    """Boxes of objects that are annotated at both keyframes around each of (T,) frames.

    Centres lie on straight lines, rotations on great arcs, at the fraction of frames passed since the earlier keyframe;
    sizes are those of the earlier keyframe.
    """
    annotations, keyframes = scene.annotations, scene.keyframes
    left = np.clip(np.searchsorted(keyframes, frames, side="right") - 1, 0, len(keyframes) - 1)
    right = np.minimum(left + 1, len(keyframes) - 1)
    fraction = (frames - keyframes[left]) / np.maximum(keyframes[right] - keyframes[left], 1)
    valid = annotations.valid[:, left] & (annotations.valid[:, right] | (fraction == 0.0))
    start, end = annotations.position[:, left], annotations.position[:, right]
    return BoxTracks(
        position=start + fraction[:, None] * (end - start),
        rotation=slerp(annotations.rotation[:, left], annotations.rotation[:, right], fraction),
        size=annotations.size[:, left],
        valid=valid,
    )


def slerp(first: Floats, second: Floats, fraction: Floats) -> Floats:
    """Slerp of (..., 4) quaternions, normalised here, on the shorter great arc; ``fraction``, (...), is broadcast."""
    first = np.asarray(first, np.float64) / np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.asarray(second, np.float64) / np.linalg.norm(second, axis=-1, keepdims=True)
    cosine = (first * second).sum(axis=-1, keepdims=True)
    # A quaternion and its negative are the same rotation; the nearer of the two is meant.
    second, cosine = np.where(cosine < 0.0, -second, second), np.minimum(np.abs(cosine), 1.0)
    share = np.asarray(fraction, np.float64)[..., None]
    angle = np.arccos(cosine)
    # On a very short arc the chord is as good, and the sine below does not vanish.
    safe = np.where(cosine > _NEARLY_PARALLEL, 1.0, np.sin(angle))
    on_chord = (1.0 - share) * first + share * second
    on_arc = (np.sin((1.0 - share) * angle) * first + np.sin(share * angle) * second) / safe
    between = np.where(cosine > _NEARLY_PARALLEL, on_chord, on_arc)
    return np.asarray(between / np.linalg.norm(between, axis=-1, keepdims=True))


_CLASS_OF_ADVERSARY: Final = {"vehicle.emergency.police": "car", "vehicle.emergency.ambulance": "truck"}
"""Stand-in classes: without them the model would not draw these adversaries, and the scene would be worthless."""
# Front, left, up of each corner as signs; faces right and left, each from the front bottom edge over the top.
_CORNER_SIGNS: Final = np.array(
    [(1, -1, 0), (1, -1, 1), (-1, -1, 1), (-1, -1, 0), (1, 1, 0), (1, 1, 1), (-1, 1, 1), (-1, 1, 0)], np.float64
)


@dataclass(frozen=True, slots=True)
class ClipBoxes:
    """Boxes of a clip; n slots, one for each object that appears in it, in the order of their names.

    `corners` and `true_corners` are (T, n, 8, 3) metres, lidar frame of the frame, 0 where the object is absent; the
    former half a height too high, as in the model's training. `classes` (T, n) index `DETECTION_CLASSES`, -1 where
    absent; `masks` (V, T, n) are 1 where any true corner lies in front of the lens. `ids` is empty where the one slot
    is padding.
    """

    ids: tuple[str, ...]
    corners: NDArray[np.float32]
    true_corners: NDArray[np.float32]
    classes: NDArray[np.int64]
    masks: NDArray[np.int64]

    @property
    def present(self) -> Bools:
        """(T, n) whether the object is there."""
        return np.asarray(self.classes != ABSENT_CLASS)


def build_clip_boxes(scene: Scene, frames: NDArray[np.int64], sensors: SensorFrames) -> ClipBoxes:
    """Boxes of all objects that the model can draw, adversaries among them, at (T,) frames; else one absent box."""
    tracks = build_box_tracks(scene, frames)
    classes = [_find_class_index(scene, index) for index in range(len(scene.agents))]
    shown = [
        index
        for index in sorted(range(len(scene.agents)), key=lambda index: scene.agents.ids[index])
        if classes[index] is not None and tracks.valid[index].any()
    ]
    if not shown:
        return _build_padding(len(frames), len(sensors.cameras))
    valid = tracks.valid[shown].T
    centre, yaw = transform_to_lidar_frame(tracks, shown, sensors.lidar)
    size = tracks.size[shown].transpose(1, 0, 2)
    true_corners = compute_corners(centre - [0.0, 0.0, 0.5] * size, size, yaw)
    # The model takes an annotation's centre for the middle of the box's floor, and was trained so.
    raised = compute_corners(centre, size, yaw)
    masks = is_in_front(true_corners, sensors.camera_from_lidar) & valid
    numbers = np.array([classes[index] for index in shown], dtype=np.int64)
    return ClipBoxes(
        ids=tuple(scene.agents.ids[index] for index in shown),
        corners=np.where(valid[..., None, None], raised, 0.0).astype(np.float32),
        true_corners=np.where(valid[..., None, None], true_corners, 0.0).astype(np.float32),
        classes=np.where(valid, numbers, ABSENT_CLASS),
        masks=masks.astype(np.int64),
    )


def transform_to_lidar_frame(tracks: BoxTracks, shown: list[int], lidar: Floats) -> tuple[Floats, Floats]:
    """Centres, (T, n, 3), and headings, (T, n), radians counter-clockwise from the lidar's x axis, of n boxes.

    ``lidar`` is (T, 4, 4), lidar frame to global frame.
    """
    turn = lidar[:, :3, :3]
    offset = tracks.position[shown].transpose(1, 0, 2) - lidar[:, None, :3, 3]
    centre = offset @ turn
    rotation = turn.transpose(0, 2, 1)[:, None] @ rotation_matrix(tracks.rotation[shown]).transpose(1, 0, 2, 3)
    # The devkit's heading of a tilted box: roll and pitch are taken off on the side of the lidar.
    return centre, np.arctan2(-rotation[..., 0, 1], rotation[..., 0, 0])


def compute_corners(floor: Floats, size: Floats, yaw: Floats) -> Floats:
    """(..., 8, 3) corners of upright boxes: front right bottom, top, rear right top, bottom, then the same on the left.

    ``floor`` (..., 3) is the middle of the floor, ``size`` length, width, height, metres; ``yaw`` heads the length.
    """
    ahead, left, up = np.moveaxis(_CORNER_SIGNS * size[..., None, :] * [0.5, 0.5, 1.0], -1, 0)
    cos, sin = np.cos(yaw)[..., None], np.sin(yaw)[..., None]
    return np.asarray(floor[..., None, :] + np.stack([ahead * cos - left * sin, ahead * sin + left * cos, up], axis=-1))


def is_in_front(corners: Floats, camera_from_lidar: Floats) -> Bools:
    """(V, T, n) whether any (T, n, 8, 3) lidar-frame corner is before a camera's lens, inside its image or not."""
    towards, offset = camera_from_lidar[:, :, 2, :3], camera_from_lidar[:, :, 2, 3]
    depth = np.einsum("vta,tnca->vtnc", towards, corners) + offset[..., None, None]
    return np.asarray((depth > 0.0).any(axis=-1))


def _find_class_index(scene: Scene, agent: int) -> int | None:
    category = scene.agents.categories[agent]
    name = DETECTION_CLASS_OF_CATEGORY.get(category)
    if name is None and scene.agents.ids[agent] in scene.adversaries:
        name = _CLASS_OF_ADVERSARY.get(category)
    return None if name is None else DETECTION_CLASSES.index(name)


def _build_padding(frames: int, views: int) -> ClipBoxes:
    """One box that is never there: the model wants at least one."""
    corners = np.zeros((frames, 1, 8, 3), dtype=np.float32)
    classes = np.full((frames, 1), ABSENT_CLASS, dtype=np.int64)
    return ClipBoxes((), corners, corners, classes, np.zeros((views, frames, 1), dtype=np.int64))


SMALL_HEIGHT_PX: Final = 224
"""Largest image height at which the model takes maps of 200 x 200 cells."""
IMAGE_FPS: Final = 120
"""Frame rate given to the model if the clip is a single image."""
OFFICIAL_SEED: Final = 1024
"""Seed of the first sample in the published scripts."""
MOST_FRAMES: Final = 241
"""The longest clip that the model was trained on: 20 s."""
SHORTEST_WHOLE: Final = 187
"""The shortest recording that it was trained on as a whole."""
_FRAMES_TOGETHER: Final = 8


@dataclass(frozen=True, slots=True)
class Clip:
    """Conditions of one clip in numbers and words; V views in the model's order, T frames, n boxes.

    `cams` are (V, T, 3, 7), the intrinsic matrix at 1600 x 900 pixels beside the camera->lidar transform; `rel_pos`
    (T, 4, 4) take points from the first lidar frame to this one; `maps` are (T, 8, cells, cells) from above.
    """

    scene: str
    frames: NDArray[np.int64]
    boxes: ClipBoxes
    cams: NDArray[np.float32]
    rel_pos: NDArray[np.float32]
    maps: Bools
    prompt: Prompt
    height: int
    width: int

    @property
    def fps(self) -> float:
        """12 for video, 120 for a single image."""
        return float(FRAME_HZ if len(self.frames) > 1 else IMAGE_FPS)

    def conditions(
        self, text: TextStates, negative_text: TextStates | None, *, latent_width: int, seed: int = OFFICIAL_SEED
    ) -> ClipConditions:
        """The clip as tensors for a hidden width; objects with the same ``seed`` of latent vectors look alike."""
        boxes = self.boxes
        return ClipConditions(
            bboxes=torch.from_numpy(boxes.corners)[None],
            classes=torch.from_numpy(boxes.classes)[None],
            masks=torch.from_numpy(boxes.masks),
            box_latent=draw_box_latents(boxes.classes.shape[1], latent_width, seed),
            cams=torch.from_numpy(self.cams)[:, :, None],
            rel_pos=torch.from_numpy(self.rel_pos),
            maps=torch.from_numpy(self.maps),
            text=text,
            fps=self.fps,
            height=self.height,
            width=self.width,
            negative_text=negative_text,
        )


def build_clip(
    scene: Scene,
    frames: Sequence[int],
    *,
    height: int = 224,
    width: int = 400,
    look: PromptLook = PromptLook.RECORDED,
) -> Clip:
    """Conditions for ordered frames of a scene with six cameras and a map; the last may repeat (`pad_frames`)."""
    chosen = np.asarray(frames, dtype=np.int64)
    _check_frames(scene, chosen)
    sensors = SensorFrames.of(scene, chosen)
    cells = MAP_CELLS if height <= SMALL_HEIGHT_PX else 2 * MAP_CELLS
    boxes, cams, rel_pos = (
        build_clip_boxes(scene, chosen, sensors),
        compute_camera_parameters(sensors),
        compute_ego_motion(sensors),
    )
    for quantity, numbers in (("annotations", boxes.corners), ("calibration", cams), ("ego poses", rel_pos)):
        if not np.isfinite(numbers).all():
            raise InputError(f"the {quantity} of {scene.name} contain NaN or infinity; correct its tables")
    return Clip(
        scene=scene.name,
        frames=chosen,
        boxes=boxes,
        cams=cams,
        rel_pos=rel_pos,
        maps=draw_clip_maps(scene, sensors.lidar, cells=cells),
        prompt=build_prompt(scene, look),
        height=height,
        width=width,
    )


def draw_box_latents(count: int, width: int, seed: int) -> torch.Tensor:
    """(n, C) float32 Gaussian vectors of objects, drawn on the processor as in the published scripts."""
    return torch.randn(count, width, generator=torch.Generator("cpu").manual_seed(seed))


def compute_trimmed_length(count: int) -> int:
    """Number of frames that the model's own data loader keeps of a scene: 8k or 8k + 1."""
    return count - max(count % _FRAMES_TOGETHER - 1, 0)


def compute_published_length(count: int) -> int:
    """Number of frames that a clip of the published data sets has.

    Recordings of 235 frames, which most of nuScenes has (40 keyframes), become 233; those of 241 stay; nothing is
    longer. Recordings that are shorter than any that the model was trained on at full length keep all they have.
    """
    return count if count < SHORTEST_WHOLE else compute_trimmed_length(min(count, MOST_FRAMES))


def pad_frames(frames: Sequence[int]) -> tuple[int, ...]:
    """Frames of which none is lost: the last one is repeated until their number is 8k or 8k + 1."""
    missing = 0 if compute_trimmed_length(len(frames)) == len(frames) else -len(frames) % _FRAMES_TOGETHER
    return (*frames, *[frames[-1]] * missing)


def group_latent_frames(count: int) -> tuple[tuple[int, ...], ...]:
    """Positions in a clip averaged into each latent frame (section 3, "P"): pairs, twice; an odd first one stays."""
    groups: list[tuple[int, ...]] = [(position,) for position in range(count)]
    for _ in range(2):
        alone, paired = groups[: len(groups) % 2], groups[len(groups) % 2 :]
        groups = [*alone, *(first + second for first, second in zip(paired[::2], paired[1::2]))]
    return tuple(groups)


def _check_frames(scene: Scene, frames: NDArray[np.int64]) -> None:
    last = len(scene.timestamps_us) - 1
    if not len(frames) or frames.min() < 0 or frames.max() > last or (np.diff(frames) < 0).any():
        raise InputError(
            f"{scene.name} has frames 0 to {last}; a clip takes some of them in ascending order, got {frames.tolist()}"
        )
    if compute_trimmed_length(len(frames)) != len(frames):
        raise InputError(
            f"MagicDriveDiT draws 8k or 8k + 1 frames at a time, not {len(frames)} (of {scene.name}); leave some out "
            "or repeat the last one"
        )
