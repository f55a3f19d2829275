"""Planners that choose among generated scenes: members, seeds and how they are made; none needs images."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from benchmark.planning import Planner


@dataclass(frozen=True, slots=True)
class PlannerPanel:
    """A panel: ``members`` are names with the number of their seeds, from 0; who is on it is not held out.

    ``make`` gives a planner of a name and a ``seed``. At most ``per_scene`` scenes of a recording are kept.
    """

    members: tuple[tuple[str, int], ...]
    make: Callable[..., Planner]
    per_scene: int = 2

    def as_json(self) -> dict[str, Any]:
        """Who is on it, as JSON values."""
        return {"members": dict(self.members), "per_scene": self.per_scene}

    def sentence(self) -> str:
        """Who is on it, for people."""
        return ", ".join(f"{name} (seeds 0-{seeds - 1})" if seeds > 1 else name for name, seeds in self.members)
