"""One clip of a scene as MagicDriveDiT is told about it, before words are encoded and chance is drawn."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
import torch
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ
from benchmark.errors import InputError
from benchmark.geometry import Bools
from benchmark.scene import Scene
from generation.extensions.magicdrive.bev_map import MAP_CELLS, clip_maps
from generation.extensions.magicdrive.boxes import ClipBoxes, clip_boxes
from generation.extensions.magicdrive.conditions import Conditions, TextStates
from generation.extensions.magicdrive.prompt import Prompt, PromptLook, prompt_of
from generation.extensions.magicdrive.sensor_frames import SensorFrames, camera_parameters, ego_motion

SMALL_HEIGHT_PX: Final = 224
"""Largest image height at which the model takes maps of 200 x 200 cells."""
IMAGE_FPS: Final = 120
"""What stands for the frame rate where the clip is a single image."""
OFFICIAL_SEED: Final = 1024
"""Seed of the first sample in the published scripts."""
MOST_FRAMES: Final = 241
"""The longest clip that the model was trained on: 20 s."""
SHORTEST_WHOLE: Final = 187
"""The shortest recording that it was trained on as a whole."""
_FRAMES_TOGETHER: Final = 8


@dataclass(frozen=True, slots=True)
class Clip:
    """The conditions of one clip in numbers and words; V views in the model's order, T frames, n boxes.

    Attributes:
        cams: (V, T, 3, 7) intrinsic matrix at 1600 x 900 pixels beside the camera->lidar transform.
        rel_pos: (T, 4, 4) transforms of points from the first lidar frame to this one.
        maps: (T, 8, cells, cells) masks from above.
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
    ) -> Conditions:
        """The clip as tensors for a model of hidden width ``latent_width``.

        ``seed`` is of the objects' latent vectors; the same objects with the same seed look alike.
        """
        boxes = self.boxes
        return Conditions(
            bboxes=torch.from_numpy(boxes.corners)[None],
            classes=torch.from_numpy(boxes.classes)[None],
            masks=torch.from_numpy(boxes.masks),
            box_latent=box_latents(boxes.classes.shape[1], latent_width, seed),
            cams=torch.from_numpy(self.cams)[:, :, None],
            rel_pos=torch.from_numpy(self.rel_pos),
            maps=torch.from_numpy(self.maps),
            text=text,
            fps=self.fps,
            height=self.height,
            width=self.width,
            negative_text=negative_text,
        )


def clip_of(
    scene: Scene,
    frames: Sequence[int],
    *,
    height: int = 224,
    width: int = 400,
    look: PromptLook = PromptLook.RECORDED,
) -> Clip:
    """Conditions of the model for some frames of a scene, which has six cameras and a map.

    The frames are in order, as many as the model can have; the last one may be repeated (see `padded_frames`).
    """
    chosen = np.asarray(frames, dtype=np.int64)
    _check_frames(scene, chosen)
    sensors = SensorFrames.of(scene, chosen)
    cells = MAP_CELLS if height <= SMALL_HEIGHT_PX else 2 * MAP_CELLS
    boxes, cams, rel_pos = clip_boxes(scene, chosen, sensors), camera_parameters(sensors), ego_motion(sensors)
    for what, numbers in (("annotations", boxes.corners), ("calibration", cams), ("ego poses", rel_pos)):
        if not np.isfinite(numbers).all():
            raise InputError(f"the {what} of {scene.name} hold numbers that are not finite; correct its tables")
    return Clip(
        scene=scene.name,
        frames=chosen,
        boxes=boxes,
        cams=cams,
        rel_pos=rel_pos,
        maps=clip_maps(scene, sensors.lidar, cells=cells),
        prompt=prompt_of(scene, look),
        height=height,
        width=width,
    )


def box_latents(count: int, width: int, seed: int) -> torch.Tensor:
    """One Gaussian vector for each object, drawn on the processor as in the published scripts.

    (n, C) float32 for n objects and the hidden width C of the model.
    """
    return torch.randn(count, width, generator=torch.Generator("cpu").manual_seed(seed))


def trimmed_length(count: int) -> int:
    """Number of frames that the model's own data loader keeps of a scene: 8k or 8k + 1."""
    return count - max(count % _FRAMES_TOGETHER - 1, 0)


def published_length(count: int) -> int:
    """Number of frames that a clip of the published data sets has.

    Recordings of 235 frames, which most of nuScenes has (40 keyframes), become 233; those of 241 stay, and nothing is
    longer. Recordings that are shorter than any that the model was trained on at full length keep all they have.
    """
    return count if count < SHORTEST_WHOLE else trimmed_length(min(count, MOST_FRAMES))


def padded_frames(frames: Sequence[int]) -> tuple[int, ...]:
    """Frames of which none is lost: the last one is repeated until their number is 8k or 8k + 1."""
    missing = 0 if trimmed_length(len(frames)) == len(frames) else -len(frames) % _FRAMES_TOGETHER
    return (*frames, *[frames[-1]] * missing)


def latent_frames(count: int) -> tuple[tuple[int, ...], ...]:
    """Frames of a clip, as positions in it, that are averaged into each latent frame.

    Twice, neighbours become pairs; of an odd number the first stays alone (specification, section 3, "P").
    """
    groups: list[tuple[int, ...]] = [(position,) for position in range(count)]
    for _ in range(2):
        alone, paired = groups[: len(groups) % 2], groups[len(groups) % 2 :]
        groups = [*alone, *(first + second for first, second in zip(paired[::2], paired[1::2]))]
    return tuple(groups)


def _check_frames(scene: Scene, frames: NDArray[np.int64]) -> None:
    last = len(scene.timestamps_us) - 1
    if not len(frames) or frames.min() < 0 or frames.max() > last or (np.diff(frames) < 0).any():
        raise InputError(
            f"{scene.name} has frames 0 to {last}; a clip needs some of them in order, got {frames.tolist()}"
        )
    if trimmed_length(len(frames)) != len(frames):
        raise InputError(
            f"MagicDriveDiT draws 8k or 8k + 1 frames at a time, not {len(frames)} (of {scene.name}); leave some out "
            "or repeat the last one"
        )
