"""Verdicts on plans, and from sub-scores to scores: products, means, the filter by what the recorded driver did."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Final, Self

import numpy as np
from pydantic import Field

from benchmark.geometry import Bools, Floats

WEIGHTS: Final = {"ep": 5.0, "ttc": 5.0, "lk": 2.0, "hc": 2.0}
EC_WEIGHT: Final = 2.0
FILTERED: Final = ("nc", "dac", "ddc", "ep", "ttc", "lk", "hc")
"""Sub-scores that the filter touches; EC stays as it is."""


@dataclass(frozen=True, slots=True)
class DrivenPlan:
    """Verdict on one plan under ``nuscenes-pdm``.

    Attributes:
        nc: No collision at fault: 0, 1/2 or 1.
        dac: Drivable area compliance: 0 or 1.
        ddc: Driving direction compliance: 0, 1/2 or 1.
        ep: Ego progress beside the recorded future, 0 to 1.
        ttc: Time to collision: 0 or 1.
        lk: Lane keeping: 0 or 1.
        hc: History comfort: 0 or 1; ``None`` where the recording began less than 1.5 s before (totals count it as 1).
        ec: Extended comfort: 0 or 1; ``None`` where no plan was made up to 0.55 s before.
        forgiven: Sub-scores in which the recorded driver has 0: 1 in the filtered scores.
        progress_m: Along the route in 3 s.
        recorded_progress_m: The same of the recorded future, tracked in the same way.
        collision_s: When the first contact at fault begins, if there is one.
        ttc_s: The first time that is followed by contact within 0.9 s, if there is one.
        hit: Instance that the driven plan touches first, at fault or not, if it touches any; of several the first by
            name.
        first_contact_s: When.
        hit_adversary: Whether that is an adversary; false without contact, ``None`` in older records, which do not
            say whom a plan touches.
        adversary_contact_s: When an adversary is first touched, also after other objects.
    """

    nc: float
    dac: float
    ddc: float
    ep: float
    ttc: float
    lk: float
    hc: float | None
    ec: float | None
    forgiven: list[str]
    progress_m: float
    recorded_progress_m: float
    collision_s: float | None
    ttc_s: float | None
    hit: Annotated[str, Field(max_length=500)] | None = None
    first_contact_s: float | None = None
    hit_adversary: bool | None = None
    adversary_contact_s: float | None = None


@dataclass(frozen=True, slots=True)
class SubScores:
    """Sub-scores of motions (see `DrivenPlan`), each of one shape, 0 to 1."""

    nc: Floats
    dac: Floats
    ddc: Floats
    ep: Floats
    ttc: Floats
    lk: Floats
    hc: Floats

    @property
    def multiplier(self) -> Floats:
        """NC DAC DDC; there are no traffic lights to obey."""
        return self.nc * self.dac * self.ddc

    @property
    def score_without_ec(self) -> Floats:
        """The score of a plan without a predecessor."""
        return self.multiplier * self._weighted() / sum(WEIGHTS.values())

    def score(self, ec: Floats) -> Floats:
        """The score of a plan, 0 to 1, with its extended comfort, 0 to 1."""
        return self.multiplier * (self._weighted() + EC_WEIGHT * ec) / (sum(WEIGHTS.values()) + EC_WEIGHT)

    def zeros(self) -> dict[str, Bools]:
        """Where each sub-score is zero: what the filter forgives if these are the recorded driver's."""
        return {name: np.asarray(getattr(self, name) == 0.0) for name in FILTERED}

    def forgive(self, forgiven: Mapping[str, Bools]) -> Self:
        """The same with sub-scores set to 1 where the recorded driver, alone and without history, has 0 (`zeros`)."""
        return replace(self, **{name: np.where(zero, 1.0, getattr(self, name)) for name, zero in forgiven.items()})

    def _weighted(self) -> Floats:
        # In this order always: the sum of other orders differs in the last bit.
        return np.asarray(sum(weight * getattr(self, name) for name, weight in WEIGHTS.items()))
