"""Scenes of the embedded town, a pure function of split, index and seed, and the annotations of their keyframes."""

from dataclasses import replace
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME, OFFICIAL_LOCATIONS
from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats, quaternion_from_yaw, to_local, wrap_angle
from benchmark.machine.storage import content_seed, make_token
from benchmark.records.driven_ego import DrivenEgoTargets
from benchmark.records.off_path import Excursion
from benchmark.scene import Agents, Annotations, EgoTrack, Scene
from generation.sources.rig import build_default_cameras, build_default_lidar
from generation.sources.town.bystanders import (
    add_crossing_pedestrians,
    add_meeting_pedestrians,
    add_parked,
    add_walkers,
)
from generation.sources.town.curves import interpolate_grid
from generation.sources.town.driven_ego import PlannerDrive, plan_ways_back
from generation.sources.town.mirror import mirror_points
from generation.sources.town.network import Town
from generation.sources.town.off_path import KEPT_ON_PATH_EVERY, PlannedEgo, drive_off_path
from generation.sources.town.paths import (
    EGO_BODY,
    LEAD_M,
    STATION_M,
    RouteLeg,
    VehiclePath,
    build_path,
    compute_fastest_start,
    compute_lane_length,
)
from generation.sources.town.speed import FRAMES, DriverHabits
from generation.sources.town.themes import (
    PROGRAMME,
    EgoLight,
    SceneProgramme,
    compute_route_points,
    draw_ego_route,
)
from generation.sources.town.towns import TOWN_VERSION, build_town
from generation.sources.town.traffic import (
    CARS,
    MIXED,
    LanePoints,
    add_companions,
    add_cycles,
    add_on_path,
    add_passing,
    add_pulling_out,
    draw_natural_pace,
)
from generation.sources.town.world import TownWorld, TrafficLights

_RAYS = 7
_LIDAR_POINTS_M2 = 4200.0
_RADAR_SHARE = 0.02
_VISIBILITY_LEVELS = (0.4, 0.6, 0.8)
_MOVING_MPS = 0.3
_LIDAR_CERTAIN_M = 50.0


def build_annotations(agents: Agents, parked: Bools, ego: EgoTrack, keyframes: NDArray[np.int64]) -> Annotations:
    """Annotations, (N, K), of agents at the (K,) keyframes. ``parked`` says (N,) which vehicles are parked.

    Visibility is the share of sight lines from the ego's roof that no nearer box crosses; lidar points fall with the
    square of the distance and that share, and are at least one within 50 m.
    """
    position, yaw, valid = agents.position[:, keyframes], agents.yaw[:, keyframes], agents.valid[:, keyframes]
    visible_share = np.zeros(valid.shape)
    distance = np.zeros(valid.shape)
    boxes = agents.boxes[:, keyframes]
    for column, frame in enumerate(keyframes.tolist()):
        eye = ego.position[frame, :2]
        distance[:, column] = np.hypot(position[:, column, 0] - eye[0], position[:, column, 1] - eye[1])
        present = np.flatnonzero(valid[:, column])
        visible_share[present, column] = _compute_visible_share(boxes[present, column], agents.size[present, 2], eye)
    area = agents.size[:, 2] * np.maximum(agents.size[:, 0], agents.size[:, 1])
    points = np.rint(_LIDAR_POINTS_M2 * area[:, None] * visible_share / np.maximum(distance, 3.0) ** 2).astype(np.int64)
    points = np.where((distance < _LIDAR_CERTAIN_M) & (visible_share > 0), np.maximum(points, 1), points)
    levels = 1 + np.searchsorted(np.array(_VISIBILITY_LEVELS), visible_share, side="right")
    return Annotations(
        position=position,
        rotation=quaternion_from_yaw(yaw),
        size=np.repeat(agents.size[:, None], len(keyframes), axis=1),
        valid=valid,
        attribute=_choose_attributes(agents, parked, keyframes),
        visibility=np.where(valid, levels, 1).astype(np.int64),
        num_lidar_pts=np.where(valid, points, 0),
        num_radar_pts=np.where(valid, np.minimum(np.rint(_RADAR_SHARE * points), 12), 0).astype(np.int64),
    )


