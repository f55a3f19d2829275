"""What a network learns from: one key frame with everything that is annotated about it."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Protocol, Self, runtime_checkable

import torch
from torch import Tensor, nn

FUTURE_STEPS = 12
"""Steps of 0.5 s for which the futures of agents are given."""
LINE_POINTS = 20
"""Points of a map element."""
DRIVABLE_CELLS = 128
"""Cells along each side of the drivable raster."""
DRIVABLE_HALF_M = 51.2
"""Half the side of the square around the lidar that the drivable raster covers."""


KEPT_ON_PROCESSOR = frozenset({"lidar2img", "global_T_lidar", "can_bus"})
"""What planners give their networks on the processor, whatever these run on: matrices in double precision."""


@dataclass(frozen=True, slots=True)
class TrainingFrame:
    """One key frame. Geometry is in the lidar frame of the frame: x right, y forward, z up, metres; yaw from +x.

    Attributes:
        scene: Scene name; a change of it is a change of scene.
        index: Number of the frame in its scene.
        timestamp_s: Time, seconds.
        images: (6, 3, H, W) uint8, red green blue, at the network's size, in the order of `CAMERA_NAMES`.
        lidar2img: (6, 4, 4) float64, lidar frame to pixels of these images.
        global_T_lidar: (4, 4) float64.
        can_bus: (18,) float64, absolute, as `adapters.camera_inputs.can_bus_vector` gives it.
        command: 0 right, 1 left, 2 straight.
        ego_future: (6, 2) float32, recorded positions of the lidar origin at steps of 0.5 s.
        ego_future_valid: (6,) bool.
        boxes: (N, 9) float32: x, y, z of the box centre, length, width, height, yaw, and velocity x, y.
        labels: (N,) int64, place in `benchmark.constants.DETECTION_CLASSES`.
        instances: (N,) int64, the same number for the same thing in all frames of a scene.
        futures: (N, 12, 3) float32, x, y, yaw at steps of 0.5 s; held where not annotated.
        futures_valid: (N, 12) bool.
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
            if isinstance(value := getattr(self, field.name), Tensor) and field.name not in KEPT_ON_PROCESSOR
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
class ForesightedObjective(Objective, Protocol):
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
