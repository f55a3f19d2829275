"""Small scenes made by hand, for tests: a straight four-lane road along +x, the ego at constant speed."""

from dataclasses import dataclass, replace

import numpy as np
import shapely

from benchmark.constants import FRAME_HZ, FRAMES_PER_KEYFRAME
from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.machine.storage import make_token
from benchmark.road_map import Divider, DividerKind, Lane, RoadMap, as_multipolygon
from benchmark.scene import Agents, Annotations, EgoTrack, Scene
from generation.sources.rig import build_default_cameras, build_default_lidar

LANE_WIDTH_M = 3.5
ROAD_X_M = (0.0, 400.0)
ROAD_Y_M = 200.0


@dataclass(frozen=True)
class Car:
    """A car that keeps its speed: rear-to-front along ``yaw`` from ``x``, ``y`` at the first frame."""

    x: float
    y: float
    speed: float = 0.0
    yaw: float = 0.0
    category: str = "vehicle.car"
    size: tuple[float, float, float] = (4.6, 1.9, 1.7)


def straight_road() -> RoadMap:
    """Lanes ``east-0``, ``east-1`` (y = 198.25, 194.75) and ``west-0``, ``west-1`` (y = 201.75, 205.25)."""
    x_min, x_max = ROAD_X_M
    lanes = {}
    for index in range(2):
        for direction, sign in (("east", -1.0), ("west", 1.0)):
            y = ROAD_Y_M + sign * (index + 0.5) * LANE_WIDTH_M
            xs = np.linspace(x_min, x_max, 41)[:: 1 if direction == "east" else -1]
            centerline = np.column_stack([xs, np.full(41, y)])
            polygon = shapely.box(x_min, y - LANE_WIDTH_M / 2, x_max, y + LANE_WIDTH_M / 2)
            name = f"{direction}-{index}"
            lanes[name] = Lane(name, centerline, polygon, (), (), False)
    road = shapely.box(x_min, ROAD_Y_M - 2 * LANE_WIDTH_M, x_max, ROAD_Y_M + 2 * LANE_WIDTH_M)
    walkways = {
        "north": shapely.box(x_min, ROAD_Y_M + 2 * LANE_WIDTH_M, x_max, ROAD_Y_M + 2 * LANE_WIDTH_M + 2),
        "south": shapely.box(x_min, ROAD_Y_M - 2 * LANE_WIDTH_M - 2, x_max, ROAD_Y_M - 2 * LANE_WIDTH_M),
    }
    ends = np.array([[x_min, 0.0], [x_max, 0.0]])
    dividers = (
        Divider("middle", ends + [0.0, ROAD_Y_M], DividerKind.SOLID_YELLOW, True),
        Divider("east", ends + [0.0, ROAD_Y_M - LANE_WIDTH_M], DividerKind.DASHED_WHITE, False),
        Divider("west", ends + [0.0, ROAD_Y_M + LANE_WIDTH_M], DividerKind.DASHED_WHITE, False),
    )
    crossing = shapely.box(150.0, ROAD_Y_M - 2 * LANE_WIDTH_M, 154.0, ROAD_Y_M + 2 * LANE_WIDTH_M)
    return RoadMap(
        location="boston-seaport",
        drivable_area=as_multipolygon(road),
        lanes=lanes,
        dividers=dividers,
        ped_crossings={"crossing": crossing},
        walkways=walkways,
        road_segments={"road": road},
        canvas_m=(400.0, 400.0),
    )


def scene_on_straight_road(
    cars: tuple[Car, ...] = (Car(80.0, 198.25, 8.0), Car(60.0, 194.75, 10.0), Car(120.0, 201.75, 9.0, np.pi)),
    *,
    ego_x: float = 50.0,
    ego_y: float = 198.25,
    ego_speed: float = 8.0,
    seconds: float = 8.0,
    name: str = "scene-9901",
    description: str = "Straight road, day",
) -> Scene:
    """The ego drives east in the inner lane; cars keep their speed and heading."""
    count = round(seconds * FRAME_HZ)
    time = np.arange(count) / FRAME_HZ
    ego = EgoTrack(
        np.column_stack([ego_x + ego_speed * time, np.full(count, ego_y), np.zeros(count)]),
        quaternion_from_yaw(np.zeros(count)),
    )
    agents = _agents(cars, time, name)
    keyframes = np.arange(0, count, FRAMES_PER_KEYFRAME)
    shape = (len(cars), len(keyframes))
    annotations = Annotations(
        position=agents.position[:, keyframes],
        rotation=quaternion_from_yaw(agents.yaw[:, keyframes]),
        size=np.repeat(agents.size[:, None], shape[1], axis=1),
        valid=np.ones(shape, dtype=np.bool_),
        attribute=np.full(shape, "vehicle.moving"),
        visibility=np.full(shape, 4),
        num_lidar_pts=np.full(shape, 20),
        num_radar_pts=np.full(shape, 2),
    )
    return Scene(
        name=name,
        token=make_token("hand-made", name),
        description=description,
        log=f"n000-{name}",
        vehicle="n000",
        date="2026-01-01",
        timestamps_us=1_700_000_000_000_000 + np.round(time * 1e6).astype(np.int64),
        keyframes=keyframes,
        ego=ego,
        agents=agents,
        annotations=annotations,
        cameras=build_default_cameras(),
        lidar=build_default_lidar(),
        road_map=straight_road(),
    )


def moved(scene: Scene, row: int, by_m: float) -> Scene:
    """The scene with one object moved, tracks alone."""
    position = scene.agents.position.copy()
    position[row, :, 0] += by_m
    return replace(scene, agents=replace(scene.agents, position=position))


def without_frames(scene: Scene, agent: int, keyframes: slice) -> Scene:
    """The scene with an agent that is not there for a while."""
    valid, annotated = scene.agents.valid.copy(), scene.annotations.valid.copy()
    first, last = scene.keyframes[keyframes][[0, -1]]
    valid[agent, first : last + 1] = False
    annotated[agent, keyframes] = False
    return replace(
        scene, agents=replace(scene.agents, valid=valid), annotations=replace(scene.annotations, valid=annotated)
    )


def _agents(cars: tuple[Car, ...], time: Floats, scene: str) -> Agents:
    count = len(time)
    position = np.empty((len(cars), count, 3))
    for row, car in enumerate(cars):
        position[row, :, 0] = car.x + car.speed * np.cos(car.yaw) * time
        position[row, :, 1] = car.y + car.speed * np.sin(car.yaw) * time
        position[row, :, 2] = car.size[2] / 2
    return Agents(
        ids=tuple(make_token("car", scene, row) for row in range(len(cars))),
        categories=tuple(car.category for car in cars),
        position=position,
        yaw=np.repeat(np.array([car.yaw for car in cars], dtype=np.float64)[:, None], count, axis=1),
        size=np.array([car.size for car in cars], dtype=np.float64).reshape(-1, 3),
        valid=np.ones((len(cars), count), dtype=np.bool_),
    )
