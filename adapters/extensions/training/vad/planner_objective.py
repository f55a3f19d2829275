"""How forecasts and the plan of VAD-mini learn from what frozen eyes have seen: dozens of frames a step."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import torch
import torch.nn.functional as F
from torch import Tensor

from adapters.extensions.training.frames import Frames, TrainingFrame
from adapters.extensions.training.looked_at import FORGOTTEN, LookedAt, weighed
from adapters.extensions.training.vad.objective import (
    WEIGHTS,
    Matched,
    forecast_losses,
    inputs_of,
    looked,
    matched_agents,
    plan_losses,
)
from adapters.networks.layers.front_reader import FrontReader
from adapters.networks.vad.model import VAD
from adapters.networks.vad.predictions import VADSights

PERCEPTION: Final = (
    "img_backbone",
    "img_neck",
    *(
        f"pts_bbox_head.{name}"
        for name in (
            "positional_encoding",
            "transformer",
            "cls_branches",
            "reg_branches",
            "map_cls_branches",
            "map_reg_branches",
            "bev_embedding",
            "query_embedding",
            "map_instance_embedding",
            "map_pts_embedding",
        )
    ),
)
"""What stays as it is."""


class PlannerObjective:
    """Forecasts and plans alone. Agents and lines of each key frame are found once, as when the network plans.

    Nine tenths of a step of `adapters.extensions.training.vad.objective.VADObjective` are images and the bird's-eye
    view. A small network would know the frames by heart: some of what is remembered is forgotten anew in each step, and
    what is read in the front camera stays as it is.
    """

    clip_frames = 1

    def __init__(self, network: VAD) -> None:
        self.network = network
        for name in PERCEPTION:
            network.get_submodule(name).requires_grad_(False)
        if network.front_eyes is not None:
            network.front_eyes.requires_grad_(False)
        reader = network.pts_bbox_head.front_reader
        if reader is not None:
            reader.only_tell()
        self._memory: dict[tuple[str, int], tuple[VADSights, Matched]] = {}

    def look(self, store: Frames, frames: Sequence[int]) -> tuple[Frames, Sequence[int]]:
        """As `adapters.extensions.training.frames.ForesightedObjective` describes."""
        seen = LookedAt(store, frames, self._look)
        return seen, weighed(seen, frames)

    def _look(self, scene: Sequence[TrainingFrame]) -> None:
        network = self.network
        previous: tuple[Tensor, Tensor] | None = None
        front_before: Tensor | None = None
        with torch.no_grad():
            for frame in scene:
                inputs = inputs_of(frame)
                predictions, finest_front, motion = looked(network, inputs, previous, True)
                previous = inputs.can_bus, predictions.bev
                # Copies, so that what is no longer needed of the same tensors is let go.
                sights = VADSights(
                    agent_states=predictions.agent_states[-1].clone(),
                    agent_places=predictions.agent_references[-1, :, :2].clone(),
                    map_states=predictions.map_states[-1].clone(),
                    map_points=predictions.map_points[-1].clone(),
                    map_scores=predictions.map_class_logits[-1].sigmoid().amax(-1),
                    finest_front=finest_front.clone(),
                    can_bus=motion.can_bus,
                    front_before=front_before,
                )
                if predictions.front is not None:
                    front_before = FrontReader.left(predictions.front, front_before)
                self._memory[frame.scene, frame.index] = sights, matched_agents(network, predictions, frame)

    def losses(self, clip: Sequence[TrainingFrame]) -> dict[str, Tensor]:
        """Losses of the last frame of a clip; weighted scalars by name."""
        frame = clip[-1]
        sights, matched = self._memory[frame.scene, frame.index]
        if self.network.training:
            agents, lines = (F.dropout(each, FORGOTTEN) for each in (sights.agent_states, sights.map_states))
            sights = replace(sights, agent_states=agents, map_states=lines)
        outlook = self.network.pts_bbox_head.look_ahead(sights)
        found = {
            **forecast_losses(self.network, outlook.mode_offsets, outlook.mode_logits, matched, frame),
            **plan_losses(outlook.plan_offsets, outlook.front, frame),
        }
        return {name: WEIGHTS[name] * loss for name, loss in found.items()}
