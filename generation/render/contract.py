"""The contract of a renderer: a scene in, six images per frame out."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.machine.workers import Executor
from benchmark.scene import Camera, EgoTrack, Scene

Images = dict[str, NDArray[np.uint8]]
"""(height, width, 3) uint8 RGB by camera name."""


class Renderer(Protocol):
    """Draws what the cameras see. The same scene and frame give the same bytes on every call and in every process.

    Attributes:
        name: Recorded in the data set's provenance.
        version: Changes when the pictures change.
    """

    @property
    def name(self) -> str:
        """Recorded in the data set's provenance."""

    @property
    def version(self) -> str:
        """Changes when the pictures change."""

    def cameras(self, scene: Scene) -> tuple[Camera, ...]:
        """The scene's cameras at the size that is rendered."""

    def render(self, scene: Scene, frames: Sequence[int]) -> Iterator[Images]:
        """Render frames of one scene.

        Args:
            scene: The scene.
            frames: Frame indices in ``scene.timestamps_us``.

        Yields:
            The images of each frame, in order.
        """


class RendererSource(Protocol):
    """The renderer that ``generate --renderer NAME`` draws with, once its options are checked."""

    def require(self) -> None:
        """Raise `InputError` where it cannot draw, before anything is built."""

    def renderer(self, work: Path) -> Renderer:
        """The renderer; it is sent to workers. ``work`` is a folder for what it keeps."""

    def executor(self, place: Executor) -> Executor | None:
        """Where scenes are drawn, if not where they are searched."""


def require_frames(scene: Scene, frames: Sequence[int]) -> None:
    """Refuse frames that a scene does not have."""
    count = len(scene.timestamps_us)
    for frame in frames:
        if not 0 <= frame < count:
            raise InputError(f"{scene.name} has frames 0 to {count - 1}, so frame {frame} cannot be rendered")


@runtime_checkable
class SweepRenderer(Renderer, Protocol):
    """A renderer that looks from where each camera really was, where a recording says that (`Scene.sweep_poses`)."""

    def camera_tracks(self, scene: Scene) -> Mapping[str, EgoTrack]:
        """Ego motion by camera name, at the times of that camera; nothing for cameras that share the scene's."""


@dataclass(frozen=True, slots=True)
class RecordedChannel:
    """When and from where a camera recorded M images, one a frame at most.

    Attributes:
        frames: (M,) ascending frames that an image belongs to.
        offsets_us: (M,) by how much each is later than its frame, microseconds.
        ego: M poses of the ego at the images' own times.
        extension: ``jpg`` or ``png``.
    """

    frames: NDArray[np.int64]
    offsets_us: NDArray[np.int64]
    ego: EgoTrack
    extension: str = "jpg"


@runtime_checkable
class RecordedImages(Renderer, Protocol):
    """Images that are there already, as files: nothing is drawn, and cameras may lack frames."""

    def channels(self, scene: Scene) -> Mapping[str, RecordedChannel]:
        """What each camera recorded, by its name."""

    def files(self, scene: Scene, frames: Collection[int]) -> Iterator[tuple[str, int, bytes]]:
        """Camera, frame and content of each file of some frames."""


@runtime_checkable
class CuttingRenderer(Renderer, Protocol):
    """A renderer that does not draw scenes of every length."""

    def cut(self, scene: Scene) -> Scene:
        """The part of a scene that is drawn, from its start; what is written ends with it."""


@runtime_checkable
class SlowRenderer(Renderer, Protocol):
    """A renderer that takes so long that a few pictures are not drawn to find out."""

    def estimate_sentence(self, scene: Scene) -> str:
        """What a scene costs, for people, said before anything is drawn."""

    def scene_seconds(self, scene: Scene) -> float:
        """About how long a scene takes."""
