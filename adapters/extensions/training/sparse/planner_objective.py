"""How the planners of the sparse miniatures learn from what frozen eyes have seen: hundreds of frames a step."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final

import torch
from torch import Tensor

from adapters.extensions.training.frames import Frames, TrainingFrame
from adapters.extensions.training.looked_at import FORGOTTEN, LookedAt, weighed
from adapters.extensions.training.losses import Matches
from adapters.extensions.training.sparse.losses import matches_of_boxes
from adapters.extensions.training.sparse.objective import SparseObjective
from adapters.extensions.training.sparse.perceived import Perceived, partly, remembered, together
from adapters.extensions.training.sparse.targets import Targets
from adapters.networks.sparse.decoder import Stage
from adapters.networks.sparse.diffusion import DiffusionPlanner
from adapters.networks.sparse.model import SparseNetwork

PERCEPTION: Final = ("img_backbone", "img_neck", "head.det_head", "head.map_head")
"""What stays as it is."""


class PlannerObjective(SparseObjective):
    """Forecasts and plans alone. Boxes and map elements of each key frame are found once, as when the network plans.

    Nine tenths of a step of `SparseObjective` are images, boxes and lines.

    A small network would know the frames by heart: some of what is remembered is forgotten anew in each step, and no
    plan is learned where the past that the network has when it drives is missing, as in the first frame of a clip.
    """

    def __init__(self, network: SparseNetwork) -> None:
        super().__init__(network)
        for name in PERCEPTION:
            network.get_submodule(name).requires_grad_(False)
        if network.front_eyes is not None:
            network.front_eyes.requires_grad_(False)
        plans_look = isinstance(network.head.motion_plan_head, DiffusionPlanner)
        self._cameras = network.config.cameras if plans_look else 0
        self._memory: dict[tuple[str, int], Perceived] = {}

    def look(self, store: Frames, frames: Sequence[int]) -> tuple[Frames, Sequence[int]]:
        """As `adapters.extensions.training.frames.ForesightedObjective` describes."""
        looked = LookedAt(store, frames, self._look)
        return looked, weighed(looked, frames)

    def _look(self, scene: Sequence[TrainingFrame]) -> None:
        device = next(self.network.parameters()).device
        with torch.no_grad():
            for frame, seen in zip(scene, super()._perceived(scene, 1, device), strict=True):
                self._memory[frame.scene, frame.index] = remembered(seen, self._cameras)

    def losses_of(self, clips: Sequence[Sequence[TrainingFrame]]) -> dict[str, Tensor]:
        """As `SparseObjective.losses_of`."""
        return super().losses_of([[_without_plan(clip[0]), *clip[1:]] for clip in clips])

    def _perceived(self, frames: Sequence[TrainingFrame], batch: int, device: torch.device) -> Iterator[Perceived]:
        for start in range(0, len(frames), batch):
            seen = together([self._memory[each.scene, each.index] for each in frames[start : start + batch]])
            yield partly(seen, FORGOTTEN) if self.network.training else seen

    def _perception_losses(self, perceived: Sequence[Perceived], targets: Targets) -> tuple[dict[str, Tensor], Matches]:
        anchors, logits = (
            torch.cat([getattr(each.agents, name) for each in perceived]) for name in ("anchors", "logits")
        )
        return {}, matches_of_boxes(Stage(anchors, logits, None), targets)


def _without_plan(frame: TrainingFrame) -> TrainingFrame:
    """The first frame of a clip: of its plan nothing is learned if it is not the first of its scene as well."""
    return replace(frame, ego_future_valid=frame.ego_future_valid & (frame.index == 0))
