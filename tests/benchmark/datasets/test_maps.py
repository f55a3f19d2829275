import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely

from benchmark.datasets.fingerprint import compute_fingerprint
from benchmark.datasets.map_layers import compute_centerline, find_expansion_file, read_road_map
from benchmark.datasets.nuscenes import MAP_MARGIN_M, NuScenesData
from benchmark.errors import InputError
from benchmark.road_map import DividerKind
from benchmark.untrusted.files import TABLE
from tests.benchmark.datasets.nuscenes_tables import TinyRoot
from tests.benchmark.untrusted.variants import write_sparse
from tests.hand_made import scene_on_straight_road

SHARED = Path(__file__).resolve().parents[4] / "shared"
LAYERS = (
    "polygon", "line", "node", "drivable_area", "road_segment", "road_block", "lane", "ped_crossing", "walkway",
    "stop_line", "carpark_area", "road_divider", "lane_divider", "traffic_light", "lane_connector",
)  # fmt: skip


class Expansion:
    """A map expansion put together by hand."""

    def __init__(self) -> None:
        self.layers: dict[str, Any] = {layer: [] for layer in LAYERS}
        self.layers |= {
            "version": "1.3", "canvas_edge": [500.0, 300.0], "arcline_path_3": {}, "connectivity": {},
        }  # fmt: skip

    def nodes(self, points: list[tuple[float, float]]) -> list[str]:
        start = len(self.layers["node"])
        self.layers["node"] += [{"token": f"n{start + i}", "x": x, "y": y} for i, (x, y) in enumerate(points)]
        return [f"n{start + i}" for i in range(len(points))]

    def polygon(self, name: str, *, hole: list[tuple[float, float]] | None = None, box: tuple[float, ...]) -> str:
        x0, y0, x1, y1 = box
        exterior = self.nodes([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])
        holes = [{"node_tokens": self.nodes(hole)}] if hole else []
        self.layers["polygon"].append({"token": f"p-{name}", "exterior_node_tokens": exterior, "holes": holes})
        return f"p-{name}"

    def surface(self, layer: str, name: str, box: tuple[float, ...], **fields: Any) -> None:
        self.layers[layer].append({"token": name, "polygon_token": self.polygon(name, box=box), **fields})

    def divider(self, layer: str, name: str, segments: list[str] | None = None) -> None:
        tokens = self.nodes([(0.0, 105.0), (50.0, 105.0), (100.0, 105.0)])
        self.layers["line"].append({"token": f"l-{name}", "node_tokens": tokens})
        row: dict[str, Any] = {"token": name, "line_token": f"l-{name}"}
        if segments is not None:
            row["lane_divider_segments"] = [
                {"node_token": token, "segment_type": kind} for token, kind in zip(tokens, segments)
            ]
        self.layers[layer].append(row)

    def write(self, path: Path) -> Path:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(self.layers))
        return path


def straight(x: float, y: float, length: float) -> list[dict[str, Any]]:
    return [{
        "start_pose": [x, y, 0.0], "end_pose": [x + length, y, 0.0], "shape": "LSR", "radius": 999.999,
        "segment_length": [0.0, length, 0.0],
    }]  # fmt: skip


def crossroads() -> Expansion:
    made = Expansion()
    hole = [(40.0, 102.0), (60.0, 102.0), (60.0, 108.0), (40.0, 108.0)]
    area = made.polygon("area", box=(0.0, 100.0, 400.0, 110.0), hole=hole)
    made.layers["drivable_area"] = [{"token": "area", "polygon_tokens": [area]}]
    made.surface("lane", "east", (0.0, 100.0, 100.0, 105.0), lane_type="CAR")
    made.surface("lane", "unknown-centre", (0.0, 105.0, 100.0, 110.0), lane_type="CAR")
    made.layers["lane_connector"].append({"token": "across"})
    made.layers["arcline_path_3"] = {"east": straight(0, 102.5, 100), "across": straight(100, 102.5, 20)}
    made.layers["connectivity"] = {
        "east": {"incoming": [], "outgoing": ["across"]}, "across": {"incoming": ["east"], "outgoing": []},
    }  # fmt: skip
    made.surface("road_segment", "junction", (100.0, 100.0, 120.0, 110.0), is_intersection=True)
    made.surface("road_segment", "road", (0.0, 100.0, 100.0, 110.0), is_intersection=False)
    made.surface("ped_crossing", "zebra", (90.0, 100.0, 94.0, 110.0))
    made.surface("walkway", "pavement", (0.0, 110.0, 100.0, 112.0))
    made.surface("stop_line", "stop", (94.0, 100.0, 96.0, 105.0), stop_line_type="TRAFFIC_LIGHT")
    made.surface("carpark_area", "park", (0.0, 80.0, 20.0, 95.0))
    made.divider("lane_divider", "dashed", ["DASHED_WHITE", "DASHED_WHITE", "SINGLE_SOLID_WHITE"])
    made.divider("lane_divider", "solid", ["DOUBLE_SOLID_WHITE"] * 3)
    made.divider("lane_divider", "nothing", ["NIL"] * 3)
    made.divider("road_divider", "middle")
    return made


