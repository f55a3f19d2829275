"""Parts of a training that follow one another, each with its own objective and recipe."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Self

from adapters.extensions.training.frames import Objective
from adapters.extensions.training.trainer import Recipe


@dataclass(frozen=True, slots=True)
class Phase:
    """One part of a training; it starts from the averaged weights of the part before it.

    Attributes:
        name: In the names of files and in the log.
        objective: Makes the objective of a network; may set its first values and what of it learns.
        recipe: How long and how fast.
    """

    name: str
    objective: Callable[[Any], Objective]
    recipe: Recipe

    def changed(self, share: float, seed: int, learning_rate: float | None) -> Self:
        """The same phase, shorter or longer.

        Args:
            share: Of its steps.
            seed: Of everything that is drawn.
            learning_rate: Peak, or ``None`` for the recipe's own.

        Returns:
            The phase.
        """
        steps = max(round(self.recipe.steps * share), 1)
        peak = self.recipe.learning_rate if learning_rate is None else learning_rate
        return replace(self, recipe=replace(self.recipe, steps=steps, seed=seed, learning_rate=peak))
