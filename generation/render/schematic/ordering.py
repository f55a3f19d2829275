"""Which upright solid hides which: a drawing order from far to near that respects every separating line."""

import heapq

import numpy as np

from benchmark.geometry import Bools, Floats, wrap_angle

_NEXT = (1, 2, 3, 0)
"""Of each corner the one that follows."""


def drawing_order(footprints: Floats, eye: Floats) -> list[int]:
    """Order upright convex solids so that each is drawn after everything that it can hide.

    Of two solids seen in the same direction, the one whose farthest point is nearer than the other's nearest point
    is in front; where their distances overlap, a line along one of their sides that separates them decides: the
    solid on the eye's side is in front. (N, 4, 2) footprints are counter-clockwise, metres; the N indices have the
    first to be drawn first.
    """
    behind = _is_behind(np.asarray(footprints, np.float64) - np.asarray(eye, np.float64))
    offset = footprints - eye
    farthest = np.hypot(offset[..., 0], offset[..., 1]).max(axis=1, initial=0.0)
    return _topological(behind, farthest)


def _is_behind(corners: Floats) -> Bools:
    """(N, N) whether the first solid must be drawn before the second; corners relative to the eye."""
    nearest, farthest = _distances(corners)
    centre = corners.mean(axis=1)
    bearing = np.arctan2(centre[:, 1], centre[:, 0])
    spread = wrap_angle(np.arctan2(corners[..., 1], corners[..., 0]) - bearing[:, None])
    low, high = spread.min(axis=1), spread.max(axis=1)
    # A solid beside or around the eye can fill any direction.
    wide = (high - low > 0.9 * np.pi) | (nearest == 0.0)
    low, high = np.where(wide, -np.pi, low), np.where(wide, np.pi, high)
    turn = wrap_angle(bearing[None, :] - bearing[:, None])
    same_direction = (turn + low[None, :] <= high[:, None]) & (turn + high[None, :] >= low[:, None])
    np.fill_diagonal(same_direction, False)
    behind = same_direction & (nearest[:, None] >= farthest[None, :])
    unclear = np.argwhere(np.triu(same_direction & ~behind & ~behind.T))
    if len(unclear):
        first, second = unclear.T
        first_is_behind = _first_is_behind(corners[first], corners[second])
        behind[first, second] = first_is_behind
        behind[second, first] = ~first_is_behind
    return np.asarray(behind)


def _distances(corners: Floats) -> tuple[Floats, Floats]:
    """Nearest and farthest distance of each footprint from the eye; zero where the eye is inside."""
    side = corners[:, _NEXT] - corners
    length_sq = np.maximum((side**2).sum(axis=-1), 1e-12)
    share = np.clip(-(corners * side).sum(axis=-1) / length_sq, 0.0, 1.0)
    foot = corners + share[..., None] * side
    nearest = np.hypot(foot[..., 0], foot[..., 1]).min(axis=1)
    inside = (side[..., 0] * -corners[..., 1] - side[..., 1] * -corners[..., 0] >= 0.0).all(axis=1)
    return np.where(inside, 0.0, nearest), np.hypot(corners[..., 0], corners[..., 1]).max(axis=1)


def _first_is_behind(first: Floats, second: Floats) -> Bools:
    """(P,) verdicts for pairs whose distances overlap; the eye is the origin."""
    centre_distance = [np.hypot(*shape.mean(axis=1).T) for shape in (first, second)]
    verdict = np.asarray(centre_distance[0] > centre_distance[1])
    best = np.full(len(first), -1e-3)
    for own, other, own_is_first in ((first, second, True), (second, first, False)):
        side = own[:, _NEXT] - own
        normal = np.stack([side[..., 1], -side[..., 0]], axis=-1)
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
        offset = (normal * own).sum(axis=-1)
        clearance = (np.einsum("pki,pci->pkc", normal, other) - offset[..., None]).min(axis=-1)
        for index in range(4):
            better = clearance[:, index] > best
            # The eye (origin) is beyond this side where the offset is negative: then the other solid is in front.
            own_is_behind = offset[:, index] < 0.0
            verdict = np.where(better, own_is_behind == own_is_first, verdict)
            best = np.where(better, clearance[:, index], best)
    return verdict


def _topological(behind: Bools, farthest: Floats) -> list[int]:
    """Far to near; a cycle (solids that interlock) is opened at its farthest member."""
    waiting = behind.sum(axis=0).tolist()
    in_front: list[list[int]] = [[] for _ in range(len(behind))]
    for first, second in np.argwhere(behind).tolist():
        in_front[first].append(second)
    distance = farthest.tolist()
    ready = [(-distance[index], index) for index, count in enumerate(waiting) if count == 0]
    heapq.heapify(ready)
    order: list[int] = []
    done = [False] * len(behind)
    while len(order) < len(behind):
        if ready:
            index = heapq.heappop(ready)[1]
        else:
            index = max((i for i in range(len(behind)) if not done[i]), key=lambda i: distance[i])
        if done[index]:
            continue
        done[index] = True
        order.append(index)
        for other in in_front[index]:
            waiting[other] -= 1
            if waiting[other] == 0 and not done[other]:
                heapq.heappush(ready, (-distance[other], other))
    return order
