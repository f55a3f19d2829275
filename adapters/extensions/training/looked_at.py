"""Frames that a part of a network has looked at already: what learns from what it saw needs no images."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Final

import torch

from adapters.extensions.training.frames import Frames, TrainingFrame
from adapters.networks.layers.motion_teller import READ
from benchmark.constants import PLAN_STEP_S
from benchmark.machine.progress import Count, progress

NOT_STRAIGHT_ON_M: Final = 3.0
"""Who is so far from where constant velocity leads after 3 s does something that a plan has to learn."""
SHORT_WAY_M: Final = 3.0
"""Who gets no further in 3 s stands, or is about to."""
OFTEN: Final = 3
"""How often a round of learning has a frame of either."""
SPEED: Final = READ[0]
"""Place in the CAN bus vector."""
FORGOTTEN: Final = 0.15
"""Share of what is remembered that a step does not have (dropout): a small network would know frames by heart."""


class LookedAt:
    """Frames without their images, in memory."""

    def __init__(self, store: Frames, frames: Sequence[int], look: Callable[[Sequence[TrainingFrame]], None]) -> None:
        """Look at all scenes that frames are learned from, one after the other and from their beginnings.

        `look` is called with all frames of each scene, in time order.
        """
        wanted = set(frames)
        self.identity = store.identity
        self.scenes = tuple(name for name in store.scenes if not wanted.isdisjoint(store.frames_of(name)))
        self._numbers = {name: store.frames_of(name) for name in self.scenes}
        self._frames: dict[int, TrainingFrame] = {}
        for name in progress(self.scenes, total=len(self.scenes), label="looking at scenes", count=Count("scene")):
            seen = [store.frame(number) for number in self._numbers[name]]
            look(seen)
            blind = (replace(frame, images=torch.empty(0, dtype=torch.uint8)) for frame in seen)
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
        return [self.frame(each) for each in range(first, number + 1)]


def weighed(frames: Frames, numbers: Sequence[int]) -> list[int]:
    """Numbers of frames, several times those in which the ego does not just drive on: most of a drive is driving on."""
    return [each for each in numbers for _ in range(OFTEN if _changes(frames.frame(each)) else 1)]


def _changes(frame: TrainingFrame) -> bool:
    if not bool(frame.ego_future_valid[-1]):
        return False
    end = frame.ego_future[-1]
    straight_on = end.new_tensor([0.0, float(frame.can_bus[SPEED]) * PLAN_STEP_S * len(frame.ego_future)])
    return float(end.norm()) < SHORT_WAY_M or float((end - straight_on).norm()) > NOT_STRAIGHT_ON_M
