"""Parked cars, pedestrians, cones and barriers."""

import numpy as np

from benchmark.constants import FRAME_HZ
from benchmark.geometry import Floats
from generation.sources.town.curves import compute_headings, compute_lengths, interpolate_at_lengths
from generation.sources.town.speed import FRAMES
from generation.sources.town.traffic import CARS
from generation.sources.town.world import ParticipantTrack, TownWorld

_PARKED_REACH_M = 55.0
_WALK_REACH_M = 38.0
_CROSSING_REACH_M = 25.0
_MEETING_TRIES = 6
_MET_AFTER_S = 2.0, 19.0
_EARLY_S = 0.0, 8.0
_WIDEST_M = 24.0
_ADULT, _CHILD = "human.pedestrian.adult", "human.pedestrian.child"


def add_parked(world: TownWorld, near: Floats, rng: np.random.Generator, *, share: float, most: int) -> None:
    """Park cars in a share of the places near the (K, 2) points of the ego's way; road works block some at the kerb."""
    places = [place for place in world.town.standing if _compute_distance(near, place.pose[:2]) < _PARKED_REACH_M]
    kerb = [index for index, place in enumerate(places) if not place.in_car_park]
    works = set()
    if kerb and rng.random() < 0.6:
        works.add(kerb[int(rng.integers(len(kerb)))])
    parked = 0
    for index in rng.permutation(len(places)).tolist():
        place = places[index]
        if index in works:
            _add_road_works(world, place.pose, rng)
        elif parked < most and rng.random() < share:
            body = CARS.draw(rng)
            shift = rng.normal(0.0, 0.12, 2).clip(-0.25, 0.25)
            turned = (
                place.pose[2]
                + float(rng.normal(0.0, 0.015))
                + (np.pi if rng.random() < 0.3 and place.in_car_park else 0)
            )
            lateral = 0.4 * shift[1]
            x = place.pose[0] + shift[0] * np.cos(turned) - lateral * np.sin(turned)
            y = place.pose[1] + shift[0] * np.sin(turned) + lateral * np.cos(turned)
            length = min(body.length, 4.9) if place.in_car_park else min(body.length, 5.4)
            box = np.array([[x, y, length, body.width, turned]])
            if world.is_free(box) and world.is_on_road(box):
                world.tracks.append(ParticipantTrack(body.category, body.height, box, parked=True))
                parked += 1


def _add_road_works(world: TownWorld, pose: Floats, rng: np.random.Generator) -> None:
    """A closed parking place: a barrier inside and cones along the traffic side."""
    along, left = np.array([np.cos(pose[2]), np.sin(pose[2])]), np.array([-np.sin(pose[2]), np.cos(pose[2])])
    barrier = pose[:2] - 0.2 * left
    boxes = [("movable_object.barrier", 1.0, [*barrier, 0.6, 2.0, pose[2] + np.pi / 2])]
    for step in (-2.4, -0.8, 0.8, 2.4):
        cone = pose[:2] + (step + float(rng.uniform(-0.1, 0.1))) * along + 0.85 * left
        boxes.append(("movable_object.trafficcone", 0.75, [*cone, 0.4, 0.4, float(rng.uniform(-np.pi, np.pi))]))
    for category, height, box in boxes:
        if world.is_free(np.array([box])):
            world.tracks.append(ParticipantTrack(category, height, np.array([box]), parked=False))


def add_walkers(world: TownWorld, near: Floats, rng: np.random.Generator, *, wanted: int) -> None:
    """Pedestrians on the pavements near the (K, 2) points of the ego's way, some of them standing."""
    added = 0
    reach = np.concatenate([near.min(axis=0) - _WALK_REACH_M, near.max(axis=0) + _WALK_REACH_M])
    walks = [walk for walk in world.town.walks if ((walk > reach[:2]) & (walk < reach[2:])).all(axis=1).any()]
    lengths = np.array([compute_lengths(walk)[-1] for walk in walks])
    for _ in range(12 * wanted if walks else 0):
        if added >= wanted:
            return
        choice = int(rng.choice(len(walks), p=lengths / lengths.sum()))
        walk, length = walks[choice], float(lengths[choice])
        start = float(rng.uniform(0.0, length))
        if _compute_distance(near, interpolate_at_lengths(walk, np.array([start]))[0]) > _WALK_REACH_M:
            continue
        speed = 0.0 if rng.random() < 0.2 else float(rng.uniform(0.9, 1.6))
        distance = speed * np.arange(FRAMES) / FRAME_HZ
        if start + distance[-1] > length:
            continue
        line = walk if rng.random() < 0.5 else walk[::-1]
        added += _add_pedestrian(world, line, start + distance, rng, lateral=float(rng.uniform(-0.7, 0.7)))


