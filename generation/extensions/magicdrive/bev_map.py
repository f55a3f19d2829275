"""The map around the lidar as masks from above (section 9)."""

from collections.abc import Callable
from typing import Final

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from benchmark.errors import InputError
from benchmark.geometry import Bools, Floats, to_global, to_local
from benchmark.road_map import RoadMap
from benchmark.scene import Scene

MAP_CHANNELS: Final = (
    "drivable_area",
    "ped_crossing",
    "walkway",
    "stop_line",
    "carpark_area",
    "road_divider",
    "lane_divider",
    "road_block",
)
"""Layers of the map expansion, in the model's order."""
MAP_EXTENT_M: Final = 50.0
"""Half the side of the square, centred on the lidar."""
MAP_CELLS: Final = 200
"""Cells on a side at 224 x 400 pixels; twice as many at larger sizes."""
_DIVIDER_CELLS: Final = 2
_SET, _CLEAR = (1.0,), (0.0,)

_Paint = Callable[[NDArray[np.uint8], shapely.Geometry, Callable[[Floats], Floats]], None]


def draw_clip_maps(scene: Scene, lidar: Floats, *, cells: int = MAP_CELLS) -> Bools:
    """Maps of a clip: (T, 8, cells, cells) masks by `MAP_CHANNELS`; ``lidar`` is (T, 4, 4) to the global frame."""
    if scene.road_map.drivable_area.is_empty:
        raise InputError(
            f"{scene.name} has no drivable area at {scene.road_map.location}; MagicDriveDiT draws the road from the "
            f"map expansion, put {scene.road_map.location}.json into maps/expansion of the data set"
        )
    layers = MapLayers(scene.road_map)
    yaw = np.arctan2(lidar[:, 1, 0], lidar[:, 0, 0])
    poses = np.column_stack([lidar[:, :2, 3], yaw])
    maps = np.empty((len(poses), len(MAP_CHANNELS), cells, cells), dtype=np.bool_)
    for index, pose in enumerate(poses):
        # The map does not change while the car stands still.
        same = index > 0 and np.array_equal(pose, poses[index - 1])
        maps[index] = maps[index - 1] if same else layers.masks(pose, cells)
    return maps


class MapLayers:
    """Geometries by channel, with an index of where they are."""

    def __init__(self, road_map: RoadMap) -> None:
        # Islands inside a hole must come after the surface that has the hole.
        drivable = sorted(road_map.drivable_area.geoms, key=lambda part: -part.area)
        lines = {
            between: [shapely.LineString(row.line) for row in road_map.dividers if row.between_directions is between]
            for between in (True, False)
        }
        surfaces = (
            drivable,
            road_map.ped_crossings.values(),
            road_map.walkways.values(),
            road_map.stop_lines.values(),
            road_map.carparks.values(),
        )
        shapes = [*map(list, surfaces), lines[True], lines[False], list(road_map.road_blocks.values())]
        painters: list[_Paint] = [_fill] * 5 + [_stroke] * 2 + [_fill]
        self._channels = [
            (np.array(layer, object), shapely.STRtree(layer), draw) for layer, draw in zip(shapes, painters)
        ]

    def masks(self, pose: Floats, cells: int = MAP_CELLS) -> Bools:
        """(8, cells, cells) masks by `MAP_CHANNELS` around a pose; first index right, second forward, -50 to 50 m.

        The (3,) global pose is x, y of the lidar and the direction of its x axis (to the right of the car). Surfaces
        are filled between corners rounded to cells; dividers are two cells wide between corners cut down to cells, as
        the devkit draws.
        """
        edge = MAP_EXTENT_M * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        window = shapely.Polygon(to_global(edge, pose))

        def to_cells(points: Floats) -> Floats:
            return (to_local(points, pose) + MAP_EXTENT_M) * (cells / (2.0 * MAP_EXTENT_M))

        # OpenCV's rows are forward and its columns right.
        canvas = np.zeros((len(self._channels), cells, cells), dtype=np.uint8)
        for image, (shapes, tree, draw) in zip(canvas, self._channels):
            for shape in shapely.intersection(shapes[np.sort(tree.query(window, predicate="intersects"))], window):
                draw(image, shape, to_cells)
        return np.asarray(canvas.transpose(0, 2, 1).astype(np.bool_))


def _fill(image: NDArray[np.uint8], shape: shapely.Geometry, to_cells: Callable[[Floats], Floats]) -> None:
    parts = [part for part in shapely.get_parts(shape) if isinstance(part, shapely.Polygon) and not part.is_empty]

    def rounded(ring: shapely.Geometry) -> NDArray[np.int32]:
        return np.rint(to_cells(shapely.get_coordinates(ring))).astype(np.int32)

    if parts:
        cv2.fillPoly(image, [rounded(part.exterior) for part in parts], _SET)
    if holes := [rounded(ring) for part in parts for ring in part.interiors]:
        cv2.fillPoly(image, holes, _CLEAR)


def _stroke(image: NDArray[np.uint8], shape: shapely.Geometry, to_cells: Callable[[Floats], Floats]) -> None:
    for line in shapely.get_parts(shape):
        corners = to_cells(shapely.get_coordinates(line)).astype(np.int32)
        cv2.polylines(image, [corners], False, _SET, _DIVIDER_CELLS)