def _compute_visible_share(boxes: Floats, heights: Floats, eye: Floats) -> Floats:
    """(N,) share of sight lines to each box, spread over its width as seen, that no other box crosses."""
    count = len(boxes)
    towards = np.arctan2(boxes[:, 1] - eye[1], boxes[:, 0] - eye[0])
    turned = boxes[:, 4] - towards
    half = 0.5 * (boxes[:, 2] * np.abs(np.sin(turned)) + boxes[:, 3] * np.abs(np.cos(turned)))
    spread = np.linspace(-0.9, 0.9, _RAYS)[None] * half[:, None]
    target_x = boxes[:, 0, None] - spread * np.sin(towards)[:, None]
    target_y = boxes[:, 1, None] + spread * np.cos(towards)[:, None]
    targets = np.stack([target_x, target_y], axis=-1)
    # (sight lines, boxes): both ends of each line in the frame of each box, then the slab test.
    frames = boxes[None, None, :, [0, 1, 4]]
    start = to_local(np.broadcast_to(eye, (1, 1, count, 2)), frames)
    end = to_local(np.broadcast_to(targets[:, :, None], (count, _RAYS, count, 2)), frames)
    step = end - start
    safe = np.where(np.abs(step) < 1e-9, 1e-9, step)
    bounds = 0.5 * boxes[None, None, :, 2:4]
    first, second = (-bounds - start) / safe, (bounds - start) / safe
    enter = np.minimum(first, second).max(axis=-1)
    leave = np.maximum(first, second).min(axis=-1)
    crossed = (enter < leave) & (leave > 0) & (enter < 0.98)
    taller = heights[None, :] > 0.75 * heights[:, None]
    hidden = (crossed & taller[:, None, :] & ~np.eye(count, dtype=np.bool_)[:, None, :]).any(axis=-1)
    return np.asarray(1.0 - hidden.mean(axis=1))


def _choose_attributes(agents: Agents, parked: Bools, keyframes: NDArray[np.int64]) -> NDArray[np.str_]:
    before = np.maximum(keyframes - 1, 0)
    after = np.minimum(keyframes + 1, agents.yaw.shape[1] - 1)
    moved = agents.position[:, after, :2] - agents.position[:, before, :2]
    speed = np.hypot(moved[..., 0], moved[..., 1]) * FRAME_HZ / (after - before)
    rows = []
    for index, category in enumerate(agents.categories):
        moving = speed[index] > _MOVING_MPS
        if category in ("vehicle.bicycle", "vehicle.motorcycle"):
            rows.append(np.full(len(keyframes), "cycle.with_rider"))
        elif category.startswith("vehicle."):
            still = "vehicle.parked" if parked[index] else "vehicle.stopped"
            rows.append(np.where(moving, "vehicle.moving", still))
        elif category.startswith("human."):
            rows.append(np.where(moving, "pedestrian.moving", "pedestrian.standing"))
        else:
            rows.append(np.full(len(keyframes), ""))
    return np.array(rows, dtype=np.str_).reshape(len(agents), len(keyframes))


Split = Literal["val", "train"]
DEFAULT_VAL_SCENES = 30

