"""Plane curves as (M, 2) polylines in metres: straight-arc-straight turns, offsets, even spacing, smoothing."""

import numpy as np

from benchmark.geometry import Floats, wrap_angle

_STRAIGHT_BELOW_RAD = np.deg2rad(4.0)


def unit_vector(heading_rad: float) -> Floats:
    """(2,) unit vector of a heading."""
    return np.array([np.cos(heading_rad), np.sin(heading_rad)])


def compute_lengths(line: Floats) -> Floats:
    """(M,) arc length at each vertex, starting at zero."""
    steps = np.hypot(np.diff(line[:, 0]), np.diff(line[:, 1]))
    return np.concatenate([[0.0], np.cumsum(steps)])


def compute_headings(line: Floats) -> Floats:
    """(M,) tangent heading at each vertex, unwrapped; central differences inside."""
    slope = np.empty_like(line)
    slope[1:-1] = line[2:] - line[:-2]
    slope[0], slope[-1] = line[1] - line[0], line[-1] - line[-2]
    return np.unwrap(np.arctan2(slope[:, 1], slope[:, 0]))


def offset_line(line: Floats, left_m: float | Floats) -> Floats:
    """Parallel curve, ``left_m`` (one number or (M,)) to the left of a smooth (M, 2) polyline, of the same stations."""
    heading = compute_headings(line)
    normal = np.column_stack([-np.sin(heading), np.cos(heading)])
    return np.asarray(line + np.asarray(left_m, np.float64).reshape(-1, 1) * normal)


def interpolate_at_lengths(line: Floats, where: Floats) -> Floats:
    """(K, 2) points at given arc lengths, linear between vertices and clamped to the ends."""
    along = compute_lengths(line)
    return np.column_stack([np.interp(where, along, line[:, 0]), np.interp(where, along, line[:, 1])])


def resample_line(line: Floats, step_m: float) -> Floats:
    """The same curve with evenly spaced vertices, about ``step_m`` apart; both ends are kept."""
    total = float(compute_lengths(line)[-1])
    return interpolate_at_lengths(line, np.linspace(0.0, total, max(round(total / step_m), 1) + 1))


def cut_line(line: Floats, start_m: float, end_m: float, step_m: float) -> Floats:
    """The part between two arc lengths, evenly spaced."""
    return interpolate_at_lengths(line, np.linspace(start_m, end_m, max(round((end_m - start_m) / step_m), 1) + 1))


def join_lines(lines: list[Floats]) -> Floats:
    """One polyline from several that meet end to start; repeated vertices are dropped."""
    line = np.concatenate(lines)
    keep = np.concatenate([[True], np.hypot(*np.diff(line, axis=0).T) > 1e-6])
    return np.asarray(line[keep])


def build_turn(
    start: Floats, start_heading: float, end: Floats, end_heading: float, *, step_m: float, max_radius_m: float = 1e9
) -> Floats:
    """A drivable curve between two poses: straight, one arc, straight where that is possible, else a cubic.

    (M, 2) polyline, its vertices ``step_m`` apart. The arc is as large as the shorter leg allows.
    """
    change = float(wrap_angle(np.array(end_heading - start_heading)))
    first, second = unit_vector(start_heading), unit_vector(end_heading)
    chord = np.asarray(end, np.float64) - start
    cross = float(first[0] * second[1] - first[1] * second[0])
    if abs(change) < _STRAIGHT_BELOW_RAD or abs(cross) < 1e-6:
        return _build_cubic(start, first, end, second, step_m)
    leg = float(chord[0] * second[1] - chord[1] * second[0]) / cross
    exit_leg = float(first[0] * chord[1] - first[1] * chord[0]) / cross
    if leg <= 0.5 or exit_leg <= 0.5:
        return _build_cubic(start, first, end, second, step_m)
    half_tangent = float(np.tan(abs(change) / 2))
    tangent = min(leg, exit_leg, max_radius_m * half_tangent)
    radius = tangent / half_tangent
    side = float(np.sign(change))
    begin = start + (leg - tangent) * first
    center = begin + side * radius * np.array([-first[1], first[0]])
    count = max(round(4 * radius * abs(change) / step_m), 4)
    angle = start_heading - side * np.pi / 2 + np.linspace(0.0, change, count + 1)
    arc = center + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    parts = [arc]
    if leg - tangent > 1e-3:
        parts.insert(0, resample_line(np.stack([start, begin]), step_m))
    if exit_leg - tangent > 1e-3:
        parts.append(resample_line(np.stack([arc[-1], end]), step_m))
    line = resample_line(join_lines(parts), step_m)
    line[0], line[-1] = start, end
    return line


def _build_cubic(start: Floats, first: Floats, end: Floats, second: Floats, step_m: float) -> Floats:
    """Cubic curve with given end directions, evenly spaced."""
    reach = float(np.hypot(*(end - start)))
    u = np.linspace(0.0, 1.0, 200)[:, None]
    inner, outer = start + first * reach * 0.4, end - second * reach * 0.4
    line = (1 - u) ** 3 * start + 3 * (1 - u) ** 2 * u * inner + 3 * (1 - u) * u**2 * outer + u**3 * end
    return resample_line(line, step_m)


def smooth_line(line: Floats, *, spacing_m: float, deviation_m: float) -> Floats:
    """Round the curvature steps of a polyline so that a car can drive it; the ends are extended straight.

    A Gaussian over arc length, summed tap by tap so that the bytes do not depend on a linear-algebra library. With
    standard deviation ``deviation_m`` an arc of radius R moves inwards by deviation^2 / (2 R).
    """
    reach = round(3 * deviation_m / spacing_m)
    taps = np.exp(-0.5 * (np.arange(-reach, reach + 1) * spacing_m / deviation_m) ** 2)
    taps /= taps.sum()
    ahead = np.arange(1, reach + 1)[:, None]
    padded = np.concatenate(
        [line[0] + ahead[::-1] * (line[0] - line[1]), line, line[-1] + ahead * (line[-1] - line[-2])]
    )
    result = np.zeros_like(line)
    for index, weight in enumerate(taps):
        result += weight * padded[index : index + len(line)]
    return result


def interpolate_grid(values: Floats, where: Floats) -> Floats:
    """Catmull-Rom look-up of (K,) fractional indices into an even grid (M, ...), one entry beyond its ends at most."""
    count = len(values)
    where = np.clip(where, -1.0, float(count))
    base = np.clip(np.floor(where).astype(np.int64), 0, count - 2)
    u = (where - base).reshape(-1, *([1] * (values.ndim - 1)))
    padded = np.concatenate([2 * values[:1] - values[1:2], values, 2 * values[-1:] - values[-2:-1]])
    p0, p1, p2, p3 = padded[base], padded[base + 1], padded[base + 2], padded[base + 3]
    linear = 0.5 * (p2 - p0)
    square = p0 - 2.5 * p1 + 2 * p2 - 0.5 * p3
    cube = 0.5 * (p3 - p0) + 1.5 * (p1 - p2)
    return np.asarray(p1 + u * (linear + u * (square + u * cube)))
