"""Map expansion files of nuScenes (version 1.3 and later) as a `RoadMap`."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely
from shapely.geometry import LineString, MultiPolygon, Polygon

from benchmark.constants import MAP_LAYERS
from benchmark.datasets.categories import LAYER, CategoryNames
from benchmark.datasets.devkit_import import import_devkit_module
from benchmark.datasets.schema.rows import format_value
from benchmark.datasets.schema.sidecar_files import ARC_LINE, MAP_LINKS, MAP_NODE, MAP_RECORD, require_records
from benchmark.datasets.tables import Row
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import read_json
from benchmark.road_map import Divider, DividerKind, Lane, RoadMap, as_multipolygon, mend_polygon
from benchmark.untrusted.files import to_one_line

CENTERLINE_STEP_M: Final = 1.0
_OLDEST_VERSION: Final = (1, 3)
_POLYGON_LAYERS: Final = {
    "ped_crossings": "ped_crossing",
    "walkways": "walkway",
    "road_segments": "road_segment",
    "stop_lines": "stop_line",
    "carparks": "carpark_area",
}
_NAMED_LAYERS: Final = (
    "polygon", "line", "lane", "lane_connector", "drivable_area", "lane_divider", "road_divider", "road_block",
)  # fmt: skip
"""Further layers whose records are named; what they hold is sorted by these names."""


def find_expansion_file(root: Path, location: str) -> Path | None:
    """Map expansion file of a nuScenes location, or ``None`` if the data set has none."""
    if Path(location).name != location:
        return None
    path = root / "maps" / "expansion" / f"{location}.json"
    return path if path.is_file() else None


def rename_layers(layers: Mapping[str, Any], names: CategoryNames) -> dict[str, Any]:
    """A map expansion with nuScenes' names of layers."""
    new = {own: to for own, to in names if own.startswith(LAYER)}
    return {new.get(f"{LAYER}{own}", own): layer for own, layer in layers.items()}


def read_road_map(path: Path, names: CategoryNames = ()) -> RoadMap:
    """Read a whole map from ``maps/expansion/<location>.json`` of version 1.3 or later, its layers renamed.

    Lanes without an arc-line path are left out: nothing tells where their centre is. Where there is no drivable area
    layer, road segments, lanes and car parks make it up.
    """
    layers = read_json(path)
    if not isinstance(layers, dict):
        raise InputError(f"{path} must be a map expansion (a JSON object of layers); fetch or make it again")
    layers = rename_layers(layers, names)
    _require_version(layers, path)
    try:
        require_records(path, "node", layers["node"], MAP_NODE)
        for layer in (*_POLYGON_LAYERS.values(), *_NAMED_LAYERS):
            require_records(path, f"{layer} record", layers.get(layer, []), MAP_RECORD)
        for lane, links in _mapping(layers["connectivity"]).items():
            require_records(path, f"link of lane {format_value(lane)}", [links], MAP_LINKS)
        for lane, arclines in _mapping(layers["arcline_path_3"]).items():
            require_records(path, f"path of lane {format_value(lane)}", arclines, ARC_LINE)
        return _ExpansionShapes(layers).road_map(path.stem)
    except KeyError as error:
        raise InputError(
            f"{path}: layer or record {to_one_line(repr(error.args[0]))} is missing; the map expansion is incomplete, "
            "fetch or make it again"
        ) from error
    except (TypeError, ValueError, AttributeError, OverflowError) as error:
        raise InputError(
            f"{path} is not a well-formed map expansion ({to_one_line(error)}); fetch or make it again"
        ) from error


def make_empty_expansion() -> dict[str, Any]:
    """Content of a map expansion that holds nothing, for code that opens the maps of all cities."""
    return {
        "version": "1.3",
        "canvas_edge": [1.0, 1.0],
        **{layer: [] for layer in MAP_LAYERS},
        "connectivity": {},
        "arcline_path_3": {},
    }


def _require_version(layers: Mapping[str, Any], path: Path) -> None:
    text = str(layers.get("version", "none"))
    try:
        version = tuple(int(part) for part in text.split("."))
    except ValueError:
        version = (0,)
    if version < _OLDEST_VERSION:
        raise InputError(
            f"{path} has map version {to_one_line(text)}; version 1.3 or later is needed, fetch the newer expansion"
        )


