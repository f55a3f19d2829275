"""From sub-scores to scores: products, weighted means, and the filter by what the recorded driver did."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from benchmark.geometry import Bools, Floats

WEIGHTS: Final = {"ep": 5.0, "ttc": 5.0, "lk": 2.0, "hc": 2.0}
EC_WEIGHT: Final = 2.0
FILTERED: Final = ("nc", "dac", "ddc", "ep", "ttc", "lk", "hc")
"""Sub-scores that the filter touches; EC stays as it is."""


@dataclass(frozen=True, slots=True)
class SubScores:
    """Sub-scores of motions, each of one shape, 0 to 1.

    Attributes:
        nc: No collision at fault.
        dac: Drivable area compliance.
        ddc: Driving direction compliance.
        ep: Ego progress.
        ttc: Time to collision.
        lk: Lane keeping.
        hc: History comfort.
    """

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

    def forgiving(self, forgiven: Mapping[str, Bools]) -> Self:
        """The same with some sub-scores set to 1.

        They are forgiven, by sub-score, where the recorded driver, scored alone and without a history, has 0
        (`zeros`).
        """
        return replace(self, **{name: np.where(zero, 1.0, getattr(self, name)) for name, zero in forgiven.items()})

    def _weighted(self) -> Floats:
        # In this order always: the sum of other orders differs in the last bit.
        return np.asarray(sum(weight * getattr(self, name) for name, weight in WEIGHTS.items()))
