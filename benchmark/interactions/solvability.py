"""The ladder of a scene: which drivers survive it, and whether any could.

``docs/severity.md``, "What solvable means". That the recorded ego passes says nothing of a driver who reacts; that a
careful human passes does.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import shapely

from benchmark.interactions.avoidability import REACTION_S, BaselineEgo, LastAvoidableTime
from benchmark.interactions.driver_outcomes import CollisionChecker, DriverOutcome
from benchmark.interactions.driver_simulation import DrivingSituation, find_first_visible_time, simulate_drivers
from benchmark.interactions.reaction import Driver
from benchmark.interactions.tracks import ContinuousTracks


@dataclass(frozen=True)
class SceneReferenceDrivers:
    """Reference drivers in a scene; outcomes go from the weakest statement to the most cautious.

    ``first_visible`` is when the recorded ego first sees the adversary once drivers drive, seconds, ``None`` for never.
    ``drivable`` is where manoeuvres may go, ``None`` without a map, which a report must say.
    """

    situation: DrivingSituation
    outcomes: dict[Driver, DriverOutcome]
    first_visible: float | None
    drivable: shapely.MultiPolygon | None

    @classmethod
    def of(
        cls,
        tracks: ContinuousTracks,
        adversary: int | None,
        start: float | None = None,
        drivable: shapely.MultiPolygon | None = None,
    ) -> "SceneReferenceDrivers":
        """Let all drivers drive a scene from ``start`` on, by default from its first frame.

        Manoeuvres may go anywhere by default. Where no adversary is known, it is never visible.
        """
        situation = DrivingSituation.of(tracks, start, adversary)
        surroundings = CollisionChecker.of(situation)
        outcomes = {
            motion.reference_driver.driver: surroundings.find_outcome(motion) for motion in simulate_drivers(situation)
        }
        visible_from = None if adversary is None else find_first_visible_time(tracks, adversary, situation.times)
        return cls(situation, outcomes, visible_from, drivable)

    def for_adversary(self, adversary: int) -> Self:
        """The same scene, with what was found, for another adversary: drivers and last chance do not depend on it."""
        situation = self.situation
        visible_from = find_first_visible_time(situation.tracks, adversary, situation.times)
        other = type(self)(situation, self.outcomes, visible_from, self.drivable)
        other.__dict__.update({name: getattr(self, name) for name in ("base", "last_chance")})
        return other

    def survives(self, driver: Driver) -> bool:
        """Whether a driver hits nothing."""
        return self.outcomes[driver].survives

    @cached_property
    def base(self) -> BaselineEgo:
        """The ego at constant speed, whose contact is to be avoided."""
        return BaselineEgo(self.situation, Driver.CONSTANT, self.drivable)

    @cached_property
    def last_chance(self) -> LastAvoidableTime:
        """Of the ego at constant speed."""
        return self.base.last_chance()

    @property
    def margin_s(self) -> float | None:
        """Time from when a driver could have reacted to the last chance; ``None`` where there is no last chance."""
        if self.last_chance.time is None or self.first_visible is None:
            return None
        return self.last_chance.time - (self.first_visible + REACTION_S)

    @cached_property
    def unsolvable(self) -> bool:
        """Whether no driver could have avoided it.

        No sampled manoeuvre succeeds 0.75 s after the adversary is first visible, and neither the careful human nor FSM
        survives.
        """
        if self.survives(Driver.CC) or self.survives(Driver.FSM):
            return False
        return not self.base.is_avoidable_after(self.first_visible)
