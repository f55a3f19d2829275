"""Which vehicles of a scene are tried as adversaries, and for each of the others why not."""

from collections import Counter
from collections.abc import Sequence
from typing import Any

from pydantic import BaseModel, ConfigDict

from benchmark.scene import Scene
from generation.search.candidates import NotTried, draw, unfit
from generation.search.hyperparameters import HyperParameters


class ConsideredVehicle(BaseModel):
    """One four-wheeled vehicle, and the reason why it is not tried (``None`` for one that is)."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    agent: int
    agent_id: str
    category: str
    reason: NotTried | None


class Eligibility(BaseModel):
    """Four-wheeled vehicles of one scene, in its order, and which of them are tried.

    ``objects`` only counts everything that is annotated.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: int = 1
    scene_name: str
    objects: int
    vehicles: tuple[ConsideredVehicle, ...]

    @property
    def chosen(self) -> tuple[ConsideredVehicle, ...]:
        """Vehicles to try, by index."""
        return tuple(vehicle for vehicle in self.vehicles if vehicle.reason is None)

    def not_tried(self) -> dict[str, int]:
        """Number of objects that are not tried, by reason."""
        counts = {NotTried.NOT_FOUR_WHEELED.value: self.objects - len(self.vehicles)}
        for vehicle in self.vehicles:
            if vehicle.reason is not None:
                counts[vehicle.reason.value] = counts.get(vehicle.reason.value, 0) + 1
        return {reason: count for reason, count in counts.items() if count}

    def row(self, earlier: tuple[str, ...]) -> dict[str, Any]:
        """One line of ``candidates.jsonl``.

        ``earlier`` are the instances that are adversaries already when these vehicles are looked at.
        """
        return {
            "scene": self.scene_name,
            "earlier": list(earlier),
            "objects": self.objects,
            "tried": len(self.chosen),
            "not_tried": self.not_tried(),
            "vehicles": [
                {"agent": vehicle.agent_id, "category": vehicle.category, "not_tried": vehicle.reason}
                for vehicle in self.vehicles
            ],
        }


def not_tried_together(looks: Sequence[Eligibility]) -> dict[str, int]:
    """Number of objects of several scenes that are not tried, by reason."""
    counts: Counter[str] = Counter()
    for look in looks:
        counts.update(look.not_tried())
    return dict(counts)


def eligibility_of(scene: Scene, hyper: HyperParameters, seed: int) -> Eligibility:
    """Which vehicles of a scene are tried and why the others are not.

    ``seed`` chooses where more than ``hyper.candidate_limit`` qualify.
    """
    reasons: dict[int, NotTried | None] = {agent: unfit(scene, agent, hyper) for agent in range(len(scene.agents))}
    drawn = set(draw(scene, [agent for agent, reason in reasons.items() if reason is None], hyper, seed))
    return Eligibility(
        scene_name=scene.name,
        objects=len(scene.agents),
        vehicles=tuple(
            ConsideredVehicle(
                agent=agent,
                agent_id=scene.agents.ids[agent],
                category=scene.agents.categories[agent],
                reason=NotTried.NOT_DRAWN if reason is None and agent not in drawn else reason,
            )
            for agent, reason in reasons.items()
            if reason is not NotTried.NOT_FOUR_WHEELED
        ),
    )
