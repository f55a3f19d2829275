"""A contact of a drive in numbers: who, of what kind, at whose fault, how hard."""

import numpy as np

from benchmark.closed_loop.riding import Touch
from benchmark.interactions.contacts import KINDS, at_fault, delta_v, mass_kg
from benchmark.records.drive_schema import ScoredContact
from benchmark.scene import Scene


def scored_contact(
    scene: Scene, touch: Touch, start_us: int, *, unsure: bool, adversary: int | None = None
) -> ScoredContact:
    """A contact in numbers.

    Args:
        start_us: Time of the first driven instant.
        unsure: Whether the ego is in several lanes or off the drivable area, which makes a lateral contact its fault.
        adversary: Index of the agent that became an adversary in this drive alone.
    """
    pair = touch.pair
    kind = KINDS[int(pair.kinds[0])]
    impact = pair.impact_speed
    own, others = delta_v(impact, np.array([mass_kg(touch.category)]))
    return ScoredContact(
        seconds=(touch.time_us - start_us) * 1e-6,
        agent=touch.uuid,
        category=touch.category,
        adversary=touch.uuid in scene.adversaries or touch.agent == adversary,
        kind=kind.value,
        at_fault=at_fault(kind, unsure),
        impact_speed=float(impact[0]),
        delta_v_ego=float(own[0]),
        delta_v_other=float(others[0]),
    )
