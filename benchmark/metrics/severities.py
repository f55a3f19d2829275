"""How severe a planner's plans are, from its record: distributions over its samples with a contact, and without."""

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.metrics.attacks import counted_rows
from benchmark.records.judgement import KindName
from benchmark.records.row_schema import PlanContactRow, PlanNearRow
from benchmark.records.run import RunRecord

CRITICAL_BTN: Final = 1.0
"""From here on braking alone is not enough."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Median and worst tenth of a quantity over the samples of which it is known; both are values that samples have.

    One in ten reaches the worst tenth, or worse; worse is more, or less where the quantity is a distance or a time
    that is left.
    """

    samples: int
    median: float | None
    worst_tenth: float | None


@dataclass(frozen=True, slots=True)
class Contacts:
    """Samples whose first contact is with an adversary, or of those with a bystander; speeds in m/s.

    ``mean_fatal`` and ``most_fatal`` are of the probability that an occupant of the ego dies.
    """

    samples: int
    at_fault: int
    kinds: dict[KindName, int]
    impact_speed: Spread
    delta_v_ego: Spread
    delta_v_other: Spread
    mean_fatal: float | None
    most_fatal: float | None


@dataclass(frozen=True, slots=True)
class NearPasses:
    """Samples without a contact at which an adversary is there.

    Attributes:
        gap: Smallest distance, metres.
        ttc: Least time to contact, seconds, of those that head for one another.
        tet: Time exposed, seconds.
        tit: Time integrated, s^2.
        pet: Post-encroachment time, seconds, of those whose ways meet.
        btn: Largest braking threat number.
        critical: How many have one at which braking alone is not enough.
    """

    samples: int
    gap: Spread
    ttc: Spread
    tet: Spread
    tit: Spread
    pet: Spread
    btn: Spread
    critical: int


def contacts_of(record: RunRecord, *, bystanders: bool = False) -> Contacts:
    """The first contacts of a record's plans with an adversary, or those with a bystander instead."""
    rows = [row.severity.contact for row in counted_rows(record) if row.severity is not None]
    found = [contact for contact in rows if contact is not None and contact.adversary is not bystanders]
    fatal = [contact.fatal_probability for contact in found]

    def spread(value: Callable[[PlanContactRow], float]) -> Spread:
        return spread_of([value(contact) for contact in found])

    return Contacts(
        samples=len(found),
        at_fault=sum(contact.at_fault is True for contact in found),
        kinds=dict(Counter(contact.kind for contact in found)),
        impact_speed=spread(lambda contact: contact.impact_speed_m_s),
        delta_v_ego=spread(lambda contact: contact.delta_v_ego_m_s),
        delta_v_other=spread(lambda contact: contact.delta_v_other_m_s),
        mean_fatal=float(np.mean(fatal)) if fatal else None,
        most_fatal=max(fatal, default=None),
    )


def near_passes_of(record: RunRecord) -> NearPasses:
    """How near a record's plans without contact come to the adversaries."""
    rows = [row.severity.near for row in counted_rows(record) if row.severity is not None]
    found = [near for near in rows if near is not None]

    def spread(value: Callable[[PlanNearRow], float | None], *, less_is_worse: bool = False) -> Spread:
        known = [one for one in map(value, found) if one is not None]
        return spread_of(known, less_is_worse=less_is_worse)

    return NearPasses(
        samples=len(found),
        gap=spread(lambda near: near.least_gap_m, less_is_worse=True),
        ttc=spread(lambda near: near.least_ttc_s, less_is_worse=True),
        tet=spread(lambda near: near.tet_s),
        tit=spread(lambda near: near.tit_s2),
        pet=spread(lambda near: near.pet_s, less_is_worse=True),
        btn=spread(lambda near: near.max_btn),
        critical=sum(near.max_btn >= CRITICAL_BTN for near in found),
    )


def spread_of(values: Sequence[float], *, less_is_worse: bool = False) -> Spread:
    """Median and worst tenth: values among those given, the worse of two where a middle lies between them."""
    if not values:
        return Spread(0, None, None)
    order = sorted(values) if less_is_worse else sorted(values, reverse=True)
    return Spread(len(order), order[(len(order) - 1) // 2], order[(len(order) - 1) // 10])
