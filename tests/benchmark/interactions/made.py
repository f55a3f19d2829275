"""Encounters made by hand: an ego along +x and cars whose motion is a formula."""

import numpy as np

from benchmark.constants import EGO_BODY_WIDTH_M, EGO_LENGTH_M
from benchmark.geometry import Floats, to_global
from benchmark.interactions.tracks import Tracks

CAR = (4.6, 1.9)
SECONDS = np.arange(97) / 12.0


def along(start_x: float, y: float, speed: float, *, brakes: float = 0.0, seconds: Floats = SECONDS) -> Floats:
    """(F, 5) a car along +x that brakes to a stand from the first frame."""
    time = np.minimum(seconds, speed / brakes) if brakes else seconds
    return boxes(start_x + speed * time - 0.5 * brakes * time**2, np.full(len(seconds), y))


def boxes(x: Floats, y: Floats, size: tuple[float, float] = CAR, yaw: float | None = None) -> Floats:
    """(F, 5) from places; headings are those of the motion unless given."""
    x, y = np.broadcast_arrays(np.asarray(x, np.float64), np.asarray(y, np.float64))
    heading = np.arctan2(np.gradient(y), np.gradient(x)) if yaw is None else np.full(len(x), yaw)
    return np.column_stack([x, y, np.broadcast_to(size, (len(x), 2)), heading])


def ego(speed: float, seconds: Floats = SECONDS) -> Floats:
    """(F, 5) the recording car along +x from the origin."""
    return boxes(speed * seconds, np.zeros(len(seconds)), (EGO_LENGTH_M, EGO_BODY_WIDTH_M), 0.0)


def scene(own: Floats, *others: Floats, categories: tuple[str, ...] = ()) -> Tracks:
    """Tracks of an ego and others who are always there, cars unless said otherwise."""
    agents = np.array(others) if others else np.empty((0, len(SECONDS), 5))
    valid = np.ones(agents.shape[:2], np.bool_)
    return Tracks(SECONDS, own, agents, valid, categories or ("vehicle.car",) * len(others))


def shifting(start_x: float, speed: float, y: float, when: float, side_speed: float, to: float = 0.0) -> Floats:
    """(F, 5) a car at constant speed that moves sideways from ``y`` to ``to`` from a time on."""
    sideways = np.clip((SECONDS - when) * side_speed, 0.0, abs(to - y))
    return boxes(start_x + speed * SECONDS, y + np.sign(to - y) * sideways)


def turned(tracks: Tracks, angle: float, shift: tuple[float, float]) -> Tracks:
    """The same scene elsewhere."""

    def move(old: Floats) -> Floats:
        place = to_global(old[..., :2], np.array([*shift, angle]))
        return np.concatenate([place, old[..., 2:4], old[..., 4:] + angle], axis=-1)

    return Tracks(tracks.seconds, move(tracks.ego), move(tracks.agents), tracks.valid, tracks.categories)
