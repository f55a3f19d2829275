"""Scenes of which nothing is regular: for properties of files that carry scenes."""

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon, Polygon

from benchmark.datasets.annotated_objects import find_nearest_valid
from benchmark.geometry import Floats
from benchmark.machine.storage import make_token
from benchmark.road_map import Divider, DividerKind, Lane, RoadMap
from benchmark.scene import Agents, Annotations, Camera, EgoTrack, LidarMount, Scene, SweepPoses

CATEGORIES = (
    "vehicle.car", "vehicle.truck", "vehicle.bicycle", "human.pedestrian.adult", "movable_object.trafficcone",
    "movable_object.barrier", "static_object.bicycle_rack", "animal", "vehicle.of.tomorrow",
)  # fmt: skip


def wild_scene(seed: int, *, name: str = "scene-0061-1a2b3c4d") -> Scene:
    """A scene from a seed: clock that is not quite even, objects that come and go, a ragged map."""
    rng = np.random.default_rng(seed)
    keyframes = np.cumsum(rng.integers(1, 8, rng.integers(2, 7)))
    keyframes -= keyframes[0]
    frames = int(keyframes[-1]) + 1
    stamps = 1_532_000_000_000_000 + np.cumsum(rng.integers(60_000, 110_000, frames))
    path = np.cumsum(rng.normal(0.5, 0.3, (frames, 3)), axis=0) + [600.0, 1600.0, 0.0]
    agents = _agents(rng, frames, keyframes)
    sweeps = SweepPoses(rng.normal(size=(frames, 4, 4)), rng.normal(size=(2, frames, 4, 4)))
    chosen = [name for name in agents.ids if rng.random() < 0.3]
    return Scene(
        name=name,
        token=make_token("wild", seed),
        description="Rain, ümlaut, a bus",
        log="n015-2018-07-24-11-22-45+0800",
        vehicle="n015",
        date="2018-07-24",
        timestamps_us=stamps.astype(np.int64),
        keyframes=keyframes.astype(np.int64),
        ego=EgoTrack(path, _rotations(rng, (frames,))),
        agents=agents,
        annotations=_annotations(rng, agents, keyframes),
        cameras=tuple(_camera(rng, each) for each in ("CAM_FRONT", "CAM_BACK")),
        lidar=LidarMount(rng.normal(size=3), _rotations(rng, ())),
        road_map=wild_map(rng),
        adversaries=tuple(chosen[::-1]),
        sweep_poses=sweeps if rng.random() < 0.5 else None,
    )


def _rotations(rng: np.random.Generator, shape: tuple[int, ...]) -> Floats:
    found = rng.normal(size=(*shape, 4))
    return np.asarray(found / np.linalg.norm(found, axis=-1, keepdims=True))


def _camera(rng: np.random.Generator, name: str) -> Camera:
    return Camera(name, rng.normal(size=3), _rotations(rng, ()), rng.normal(size=(3, 3)), 1600, 900)


def _agents(rng: np.random.Generator, frames: int, keyframes: NDArray[np.int64]) -> Agents:
    count = int(rng.integers(0, 6))
    valid = rng.random((count, frames)) < 0.6
    valid[np.arange(count), rng.choice(keyframes, count)] = True
    held = find_nearest_valid(valid)
    rows = np.arange(count)[:, None]
    # Names that are digits come from Waymo.
    ids = tuple(str(row) if row % 2 else make_token("object", row) for row in range(count))
    return Agents(
        ids=ids,
        categories=tuple(rng.choice(CATEGORIES, count).tolist()),
        position=rng.normal(1000.0, 50.0, (count, frames, 3))[rows, held],
        yaw=rng.uniform(-9.0, 9.0, (count, frames))[rows, held],
        size=rng.uniform(0.2, 12.0, (count, 3)),
        valid=valid,
    )


def _annotations(rng: np.random.Generator, agents: Agents, keyframes: NDArray[np.int64]) -> Annotations:
    shape = (len(agents), len(keyframes))
    return Annotations(
        position=agents.position[:, keyframes] + rng.normal(0.0, 0.01, (*shape, 3)),
        rotation=_rotations(rng, shape),
        size=rng.uniform(0.2, 12.0, (*shape, 3)),
        valid=agents.valid[:, keyframes],
        attribute=rng.choice(["", "vehicle.moving", "cycle.with_rider;é"], shape).astype(np.str_),
        visibility=rng.integers(0, 5, shape),
        num_lidar_pts=rng.integers(0, 900, shape),
        num_radar_pts=rng.integers(0, 9, shape),
    )


def wild_map(rng: np.random.Generator) -> RoadMap:
    """Every layer, surfaces with holes, names that are in two layers."""

    def surface() -> Polygon:
        x, y = rng.uniform(0.0, 900.0, 2)
        whole: Polygon = shapely.box(x, y, x + 20, y + 30)
        return whole.difference(shapely.box(x + 5, y + 5, x + 6, y + 9)) if rng.random() < 0.5 else whole

    def layer(called: str) -> dict[str, Polygon]:
        return {f"{called}-{number}": surface() for number in range(rng.integers(0, 3))}

    kinds = list(DividerKind)
    lines = [rng.uniform(0.0, 900.0, (rng.integers(2, 6), 2)) for _ in range(4)]
    names = [f"lane-{number}" for number in range(3)]
    lanes = {
        name: Lane(
            name,
            line,
            None if number == 0 else surface() if number == 1 else Polygon(np.vstack([line, line[:1] + [3, 40]])),
            tuple(names[number + 1 :]),
            tuple(names[:number]),
            number == 0,
        )
        for number, (name, line) in enumerate(zip(names, lines, strict=False))
    }
    segments = layer("segment")
    return RoadMap(
        location="singapore-onenorth",
        drivable_area=MultiPolygon([surface() for _ in range(3)]),
        lanes=lanes,
        dividers=tuple(
            Divider(
                "lane-0" if number == 0 else f"line-{number}", line, kinds[rng.integers(len(kinds))], number % 2 == 0
            )
            for number, line in enumerate(lines)
        ),
        ped_crossings=layer("crossing"),
        walkways=layer("walkway"),
        road_segments=segments,
        intersections=frozenset(list(segments)[:1]),
        stop_lines=layer("stop"),
        carparks=layer("park"),
        road_blocks=layer("block"),
        canvas_m=(1585.6, 2025.0),
    )
