"""Parked cars, pedestrians, cones and barriers."""

import numpy as np

from benchmark.constants import FRAME_HZ
from benchmark.geometry import Floats
from generation.sources.town.curves import at_lengths, headings, lengths_along
from generation.sources.town.speed import FRAMES
from generation.sources.town.traffic import CARS
from generation.sources.town.world import Track, World

_PARKED_REACH_M = 55.0
_WALK_REACH_M = 38.0
_ADULT, _CHILD = "human.pedestrian.adult", "human.pedestrian.child"


def add_parked(world: World, near: Floats, rng: np.random.Generator, *, share: float, most: int) -> None:
    """Fill part of the parking places along the ego's way; road works block a few of those at the kerb.

    Args:
        world: Who is there already.
        near: (K, 2) points of the ego's way.
        rng: Chance.
        share: Share of the places that are taken.
        most: Upper bound on the number of cars.
    """
    places = [place for place in world.town.standing if _distance(near, place.pose[:2]) < _PARKED_REACH_M]
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
            if world.is_free(box):
                world.tracks.append(Track(body.category, body.height, box, parked=True))
                parked += 1


def _add_road_works(world: World, pose: Floats, rng: np.random.Generator) -> None:
    """A closed parking place: a barrier inside and cones along the traffic side."""
    along, left = np.array([np.cos(pose[2]), np.sin(pose[2])]), np.array([-np.sin(pose[2]), np.cos(pose[2])])
    barrier = pose[:2] - 0.2 * left
    boxes = [("movable_object.barrier", 1.0, [*barrier, 0.6, 2.0, pose[2] + np.pi / 2])]
    for step in (-2.4, -0.8, 0.8, 2.4):
        cone = pose[:2] + (step + float(rng.uniform(-0.1, 0.1))) * along + 0.85 * left
        boxes.append(("movable_object.trafficcone", 0.75, [*cone, 0.4, 0.4, float(rng.uniform(-np.pi, np.pi))]))
    for category, height, box in boxes:
        if world.is_free(np.array([box])):
            world.tracks.append(Track(category, height, np.array([box]), parked=False))


def add_walkers(world: World, near: Floats, rng: np.random.Generator, *, wanted: int) -> None:
    """Pedestrians on the pavements along the ego's way, some of them standing.

    Args:
        world: Who is there already.
        near: (K, 2) points of the ego's way.
        rng: Chance.
        wanted: How many.
    """
    added = 0
    for _ in range(6 * wanted):
        if added >= wanted:
            return
        walk = world.town.walks[int(rng.integers(len(world.town.walks)))]
        length = float(lengths_along(walk)[-1])
        start = float(rng.uniform(0.0, length))
        if _distance(near, at_lengths(walk, np.array([start]))[0]) > _WALK_REACH_M:
            continue
        speed = 0.0 if rng.random() < 0.2 else float(rng.uniform(0.9, 1.6))
        distance = speed * np.arange(FRAMES) / FRAME_HZ
        if start + distance[-1] > length:
            continue
        line = walk if rng.random() < 0.5 else walk[::-1]
        added += _add_pedestrian(world, line, start + distance, rng, lateral=float(rng.uniform(-0.7, 0.7)))


def add_crossing_pedestrians(world: World, near: Floats, rng: np.random.Generator, *, wanted: int) -> None:
    """Pedestrians who cross the road ahead of the ego; whoever is planned later gives way to them."""
    walks = [walk for walk in world.town.crossing_walks if _distance(near, walk.mean(axis=0)) < 25.0]
    if not walks:
        return
    for _ in range(wanted):
        walk = walks[int(rng.integers(len(walks)))]
        walk = walk if rng.random() < 0.5 else walk[::-1]
        begin, speed = float(rng.uniform(1.0, 14.0)), float(rng.uniform(1.2, 1.6))
        time = np.arange(FRAMES) / FRAME_HZ
        # Pace builds up over a second on each side of the crossing.
        length = float(np.hypot(*(walk[1] - walk[0])))
        eased = np.clip(np.where(time < begin, 0.0, time - begin), 0.0, None)
        gone = speed * (eased - 0.5 * (1 - np.exp(-2 * eased)))
        gone = np.where(gone > length - 0.5, length - 0.5 * np.exp(-np.maximum(gone - length + 0.5, 0.0) / 0.5), gone)
        _add_pedestrian(world, walk, gone, rng, lateral=float(rng.uniform(-1.0, 1.0)))


def _add_pedestrian(world: World, line: Floats, along: Floats, rng: np.random.Generator, *, lateral: float) -> bool:
    where = at_lengths(line, along)
    yaw = np.interp(along, lengths_along(line), headings(line))
    child = rng.random() < 0.15
    x, y = where[:, 0] - lateral * np.sin(yaw), where[:, 1] + lateral * np.cos(yaw)
    size = (0.5, 0.5, float(rng.uniform(1.1, 1.4))) if child else (0.7, 0.65, float(rng.uniform(1.58, 1.9)))
    boxes = np.column_stack([x, y, np.full(len(x), size[0]), np.full(len(x), size[1]), yaw])
    if not world.is_free(boxes):
        return False
    world.tracks.append(Track(_CHILD if child else _ADULT, round(size[2], 2), boxes, parked=False))
    return True


def _distance(points: Floats, point: Floats) -> float:
    return float(np.hypot(points[:, 0] - point[0], points[:, 1] - point[1]).min())
