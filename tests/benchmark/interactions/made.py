"""Encounters made by hand: an ego along +x and cars whose motion is a formula."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import EGO_BODY_WIDTH_M, EGO_LENGTH_M
from benchmark.geometry import Floats, to_global
from benchmark.interactions.tracks import ContinuousTracks

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


def scene(own: Floats, *others: Floats, categories: tuple[str, ...] = ()) -> ContinuousTracks:
    """Tracks of an ego and others who are always there, cars unless said otherwise."""
    agents = np.array(others) if others else np.empty((0, len(SECONDS), 5))
    valid = np.ones(agents.shape[:2], np.bool_)
    return ContinuousTracks(SECONDS, own, agents, valid, categories or ("vehicle.car",) * len(others))


def shifting(start_x: float, speed: float, y: float, when: float, side_speed: float, to: float = 0.0) -> Floats:
    """(F, 5) a car at constant speed that moves sideways from ``y`` to ``to`` from a time on."""
    sideways = np.clip((SECONDS - when) * side_speed, 0.0, abs(to - y))
    return boxes(start_x + speed * SECONDS, y + np.sign(to - y) * sideways)


def turned(tracks: ContinuousTracks, angle: float, shift: tuple[float, float]) -> ContinuousTracks:
    """The same scene elsewhere."""

    def move(old: Floats) -> Floats:
        place = to_global(old[..., :2], np.array([*shift, angle]))
        return np.concatenate([place, old[..., 2:4], old[..., 4:] + angle], axis=-1)

    return ContinuousTracks(tracks.seconds, move(tracks.ego), move(tracks.agents), tracks.valid, tracks.categories)


def made_scene(number: int) -> tuple[ContinuousTracks, NDArray[np.int64]]:
    """A made-up drive along a bend with traffic, 12 Hz, and its keyframes."""
    rng = np.random.default_rng(number)
    seconds = np.round(np.arange(181) / 12.0, 6)
    speed, radius = 7.0 + number, 60.0 + 20.0 * number
    own = along_bend(seconds, 0.0, 0.0, speed, radius, (4.084, 1.73))
    cars = [
        along_bend(seconds, start, lane, speed + change, radius, size, wobble)
        for start, lane, change, size, wobble in (
            (14.0, 0.0, 0.5, (4.6, 1.9), 0.05),
            (30.0, 3.5, -1.0, (4.4, 1.8), 0.2),
            (-18.0, 3.5, 1.5, (4.5, 1.9), 0.1),
            (45.0, 0.0, -0.5, (8.0, 2.5), 0.0),
            (25.0, -7.0, 0.0, (4.6, 1.9), 0.0),
        )
    ]
    cars[4][:] = cars[4][0]
    walker = boxes(20.0 + 0.0 * seconds, -9.0 + 1.2 * seconds, (0.7, 0.7), 1.5)
    agents = np.array([*cars, walker])
    # Annotated at 2 Hz and linear between, as recordings are.
    keyframes = np.arange(0, len(seconds), 6)
    agents[:4, :, :2] += np.array(
        [
            np.column_stack([np.interp(seconds, seconds[keyframes], axis) for axis in rng.normal(0, 0.05, (2, 31))])
            for _ in range(4)
        ]
    )
    valid = np.ones((len(agents), len(seconds)), np.bool_)
    valid[2, :24] = valid[1, 150:] = False
    names = ("vehicle.car", "vehicle.car", "vehicle.car", "vehicle.truck", "vehicle.car", "human.pedestrian.adult")
    return ContinuousTracks(seconds, np.round(own, 6), np.round(agents, 6), valid, names), keyframes


def along_bend(
    seconds: Floats, start: float, lane: Any, speed: Any, radius: float, size: tuple[float, float], wobble: float = 0.0
) -> Floats:
    """Along a left bend: metres from its start, to the left of it, m/s."""
    step = np.broadcast_to(speed, seconds.shape) * np.gradient(seconds)
    angle = (start + np.cumsum(step) - step[0]) / radius
    across = radius - lane - wobble * np.sin(seconds)
    x, y = across * np.sin(angle), radius - across * np.cos(angle)
    return np.column_stack([x, y, np.broadcast_to(size, (len(seconds), 2)), angle])
