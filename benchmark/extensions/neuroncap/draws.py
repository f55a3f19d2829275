"""A run's draws, in the official order and written down: its seed is the run's index."""

from collections.abc import Sequence
from typing import Any, Self

import numpy as np

Draw = tuple[Any, ...]
"""Name of the generator's call, its arguments, its result; permutations and choices as indices."""


class Draws:
    """PCG64 with a log of all draws in order."""

    def __init__(self, seed: int, made: Sequence[Draw] = ()) -> None:
        self._generator = np.random.default_rng(seed)
        self.made: list[Draw] = [*made, ("default_rng", seed)]

    def seeded_again(self, seed: int) -> Self:
        """A fresh generator whose log goes on from this one's."""
        return type(self)(seed, self.made)

    def integers(self, low: int, high: int) -> int:
        """From ``low`` to ``high - 1``."""
        drawn = int(self._generator.integers(low, high))
        self.made.append(("integers", low, high, drawn))
        return drawn

    def permutation(self, count: int) -> list[int]:
        """An order of so many."""
        drawn = [int(index) for index in self._generator.permutation(count)]
        self.made.append(("permutation", count, drawn))
        return drawn

    def choice(self, count: int) -> int:
        """One of so many; no bits are used for one."""
        drawn = int(self._generator.choice(count))
        self.made.append(("choice", count, drawn))
        return drawn

    def uniform(self, limit: float) -> float:
        """Between plus and minus a limit."""
        drawn = float(self._generator.uniform(-limit, limit))
        self.made.append(("uniform", -limit, limit, drawn))
        return drawn

    def normal(self, scale: float) -> float:
        """Around zero with a standard deviation."""
        drawn = float(self._generator.normal(scale=scale))
        self.made.append(("normal", scale, drawn))
        return drawn