def test_every_layer_is_read(tmp_path: Path) -> None:
    road_map = read_road_map(crossroads().write(tmp_path / "boston-seaport.json"))
    assert road_map.location == "boston-seaport" and road_map.canvas_m == (500.0, 300.0)
    assert road_map.drivable_area.area == pytest.approx(4000 - 120)
    places = np.array([[50.0, 105.0], [50.0, 101.0], [50.0, 120.0]])
    assert road_map.is_drivable(places).tolist() == [False, True, False]
    assert set(road_map.lanes) == {"east", "across"}
    east, across = road_map.lanes["east"], road_map.lanes["across"]
    assert east.successors == ("across",) and across.predecessors == ("east",)
    assert across.is_connector and across.polygon is None and east.polygon is not None
    assert np.allclose(east.centerline[[0, -1]], [[0, 102.5], [100, 102.5]])
    assert np.linalg.norm(np.diff(east.centerline, axis=0), axis=1).max() <= 1.01
    kinds = {line.identifier: (line.kind, line.between_directions) for line in road_map.dividers}
    assert kinds == {
        "dashed": (DividerKind.DASHED_WHITE, False),
        "solid": (DividerKind.SOLID_WHITE, False),
        "nothing": (DividerKind.UNPAINTED, False),
        "middle": (DividerKind.SOLID_YELLOW, True),
    }
    assert road_map.intersections == {"junction"} and set(road_map.road_segments) == {"junction", "road"}
    areas = {"ped_crossings": "zebra", "walkways": "pavement", "stop_lines": "stop", "carparks": "park"}
    assert all(set(getattr(road_map, layer)) == {name} for layer, name in areas.items())
    assert road_map.stop_line_types == {"stop": "TRAFFIC_LIGHT"}


def test_an_arc_turns_as_far_as_it_says() -> None:
    quarter = {
        "start_pose": [0.0, 0.0, 0.0], "end_pose": [10.0, 10.0, np.pi / 2], "shape": "LSL", "radius": 10.0,
        "segment_length": [5 * np.pi, 0.0, 0.0],
    }  # fmt: skip
    line = compute_centerline([quarter])
    assert np.allclose(line[-1], [10.0, 10.0], atol=0.02)
    assert np.allclose(np.hypot(line[:, 0], line[:, 1] - 10.0), 10.0, atol=0.02)


def test_without_a_drivable_area_layer_the_roads_make_it_up(tmp_path: Path) -> None:
    made = crossroads()
    made.layers["drivable_area"] = []
    road_map = read_road_map(made.write(tmp_path / "m.json"))
    assert road_map.drivable_area.area == pytest.approx(120 * 10 + 300)


@pytest.mark.parametrize(
    ("layer", "value", "message"),
    [
        ("version", "1.2", "map version 1.2; version 1.3 or later"),
        ("version", None, "map version None"),
        ("node", [{"token": "a", "x": "1.0", "y": 2.0}], 'x of node 0 is "1.0", it must be a number'),
        ("node", [{"token": "a", "x": 1.0, "y": float("nan")}], "y of node 0 is NaN, it must be a number"),
        ("node", [{"token": "a", "x": 10**400, "y": 2.0}], "x of node 0 is 1"),
        ("node", {"a": [1.0, 2.0]}, "must hold a list of objects, each a node"),
        ("arcline_path_3", {"lane": [{"start_pose": [0, 0]}]}, 'path of lane "lane" 0 is .0, 0., it must be three'),
        ("node", [], "record 'n[0-9]+' is missing"),
        ("polygon", None, "a list of objects, each a polygon record"),
        ("canvas_edge", 3, "not a well-formed map expansion"),
        ("lane_divider", [{"token": "x", "line_token": "gone"}], "record 'gone' is missing"),
        ("lane_divider", [{"token": "x", "line_token": "x" * 1000}], "record 'x{1,200}.{0,20} is missing"),
        ("walkway", [{"token": True, "polygon_token": ""}], "token of walkway record 0 is true"),
        ("connectivity", {"lane": {"incoming": [1e300], "outgoing": []}}, "incoming of link of lane"),
    ],
)
def test_a_broken_expansion_is_refused(tmp_path: Path, layer: str, value: Any, message: str) -> None:
    made = crossroads()
    made.layers[layer] = value
    with pytest.raises(InputError, match=message):
        read_road_map(made.write(tmp_path / "m.json"))


