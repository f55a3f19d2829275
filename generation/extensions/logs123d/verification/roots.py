"""The root made of a log, against py123d's reading of the log and against the tables that it was made of."""

import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from benchmark.constants import CAMERA_NAMES
from benchmark.datasets.map_layers import read_road_map
from benchmark.machine.storage import read_json
from benchmark.road_map import RoadMap
from benchmark.untrusted.compressed import unpack_archive
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder
from generation.extensions.logs123d.importing import ImportedLog, LogImport, import_123d
from generation.extensions.logs123d.labels import find_category
from generation.extensions.logs123d.log_files import EGO, read_log
from generation.extensions.logs123d.log_scene import EgoBody
from generation.extensions.logs123d.poses import compose, invert, shift
from generation.extensions.logs123d.verification.logs import EXPECTED, close, close_poses, find_folder
from generation.sources.importing import VERSION_FOLDER

Row = dict[str, Any]
_TOKEN_DIGITS = 32


class RootTables:
    """Tables of a small root, by token."""

    def __init__(self, root: Path) -> None:
        self.root = root
        folder = root / VERSION_FOLDER
        self.rows: dict[str, list[Row]] = {path.stem: read_json(path) for path in folder.glob("*.json")}
        tables = ("sample", "ego_pose", "calibrated_sensor", "sensor", "instance", "category")
        self.by_token = {name: {row["token"]: row for row in self.rows[name]} for name in tables}

    def get(self, table: str, token: str) -> Row:
        """One row."""
        return self.by_token[table][token]

    def sensor_rows(self, channel: str) -> list[tuple[int, int, bool, Any, Any]]:
        """Of each row of a sensor, in time: time, time of its sample, whether it is a key frame's, ego, place on it."""
        found = []
        for row in self.rows["sample_data"]:
            mount = self.get("calibrated_sensor", row["calibrated_sensor_token"])
            if self.get("sensor", mount["sensor_token"])["channel"] == channel:
                ego = self.get("ego_pose", row["ego_pose_token"])
                poses = [np.array([*one["translation"], *one["rotation"]]) for one in (ego, mount)]
                at_us = self.get("sample", row["sample_token"])["timestamp"]
                found.append((row["timestamp"], at_us, bool(row["is_key_frame"]), *poses))
        return sorted(found, key=lambda one: one[0])

    def annotations(self) -> dict[tuple[int, str], Row]:
        """Annotations by time and instance, with the name of their category."""
        found = {}
        for row in self.rows["sample_annotation"]:
            instance = self.get("instance", row["instance_token"])
            named = {**row, "category": self.get("category", instance["category_token"])["name"]}
            found[self.get("sample", row["sample_token"])["timestamp"], row["instance_token"]] = named
        return found

    def road_map(self) -> RoadMap:
        """The map of the place of its first log."""
        return read_road_map(self.root / "maps" / "expansion" / f"{self.rows['log'][0]['location']}.json")


def compare_roots(comparison: Comparison, golden: GoldenFolder) -> None:
    """Samples, poses of every sensor, annotations and drivable area of the root of each log."""
    for title, expected in sorted(golden.facts(EXPECTED)["logs"].items()):
        comparison.where = title
        with tempfile.TemporaryDirectory() as folder:
            imported, tables = _import(golden, title, Path(folder))
            _compare_root(comparison, golden, imported, tables, title, expected)


def _import(golden: GoldenFolder, title: str, root: Path) -> tuple[ImportedLog, RootTables]:
    settings = LogImport(golden.path / "maps", golden.path / "sensors" / "nuscenes")
    (imported,) = import_123d(find_folder(golden, title), root, settings)
    return imported, RootTables(root)


def _compare_root(
    comparison: Comparison,
    golden: GoldenFolder,
    imported: ImportedLog,
    tables: RootTables,
    title: str,
    expected: Mapping[str, Any],
) -> None:
    frames, moved, later = expected["frames"], np.array(imported.facts["moved_m"]), imported.facts["later_us"]
    key_frames = [frames[number] for number in expected["keyframes_2hz"]]
    samples = sorted(row["timestamp"] for row in tables.rows["sample"])
    comparison.same("root: samples", samples, [frame["timestamp_us"] + later for frame in key_frames])
    body = EgoBody.of(read_log(find_folder(golden, title)).others[EGO])
    lidar = tables.sensor_rows("LIDAR_TOP")
    comparison.same("root: frames", [row[0] for row in lidar], [frame["timestamp_us"] + later for frame in frames])
    on_ground = compose(
        np.array([one["ego"]["rear_axle_se3"] for one in frames]), compose(invert(body.rear_axle), body.base)
    )
    close_poses(comparison, "root: ego", np.array([row[3] for row in lidar]), shift(on_ground, moved))
    for key, camera in expected["cameras"].items():
        rows = tables.sensor_rows(camera["name"])
        golden_rows = {
            frame["cameras"][key]["timestamp_us"] + later: frame["cameras"][key]["camera_to_global_se3"]
            for frame in frames
            if frame["cameras"][key] is not None
        }
        comparison.verdicts("root: images at the log's times", [row[0] not in golden_rows for row in rows])
        comparison.verdicts("root: an image of each camera a sample", [row[1] for row in rows if row[2]] != samples)
        ours = np.array([compose(row[3], row[4]) for row in rows])
        theirs = np.array([golden_rows.get(row[0], np.full(7, np.nan)) for row in rows])
        close_poses(comparison, "root: cameras", ours, shift(theirs, moved))
    _compare_annotations(comparison, tables, expected["label_class"], key_frames, moved, later)
    if expected["map"] is not None:
        area = golden.facts(EXPECTED)["maps"][expected["map"]]
        # Of nuScenes the layer itself: surfaces of connectors, which the union holds, are py123d's own.
        own = (
            area["layers"].get("GENERIC_DRIVABLE", {}).get("area") if expected["log"]["dataset"] == "nuscenes" else None
        )
        ratio = tables.road_map().drivable_area.area / (own or area["drivable_union_area"])
        comparison.numbers("root: drivable area, relative", ratio, 1.0)


