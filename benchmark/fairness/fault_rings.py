"""Roundabouts from lanes alone: short cycles that turn to the far side all around and are nearly round."""

from collections.abc import Sequence

import numpy as np

from benchmark.fairness.fault_definition import RING_M, RING_SPREAD, SLACK
from benchmark.geometry import Floats, directions_of, wrap_angle
from benchmark.road_map import Handedness


def find_ring(
    start: int, successors: Sequence[Sequence[int]], lines: Sequence[Floats], handedness: Handedness
) -> tuple[int, ...]:
    """Lanes of the first cycle through a lane that is a ring; empty if there is none.

    A ring is at most 200 m long, turns by 360 degrees to the far side, and each point of its centre lines is 0.7 to 1.3
    times as far from their mean as they are on the mean: around a block is none, nor are two U-turns.
    """
    ways: list[tuple[tuple[int, ...], float]] = [((start,), _measure(lines[start]))]
    while ways:
        way, length = ways.pop()
        for following in successors[way[-1]]:
            if (
                following == start
                and length <= RING_M + SLACK
                and _is_round(np.concatenate([lines[lane] for lane in way]), handedness)
            ):
                return way
            longer = length + _measure(lines[following])
            back = float(np.hypot(*(lines[following][-1] - lines[start][0])))
            if following not in way and longer + back <= RING_M + SLACK:
                ways.append(((*way, following), longer))
    return ()


def _measure(line: Floats) -> float:
    return float(np.hypot(*np.diff(line, axis=0).T).sum())


def _is_round(points: Floats, handedness: Handedness) -> bool:
    steps = np.diff(points, axis=0, append=points[:1])
    headings = directions_of(steps[np.hypot(*steps.T) > 1e-6])
    turn = wrap_angle(np.diff(headings, append=headings[:1])).sum()
    away = np.hypot(*(points - points.mean(axis=0)).T)
    low, high = (share * away.mean() for share in RING_SPREAD)
    round_enough = (away >= low - SLACK).all() and (away <= high + SLACK).all()
    return bool(round(turn / (2 * np.pi)) == handedness.far_turn and round_enough)
