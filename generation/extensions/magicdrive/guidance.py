"""Classifier-free guidance: one branch is told everything, one is not, and the sampler follows their difference."""

from dataclasses import replace
from typing import Literal, Self

import torch
from torch import Tensor

from generation.extensions.magicdrive.conditions import Conditions, TextStates
from generation.extensions.magicdrive.model import Encoded, MagicDriveDiT

GuidanceMode = Literal["rflow-slice", "rflow"]


def null_conditions(model: MagicDriveDiT, conditions: Conditions, *, keep_map: bool) -> Conditions:
    """Conditions of the null branch (section 8): size and frame rate, and a negative prompt if there is one.

    There is one empty box, which stands for all of them; prompt, camera and ego motion are the learned null ones of
    ``model``.
    """
    views, frames = conditions.views, conditions.frames
    text, negative = conditions.text, conditions.negative_text
    hidden = model.y_embedder.y_embedding if negative is None else negative.hidden
    ego = conditions.rel_pos.clone()
    ego[:, :3] = model.frame_embedder.uncond_cam
    return replace(
        conditions,
        bboxes=conditions.bboxes.new_zeros(1, frames, 1, 8, 3),
        classes=conditions.classes.new_zeros(1, frames, 1),
        masks=conditions.masks.new_zeros(views, frames, 1),
        box_latent=conditions.box_latent.new_zeros(1, conditions.box_latent.shape[1]),
        cams=model.camera_embedder.uncond_cam.to(conditions.cams.dtype).expand_as(conditions.cams),
        rel_pos=ego,
        maps=conditions.maps if keep_map else torch.zeros_like(conditions.maps),
        # As published, as many tokens as the prompt has, whatever the length of the negative one.
        text=TextStates(hidden, text.mask),
        negative_text=None,
    )


class GuidedModel:
    """A network with the conditions of one clip."""

    def __init__(
        self, model: MagicDriveDiT, conditional: Encoded, unconditional: Encoded, scale: float, *, together: bool
    ) -> None:
        """Take branches that are encoded already.

        A scale of 1 is the first branch alone; both ``together`` as one batch take twice the memory.
        """
        self._model, self._scale = model, scale
        self._branches = (Encoded.batched([conditional, unconditional]),) if together else (conditional, unconditional)

    @classmethod
    def of(
        cls,
        model: MagicDriveDiT,
        conditions: Conditions,
        *,
        mode: GuidanceMode = "rflow-slice",
        scale: float = 2.0,
        together: bool = False,
        keep_keys_values: bool = False,
        rows_multiple: int | None = None,
    ) -> Self:
        """Encode both branches.

        Args:
            mode: ``rflow-slice`` takes the map away from the null branch, ``rflow`` leaves it there.
            together: Whether both branches are one batch, which takes twice the memory.
            keep_keys_values: Whether to keep what the blocks make of the conditions, for speed; not with ``together``.
            rows_multiple: To what rows of tokens are padded; as the configuration says by default.
        """
        keep = keep_keys_values and not together
        null = null_conditions(model, conditions, keep_map=mode == "rflow")
        return cls(
            model,
            model.encode(conditions, rows_multiple=rows_multiple, keep_keys_values=keep),
            model.encode(null, box_repeats=conditions.boxes, rows_multiple=rows_multiple, keep_keys_values=keep),
            scale,
            together=together,
        )

    def branches(self, latent: Tensor, timestep: Tensor, given: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Velocities of both branches; arguments as in `MagicDriveDiT.forward` with a batch of one."""
        if len(self._branches) == 1:
            twice = None if given is None else given.expand(2, -1)
            inputs = latent.expand(2, *latent.shape[1:]), timestep.expand(2)
            both = self._model(*inputs, self._branches[0], twice).chunk(2)
        else:
            both = tuple(self._model(latent, timestep, encoded, given) for encoded in self._branches)
        conditional, unconditional = both
        return conditional, unconditional

    def velocity(self, latent: Tensor, timestep: Tensor, given: Tensor | None = None) -> Tensor:
        """The velocity to follow, (1, 96, t, h, w) in single precision."""
        conditional, unconditional = self.branches(latent, timestep, given)
        return unconditional + self._scale * (conditional - unconditional)
