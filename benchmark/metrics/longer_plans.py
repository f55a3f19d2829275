"""Collision and L2 at 4, 5 and 6 s, of plans that reach so far: by the definition of ``exact``, from rows alone."""

from dataclasses import dataclass

import numpy as np

from benchmark.constants import LONGER_HORIZON_STEPS
from benchmark.metrics.rates import Rate, compute_ratios_over_scenes
from benchmark.metrics.scores import map_scenes_to_sources
from benchmark.records.run import RunRecord

HORIZONS = tuple(LONGER_HORIZON_STEPS)


@dataclass(frozen=True, slots=True)
class LongerRates:
    """Rates of a record beyond 3 s, by horizon.

    Collision is any contact up to there; its denominator are the samples whose plan and whose recording both reach the
    horizon, and whose surroundings are annotated. L2 is the displacement there, metres.
    """

    collision: dict[str, Rate]
    l2: dict[str, Rate]


def compute_longer_rates(record: RunRecord) -> LongerRates | None:
    """Rates at 4, 5 and 6 s; ``None`` where no plan reaches 4 s."""
    sources = map_scenes_to_sources(record)
    nearest = min(LONGER_HORIZON_STEPS.values())
    all_of = zip(record.columns.values("scene"), record.columns.values("longer"))
    rows = [(scene, longer) for scene, longer in all_of if longer is not None and len(longer.l2) >= nearest]
    if not rows:
        return None
    values = np.zeros((2, len(rows), len(HORIZONS)))
    counted = np.zeros((2, len(rows), len(HORIZONS)))
    for place, (_, longer) in enumerate(rows):
        for column, steps in enumerate(LONGER_HORIZON_STEPS.values()):
            metres = longer.l2[:steps]
            last = metres[-1]
            if len(metres) < steps or None in metres or last is None:
                continue
            counted[:, place, column] = longer.collision is not None, 1.0
            values[:, place, column] = any((longer.collision or [])[:steps]), last
    scenes = [sources[scene] for scene, _ in rows]
    collision, l2 = (
        dict(zip(HORIZONS, compute_ratios_over_scenes(part, weights, scenes, seed=record.run.seed), strict=True))
        for part, weights in zip(values, counted)
    )
    return LongerRates(collision, l2)