class _ExpansionShapes:
    """Records of one expansion file, resolved to geometry."""

    def __init__(self, layers: Mapping[str, Any]) -> None:
        self.layers = layers
        self.nodes = {row["token"]: (row["x"], row["y"]) for row in layers["node"]}
        self.polygons = {row["token"]: row for row in layers["polygon"]}
        self.lines = {row["token"]: row["node_tokens"] for row in layers["line"]}
        self.arclines: Mapping[str, Any] = _mapping(layers["arcline_path_3"])
        self.connectivity: Mapping[str, Any] = _mapping(layers["connectivity"])

    def road_map(self, location: str) -> RoadMap:
        layers = self.layers
        width, height = layers["canvas_edge"]
        surfaces = {field: self._surfaces(layers[layer]) for field, layer in _POLYGON_LAYERS.items()}
        road_blocks = self._surfaces(layers.get("road_block", ()))
        lanes = {lane.identifier: lane for lane in self._lanes()}
        intersections = {row["token"] for row in layers["road_segment"] if row["is_intersection"]}
        dividers = (*self._dividers("lane_divider"), *self._dividers("road_divider"))
        return RoadMap(
            location=location,
            drivable_area=self._drivable_area(surfaces),
            lanes=lanes,
            dividers=dividers,
            intersections=frozenset(intersections & set(surfaces["road_segments"])),
            canvas_m=(float(width), float(height)),
            road_blocks=road_blocks,
            stop_line_types={
                row["token"]: str(row["stop_line_type"]) for row in layers["stop_line"] if row.get("stop_line_type")
            },
            **surfaces,
        )

    def _drivable_area(self, surfaces: Mapping[str, Mapping[str, Polygon]]) -> MultiPolygon:
        parts = [self._polygon(token) for row in self.layers["drivable_area"] for token in row["polygon_tokens"]]
        if not parts:
            lanes = self._surfaces(self.layers["lane"])
            parts = [*surfaces["road_segments"].values(), *lanes.values(), *surfaces["carparks"].values()]
        return as_multipolygon(shapely.union_all(parts))

    def _surfaces(self, rows: Iterable[Row]) -> dict[str, Polygon]:
        polygons = {row["token"]: self._polygon(row["polygon_token"]) for row in rows if row.get("polygon_token")}
        return {token: shape for token, shape in polygons.items() if not shape.is_empty}

    def _polygon(self, token: str) -> Polygon:
        row = self.polygons[token]
        exterior = self._points(row["exterior_node_tokens"])
        holes = [self._points(hole["node_tokens"]) for hole in row["holes"]]
        if len(exterior) < 3:
            return Polygon()
        return mend_polygon(Polygon(exterior, [hole for hole in holes if len(hole) >= 3]))

    def _points(self, tokens: Sequence[str]) -> Floats:
        return np.array([self.nodes[token] for token in tokens], dtype=np.float64).reshape(-1, 2)

    def _lanes(self) -> Iterable[Lane]:
        for layer in ("lane", "lane_connector"):
            for row in self.layers[layer]:
                token = row["token"]
                if not self.arclines.get(token):
                    continue
                polygon = self._polygon(row["polygon_token"]) if row.get("polygon_token") else None
                links = self.connectivity.get(token, {"incoming": (), "outgoing": ()})
                yield Lane(
                    identifier=token,
                    centerline=compute_centerline(self.arclines[token]),
                    polygon=None if polygon is None or polygon.is_empty else polygon,
                    successors=tuple(links["outgoing"]),
                    predecessors=tuple(links["incoming"]),
                    is_connector=layer == "lane_connector",
                )

    def _dividers(self, layer: str) -> Iterable[Divider]:
        for row in self.layers[layer]:
            line = self._points(self.lines[row["line_token"]])
            if len(line) < 2 or LineString(line).length == 0.0:
                continue
            between_directions = layer == "road_divider"
            yield Divider(row["token"], line, _kind(row, between_directions), between_directions)


def compute_centerline(arcline_paths: Sequence[Row]) -> Floats:
    """(M, 2) points, metres, of a lane's ``arcline_path_3`` records by the devkit's discretisation, about 1 m apart.

    Points are not repeated. Paths without length raise `ValueError`.
    """
    discretize_lane = import_devkit_module("nuscenes.map_expansion.arcline_path_utils").discretize_lane
    points = np.array(discretize_lane(list(arcline_paths), CENTERLINE_STEP_M), dtype=np.float64)[:, :2]
    moved = np.concatenate([[True], np.hypot(*np.diff(points, axis=0).T) > 1e-6])
    if moved.sum() < 2:
        raise ValueError("an arc-line path has no length")
    return np.asarray(points[moved])


def _mapping(value: Any) -> Mapping[str, Any]:
    """A layer that is an object by token; writers that have nothing to say leave an empty list instead."""
    return value if isinstance(value, dict) else {}


def _kind(row: Row, between_directions: bool) -> DividerKind:
    """Paint of most of a divider's segments; road dividers carry none in nuScenes and are solid yellow there."""
    types = Counter(str(segment["segment_type"]) for segment in row.get("lane_divider_segments", ()))
    if not types:
        return DividerKind.SOLID_YELLOW if between_directions else DividerKind.DASHED_WHITE
    name = max(sorted(types), key=lambda kind: types[kind])
    if name in ("NIL", ""):
        return DividerKind.UNPAINTED
    dashed, yellow = "DASHED" in name, "YELLOW" in name
    if yellow:
        return DividerKind.DASHED_YELLOW if dashed else DividerKind.SOLID_YELLOW
    return DividerKind.DASHED_WHITE if dashed else DividerKind.SOLID_WHITE
