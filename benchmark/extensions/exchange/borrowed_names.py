"""Export of roots in nuScenes format whose scenes have names of nuScenes' validation split.

Some readers (py123d, trajdata) know no other scenes than nuScenes' own: they leave others out without a word, or fail.
"""

import csv
import io
import shutil
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.constants import CAMERA_NAMES, LIDAR_NAME, NUSCENES_TABLES, OFFICIAL_LOCATIONS
from benchmark.datasets.cached_tables import read_tables_cached
from benchmark.datasets.can_bus import move_messages
from benchmark.datasets.devkit_import import import_devkit_module
from benchmark.datasets.map_layers import find_expansion_file
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.roots import DataSet
from benchmark.datasets.scene_names import NUMBERED, PROVENANCE, SHIFT_US, find_can_bus_file, find_shift_us
from benchmark.datasets.scene_tables import GROWING_TABLES, SceneTables
from benchmark.datasets.schema import FaultList
from benchmark.datasets.split_names import BORROWED_NAMES, compute_shifts_us
from benchmark.datasets.tables import Row, find_variant_folders
from benchmark.errors import InputError
from benchmark.machine.storage import canonical_json, lock_folder, read_json, write_bytes, write_json, writing_to
from benchmark.untrusted.files import to_one_line

NAMES_FILE: Final = "borrowed_names.csv"
"""Table in the root that says which scene is which."""
VERSION_FOLDER: Final = "v1.0-trainval"
"""Where readers look for validation scenes."""
_TIMED: Final = ("sample", "sample_data", "ego_pose")
_CAN_MESSAGES: Final = (
    "meta", "ms_imu", "pose", "route", "steeranglefeedback", "vehicle_monitor", "zoe_veh_info", "zoesensors",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class BorrowedName:
    """A scene of an export, called ``scene``, and its name in the data set; its times are moved by ``shift_us``."""

    scene: str
    name: str
    source_scene: str
    shift_us: int


@dataclass(frozen=True, slots=True)
class BorrowedRoot:
    """A root to write or written.

    Attributes:
        folder: The root.
        names: Its scenes, sorted.
        stand_in_maps: Cities without a scene and without a map, and the city whose map is theirs here.
        cities_without_lanes: Cities with scenes whose map has no lane, or that have none.
    """

    folder: Path
    names: tuple[BorrowedName, ...]
    stand_in_maps: Mapping[str, str]
    cities_without_lanes: tuple[str, ...]


def export_nuscenes(data: DataSet, names: Sequence[str], to: Path) -> tuple[BorrowedRoot, ...]:
    """Write a root whose scenes have official validation names, marked as such in its ``challenger.json``.

    Tables and CAN bus are written anew, with times moved where scenes overlap (`compute_shifts_us`); images and maps
    are links to those of the data set. Either everything is written or nothing.

    Args:
        data: The data set; of a folder of variant roots each becomes a root in a folder of its name.
        names: Names of the scenes to export.
        to: Folder of the root, new, empty, or with the same export.

    Returns:
        The roots.

    Raises:
        InputError: If there is no scene or more than nuScenes has names for; if one lies in none of its cities or lacks
            a camera or the lidar; if the data set is such an export, or is broken; if the folder holds something else
            or cannot be written.
    """
    if not names:
        raise InputError("there is no scene to export; name one with --scenes, or leave --scenes and --limit out")
    to = to.resolve()
    exports = [_RootExport(root, chosen, folder) for root, chosen, folder in _list_roots(data, names, to)]
    if to.is_dir() and any(to.iterdir()):
        if not all(export.is_written() for export in exports):
            raise InputError(f"{to} is not empty and holds another export or something else; choose an empty --to")
        return tuple(export.root for export in exports)
    beside = to.with_name(f".{to.name}.part")
    with lock_folder(beside), writing_to(to):
        try:
            # Left by a killed process.
            for left in beside.iterdir():
                shutil.rmtree(left) if left.is_dir() else left.unlink()
            for export in exports:
                export.write(beside / export.root.folder.relative_to(to))
            beside.rename(to)
        except BaseException:
            shutil.rmtree(beside, ignore_errors=True)
            raise
    return tuple(export.root for export in exports)


def _list_roots(data: DataSet, names: Sequence[str], to: Path) -> list[tuple[DataSet, list[str], Path]]:
    variants = find_variant_folders(data.root)
    if not variants:
        return [(data, list(names), to)]
    by_variant = {
        folder: [name.partition("/")[2] for name in names if name.startswith(f"{folder}/")] for folder in variants
    }
    return [
        (NuScenesData.open(data.root / folder, version=data.version), chosen, to / folder)
        for folder, chosen in by_variant.items()
        if chosen
    ]


class _RootExport:
    """One root: everything is decided, and what cannot be is refused, before anything is written."""

    def __init__(self, data: DataSet, names: Sequence[str], folder: Path) -> None:
        self._data, self._made = data, data.provenance() or {}
        if self._made.get("split") == BORROWED_NAMES:
            raise InputError(f"{data.root} is such an export; choose the data set that it was exported from")
        tables = read_tables_cached(data.root / data.version, FaultList())
        if tables is None:
            # Strings hash differently in each process.
            raise InputError(f"two tokens of {data.root} collided by chance; run the same command again")
        self._tables: SceneTables = tables
        wanted, self._facts = set(names), data.scene_facts(names)
        self._scenes = [row for row in tables.shared["scene"] if row["name"] in wanted]
        self._logs = {row["token"]: row for row in tables.shared["log"]}
        cities = self._find_cities()
        lanes = {city: _has_lanes(find_expansion_file(data.root, city)) for city in OFFICIAL_LOCATIONS}
        with_lanes = sorted(city for city in cities if lanes[city])
        stand_ins = [city for city in OFFICIAL_LOCATIONS if city not in cities and not lanes[city]]
        self.root = BorrowedRoot(
            folder,
            self._borrow_names(),
            {city: with_lanes[0] for city in stand_ins if with_lanes},
            tuple(sorted(city for city in cities if not lanes[city])),
        )

    def is_written(self) -> bool:
        """Whether the folder holds this very export."""
        mark = self.root.folder / VERSION_FOLDER / PROVENANCE
        return mark.is_file() and read_json(mark) == self._build_provenance()

    def write(self, folder: Path) -> None:
        """Write all of it to a folder."""
        for row in self._scenes:
            # Draws what is drawn when it is looked at.
            self._data.videos(row["name"], sweeps=False)
        self._write_tables(folder / VERSION_FOLDER)
        self._write_links(folder)
        # The devkit's reader refuses a root without this folder.
        (folder / "can_bus").mkdir(parents=True)
        for scene in self.root.names:
            self._write_can_bus(folder / "can_bus", scene)
        text = io.StringIO(newline="")
        table = csv.writer(text, lineterminator="\n")
        table.writerow(BorrowedName.__dataclass_fields__)
        table.writerows((scene.scene, scene.name, scene.source_scene, scene.shift_us) for scene in self.root.names)
        write_bytes(folder / NAMES_FILE, text.getvalue().encode())
        write_json(folder / VERSION_FOLDER / PROVENANCE, self._build_provenance())

    def _find_cities(self) -> set[str]:
        cities = set()
        for row in self._scenes:
            city = str(self._logs[row["log_token"]]["location"])
            if city not in OFFICIAL_LOCATIONS:
                raise InputError(
                    f"{row['name']} lies in {to_one_line(city, 80)}, and such readers know only "
                    f"{', '.join(OFFICIAL_LOCATIONS)}; leave the scene out with --scenes or --split"
                )
            cities.add(city)
        return cities

    def _borrow_names(self) -> tuple[BorrowedName, ...]:
        """Scenes that are called so already keep their names; others get the next free one, in the order of names."""
        known = sorted(import_devkit_module("nuscenes.utils.splits").create_splits_scenes()["val"])
        own = sorted(row["name"] for row in self._scenes)
        if len(own) > len(known):
            raise InputError(
                f"{self._data.root} has {len(own)} scenes to export, and nuScenes' validation split has names for "
                f"{len(known)}; choose fewer with --split, --scenes or --limit"
            )
        free = iter([name for name in known if name not in set(own)])
        borrowed = {name: name if name in known else next(free) for name in own}
        shifts = compute_shifts_us([(row["name"], *self._find_span(row)) for row in self._scenes])
        names = (BorrowedName(borrowed[name], name, self._facts[name].source, shifts.get(name, 0)) for name in own)
        return tuple(sorted(names, key=lambda scene: scene.scene))

    def _find_span(self, scene: Row) -> tuple[int, int]:
        numbers = self._tables.numbers_of_scene("sample", scene["token"])
        times = [row["timestamp"] for row in self._tables.stored["sample"].read(np.array(numbers, np.int64))]
        return min(times), max(times)

    def _build_provenance(self) -> dict[str, Any]:
        """The mark, and what the data set's own file says of its scenes, under their borrowed names."""
        reports = self._made.get("scenes", {})
        return {
            "schema": 1,
            "split": BORROWED_NAMES,
            "source": {"name": self._data.name, "fingerprint": self._data.fingerprint()},
            "renderer": self._made.get("renderer"),
            "stand_in_maps": dict(self.root.stand_in_maps),
            "scenes": {
                scene.scene: {
                    **({"adversaries": []} if self._facts[scene.name].adversaries == 0 else {}),
                    **{key: value for key, value in reports.get(scene.name, {}).items() if key != NUMBERED},
                    "source_scene": scene.source_scene,
                    "exported_from": scene.name,
                    SHIFT_US: find_shift_us(self._made, scene.name) + scene.shift_us,
                }
                for scene in self.root.names
            },
        }

    def _write_tables(self, folder: Path) -> None:
        by_name = {scene.name: scene for scene in self.root.names}
        lines: dict[str, dict[str, str]] = {table: {} for table in NUSCENES_TABLES}
        mounts: set[str] = set()
        for row in self._scenes:
            scene = by_name[row["name"]]
            lines["scene"][row["token"]] = canonical_json({"description": "", **row, "name": scene.scene})
            rows = self._tables.of_scene(row["token"])
            self._require_sensors(row, rows)
            mounts |= {data_row["calibrated_sensor_token"] for data_row in rows["sample_data"]}
            for table in GROWING_TABLES:
                for part in rows[table]:
                    if table in _TIMED:
                        part["timestamp"] += scene.shift_us
                    lines[table][part["token"]] = canonical_json(part)
        for table, kept in self._select_shared(mounts).items():
            lines[table] = {row["token"]: canonical_json(row) for row in kept}
        for table, texts in lines.items():
            write_bytes(folder / f"{table}.json", ("[\n" + ",\n".join(texts.values()) + "\n]\n").encode())

    def _require_sensors(self, scene: Row, rows: Mapping[str, Sequence[Row]]) -> None:
        """Refuse scenes on which such readers fail: they take poses from a camera or the lidar."""
        sensors = {row["token"]: row["channel"] for row in rows["sensor"]}
        channels = {row["token"]: sensors[row["sensor_token"]] for row in rows["calibrated_sensor"]}
        seen = Counter(channels[row["calibrated_sensor_token"]] for row in rows["sample_data"] if row["is_key_frame"])
        for name in (*CAMERA_NAMES, LIDAR_NAME):
            if seen[name] < len(rows["sample"]):
                lacking = len(rows["sample"]) - seen[name]
                raise InputError(
                    f"{scene['name']} has no {name} at {lacking} of its samples, on which such readers fail; build the "
                    "data set with images (--renderer schematic or magicdrive)"
                )

    def _select_shared(self, mounts: Collection[str]) -> dict[str, list[Row]]:
        """Rows of the tables that do not grow, less those of other scenes."""
        shared, logs = dict(self._tables.shared), {row["log_token"] for row in self._scenes}
        del shared["scene"]
        shared["log"] = [row for row in shared["log"] if row["token"] in logs]
        shared["calibrated_sensor"] = [row for row in shared["calibrated_sensor"] if row["token"] in mounts]
        shared["map"] = [
            {**row, "log_tokens": [token for token in row["log_tokens"] if token in logs]} for row in shared["map"]
        ]
        return shared

    def _write_links(self, folder: Path) -> None:
        """Link folders of images, and what lies below ``maps``; cities that no scene lies in get a map with lanes."""
        root = self._data.root.resolve()
        links = {name: root / name for name in ("samples", "sweeps")}
        links |= {f"maps/{path.name}": path for path in (root / "maps").glob("*") if path.name != "expansion"}
        links |= {f"maps/expansion/{path.name}": path for path in (root / "maps" / "expansion").glob("*")}
        expansion = {city: f"maps/expansion/{city}.json" for city in OFFICIAL_LOCATIONS}
        links |= {expansion[city]: root / expansion[other] for city, other in self.root.stand_in_maps.items()}
        for name, target in links.items():
            if target.exists():
                (folder / name).parent.mkdir(parents=True, exist_ok=True)
                (folder / name).symlink_to(target.resolve())

    def _write_can_bus(self, folder: Path, scene: BorrowedName) -> None:
        for message in _CAN_MESSAGES:
            path = find_can_bus_file(self._data.root, scene.name, message)
            if not path.is_file():
                continue
            content = read_json(path)
            move_messages(content, scene.shift_us)
            try:
                write_json(folder / f"{scene.scene}_{message}.json", content, indent=None)
            except ValueError as error:
                raise InputError(f"{path} has a number that is not finite; fetch or make it again") from error


def _has_lanes(path: Path | None) -> bool:
    layers = None if path is None else read_json(path)
    return isinstance(layers, dict) and bool(layers.get("lane"))
