"""How hard a contact is: what a row of a table says of the first contact of a scene."""

from typing import Final

import numpy as np

from benchmark.interactions.contacts import (
    KINDS,
    Pairs,
    delta_v,
    fatal_probability,
    is_agent,
    mass_kg,
)
from benchmark.interactions.outcomes import Contact
from benchmark.interactions.tracks import STEP_S, Tracks
from benchmark.records.judgement import Impact

DIGITS: Final = 6
"""Numbers are rounded, so that they are the same on every machine."""


def impact_of(contact: Contact, category: str, at_fault: bool | None) -> Impact:
    """The numbers of the first contact of a run with an agent of a category, and whether the ego is to blame."""
    ego, other = delta_v(np.asarray(contact.impact_speed), np.asarray(mass_kg(category)))
    numbers = {
        "time_s": contact.time,
        "impact_speed_m_s": contact.impact_speed,
        "delta_v_ego_m_s": float(ego),
        "delta_v_other_m_s": float(other),
        "fatal_probability": float(fatal_probability(ego)),
    }
    # Adding zero makes -0.0 plain.
    rounded = {name: round(value, DIGITS) + 0.0 for name, value in numbers.items()}
    return Impact(kind=contact.kind.value, at_fault=at_fault, **rounded)


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