def test_an_expansion_that_lacks_a_layer_or_its_end_is_refused(tmp_path: Path) -> None:
    made = crossroads()
    del made.layers["walkway"]
    path = made.write(tmp_path / "m.json")
    with pytest.raises(InputError, match="'walkway' is missing"):
        read_road_map(path)
    path.write_text(path.read_text()[:-9])
    with pytest.raises(InputError, match="not valid JSON"):
        read_road_map(path)


def test_a_scene_gets_the_map_around_its_path(tmp_path: Path) -> None:
    scene = scene_on_straight_road(ego_y=102.5, seconds=4.0)
    root = TinyRoot.of(tmp_path, [scene]).write()
    data = NuScenesData.open(root)
    assert not data.has_map("scene-9901") and data.scene("scene-9901").road_map.drivable_area.is_empty
    crossroads().write(root / "maps" / "expansion" / "boston-seaport.json")
    data = NuScenesData.open(root)
    assert data.has_map("scene-9901")
    road_map = data.scene("scene-9901").road_map
    last = data.scene("scene-9901").ego.position[-1, 0]
    assert road_map.drivable_area.bounds[2] == pytest.approx(last + MAP_MARGIN_M)
    assert set(road_map.lanes) == {"east", "across"}


def test_a_location_is_no_path(tmp_path: Path) -> None:
    (tmp_path / "maps" / "expansion").mkdir(parents=True)
    (tmp_path / "maps" / "x.json").write_text("{}")
    assert find_expansion_file(tmp_path, "../x") is None


@pytest.mark.skipif(not SHARED.is_dir(), reason="no shared material beside the repository")
def test_a_strangers_expansion_is_read(tmp_path: Path) -> None:
    folder = SHARED / "data" / "nuscenes" / "maps" / "drivearena_map_expansion_format"
    path = tmp_path / "boston-thomaspark.json"
    path.write_bytes(gzip.decompress((folder / "boston-thomaspark.json.gz").read_bytes()))
    road_map = read_road_map(path)
    assert road_map.drivable_area.area > 10_000 and road_map.drivable_area.is_valid
    assert len(road_map.intersections) > 10 and len(road_map.dividers) > 50 and not road_map.lanes
    assert all(isinstance(shape, shapely.Polygon) for shape in road_map.road_segments.values())


@pytest.mark.parametrize("lengths", [[1e15, 0.0, 0.0], [-1.0, 0.0, 0.0], [float("inf"), 0.0, 0.0], [1.0]])
def test_a_lane_of_no_possible_length_is_refused_at_once(tmp_path: Path, lengths: list[float]) -> None:
    made = crossroads()
    next(iter(made.layers["arcline_path_3"].values()))[0]["segment_length"] = lengths
    with pytest.raises(InputError, match=r"segment_length of path of lane .* 0 is .*, it must be three lengths"):
        read_road_map(made.write(tmp_path / "m.json"))


def test_a_map_of_nowhere_that_is_longer_than_any_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "maps" / "expansion" / "atlantis.json"
    path.parent.mkdir(parents=True)
    path.write_text("{}")
    known = compute_fingerprint(tmp_path, "v1.0-mini", ())
    path.write_text("[]")
    assert compute_fingerprint(tmp_path, "v1.0-mini", ()) != known
    path.unlink()
    write_sparse(path, TABLE.file_bytes + 1)
    with pytest.raises(InputError, match=r"atlantis\.json"):
        compute_fingerprint(tmp_path, "v1.0-mini", ())
