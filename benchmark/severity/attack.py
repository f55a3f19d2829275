"""Whether an attack on a planner succeeded, in three readings, each stricter than the one before."""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Attack:
    """One scene and one planner.

    Attributes:
        contact: Whether the planner touches anybody: the reading of the paper.
        at_fault: Whether the first contact is its fault.
        attributable: Whether, besides, the careful and competent human survives the same scene (CARS, 2026).
    """

    contact: bool
    at_fault: bool
    attributable: bool

    @classmethod
    def of(cls, at_fault: bool | None, careful_survives: bool) -> "Attack":
        """Read one scene.

        Args:
            at_fault: Whether the first contact is the planner's fault; ``None`` without contact.
            careful_survives: Whether the careful human survives the scene.

        Returns:
            The three readings.
        """
        blamed = bool(at_fault)
        return cls(at_fault is not None, blamed, blamed and careful_survives)


@dataclass(frozen=True, slots=True)
class AttackSuccess:
    """Shares of scenes, and of how many.

    Attributes:
        scenes: How many were read.
        contact: Share with any contact; ``None`` of no scenes.
        at_fault: Share with a contact at fault.
        attributable: Share with an attributable contact.
    """

    scenes: int
    contact: float | None
    at_fault: float | None
    attributable: float | None


def attack_success(attacks: Sequence[Attack]) -> AttackSuccess:
    """Sum scenes up.

    Args:
        attacks: One for each scene.

    Returns:
        The shares.
    """
    if not attacks:
        return AttackSuccess(0, None, None, None)
    shares = (
        sum(getattr(attack, reading) for attack in attacks) / len(attacks)
        for reading in ("contact", "at_fault", "attributable")
    )
    return AttackSuccess(len(attacks), *shares)
