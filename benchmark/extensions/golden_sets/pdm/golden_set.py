"""Golden files of the PDM sub-scores: scenes as plain arrays, plans, and what the official code says about them."""

from itertools import pairwise
from typing import Final

import numpy as np
from shapely.geometry import Polygon

from benchmark.constants import PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.pdm.definition import (
    CENTER_AHEAD_M,
    COMFORT_CENTER_AHEAD_M,
    LENGTH_M,
    STATE_COLUMNS,
    WHEELBASE_M,
    WIDTH_M,
)
from benchmark.pdm.road import Layer, Road
from benchmark.pdm.traffic import KeyFrames
from benchmark.verification.golden import GoldenArrays

VEHICLE: Final = (LENGTH_M, WIDTH_M, CENTER_AHEAD_M, WHEELBASE_M, WHEELBASE_M, COMFORT_CENTER_AHEAD_M)
"""Length, width, centre ahead, wheelbase of tracker and bicycle, centre ahead inside the comfort terms."""
RECORDED: Final = "recorded"
AGENT_TYPES: Final = 3
"""Types of objects below this move by themselves."""


class GoldenScene:
    """One scene with S samples and P plans for each.

    Attributes:
        now: (S, 11) states of the car.
        plans: (S, P, 6, 3) poses in the frame of the rear axle.
        history: (S, 4, 8) the beginnings of states at -1.5, -1, -0.5 and 0 s.
        recorded: Which plan is the recorded future, the reference of EP and of the filter.
        pair: (S,) samples with the same number are consecutive, the earlier one first.
        key_frames: Objects of all samples.
        route: (M, 2) polyline.
    """

    def __init__(self, stored: GoldenArrays) -> None:
        self.stored = stored
        self.plans = stored.floats("plans", None, None, PLAN_STEPS, 3)
        self.samples, self.count = self.plans.shape[:2]
        vehicle = tuple(stored.floats("vehicle", len(VEHICLE)).tolist())
        if vehicle != VEHICLE:
            raise ValueError(f"it is about a vehicle of {vehicle}, this program's is {VEHICLE}")
        self.now = stored.floats("ego_initial_state", self.samples, STATE_COLUMNS)
        self.history = stored.floats("history_keyframes", self.samples, 4, 8)
        self.recorded = stored.texts("plan_names", self.count).index(RECORDED)
        self.pair = stored.integers("pair", self.samples)
        self.route = stored.floats("centerline", None, 2)
        self.key_frames = self._key_frames()
        self.with_area = stored.verdicts("uses_drivable_area", self.samples)
        self._surfaces = self._read_surfaces()

    def road(self, sample: int) -> Road:
        """Surfaces of a sample; some do without the drivable area."""
        area = bool(self.with_area[sample])
        return Road.of([found for found in self._surfaces if area or found[0] is not Layer.DRIVABLE_AREA])

    def by_plan(self, name: str, *shape: int) -> Floats:
        """An official array, (S, P, ...)."""
        return self.stored.floats(name, self.samples, self.count, *shape)

    def flags_by_plan(self, name: str, *shape: int) -> Bools:
        """Official verdicts, (S, P, ...)."""
        return self.stored.verdicts(name, self.samples, self.count, *shape)

    def _key_frames(self) -> KeyFrames:
        stored, frames = self.stored, PLAN_STEPS + 1
        offsets = stored.integers("obj_offset", self.samples + 1)
        count = int(offsets[-1])
        return KeyFrames(
            offsets=offsets,
            box=stored.floats("obj_key_box", count, frames, 3),
            size=stored.floats("obj_size", count, 2),
            annotated=stored.verdicts("obj_key_valid", count, frames),
            velocity=stored.floats("obj_key_velocity", count, frames, 2),
            is_agent=stored.integers("obj_type", count) < AGENT_TYPES,
            number=np.arange(count),
        )

    def _read_surfaces(self) -> list[tuple[Layer, Polygon, bool]]:
        stored = self.stored
        names, layers = stored.texts("layer_names"), stored.integers("poly_layer", None)
        routed = stored.verdicts("poly_on_route", len(layers))
        points, offsets = stored.floats("ring_xy", None, 2), stored.integers("ring_offset", None)
        owner = stored.integers("ring_poly", len(offsets) - 1)
        is_hole = stored.verdicts("ring_is_hole", len(offsets) - 1)
        rings = [points[start:stop] for start, stop in pairwise(offsets.tolist())]
        shells = {int(owner[ring]): rings[ring] for ring in np.flatnonzero(~is_hole)}
        holes: dict[int, list[Floats]] = {}
        for ring in np.flatnonzero(is_hole):
            holes.setdefault(int(owner[ring]), []).append(rings[ring])
        return [
            (Layer(names[layer]), Polygon(shells[number], holes.get(number, [])), bool(on_route))
            for number, (layer, on_route) in enumerate(zip(layers.tolist(), routed))
        ]
