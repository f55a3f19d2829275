"""Maps as they are read here, against py123d's own reading of them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import shapely

from benchmark.errors import InputError
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder
from generation.extensions.logs123d.log_files import MapObject, read_map_objects
from generation.extensions.logs123d.road_maps import DRIVABLE_LAYERS, read_shape
from generation.extensions.logs123d.verification.logs import EXPECTED, close

_LAYERS: Final = (
    "LANE", "LANE_GROUP", "INTERSECTION", "CROSSWALK", "WALKWAY", "CARPARK", "GENERIC_DRIVABLE", "STOP_ZONE",
    "ROAD_EDGE", "ROAD_LINE", "SPEED_BUMP",
)  # fmt: skip
_TYPES: Final = {
    "LANE": ("lane_type", ("UNDEFINED", "FREEWAY", "SURFACE_STREET", "BIKE_LANE", "BUS_LANE")),
    "INTERSECTION": (
        "intersection_type",
        ("DEFAULT", "TRAFFIC_LIGHT", "STOP_SIGN", "LANE_BRANCH", "LANE_MERGE", "PASS_THROUGH", "UNKNOWN"),
    ),
    "STOP_ZONE": (
        "stop_zone_type",
        ("UNKNOWN", "TRAFFIC_LIGHT", "STOP_SIGN", "YIELD_SIGN", "PEDESTRIAN_CROSSING", "TURN_STOP"),
    ),
    "ROAD_EDGE": ("road_edge_type", ("UNKNOWN", "ROAD_EDGE_BOUNDARY", "ROAD_EDGE_MEDIAN")),
    "ROAD_LINE": (
        "road_line_type",
        (
            "NONE", "UNKNOWN", "DASH_SOLID_YELLOW", "DASH_SOLID_WHITE", "DASHED_WHITE", "DASHED_YELLOW",
            "DOUBLE_SOLID_YELLOW", "DOUBLE_SOLID_WHITE", "DOUBLE_DASH_YELLOW", "DOUBLE_DASH_WHITE", "SOLID_YELLOW",
            "SOLID_WHITE", "SOLID_DASH_WHITE", "SOLID_DASH_YELLOW", "SOLID_BLUE",
        ),
    ),
}  # fmt: skip
_LINKS: Final = {
    "LANE": {"group": "lane_group_id", "left": "left_lane_id", "right": "right_lane_id",
             "predecessors": "predecessor_ids", "successors": "successor_ids"},
    "LANE_GROUP": {"intersection": "intersection_id", "lanes": "lane_ids", "predecessors": "predecessor_ids",
                   "successors": "successor_ids"},
    "INTERSECTION": {"groups": "lane_group_ids"},
    "STOP_ZONE": {"lanes": "lane_ids"},
}  # fmt: skip
_LENGTHS: Final = {"length_3d": "centerline", "left_length_3d": "left_boundary", "right_length_3d": "right_boundary"}


def compare_maps(comparison: Comparison, golden: GoldenFolder) -> None:
    """Layers, shapes, types and links of every map."""
    for name, expected in sorted(golden.facts(EXPECTED)["maps"].items()):
        path = golden.path / name
        if ".." in Path(name).parts or not path.is_file():
            raise InputError(f"{golden.path} has no {name}, which {EXPECTED} names; get the set again")
        comparison.where = name
        metadata, objects = read_map_objects(path)
        comparison.verdicts(
            "map: metadata", [metadata.get(key) != value for key, value in expected["metadata"].items()]
        )
        layers = {layer: [one for one in objects if one.layer == place] for place, layer in enumerate(_LAYERS)}
        comparison.verdicts("map: layers", {layer for layer in layers if layers[layer]} != {*expected["layers"]})
        for layer, facts in expected["layers"].items():
            _compare_layer(comparison, path, layer, layers[layer], facts)
            of_group = {one.identifier: one.features for one in layers["LANE_GROUP"]}
            for one in layers[layer] if "objects" in facts else ():
                _compare_object(comparison, path, layer, one, facts["objects"][str(one.identifier)], of_group)
        union = shapely.union_all(
            [shapely.make_valid(read_shape(one, path)) for one in objects if one.layer in DRIVABLE_LAYERS]
        )
        comparison.numbers("map: drivable area, relative", union.area / expected["drivable_union_area"], 1.0)


def _compare_layer(
    comparison: Comparison, path: Path, layer: str, objects: Sequence[MapObject], facts: Mapping[str, Any]
) -> None:
    shapes = [read_shape(one, path) for one in objects]
    comparison.verdicts("map: number of objects", len(objects) != facts["count"])
    if layer in _TYPES and "types" in facts:
        counts = Counter(_name_type(layer, one) for one in objects)
        comparison.verdicts("map: types", dict(counts) != facts["types"])
    if "area" in facts:
        close(comparison, "map: areas", sum(shape.area for shape in shapes), facts["area"])
        rings = sum(len(part.interiors) for shape in shapes for part in shapely.get_parts(shape))
        comparison.verdicts("map: holes", rings != facts["interior_rings"])
        outlines = sum(_measure(one.features["outline"]) for one in objects)
        close(comparison, "map: outlines", outlines, facts["outline_length_3d"])
    if "length_2d" in facts:
        close(comparison, "map: lengths of lines", sum(shape.length for shape in shapes), facts["length_2d"])
    if "centerline_length_2d" in facts:
        lines = [one.features["centerline"] for one in objects]
        planar, spatial = sum(_measure(line[:, :2]) for line in lines), sum(_measure(line) for line in lines)
        close(comparison, "map: lengths of lanes", planar, facts["centerline_length_2d"])
        close(comparison, "map: lengths of lanes", spatial, facts["centerline_length_3d"])


def _compare_object(
    comparison: Comparison,
    path: Path,
    layer: str,
    found: MapObject,
    facts: Mapping[str, Any],
    of_group: Mapping[int, Mapping[str, Any]],
) -> None:
    features = found.features
    # Lists have no order.
    links = [_sort(features.get(ours)) != _sort(facts[name]) for name, ours in _LINKS[layer].items()]
    comparison.verdicts("map: links", links, where=f"{path}: {layer} {found.identifier}")
    if "type" in facts:
        comparison.verdicts("map: types", _name_type(layer, found) != facts["type"])
    if "area" in facts:
        close(comparison, "map: areas", read_shape(found, path).area, facts["area"])
    if layer != "LANE":
        return
    group = of_group.get(features["lane_group_id"], {})
    comparison.verdicts("map: in a junction", (group.get("intersection_id") is not None) != facts["in_intersection"])
    for name, ours in _LENGTHS.items():
        close(comparison, "map: lengths of lanes", _measure(features[ours]), facts[name])
    line = np.column_stack([features["centerline"], np.zeros(len(features["centerline"]))])[:, :3]
    close(comparison, "map: ends of lanes", line[[0, -1]], [facts["first"], facts["last"]])
    limit = features.get("speed_limit_mps")
    limit = None if limit is None or np.isnan(limit) else limit
    comparison.verdicts("map: speed limits", (limit is None) != (facts["speed_limit_mps"] is None))
    if limit is not None:
        close(comparison, "map: speed limits, m/s", limit, facts["speed_limit_mps"])


def _sort(links: Any) -> Any:
    return sorted(links) if isinstance(links, list) else links


def _name_type(layer: str, found: MapObject) -> str:
    name, words = _TYPES[layer]
    return words[int(found.features[name])]


def _measure(line: Any) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
