"""How the plan of UniAD-mini learns from what the whole network before it makes of a scene: dozens of frames a step."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from adapters.extensions.training.frames import Frames, TrainingFrame
from adapters.extensions.training.looked_at import FORGOTTEN, LookedAt, weighed
from adapters.extensions.training.uniad.objective import plan_losses
from adapters.extensions.training.uniad.targets import network_inputs
from adapters.networks.uniad.model import UniAD


@dataclass(frozen=True, slots=True)
class PlannerSights:
    """Inputs of the plan of a key frame, in half precision.

    `bev` is (cells, C), `mode_queries` (modes, C) forecast states of the ego, `state` (C,) its track, `finest_front`
    (1, C, h, w), `can_bus` (18,) float32.
    """

    bev: Tensor
    mode_queries: Tensor
    state: Tensor
    finest_front: Tensor
    can_bus: Tensor


class PlannerObjective:
    """The plan alone. All before it runs over each scene once as when the network drives, its own tracks included.

    In the clips of `adapters.extensions.training.uniad.objective.UniADObjective` tracks are a few frames old, and stand
    for whom they should. A small network would know the frames by heart: some of the ego's forecast and track is
    forgotten anew in each step, the planner has its dropout, and what is read in the front camera stays as it is.
    """

    clip_frames = 1

    def __init__(self, network: UniAD) -> None:
        self.network = network
        network.requires_grad_(False)
        head = network.planning_head.requires_grad_(True)
        if head.front_reader is not None:
            head.front_reader.only_tell()
        self._memory: dict[tuple[str, int], PlannerSights] = {}

    def look(self, store: Frames, frames: Sequence[int]) -> tuple[Frames, Sequence[int]]:
        """As `adapters.extensions.training.frames.ForesightedObjective` describes."""
        seen = LookedAt(store, frames, self._look)
        return seen, weighed(seen, frames)

    def _look(self, scene: Sequence[TrainingFrame]) -> None:
        network = self.network.eval()
        network.reset()
        given: list[PlannerSights] = []
        head = network.planning_head
        hook = head.register_forward_pre_hook(lambda _, arguments: given.append(_sights(*arguments)))
        with hook, torch.no_grad(), _nothing_occupied(network):
            for frame in scene:
                network.predict(network_inputs(frame))
                self._memory[frame.scene, frame.index] = given.pop()
        network.reset()

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """Losses of the last frame of a clip; weighted scalars by name."""
        network, frame = self.network, clip[-1]
        sights = self._memory[frame.scene, frame.index]
        modes, state = sights.mode_queries.float(), sights.state.float()
        if network.training:
            network.eval().planning_head.train()
        if network.planning_head.training:
            modes, state = F.dropout(modes, FORGOTTEN), F.dropout(state, FORGOTTEN)
        plan = network.planning_head(
            sights.bev.float(),
            network.pts_bbox_head.positional_encoding(),
            modes,
            state,
            frame.command,
            sights.finest_front.float(),
            sights.can_bus,
        )
        return plan_losses(plan, frame)


@contextmanager
def _nothing_occupied(network: UniAD) -> Iterator[None]:
    """Leave out occupancy, which is nearly half of a frame's cost and which no plan reads: no track is a vehicle."""
    vehicles = network.vehicle_classes
    network.vehicle_classes = torch.zeros_like(vehicles)
    try:
        yield
    finally:
        network.vehicle_classes = vehicles


def _sights(
    bev: Tensor, _: Tensor, mode_queries: Tensor, state: Tensor, __: int, finest_front: Tensor, can_bus: Tensor
) -> PlannerSights:
    """Inputs of `adapters.networks.uniad.planning.PlanningHead`; copies, so that nothing else is kept."""
    return PlannerSights(bev.half(), mode_queries.half(), state.half(), finest_front.half(), can_bus)