def add_crossing_pedestrians(world: TownWorld, near: Floats, rng: np.random.Generator, *, wanted: int) -> None:
    """Pedestrians who cross the road ahead of the ego; vehicles that are planned later give way to them."""
    walks = [
        walk for walk in world.town.crossing_walks if _compute_distance(near, walk.mean(axis=0)) < _CROSSING_REACH_M
    ]
    if not walks:
        return
    for _ in range(wanted):
        walk = walks[int(rng.integers(len(walks)))]
        walk = walk if rng.random() < 0.5 else walk[::-1]
        _add_crossing(world, walk, float(rng.uniform(1.0, 14.0)), rng)


def add_meeting_pedestrians(
    world: TownWorld, way: Floats, rng: np.random.Generator, *, wanted: int, speed_mps: float
) -> None:
    """Pedestrians who walk across the ego's (K, 2) way, from pavement to pavement, when it is about to come there.

    They are fewer than ``wanted`` where a pavement is missing or another is in their way; ``speed_mps`` is about what
    the ego drives where it is free to.
    """
    length, added = float(compute_lengths(way)[-1]), 0
    for _ in range(_MEETING_TRIES * wanted):
        if added >= wanted:
            return
        comes_s = float(rng.uniform(*_MET_AFTER_S))
        early_s = float(rng.uniform(*_EARLY_S))
        if comes_s * speed_mps > length:
            continue
        walk = _find_walk_across(world, way, comes_s * speed_mps)
        if walk is None:
            continue
        walk = walk if rng.random() < 0.5 else walk[::-1]
        added += _add_crossing(world, walk, max(0.0, comes_s - early_s), rng)


def _find_walk_across(world: TownWorld, way: Floats, station_m: float) -> Floats | None:
    """(2, 2) a line square to the way at a station, from the nearest pavement to its right to that to its left."""
    middle = interpolate_at_lengths(way, np.array([station_m]))[0]
    yaw = float(np.interp(station_m, compute_lengths(way), compute_headings(way)))
    ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    offsets = []
    for walk in world.town.walks:
        aside, along = (walk - middle) @ left, (walk - middle) @ ahead
        meets = np.flatnonzero(np.diff(np.sign(along)) != 0)
        share = along[meets] / (along[meets] - along[meets + 1])
        offsets.append(aside[meets] + share * (aside[meets + 1] - aside[meets]))
    sides = np.concatenate(offsets) if offsets else np.empty(0)
    right_m, left_m = sides[sides < 0], sides[sides > 0]
    if not len(right_m) or not len(left_m) or left_m.min() - right_m.max() > _WIDEST_M:
        return None
    return np.asarray(middle + np.array([right_m.max(), left_m.min()])[:, None] * left)


def _add_crossing(world: TownWorld, walk: Floats, begin_s: float, rng: np.random.Generator) -> bool:
    """A pedestrian stands at the kerb, walks across from a time on and stands there."""
    speed = float(rng.uniform(1.2, 1.6))
    time = np.arange(FRAMES) / FRAME_HZ
    # Pace builds up over a second on each side of the crossing.
    length = float(np.hypot(*(walk[1] - walk[0])))
    eased = np.clip(np.where(time < begin_s, 0.0, time - begin_s), 0.0, None)
    distance = speed * (eased - 0.5 * (1 - np.exp(-2 * eased)))
    distance = np.where(
        distance > length - 0.5, length - 0.5 * np.exp(-np.maximum(distance - length + 0.5, 0.0) / 0.5), distance
    )
    return _add_pedestrian(world, walk, distance, rng, lateral=float(rng.uniform(-1.0, 1.0)))


def _add_pedestrian(world: TownWorld, line: Floats, along: Floats, rng: np.random.Generator, *, lateral: float) -> bool:
    where = interpolate_at_lengths(line, along)
    yaw = np.interp(along, compute_lengths(line), compute_headings(line))
    child = rng.random() < 0.15
    x, y = where[:, 0] - lateral * np.sin(yaw), where[:, 1] + lateral * np.cos(yaw)
    size = (0.5, 0.5, float(rng.uniform(1.1, 1.4))) if child else (0.7, 0.65, float(rng.uniform(1.58, 1.9)))
    boxes = np.column_stack([x, y, np.full(len(x), size[0]), np.full(len(x), size[1]), yaw])
    if not world.is_free(boxes) or world.surprises_ego(boxes):
        return False
    world.tracks.append(ParticipantTrack(_CHILD if child else _ADULT, round(size[2], 2), boxes, parked=False))
    return True


def _compute_distance(points: Floats, point: Floats) -> float:
    return float(np.hypot(points[:, 0] - point[0], points[:, 1] - point[1]).min())
