"""The rule of `benchmark.metrics.diagnosis` once more: loops, shapely polygons, one decision after the other."""

import math
from dataclasses import dataclass

import numpy as np
import shapely

from benchmark.geometry import Floats
from benchmark.planning import Forecasts
from benchmark.truth import SampleTruth


@dataclass(frozen=True)
class Found:
    """A reason, and whether it hangs on less than a hair."""

    reason: str
    close: bool


def rectangle(x: float, y: float, length: float, width: float, yaw: float) -> shapely.Polygon:
    half = [(length / 2, width / 2), (length / 2, -width / 2), (-length / 2, -width / 2), (-length / 2, width / 2)]
    cos, sin = math.cos(yaw), math.sin(yaw)
    return shapely.Polygon([(x + a * cos - b * sin, y + a * sin + b * cos) for a, b in half])


def headings(points: list[tuple[float, float]], start: float, hold_below_m: float) -> list[float]:
    """Heading at each of the seven points of a path: of the chord around it, or that of the point before."""
    found = [start]
    for index in range(1, len(points)):
        before, after = points[index - 1], points[min(index + 1, len(points) - 1)]
        if math.dist(before, after) >= hold_below_m:
            found.append(math.atan2(after[1] - before[1], after[0] - before[0]))
        else:
            found.append(found[-1])
    return found


def swept(
    points: list[tuple[float, float]], yaws: list[float], size: tuple[float, float], ahead_m: float, half_turns: bool
) -> list[shapely.Polygon]:
    """Thirty rectangles, ``ahead_m`` in front of a path of seven points."""
    boxes = []
    yaw = yaws[0]
    for step in range(6):
        turn = yaws[step + 1] - yaw
        period = math.pi if half_turns else 2 * math.pi
        while turn > period / 2:
            turn -= period
        while turn < -period / 2:
            turn += period
        for part in range(1, 6):
            share = part / 5
            x = points[step][0] + share * (points[step + 1][0] - points[step][0])
            y = points[step][1] + share * (points[step + 1][1] - points[step][1])
            angle = yaw + share * turn
            boxes.append(rectangle(x + ahead_m * math.cos(angle), y + ahead_m * math.sin(angle), *size, angle))
        yaw += turn
    return boxes


def slow_reason(truth: SampleTruth, waypoints: Floats, forecasts: Forecasts, hit: str) -> Found:
    """Everything in the lidar frame."""
    close = False
    candidates = []
    for row, instance in enumerate(truth.instances):
        first = next(step for step in range(7) if truth.annotated[row, step])
        x, y, length, width, yaw = truth.boxes[row, first]
        for column, box in enumerate(forecasts.boxes):
            mode = max(range(len(forecasts.scores[column])), key=lambda m: (forecasts.scores[column][m], -m))
            there = box[:2] if first == 0 else forecasts.trajectories[column, mode, first - 1]
            axis = shapely.Point(x, y)
            if length > 4.0:
                reach = length / 2 - 2.0
                tip = (reach * math.cos(yaw), reach * math.sin(yaw))
                axis = shapely.LineString([(x - tip[0], y - tip[1]), (x + tip[0], y + tip[1])])
            gap = axis.distance(shapely.Point(*there))
            ratio = (length * width) / (box[2] * box[3])
            close |= abs(gap - 2.0) < 1e-6 or abs(ratio - 4.0) < 1e-6 or abs(ratio - 0.25) < 1e-6
            if gap <= 2.0 and 0.25 <= ratio <= 4.0:
                candidates.append((first, math.dist((x, y), there), instance, column))
    matched: dict[str, int] = {}
    for _, _, instance, column in sorted(candidates):
        if instance not in matched and column not in matched.values():
            matched[instance] = column
    if hit not in matched:
        return Found("no forecast near", close)
    column = matched[hit]
    path = [(0.0, 0.0), *((float(x), float(y)) for x, y in waypoints)]
    ego = swept(path, headings(path, math.pi / 2, 0.3), (4.084, 1.85), 0.5, half_turns=False)
    box, hits = forecasts.boxes[column], []
    for trajectory in forecasts.trajectories[column]:
        way = [(float(box[0]), float(box[1])), *((float(x), float(y)) for x, y in trajectory)]
        other = swept(way, headings(way, float(box[4]), 1.0), (float(box[2]), float(box[3])), 0.0, half_turns=True)
        gaps = [one.distance(two) for one, two in zip(ego, other)]
        areas = [one.intersection(two).area for one, two in zip(ego, other)]
        close |= any(0 < gap < 1e-6 for gap in gaps) or any(0 < area < 1e-6 for area in areas)
        hits.append(any(one.intersects(two) for one, two in zip(ego, other)))
    likeliest = int(np.argmax(forecasts.scores[column]))
    if hits[likeliest]:
        return Found("plan hits forecast", close)
    others = [hit_ for hit_, score in zip(hits, forecasts.scores[column]) if score >= 0.2]
    return Found("plan clear of forecast, hits another likely mode" if any(others) else "plan clear of forecast", close)