_NUMBERS: dict[str, tuple[range, ...]] = {"val": (range(8000, 9000),), "train": (range(9000, 10000), range(2000, 8000))}
MOST_TRAIN_SCENES = sum(map(len, _NUMBERS["train"]))
_LOCATIONS: dict[str, tuple[str, str]] = {"val": OFFICIAL_LOCATIONS[:2], "train": OFFICIAL_LOCATIONS[2:]}
_FIRST_DAY_US = 1_767_254_400_000_000
_DAY_US = 86_400_000_000
_SCENE_SPACING_US = 30_000_000
_DIGITS = 6
_LONG_CLEARANCE_S = 7.0
"""Where the ego comes at the end of green: until it stands."""
_TRIES = 24
_TRIES_PER_TOWN = 2
_PLAIN_TRIES = 8
"""Where neither town has room for one ahead or behind as well."""
_LEADER_TRIES = 6
_LEAST_NEIGHBOURS = 2
_NEIGHBOUR_REACH_M = 25.0
_LEAST_SECONDS_NEAR = 1.5
_LEAST_SECONDS_PRESENT = 6
_LEAST_DISTANCE_M = 6.0
_LEAST_EGO_DISTANCE_M = 30.0


def list_town_scene_names(split: Split, count: int) -> tuple[str, ...]:
    """Names of scenes, ``scene-8000``... for val, ``scene-9000``... for train: four digits, none of nuScenes."""
    if split not in get_args(Split):
        raise InputError(f"the embedded town has no split {split!r}; choose val or train")
    numbers = [number for block in _NUMBERS[split] for number in block]
    if not 0 <= count <= len(numbers):
        raise InputError(
            f"the number of {split} scenes of the embedded town must be between 0 and {len(numbers)}, got {count}"
        )
    return tuple(f"scene-{number:04d}" for number in numbers[:count])


def build_town_scene(split: Split, index: int, *, seed: int = 0, crossing: int = 0) -> Scene:
    """Scene ``index`` of a split, 20 s at 12 Hz; nothing but the arguments decides its bytes.

    The splits have different towns; each seed has its own towns and traffic. ``crossing`` is the most pedestrians more
    who cross the ego's way when it comes; with any, all is different but the town.
    """
    return _build_scene(split, index, seed, crossing, off_path=False)[0]


def build_town_scene_off_path(index: int, *, seed: int = 0, crossing: int = 0) -> tuple[Scene, tuple[Excursion, ...]]:
    """A scene as of `build_town_scene` but for the ego's excursions; one of `KEPT_ON_PATH_EVERY` has none."""
    off_path = index % KEPT_ON_PATH_EVERY != KEPT_ON_PATH_EVERY - 1
    return _build_scene("train", index, seed, crossing, off_path=off_path)


def build_town_scene_driven(
    index: int, driven: PlannerDrive, *, seed: int = 0, crossing: int = 0
) -> tuple[Scene, DrivenEgoTargets]:
    """A scene as of `build_town_scene` but with the ego as driven, and a good driver's way from each key frame."""
    world, planned, programme = _find_populated_world("train", index, seed, crossing)
    inside = replace(driven, poses=_show(world.town, driven.poses))
    wanted = _show(world.town, plan_ways_back(world, planned, inside))
    world.place_ego(inside.rear())
    name = list_town_scene_names("train", index + 1)[-1]
    scene = _assemble_scene(world, programme, "train", index, seed, name)
    frames = (len(driven) - 1) * FRAMES_PER_KEYFRAME + 1
    return scene.first_frames(frames), DrivenEgoTargets(driven.planner, driven.commands, wanted)


def _build_scene(
    split: Split, index: int, seed: int, crossing: int, *, off_path: bool
) -> tuple[Scene, tuple[Excursion, ...]]:
    world, planned, programme = _find_populated_world(split, index, seed, crossing)
    excursions: tuple[Excursion, ...] = ()
    if off_path:
        leaving = np.random.default_rng(content_seed("off path", TOWN_VERSION, split, index, seed))
        rear, excursions = drive_off_path(world, planned, leaving)
        world.place_ego(rear)
        if _is_left_handed(world.town):
            excursions = tuple(
                replace(one, lateral_m=-one.lateral_m, heading_rad=-one.heading_rad) for one in excursions
            )
    name = list_town_scene_names(split, index + 1)[-1]
    return _assemble_scene(world, programme, split, index, seed, name), excursions


