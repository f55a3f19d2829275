"""Training frames: annotated key frames, also turned or without ego motion, and those a network has already seen."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Final, Protocol, Self, runtime_checkable

import torch
from torch import Tensor, nn

from adapters.networks.layers.ego_motion import CAN_BUS_INDICES, BEVMotion
from benchmark.constants import PLAN_STEP_S
from benchmark.machine.progress import CountedUnits, track_progress


def rotate_can_bus(can_bus: Tensor, turn_rad: float) -> Tensor:
    """The same motion, (18,) as of `can_bus_vector`, in a world turned counter-clockwise; car-frame parts stay."""
    turned = can_bus.clone()
    cosine, sine = math.cos(turn_rad), math.sin(turn_rad)
    turned[0] = cosine * can_bus[0] - sine * can_bus[1]
    turned[1] = sine * can_bus[0] + cosine * can_bus[1]
    heading_rad = (float(can_bus[16]) + turn_rad) % (2 * math.pi)
    turned[3:7] = abs(math.cos(heading_rad / 2))
    turned[16], turned[17] = heading_rad, math.degrees(heading_rad)
    return turned


def mask_ego_status(motion: BEVMotion) -> BEVMotion:
    """The same motion, of which a network is not told; its view of before is aligned all the same."""
    silent = motion.can_bus.clone()
    silent[:3], silent[7:16] = 0.0, 0.0
    return replace(motion, can_bus=silent)


FUTURE_STEPS = 12
"""Steps of 0.5 s for which the futures of agents are given."""
LINE_POINTS = 20
"""Points of a map element."""
DRIVABLE_CELLS = 128
"""Cells along each side of the drivable raster."""
DRIVABLE_HALF_M = 51.2
"""Half the side of the square around the lidar that the drivable raster covers."""


PROCESSOR_FIELDS = frozenset({"lidar2img", "global_T_lidar", "can_bus"})
"""Inputs that stay on the CPU on every device: matrices in double precision."""


@dataclass(frozen=True, slots=True)
class TrainingFrame:
    """One key frame. Geometry is in the lidar frame of the frame: x right, y forward, z up, metres; yaw from +x.

    Attributes:
        images: (6, 3, H, W) uint8, red green blue, at the network's size, in the order of `CAMERA_NAMES`.
        lidar2img: (6, 4, 4) float64, lidar frame to pixels of these images.
        global_T_lidar: (4, 4) float64.
        can_bus: (18,) float64, absolute, as `adapters.camera_inputs.can_bus_vector` gives it.
        command: 0 right, 1 left, 2 straight.
        ego_future: (6, 2) float32, recorded positions of the lidar origin at steps of 0.5 s; `ego_future_valid` (6,).
        boxes: (N, 9) float32: x, y, z of the box centre, length, width, height, yaw, and velocity x, y.
        labels: (N,) int64, place in `benchmark.constants.DETECTION_CLASSES`.
        instances: (N,) int64, the same number for the same thing in all frames of a scene.
        futures: (N, 12, 3) float32, x, y, yaw at steps of 0.5 s; held where not annotated (`futures_valid`).
        lines: (M, 20, 2) float32, map elements within 15 m to the sides and 30 m ahead and behind.
        line_labels: (M,) int64: 0 divider, 1 pedestrian crossing, 2 boundary of the road.
        drivable: (128, 128) bool, rows along y, columns along x, from -51.2 m; the centre of cell (i, j) is at
            x = (j + 0.5) 0.8 - 51.2, y = (i + 0.5) 0.8 - 51.2.
    """

    scene: str
    index: int
    timestamp_s: float
    images: Tensor
    lidar2img: Tensor
    global_T_lidar: Tensor
    can_bus: Tensor
    command: int
    ego_future: Tensor
    ego_future_valid: Tensor
    boxes: Tensor
    labels: Tensor
    instances: Tensor
    futures: Tensor
    futures_valid: Tensor
    lines: Tensor
    line_labels: Tensor
    drivable: Tensor

    def on(self, device: torch.device) -> Self:
        """The frame with its images and annotations on a device; matrices stay on the processor."""
        if device.type == "cpu":
            return self
        moved: dict[str, Any] = {
            field.name: value.to(device)
            for field in fields(self)
            if isinstance(value := getattr(self, field.name), Tensor) and field.name not in PROCESSOR_FIELDS
        }
        return replace(self, **moved)


class Frames(Protocol):
    """Frames in the order of scenes and time, as `FrameStore` gives them.

    Attributes:
        scenes: Names of the scenes.
        identity: Key of everything that the frames depend on.
    """

    @property
    def scenes(self) -> tuple[str, ...]:
        """Names of the scenes."""
        ...

    @property
    def identity(self) -> str:
        """Key of everything that the frames depend on."""
        ...

    def __len__(self) -> int:
        """Number of frames."""
        ...

    def frames_of(self, scene: str) -> range:
        """Numbers of the frames of a scene, in time order."""
        ...

    def frame(self, number: int) -> TrainingFrame:
        """One frame."""
        ...

    def clip(self, number: int, length: int) -> list[TrainingFrame]:
        """A frame and those before it in its scene."""
        ...


class Objective(Protocol):
    """How one kind of network learns.

    Attributes:
        network: Its parameters are what is trained; the objective itself has none.
        clip_frames: How many consecutive key frames of a scene it learns from at once.
    """

    @property
    def network(self) -> nn.Module:
        """Its parameters are what is trained."""
        ...

    @property
    def clip_frames(self) -> int:
        """Key frames of a clip."""
        ...

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """Losses of a clip.

        Args:
            clip: `clip_frames` consecutive key frames of one scene (fewer at its start); networks with memory see the
                earlier ones first. They are where the network is (`TrainingFrame.on`).

        Returns:
            Weighted scalars by name; their sum is minimised.
        """
        ...


@runtime_checkable
class BatchObjective(Objective, Protocol):
    """An objective that learns from several clips at once faster than from one after the other."""

    def losses_of(self, clips: Sequence[Sequence[TrainingFrame]]) -> dict[str, Tensor]:
        """Losses of several clips.

        Args:
            clips: As for `Objective.losses`, of any lengths.

        Returns:
            As `Objective.losses`, means over the clips.
        """
        ...


@runtime_checkable
class CachingObjective(Objective, Protocol):
    """An objective part of whose network does not learn: what that makes of the frames is made once."""

    def look(self, store: Frames, frames: Sequence[int]) -> tuple[Frames, Sequence[int]]:
        """Look at everything that will be learned from; the network is where it learns.

        Args:
            store: Training frames.
            frames: Numbers of those to learn from.

        Returns:
            Frames of which the objective remembers what it needs of the images, which they do not have; and the numbers
            of those to learn from, some of them perhaps more than once.

        Raises:
            InputError: If frames cannot be read.
        """
        ...


NOT_STRAIGHT_ON_M: Final = 3.0
"""Distance from constant velocity after 3 s beyond which a plan has something to learn."""
SHORT_WAY_M: Final = 3.0
"""Distance in 3 s below which the ego stands, or is about to."""
REPEATS: Final = 3
"""How often a round of learning has a frame of either."""
SPEED: Final = CAN_BUS_INDICES[0]
"""Place in the CAN bus vector."""
MEMORY_DROPOUT: Final = 0.15
"""Share of what is remembered that a step does not have (dropout): a small network would know frames by heart."""


class CachedFrames:
    """Frames without their images, in memory."""

    def __init__(self, store: Frames, frames: Sequence[int], look: Callable[[Sequence[TrainingFrame]], None]) -> None:
        """Look at all scenes of the frames from their beginnings; `look` gets all frames of each, in time order."""
        learned = set(frames)
        self.identity = store.identity
        self.scenes = tuple(name for name in store.scenes if not learned.isdisjoint(store.frames_of(name)))
        self._numbers = {name: store.frames_of(name) for name in self.scenes}
        self._frames: dict[int, TrainingFrame] = {}
        for name in track_progress(
            self.scenes, total=len(self.scenes), label="looking at scenes", count=CountedUnits("scene")
        ):
            scene_frames = [store.frame(number) for number in self._numbers[name]]
            look(scene_frames)
            blind = (replace(frame, images=torch.empty(0, dtype=torch.uint8)) for frame in scene_frames)
            self._frames.update(zip(self._numbers[name], blind, strict=True))

    def __len__(self) -> int:
        return len(self._frames)

    def frames_of(self, scene: str) -> range:
        """Numbers of the frames of a scene, in time order."""
        return self._numbers[scene]

    def frame(self, number: int) -> TrainingFrame:
        """One frame."""
        return self._frames[number]

    def clip(self, number: int, length: int) -> list[TrainingFrame]:
        """A frame and those before it in its scene."""
        first = max(number - length + 1, number - self.frame(number).index)
        return [self.frame(frame_number) for frame_number in range(first, number + 1)]


def oversample_changes(frames: Frames, numbers: Sequence[int]) -> list[int]:
    """Numbers of frames, several times those in which the ego does not just drive on: most of a drive is driving on."""
    return [number for number in numbers for _ in range(REPEATS if _changes_motion(frames.frame(number)) else 1)]


def _changes_motion(frame: TrainingFrame) -> bool:
    if not bool(frame.ego_future_valid[-1]):
        return False
    end = frame.ego_future[-1]
    straight_on = end.new_tensor([0.0, float(frame.can_bus[SPEED]) * PLAN_STEP_S * len(frame.ego_future)])
    return float(end.norm()) < SHORT_WAY_M or float((end - straight_on).norm()) > NOT_STRAIGHT_ON_M