def _compare_annotations(
    comparison: Comparison, tables: RootTables, label_class: str, key_frames: list[Any], moved: Any, later: int
) -> None:
    ours = tables.annotations()
    count = 0
    for frame in key_frames:
        wanted = [one for one in frame["boxes"]["items"] if _categorise(label_class, one) is not None]
        centres = np.array([one["center"] for one in wanted]).reshape(-1, 3) + moved
        count += len(wanted)
        here = [row for (at_us, _), row in ours.items() if at_us == frame["timestamp_us"] + later]
        comparison.verdicts("root: annotations a sample", len(here) != len(wanted))
        for row in here:
            one = wanted[int(np.linalg.norm(centres - row["translation"], axis=1).argmin())]
            close_poses(
                comparison,
                "root: annotations",
                np.array([*row["translation"], *row["rotation"]]),
                [*(one["center"] + moved), *one["rotation"]],
            )
            length, width, height = one["size_lwh"]
            close(comparison, "root: annotations: size", row["size"], [width, length, height])
            comparison.verdicts("root: categories", row["category"] != _categorise(label_class, one))
            points = 1 if one["points"] is None else one["points"]
            comparison.verdicts("root: points", row["num_lidar_pts"] != points)
    comparison.verdicts("root: number of annotations", len(ours) != count)


def _categorise(label_class: str, box: Mapping[str, Any]) -> str | None:
    return find_category(label_class, box["label"], box["default"], box["size_lwh"][0])


def compare_source(comparison: Comparison, golden: GoldenFolder) -> None:
    """NuScenes to 123D to here, against the tables that it was made of, where the set has them."""
    archive = golden.path / "source" / "tables.tar.xz"
    title = next((name for name in golden.facts(EXPECTED)["logs"] if name.startswith("nuscenes_")), None)
    if title is None or not archive.is_file():
        return
    comparison.where = title
    with tempfile.TemporaryDirectory() as folder:
        unpack_archive(archive, Path(folder) / "source")
        source = RootTables(Path(folder) / "source")
        _, ours = _import(golden, title, Path(folder) / "root")
        _compare_tables(comparison, ours, source)
        _compare_road_maps(comparison, ours.road_map(), source.road_map())


def _compare_tables(comparison: Comparison, ours: RootTables, source: RootTables) -> None:
    mine, theirs = ours.annotations(), source.annotations()
    comparison.verdicts("round trip: annotations", mine.keys() != theirs.keys())
    for key in sorted(mine.keys() & theirs.keys()):
        row, other = mine[key], theirs[key]
        comparison.verdicts("round trip: categories", row["category"] != other["category"])
        comparison.verdicts("round trip: points", row["num_lidar_pts"] != other["num_lidar_pts"])
        close(comparison, "round trip: sizes", row["size"], other["size"])
        poses = [np.array([*one["translation"], *one["rotation"]]) for one in (row, other)]
        close_poses(comparison, "round trip: boxes", *poses)
    for channel in ("LIDAR_TOP", *CAMERA_NAMES):
        rows = [[row for row in tables.sensor_rows(channel) if row[2]] for tables in (ours, source)]
        comparison.verdicts("round trip: times", [row[:2] for row in rows[0]] != [row[:2] for row in rows[1]])
        for what, place in (("ego", 3), ("sensors", 4)):
            close_poses(comparison, f"round trip: {what}", *(np.array([row[place] for row in of]) for of in rows))
    said = [{row["location"] for row in tables.rows["log"]} for tables in (ours, source)]
    comparison.verdicts("round trip: places", said[0] != said[1])


def _compare_road_maps(comparison: Comparison, ours: RoadMap, source: RoadMap) -> None:
    for layer in ("ped_crossings", "walkways", "carparks", "stop_lines"):
        areas = [sorted(shape.area for shape in getattr(one, layer).values()) for one in (ours, source)]
        comparison.verdicts(f"round trip: number of {layer}", len(areas[0]) != len(areas[1]))
        close(comparison, f"round trip: areas of {layer}", *areas)
    lanes = [[lane for lane in one.lanes.values() if not lane.is_connector] for one in (ours, source)]
    areas = [sorted(lane.polygon.area for lane in of if lane.polygon is not None) for of in lanes]
    close(comparison, "round trip: areas of lanes", *areas)
    connectors = [len(one.lanes) - len(of) for one, of in zip((ours, source), lanes)]
    comparison.verdicts("round trip: number of connectors", connectors[0] != connectors[1])
    # Links that lead out of the map are dropped on the way.
    links = [
        sorted(sum(other in one.lanes for other in lane.successors) for lane in one.lanes.values())
        for one in (ours, source)
    ]
    comparison.verdicts("round trip: links of lanes", links[0] != links[1])
    apart = shapely.symmetric_difference(ours.drivable_area, source.drivable_area).area
    comparison.numbers("round trip: drivable area, relative", 1.0 + apart / source.drivable_area.area, 1.0)
    holes = [sum(len(part.interiors) for part in one.drivable_area.geoms) for one in (ours, source)]
    comparison.verdicts("round trip: holes", holes[0] != holes[1])
