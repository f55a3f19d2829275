"""How what follows from the bird's-eye view of UniAD-mini learns: from views that frozen eyes have seen."""

from collections.abc import Iterator, Sequence

import torch

from adapters.extensions.training.frames import Frames, TrainingFrame
from adapters.extensions.training.looked_at import LookedAt, weighed
from adapters.extensions.training.uniad.objective import UniADObjective, View
from adapters.extensions.training.uniad.targets import network_inputs
from adapters.networks.uniad.frames import UniADInputs
from adapters.networks.uniad.model import UniAD


class HeadsObjective(UniADObjective):
    """Tracks, map, forecasts, occupancy and plan. The views are those of the network when it runs, made once.

    All frames of a clip have gradients.
    """

    def __init__(self, network: UniAD, clip_frames: int) -> None:
        super().__init__(network, clip_frames=clip_frames, unaware=0.0, sees_already=True)
        self._memory: dict[tuple[str, float], View] = {}

    def look(self, store: Frames, frames: Sequence[int]) -> tuple[Frames, Sequence[int]]:
        """As `adapters.extensions.training.frames.ForesightedObjective` describes."""
        looked = LookedAt(store, frames, self._look)
        return looked, weighed(looked, frames)

    def _look(self, scene: Sequence[TrainingFrame]) -> None:
        inputs = [network_inputs(frame) for frame in scene]
        with torch.no_grad():
            for given, view in zip(inputs, super()._views(inputs, aware=True), strict=True):
                seen = View(view.bev.half(), view.finest_front.half(), view.can_bus)
                self._memory[given.scene_token, given.timestamp] = seen

    def _views(self, inputs: Sequence[UniADInputs], aware: bool) -> Iterator[View]:
        for given in inputs:
            seen = self._memory[given.scene_token, given.timestamp]
            yield View(seen.bev.float(), seen.finest_front.float(), seen.can_bus)
