"""A road where there is no map: where logged vehicles drove, as wide as lanes, and in which direction."""

from collections.abc import Sequence
from typing import Final

import numpy as np
import shapely
from shapely.geometry import LineString

from benchmark.geometry import Floats
from benchmark.road_map import Lane, RoadMap, as_multipolygon

LANE_M: Final = 3.2
"""Width of the strip that a car's path stands for; a wider vehicle has `_AIR_M` on both sides."""
_AIR_M: Final = 0.3
_END_M: Final = 1.0
"""Of road beyond the body where a path begins and ends."""
_LEAST_MOTION_M: Final = 3.0
"""Who moves less is parked, and where it stands is no lane."""
_SPACING_M: Final = 1.0
_SMOOTH_M: Final = 0.05


def estimate_road(paths: Sequence[tuple[str, Floats, Floats]], location: str = "") -> RoadMap:
    """Drivable corridor and lanes of vehicles: name, (P, 3) poses of the box centre, (3,) size of each."""
    strips, lanes = [], {}
    for name, poses, size in paths:
        line = _thin_path(poses)
        if line is None:
            continue
        ahead = 0.5 * float(size[0]) + _END_M
        ends = [line[0] - ahead * _direction(line[1] - line[0]), line[-1] + ahead * _direction(line[-1] - line[-2])]
        whole = LineString(np.concatenate([ends[:1], line, ends[1:]])).simplify(_SMOOTH_M)
        width = max(LANE_M, float(size[1]) + 2.0 * _AIR_M)
        strips.append(whole.buffer(0.5 * width, cap_style="flat"))
        lanes[name] = Lane(name, np.asarray(whole.coords), None, (), (), is_connector=False)
    return RoadMap(location, as_multipolygon(shapely.union_all(strips)), lanes)


def _thin_path(poses: Floats) -> Floats | None:
    """(K, 2) points at least a metre apart that a vehicle drove over; ``None`` if it did not drive."""
    kept = [poses[0, :2]]
    for point in poses[1:, :2]:
        if np.hypot(*(point - kept[-1])) >= _SPACING_M:
            kept.append(point)
    driven = float(np.hypot(*np.diff(kept, axis=0).T).sum()) if len(kept) > 1 else 0.0
    return np.array(kept) if driven >= _LEAST_MOTION_M else None


def _direction(step: Floats) -> Floats:
    return np.asarray(step / np.hypot(*step))
