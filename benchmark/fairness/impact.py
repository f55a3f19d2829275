"""How hard a contact is: what a row of a table says of the first contact of a scene."""

from dataclasses import dataclass

import numpy as np

from benchmark.interactions.contacts import (
    KINDS,
    ContactKind,
    Pairs,
    at_fault,
    delta_v,
    fatal_probability,
    is_agent,
    mass_kg,
)
from benchmark.interactions.outcomes import Contact
from benchmark.interactions.tracks import STEP_S, Tracks


@dataclass(frozen=True, slots=True)
class Impact:
    """Contact in numbers; seconds and m/s.

    Attributes:
        agent: Index of the touched agent.
        at_fault: Whether the ego is to blame.
        delta_v_other: Change of the other's velocity: what to look at for people on foot.
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
    """The numbers of the first contact of a run with an agent of a category.

    ``unsure`` is the ego in several lanes or off the drivable area, which makes a lateral contact its fault.
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


def contact_at(tracks: Tracks, agent: int, time: float) -> Contact:
    """The ego and an agent at the moment at which they touch, independent of earlier touches of either.

    The ego may be the recorded one or one that follows a plan; seconds are inside the tracks. Speeds are those of the
    last 0.2 s (`Tracks.velocities_at`), the ego's along its heading.
    """
    at = np.array([time])
    ego, other = tracks.ego_at(at), tracks.agents_at(at)[0][agent]
    pair = Pairs(
        ego=ego,
        ego_speed=np.hypot(*tracks.ego_velocities_at(at).T),
        other=other,
        other_velocity=tracks.velocities_at(at, np.array([agent]))[0],
        is_agent=np.array([is_agent(tracks.categories[agent])]),
    )
    return Contact(
        time=time,
        step=round((time - float(tracks.seconds[0])) / STEP_S),
        agent=agent,
        kind=KINDS[pair.kinds[0]],
        ego_speed=float(pair.ego_speed[0]),
        other_speed=float(pair.other_speed[0]),
        impact_speed=float(pair.impact_speed[0]),
        ego=ego[0],
        other=other[0],
    )
