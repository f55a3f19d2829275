"""How hard a contact is: what a row of a table says of the first contact of a scene."""

from dataclasses import dataclass

import numpy as np

from benchmark.drivers.outcomes import Contact
from benchmark.encounters.contacts import ContactKind, at_fault, delta_v, fatal_probability, mass_kg


@dataclass(frozen=True, slots=True)
class Impact:
    """A contact in numbers.

    Attributes:
        time: Seconds.
        agent: Index of who is touched.
        kind: What hits what.
        at_fault: Whether the ego is to blame.
        impact_speed: m/s.
        delta_v_ego: Change of the ego's velocity, m/s.
        delta_v_other: Change of the other's velocity, m/s: what to look at for people on foot.
        fatal_probability: Of those in the ego.
    """

    time: float
    agent: int
    kind: ContactKind
    at_fault: bool
    impact_speed: float
    delta_v_ego: float
    delta_v_other: float
    fatal_probability: float


def impact_of(contact: Contact, category: str, *, unsure: bool = False) -> Impact:
    """The numbers of a contact.

    Args:
        contact: The first contact of a run.
        category: Of who is touched.
        unsure: Whether the ego is in several lanes or off the drivable area, which makes a lateral contact its fault.

    Returns:
        The impact.
    """
    ego, other = delta_v(np.asarray(contact.impact_speed), np.asarray(mass_kg(category)))
    return Impact(
        time=contact.time,
        agent=contact.agent,
        kind=contact.kind,
        at_fault=at_fault(contact.kind, unsure),
        impact_speed=contact.impact_speed,
        delta_v_ego=float(ego),
        delta_v_other=float(other),
        fatal_probability=float(fatal_probability(ego)),
    )