def _find_populated_world(
    split: Split, index: int, seed: int, crossing: int
) -> tuple[TownWorld, PlannedEgo, SceneProgramme]:
    if index < 0:
        raise InputError(f"the number of a town scene starts at 0, got {index}")
    list_town_scene_names(split, index + 1)
    programme = PROGRAMME[index % len(PROGRAMME)]
    place = (index + index // len(PROGRAMME)) % 2
    for attempt in range(_TRIES):
        # Not every town has a place for every theme: after some attempts the other town of the split is tried.
        location = _LOCATIONS[split][(place + attempt // _TRIES_PER_TOWN) % 2]
        town = build_town(location, seed)
        # A drive given the wrong number of them gets another ego, not the same one with other pedestrians.
        also = (crossing,) if crossing else ()
        rng = np.random.default_rng(content_seed("town scene", TOWN_VERSION, split, index, seed, attempt, *also))
        if attempt == _TRIES - _PLAIN_TRIES:
            programme = replace(programme, leader=False, follower=False)
        populated = _populate(town, location, seed, programme, rng, crossing)
        if populated is None or not _is_worth_attacking(populated[0]):
            continue
        return *populated, programme
    raise InputError(f"the embedded town has no traffic for {split} scene {index} with seed {seed}; use another seed")


@lru_cache(maxsize=8)
def _build_lane_points(location: str, seed: int) -> LanePoints:
    return LanePoints.of(build_town(location, seed))


def _populate(
    town: Town, location: str, seed: int, programme: SceneProgramme, rng: np.random.Generator, crossing: int
) -> tuple[TownWorld, PlannedEgo] | None:
    """One attempt at a scene: a route, then all others in the order in which they have the right of way."""
    theme = programme.theme
    route = draw_ego_route(town, programme, rng)
    if route is None:
        return None
    legs, start_m = route
    points = _build_lane_points(location, seed)
    way = compute_route_points(town, legs, start_m, 200.0)
    path = build_path(town, legs, start_m, EGO_BODY)
    eagerness = float(rng.uniform(0.82, 0.98))
    start = int(min(eagerness * float(path.speed_limit[0]), compute_fastest_start(path)) + 0.3)
    slower = float(rng.uniform(0.62, 0.75)) if programme.leader else 1.0
    start = min(start, int(slower * float(path.speed_limit[0])) + 1)
    if programme.light is EgoLight.WAITS:
        start = 0
    world = TownWorld(town, _draw_lights(town, programme, path, start, rng))
    add_parked(world, way, rng, share=0.65, most=theme.parked)
    if programme.leader and not _add_leader(world, legs, start_m, start, slower, rng):
        return None
    if programme.light is EgoLight.GREEN:
        add_crossing_pedestrians(world, way[5:], rng, wanted=theme.crossing)
    if crossing:
        speed = eagerness * float(np.mean(path.speed_limit))
        add_meeting_pedestrians(world, way, rng, wanted=crossing, speed_mps=speed)
    stations = world.stations(path, start_mps=start, habits=DriverHabits(eagerness, draw_natural_pace(rng)))
    if stations is None:
        return None
    rear = interpolate_grid(path.rear, stations)
    world.place_ego(rear)
    world.expect_ego(path, stations)
    if programme.light is not EgoLight.GREEN:
        add_crossing_pedestrians(world, way[5:], rng, wanted=2 * theme.crossing)
    if programme.follower and not _add_follower(world, legs, start_m, start, rng):
        return None
    add_companions(world, points, legs, rng, wanted=theme.companions)
    add_pulling_out(world, points, rear[:, :2], rng, wanted=theme.pulling_out)
    add_passing(world, points, rng, wanted=theme.passing, attempts=4 * theme.passing)
    add_cycles(world, points, rng, wanted=1 + int(rng.integers(2)), attempts=8)
    add_walkers(world, rear[:, :2], rng, wanted=theme.pedestrians)
    return world, PlannedEgo(path, stations)


def _draw_lights(
    town: Town, programme: SceneProgramme, path: VehiclePath, start_mps: int, rng: np.random.Generator
) -> dict[str, TrafficLights]:
    """Lights of all junctions; those that the ego meets first are as the programme says, later ones are green."""
    nodes = sorted({node for node, _ in town.signals.values()})
    lights = {node: TrafficLights(int(rng.integers(2)), float(rng.uniform(3.0, 17.0))) for node in nodes}
    light = programme.light
    for station, lane in path.halts:
        node, phase = town.signals[lane]
        arrives = max(station, 0) * STATION_M / max(start_mps, 6.0)
        if light is EgoLight.WAITS:
            lights[node] = TrafficLights(1 - phase, float(rng.uniform(6.0, 11.0)))
        elif light is EgoLight.RED:
            lights[node] = TrafficLights(1 - phase, arrives + float(rng.uniform(6.0, 9.0)))
        elif light is EgoLight.STOPS:
            lights[node] = TrafficLights(phase, max(arrives - float(rng.uniform(3.0, 5.0)), 1.0), _LONG_CLEARANCE_S)
        else:
            lights[node] = TrafficLights(phase, arrives + float(rng.uniform(6.0, 9.0)))
        light = EgoLight.GREEN
    return lights


def _add_leader(
    world: TownWorld,
    legs: list[RouteLeg],
    start_m: float,
    start_mps: int,
    eagerness: float,
    rng: np.random.Generator,
) -> bool:
    """One who drives where the ego goes, a little slower than the ego would like to."""
    for _ in range(_LEADER_TRIES):
        body = MIXED.draw(rng)
        ahead = start_m + body.length + max(1.5 + float(rng.uniform(1.45, 1.75)) * start_mps, 4.5)
        path = build_path(world.town, legs, ahead, body)
        habits = DriverHabits(eagerness, draw_natural_pace(rng))
        if add_on_path(world, path, start_mps, habits):
            return True
    return False


def _add_follower(
    world: TownWorld, legs: list[RouteLeg], start_m: float, start_mps: int, rng: np.random.Generator
) -> bool:
    """One who drives behind the ego, and would like to be faster."""
    for _ in range(_LEADER_TRIES):
        body = CARS.draw(rng)
        behind = start_m - EGO_BODY.length - 2.5 - float(rng.uniform(2.0, 2.4)) * start_mps
        before = list(legs)
        while behind < LEAD_M:
            options = world.town.predecessors[before[0].lane]
            if not options:
                return False
            before.insert(0, RouteLeg(options[int(rng.integers(len(options)))]))
            behind += compute_lane_length(world.town.lanes[before[0].lane])
        path = build_path(world.town, before, behind, body)
        habits = DriverHabits(float(rng.uniform(1.0, 1.1)), draw_natural_pace(rng), headway_s=2.0, ego_gap_s=1.5)
        if add_on_path(world, path, start_mps, habits):
            return True
    return False


def _is_worth_attacking(world: TownWorld) -> bool:
    """Whether the ego moves and enough cars are near it for some seconds and there for long."""
    assert world.ego_rear is not None
    if float(np.hypot(*np.diff(world.ego_rear[:, :2], axis=0).T).sum()) < _LEAST_EGO_DISTANCE_M:
        return False
    enough = 0
    for track in world.tracks:
        if track.category == "vehicle.car" and len(track.boxes) > 1:
            near = world.compute_distance_to_ego(track.boxes) < _NEIGHBOUR_REACH_M
            enough += bool(
                np.ptp(track.boxes[:, :2], axis=0).max() > _LEAST_DISTANCE_M
                and near.sum() >= _LEAST_SECONDS_NEAR * FRAME_HZ
                and world.present(track.boxes).sum() >= _LEAST_SECONDS_PRESENT * FRAME_HZ
            )
    return enough >= _LEAST_NEIGHBOURS


def _assemble_scene(world: TownWorld, programme: SceneProgramme, split: str, index: int, seed: int, name: str) -> Scene:
    assert world.ego_rear is not None
    rear = np.round(_show(world.town, world.ego_rear), _DIGITS)
    ego = EgoTrack(np.column_stack([rear[:, :2], np.zeros(FRAMES)]), quaternion_from_yaw(rear[:, 2]))
    agents, parked = _build_agents(world, (split, index, seed))
    keyframes = np.arange(0, FRAMES, FRAMES_PER_KEYFRAME)
    location = world.town.road_map.location
    near, far = ("left", "right") if _is_left_handed(world.town) else ("right", "left")
    day = OFFICIAL_LOCATIONS.index(location)
    first = _FIRST_DAY_US + day * _DAY_US + index * _SCENE_SPACING_US
    return Scene(
        name=name,
        token=make_token("town scene", TOWN_VERSION, split, index, seed),
        description=f"{programme.theme.title.format(near=near, far=far)}, {programme.look.value}",
        log=f"n000-2026-01-{day + 1:02d}-08-00-00+0000",
        vehicle="n000",
        date=f"2026-01-{day + 1:02d}",
        timestamps_us=first + np.round(np.arange(FRAMES) * 1e6 / FRAME_HZ).astype(np.int64),
        keyframes=keyframes.astype(np.int64),
        ego=ego,
        agents=agents,
        annotations=build_annotations(agents, parked, ego, keyframes),
        cameras=build_default_cameras(),
        lidar=build_default_lidar(),
        road_map=world.town.shown_map,
    )


def _is_left_handed(town: Town) -> bool:
    return town.shown_map is not town.road_map


def _show(town: Town, poses: Floats) -> Floats:
    """(..., 2) points or (..., 3) poses as on the town's shown map, or back from there."""
    return mirror_points(poses) if _is_left_handed(town) else poses


def _build_agents(world: TownWorld, key: tuple[str, int, int]) -> tuple[Agents, Bools]:
    """Agents that are seen at a keyframe, in the order of placement; where absent, the nearest pose is held."""
    rows: list[tuple[str, Floats, Bools, list[float], bool]] = []
    for track in world.tracks:
        boxes = np.broadcast_to(track.boxes, (FRAMES, 5))
        valid = world.present(boxes)
        if valid[::FRAMES_PER_KEYFRAME].any():
            size = [float(boxes[0, 2]), float(boxes[0, 3]), track.height]
            rows.append((track.category, boxes[_find_nearest_valid(valid)], valid, size, track.parked))
    held = np.stack([row[1] for row in rows])
    shown = _show(world.town, held[..., [0, 1, 4]])
    size = np.round(np.array([row[3] for row in rows]), 3)
    height = np.broadcast_to(size[:, None, 2] / 2, held.shape[:2])
    agents = Agents(
        ids=tuple(make_token("town agent", TOWN_VERSION, *key, row) for row in range(len(rows))),
        categories=tuple(row[0] for row in rows),
        position=np.round(np.concatenate([shown[..., :2], height[..., None]], axis=-1), _DIGITS),
        yaw=np.round(wrap_angle(shown[..., 2]), _DIGITS),
        size=size,
        valid=np.stack([row[2] for row in rows]),
    )
    return agents, np.array([row[4] for row in rows], dtype=np.bool_)


def _find_nearest_valid(valid: Bools) -> NDArray[np.int64]:
    """(T,) index of the nearest valid frame, the earlier of two."""
    valid_frames = np.flatnonzero(valid)
    frames = np.arange(len(valid))
    after = np.clip(np.searchsorted(valid_frames, frames), 0, len(valid_frames) - 1)
    before = np.maximum(after - 1, 0)
    choice = np.where(frames - valid_frames[before] <= valid_frames[after] - frames, before, after)
    return np.asarray(valid_frames[np.where(valid, after, choice)])
