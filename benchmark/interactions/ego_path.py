"""The path that the ego took, as stations: what a driver follows who brakes or dawdles instead.

``docs/severity.md``, "Path". Station 0 is the first frame; 100 m before it and 200 m after the end the path goes on
straight, so that no driver falls off; what is past the last recorded vertex is no road.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from benchmark.geometry import Floats, wrap_angle
from benchmark.interactions.tracks import ContinuousTracks, Integers, locate_frames

VERTEX_SPACING_M: Final = 0.5
BEFORE_M: Final = 100.0
AFTER_M: Final = 200.0
TANGENT_REACH_M: Final = 0.5
_SPEED_REACH_S: Final = 0.25
_PAIRS_AT_ONCE: Final = 400_000
"""Points times segments of a batch: bounds the memory of a projection to some 30 MB."""


@dataclass(frozen=True, slots=True)
class EgoPath:
    """Polyline of M vertices, metres, with (M,) headings of the ego there, radians, unwrapped.

    ``station`` is (M,), 0 at the second vertex; ``vertex_seconds`` are (M - 2,), of all vertices but the first and the
    last; ``length`` (M - 1,) and unit vectors ``direction`` (2, M - 1) are of the segments; ``size`` is the ego's.
    """

    points: Floats
    yaw: Floats
    station: Floats
    size: Floats
    tracks: ContinuousTracks
    vertex_seconds: Floats
    length: Floats
    direction: Floats

    @classmethod
    def of(cls, tracks: ContinuousTracks) -> "EgoPath":
        """The path of a recorded ego."""
        spaced_frames = _find_spaced_frames(tracks.ego[:, :2])
        boxes = tracks.ego[spaced_frames]
        ends = boxes[[0, -1]]
        heading = np.column_stack([np.cos(ends[:, 4]), np.sin(ends[:, 4])])
        before, after = ends[0, :2] - BEFORE_M * heading[0], ends[1, :2] + AFTER_M * heading[1]
        points = np.concatenate([before[None], boxes[:, :2], after[None]])
        yaw = np.concatenate([boxes[:1, 4], boxes[:, 4], boxes[-1:, 4]])
        yaw = np.concatenate([yaw[:1], yaw[0] + np.cumsum(wrap_angle(np.diff(yaw)))])
        step = np.diff(points, axis=0).T
        length = np.hypot(*step)
        station = np.concatenate([[0.0], np.cumsum(length)]) - length[0]
        return cls(
            points, yaw, station, tracks.ego[0, 2:4], tracks, tracks.seconds[spaced_frames], length, step / length
        )

    @property
    def end_m(self) -> float:
        """Station of the last recorded vertex."""
        return float(self.station[-2])

    def position(self, station: Floats) -> Floats:
        """(..., 2) the point at stations."""
        return np.stack([np.interp(station, self.station, self.points[:, axis]) for axis in range(2)], axis=-1)

    def heading(self, station: Floats) -> Floats:
        """(...) the ego's heading at stations, radians, unwrapped."""
        return np.interp(station, self.station, self.yaw)

    def boxes(self, station: Floats) -> Floats:
        """(..., 5) the ego's rectangle at stations."""
        station = np.asarray(station, np.float64)
        size = np.broadcast_to(self.size, (*station.shape, 2))
        return np.concatenate([self.position(station), size, self.heading(station)[..., None]], axis=-1)

    def tangent(self, station: Floats) -> Floats:
        """(..., 2) unit direction of the path, over half a metre to both sides."""
        station = np.asarray(station, np.float64)
        chord = self.position(station + TANGENT_REACH_M) - self.position(station - TANGENT_REACH_M)
        length = np.hypot(chord[..., 0], chord[..., 1])
        return np.asarray(chord / np.maximum(length, 1e-12)[..., None])

    def recorded_station(self, times: Floats) -> Floats:
        """Metres of the recorded ego along the path at times in seconds.

        Its centre projected on the segment after the last vertex whose frame is not later.
        """
        times = np.asarray(times, np.float64)
        last = np.searchsorted(self.vertex_seconds, times + 1e-9, side="right") - 1
        segment = np.maximum(last, 0) + 1
        frame, fraction = locate_frames(self.tracks.seconds, times)
        first, second = self.tracks.ego[frame, :2], self.tracks.ego[frame + 1, :2]
        centre = first + fraction[..., None] * (second - first)
        station, _ = self._project_on_segments(centre, segment, self.station[segment], self.station[segment + 1])
        return station

    def recorded_speed(self, times: Floats) -> Floats:
        """Speed of the recorded ego along the path, m/s, not negative, over a quarter of a second to both sides."""
        first, last = (
            np.clip(times + reach, self.tracks.seconds[0], self.tracks.seconds[-1])
            for reach in (-_SPEED_REACH_S, _SPEED_REACH_S)
        )
        moved = self.recorded_station(last) - self.recorded_station(first)
        return np.asarray(np.maximum(moved / (last - first), 0.0))

    def project(self, points: Floats, low: Floats | None = None, high: Floats | None = None) -> tuple[Floats, Floats]:
        """(Q,) stations nearest to (Q, 2) points, and (Q,) signed distances, positive on the left of the tangent there.

        The lowest station where several are as near; (Q,) ``low`` and ``high`` limit them, by default to the whole
        path.
        """
        count = len(points)
        low = np.full(count, -np.inf) if low is None else low
        high = np.full(count, np.inf) if high is None else high
        low, high = (np.clip(limit, self.station[0], self.station[-1]) for limit in (low, high))
        last_segment = len(self.station) - 2
        first = np.clip(np.searchsorted(self.station, low, side="right") - 1, 0, last_segment)
        last = np.clip(np.searchsorted(self.station, high, side="left") - 1, first, last_segment)
        width = int((last - first).max(initial=0)) + 1
        station, squared = np.empty(count), np.empty(count)
        batch = max(1, _PAIRS_AT_ONCE // width)
        for start in range(0, count, batch):
            rows = slice(start, start + batch)
            segment = np.minimum(first[rows, None] + np.arange(width), last[rows, None])
            along, distance = self._project_on_segments(points[rows, None], segment, low[rows, None], high[rows, None])
            nearest = np.argmin(distance, axis=1)[:, None]
            station[rows] = np.take_along_axis(along, nearest, axis=1)[:, 0]
            squared[rows] = np.take_along_axis(distance, nearest, axis=1)[:, 0]
        tangent, offset = self.tangent(station), points - self.position(station)
        left = tangent[:, 0] * offset[:, 1] - tangent[:, 1] * offset[:, 0]
        return station, np.copysign(np.sqrt(squared), left)

    def _project_on_segments(
        self, points: Floats, segment: Integers, low: Floats, high: Floats
    ) -> tuple[Floats, Floats]:
        """Feet of points on segments between two stations: station, and distance squared."""
        base = self.station[segment]
        x, y = (points[..., axis] - self.points[:, axis][segment] for axis in range(2))
        cos, sin = (component[segment] for component in self.direction)
        along = x * cos
        along += y * sin
        np.clip(along, np.maximum(low - base, 0.0), np.minimum(high - base, self.length[segment]), out=along)
        x -= along * cos
        y -= along * sin
        np.multiply(x, x, out=x)
        x += y * y
        base += along
        return base, x


def _find_spaced_frames(centres: Floats) -> Integers:
    """Frames of the first centre and of each that is half a metre or more from the last one kept."""
    spaced_frames = [0]
    x, y = centres[0].tolist()
    for frame, (next_x, next_y) in enumerate(centres.tolist()):
        if np.hypot(next_x - x, next_y - y) >= VERTEX_SPACING_M:
            spaced_frames.append(frame)
            x, y = next_x, next_y
    return np.array(spaced_frames)
