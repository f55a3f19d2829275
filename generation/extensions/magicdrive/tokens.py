"""The tokens that describe a clip to the transformer, each kind in the smallest shape that says it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Self

import torch
from torch import Tensor


@dataclass(frozen=True, slots=True)
class ConditionTokens:
    """Tokens of every view and latent frame (section 4), or keys and values made of them.

    An axis of length one means the same for all views or frames, so that linear layers see no token twice. What a layer
    makes of n equal tokens is made once.

    Attributes:
        ego: (b, 1, t, 1, C) ego motion.
        camera: (b, V, 1, 1, C).
        text: (b, 1, 1, L, C).
        boxes: (b, V, t, n, C).
        box_repeats: How often each box token stands in the sequence.
    """

    ego: Tensor
    camera: Tensor
    text: Tensor
    boxes: Tensor
    box_repeats: int = 1

    def map(self, layer: Callable[[Tensor], Tensor]) -> Self:
        """Apply what works on each token alone, for example a linear layer."""
        return type(self)(layer(self.ego), layer(self.camera), layer(self.text), layer(self.boxes), self.box_repeats)

    def sequence(self) -> Tensor:
        """All tokens in the model's order, (b, V, t, 2 + L + n, C): ego motion, camera, text, boxes."""
        batch, views, frames = self.boxes.shape[:3]
        repeated = self.boxes if self.box_repeats == 1 else self._repeated_boxes()
        kinds = [kind.expand(batch, views, frames, -1, -1) for kind in (self.ego, self.camera, self.text)]
        return torch.cat([*kinds, repeated], 3)

    @property
    def length(self) -> int:
        """Length of the sequence."""
        return 2 + self.text.shape[3] + self.boxes.shape[3] * self.box_repeats

    @classmethod
    def batched(cls, parts: Sequence[Self]) -> Self:
        """Several scenes or branches as one batch.

        They have equal numbers of views, frames, text tokens and boxes; repeats are kept where all parts have the
        same.
        """
        same = len({part.box_repeats for part in parts}) == 1
        boxes = [part.boxes if same else part._repeated_boxes() for part in parts]
        lengths = {(part.text.shape[3], tuple(own.shape[1:])) for part, own in zip(parts, boxes, strict=True)}
        if len(lengths) != 1:
            raise ValueError(f"conditions of different sizes cannot be one batch: {sorted(lengths)}")
        return cls(
            ego=torch.cat([part.ego for part in parts]),
            camera=torch.cat([part.camera for part in parts]),
            text=torch.cat([part.text for part in parts]),
            boxes=torch.cat(boxes),
            box_repeats=parts[0].box_repeats if same else 1,
        )

    def _repeated_boxes(self) -> Tensor:
        batch, views, frames, boxes, _ = self.boxes.shape
        return self.boxes[..., None, :].expand(batch, views, frames, boxes, self.box_repeats, -1).flatten(3, 4)
