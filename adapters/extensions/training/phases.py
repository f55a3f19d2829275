"""Parts of a training that follow one another, each with its own objective and recipe."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

from adapters.extensions.training.frames import Objective
from adapters.extensions.training.trainer import Recipe


@dataclass(frozen=True, slots=True)
class Phase:
    """One part of a training; it starts from the averaged weights of the part before it.

    `objective` makes that of a network; it may set first values and what of the network learns.
    """

    name: str
    objective: Callable[[Any], Objective]
    recipe: Recipe

    def changed(self, share: float, seed: int, learning_rate: float | None) -> Self:
        """The same phase with a share of its steps; a learning rate of ``None`` is the recipe's own."""
        steps = max(round(self.recipe.steps * share), 1)
        peak = self.recipe.learning_rate if learning_rate is None else learning_rate
        return replace(self, recipe=replace(self.recipe, steps=steps, seed=seed, learning_rate=peak))
