"""Which vehicles of a scene are tried as adversaries, and for each of the others why not."""

from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError

from benchmark.scene import Scene
from generation.search.candidates import NotTried, draw, unfit
from generation.search.hyperparameters import HyperParameters


class SurveyedVehicle(BaseModel):
    """One four-wheeled vehicle.

    Attributes:
        agent: Its index in the scene.
        agent_id: Its instance identifier.
        category: nuScenes category.
        reason: Why it is not tried, ``None`` for one that is.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    agent: int
    agent_id: str
    category: str
    reason: NotTried | None


class Survey(BaseModel):
    """The vehicles of one scene; what is no four-wheeler is only counted.

    Attributes:
        scene_name: The scene.
        objects: Everything that is annotated.
        vehicles: All four-wheeled vehicles in the scene's order.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: int = 1
    scene_name: str
    objects: int
    vehicles: tuple[SurveyedVehicle, ...]

    @property
    def chosen(self) -> tuple[SurveyedVehicle, ...]:
        """Vehicles to try, by index."""
        return tuple(vehicle for vehicle in self.vehicles if vehicle.reason is None)

    def not_tried(self) -> dict[str, int]:
        """How many objects are not tried, by reason."""
        counts = {NotTried.NOT_FOUR_WHEELED.value: self.objects - len(self.vehicles)}
        for vehicle in self.vehicles:
            if vehicle.reason is not None:
                counts[vehicle.reason.value] = counts.get(vehicle.reason.value, 0) + 1
        return {reason: count for reason, count in counts.items() if count}

    def row(self, earlier: tuple[str, ...]) -> dict[str, Any]:
        """One line of ``candidates.jsonl``.

        Args:
            earlier: Instances that are adversaries already when these vehicles are looked at.

        Returns:
            JSON values.
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


def survey(scene: Scene, hyper: HyperParameters, seed: int) -> Survey:
    """Look at every object of a scene; who is tried is `generation.search.candidates.choose`.

    Args:
        scene: The recorded scene, or one with adversaries in it.
        hyper: Limits of the choice.
        seed: Which choice.

    Returns:
        The survey.
    """
    reasons: dict[int, NotTried | None] = {agent: unfit(scene, agent, hyper) for agent in range(len(scene.agents))}
    drawn = set(draw(scene, [agent for agent, reason in reasons.items() if reason is None], hyper, seed))
    return Survey(
        scene_name=scene.name,
        objects=len(scene.agents),
        vehicles=tuple(
            SurveyedVehicle(
                agent=agent,
                agent_id=scene.agents.ids[agent],
                category=scene.agents.categories[agent],
                reason=NotTried.NOT_DRAWN if reason is None and agent not in drawn else reason,
            )
            for agent, reason in reasons.items()
            if reason is not NotTried.NOT_FOUR_WHEELED
        ),
    )


def read_survey(value: Any, scene_name: str) -> Survey | None:
    """A survey that was kept on disk; ``None`` where it is damaged or of another scene, so that it is made again.

    Args:
        value: JSON value.
        scene_name: The scene it should be of.

    Returns:
        The survey, or ``None``.
    """
    try:
        kept = Survey.model_validate(value)
    except ValidationError:
        return None
    return kept if kept.scene_name == scene_name else None
