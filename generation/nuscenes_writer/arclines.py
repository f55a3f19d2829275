"""Centre lines as chains of circular arcs and straight pieces, the form ``arcline_path_3`` has in map expansion 1.3.

A devkit path is three pieces (left or right arc, straight or opposite arc, left or right arc) of one radius. Each piece
of ours uses one of the three and leaves the other two at length zero.
"""

from typing import Any

import numpy as np

from benchmark.geometry import Floats

TOLERANCE_M = 0.03
"""Farthest a piece may be from the centre line."""
_STRAIGHT_RADIUS_M = 1e4
_MAX_SAGITTA_PER_CHORD = 0.2
"""Arcs turn at most 87 degrees; longer ones are split."""
_FLAT_SAGITTA_PER_CHORD = 0.02
_SHORTEST_M = 1e-3


def arcline_path(centerline: Floats) -> list[dict[str, Any]]:
    """Arcs and straight pieces fitted to an (M, 2) centre line, metres.

    Each begins where the previous one ends; none if the line has no length.
    """
    points = np.asarray(centerline, np.float64)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    points = points[np.concatenate([[True], steps > _SHORTEST_M])]
    paths = []
    start = 0
    while start < len(points) - 1:
        end = _farthest_end(points, start)
        paths.append(_path(points[start], points[end], _sagitta(points[start : end + 1])))
        start = end
    return paths


def _farthest_end(points: Floats, start: int) -> int:
    """Last vertex that one piece from ``start`` reaches: doubling steps, then bisection."""
    reached, step = start + 1, 1
    while reached < len(points) - 1:
        candidate = min(reached + step, len(points) - 1)
        if not _fits(points[start : candidate + 1]):
            break
        reached, step = candidate, 2 * step
    else:
        return reached
    low, high = reached, min(reached + step, len(points) - 1)
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if _fits(points[start : middle + 1]) else (low, middle)
    return low


def _in_chord_frame(points: Floats) -> tuple[Floats, Floats, float]:
    """Coordinates along and to the left of the chord, and its length."""
    chord = points[-1] - points[0]
    length = float(np.hypot(*chord))
    if length < _SHORTEST_M:
        return np.zeros(len(points)), np.zeros(len(points)), 0.0
    along, left = chord / length, np.array([-chord[1], chord[0]]) / length
    offset = points - points[0]
    return offset @ along, offset @ left, length


def _sagitta(points: Floats) -> float:
    """Signed height of the arc above its chord, by least squares; positive where the line bulges to the left.

    A flat arc is a parabola. Otherwise, of the circles through both ends, ``u^2 - u length + v^2 = 2 c v``, the centre
    height ``c`` is fitted.
    """
    u, v, length = _in_chord_frame(points)
    shape = 4 * u * (length - u) / max(length, _SHORTEST_M) ** 2
    weight = float((shape * shape).sum())
    flat = float((shape * v).sum()) / weight if weight > 1e-12 else 0.0
    if abs(flat) < _FLAT_SAGITTA_PER_CHORD * length:
        return flat
    centre = float((v * (u * u - u * length + v * v)).sum() / (2 * (v * v).sum()))
    return centre + float(np.copysign(np.hypot(centre, length / 2), flat))


def _fits(points: Floats) -> bool:
    """Whether one piece through the end points stays within tolerance of all vertices and segment middles."""
    u, v, length = _in_chord_frame(points)
    if length < _SHORTEST_M or (np.diff(u) <= 0).any():
        return False
    sagitta = _sagitta(points)
    if abs(sagitta) > _MAX_SAGITTA_PER_CHORD * length:
        return False
    u = np.concatenate([u, (u[1:] + u[:-1]) / 2])
    v = np.concatenate([v, (v[1:] + v[:-1]) / 2])
    if _is_straight(sagitta, length):
        return bool((np.abs(v) <= TOLERANCE_M).all())
    radius = _radius(sagitta, length)
    centre_v = sagitta - np.sign(sagitta) * radius
    off = np.hypot(u - length / 2, v - centre_v) - radius
    return bool((np.abs(off) <= TOLERANCE_M).all())


def _is_straight(sagitta: float, length: float) -> bool:
    return abs(sagitta) < 1e-4 or _radius(sagitta, length) > _STRAIGHT_RADIUS_M


def _radius(sagitta: float, length: float) -> float:
    return (length * length / 4 + sagitta * sagitta) / (2 * abs(sagitta))


def _path(start: Floats, end: Floats, sagitta: float) -> dict[str, Any]:
    chord = end - start
    length = float(np.hypot(*chord))
    heading = float(np.arctan2(chord[1], chord[0]))
    if _is_straight(sagitta, length):
        return _record(start, heading, end, heading, "LSR", _STRAIGHT_RADIUS_M, [0.0, length, 0.0])
    radius = _radius(sagitta, length)
    half_turn = float(np.arcsin(length / (2 * radius))) * float(np.sign(sagitta))
    shape = "RSR" if sagitta > 0 else "LSL"
    arc = 2 * radius * abs(half_turn)
    return _record(start, heading + half_turn, end, heading - half_turn, shape, radius, [arc, 0.0, 0.0])


def _record(
    start: Floats, start_yaw: float, end: Floats, end_yaw: float, shape: str, radius: float, lengths: list[float]
) -> dict[str, Any]:
    return {
        "start_pose": [float(start[0]), float(start[1]), start_yaw],
        "end_pose": [float(end[0]), float(end[1]), end_yaw],
        "shape": shape,
        "radius": radius,
        "segment_length": lengths,
    }
