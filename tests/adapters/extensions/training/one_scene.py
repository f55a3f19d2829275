"""Training frames in a list, as a store of one scene."""

from collections.abc import Sequence

from adapters.extensions.training.frames import TrainingFrame


class OneScene:
    """`adapters.extensions.training.frames.Frames` of frames that are given.

    Args:
        frames: In time order.
    """

    identity = "one scene"

    def __init__(self, frames: Sequence[TrainingFrame]) -> None:
        self._frames, self.scenes = list(frames), ("a",)

    def __len__(self) -> int:
        return len(self._frames)

    def frames_of(self, scene: str) -> range:
        """All of them."""
        return range(len(self._frames))

    def frame(self, number: int) -> TrainingFrame:
        """One frame."""
        return self._frames[number]

    def clip(self, number: int, length: int) -> list[TrainingFrame]:
        """A frame and those before it."""
        return self._frames[max(number - length + 1, 0) : number + 1]
