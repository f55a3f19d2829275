"""The rows of one scene as an exporter needs them: by token, in the order of the files, with their numbers there."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from benchmark.constants import LIDAR_NAME
from benchmark.datasets.cached_tables import read_tables_cached
from benchmark.datasets.scene_tables import SceneTables
from benchmark.datasets.schema import FaultList
from benchmark.datasets.tables import Row
from benchmark.errors import InputError
from benchmark.extensions.infos.frames import SensorFrame

ByToken = Mapping[str, Row]


@dataclass(frozen=True)
class SceneTableRows:
    """Rows of one scene, in the order of the files; numbers are those of rows in the whole tables.

    `channels` are by token of a calibrated sensor, `categories` by token of the instance.
    """

    scene: Row
    location: str
    samples: tuple[Row, ...]
    sample_numbers: tuple[int, ...]
    channels: Mapping[str, str]
    data: ByToken
    poses: ByToken
    mounts: ByToken
    annotations: ByToken
    instance_numbers: Mapping[str, int]
    categories: Mapping[str, str]
    category_numbers: Mapping[str, int]

    @property
    def name(self) -> str:
        """Name of the scene."""
        return str(self.scene["name"])

    @cached_property
    def samples_in_time_order(self) -> tuple[Row, ...]:
        """The samples as their chain goes."""
        by_token = {row["token"]: row for row in self.samples}
        chain, token = [], self.scene["first_sample_token"]
        while token:
            chain.append(by_token[token])
            token = by_token[token]["next"]
        return tuple(chain)

    @cached_property
    def key_frames(self) -> Mapping[str, Mapping[str, Row]]:
        """Rows of ``sample_data`` by token of the sample and channel."""
        frames: defaultdict[str, dict[str, Row]] = defaultdict(dict)
        for row in self.data.values():
            if row["is_key_frame"]:
                frames[row["sample_token"]][self.channels[row["calibrated_sensor_token"]]] = row
        return frames

    @cached_property
    def annotations_of(self) -> Mapping[str, list[Row]]:
        """Rows of ``sample_annotation`` by token of the sample, in the order of the file."""
        annotations: defaultdict[str, list[Row]] = defaultdict(list)
        for row in self.annotations.values():
            annotations[row["sample_token"]].append(row)
        return annotations

    def lidar(self, sample: Row) -> Row:
        """The lidar's row of ``sample_data`` at a sample; raises `InputError` where there is none."""
        lidar_row = self.key_frames[sample["token"]].get(LIDAR_NAME)
        if lidar_row is None:
            raise InputError(
                f"{self.name} has no {LIDAR_NAME}, whose frame info files use; write the data set with one (an "
                "empty file is enough)"
            )
        return lidar_row

    def frame(self, data: Row) -> SensorFrame:
        """Where the sensor of a row of ``sample_data`` is."""
        return SensorFrame.of(self.mounts[data["calibrated_sensor_token"]], self.poses[data["ego_pose_token"]])


class InfoTables:
    """Tables of a root, scene by scene; all 13 must be there. ``rates`` gets scenes without keyframes at 2 Hz."""

    def __init__(self, root: Path, version: str, rates: FaultList) -> None:
        tables = read_tables_cached(root / version, rates)
        if tables is None:
            # Strings hash differently in each process.
            raise InputError(f"two tokens of {root / version} collided by chance; run the same command again")
        self._tables: SceneTables = tables
        shared = tables.shared
        self._sensors = {row["token"]: row["channel"] for row in shared["sensor"]}
        self._logs = {row["token"]: row for row in shared["log"]}
        self._category_names = {row["token"]: row["name"] for row in shared["category"]}
        self.category_numbers = {row["name"]: number for number, row in enumerate(shared["category"])}

    @property
    def scenes(self) -> list[Row]:
        """Rows of the scenes."""
        return self._tables.shared["scene"]

    def location(self, scene: Row) -> str:
        """Where a scene was recorded."""
        return str(self._logs[scene["log_token"]]["location"])

    def of_scenes(self, names: frozenset[str]) -> Iterator[SceneTableRows]:
        """Scenes by name, in the order of the table."""
        return (self._read_scene(scene) for scene in self.scenes if scene["name"] in names)

    def _read_scene(self, scene: Row) -> SceneTableRows:
        rows = self._tables.of_scene(scene["token"])
        numbers = {table: self._tables.numbers_of_scene(table, scene["token"]) for table in ("sample", "instance")}
        return SceneTableRows(
            scene=scene,
            location=self.location(scene),
            samples=tuple(rows["sample"]),
            sample_numbers=numbers["sample"],
            channels={row["token"]: self._sensors[row["sensor_token"]] for row in rows["calibrated_sensor"]},
            data=_by_token(rows["sample_data"]),
            poses=_by_token(rows["ego_pose"]),
            mounts=_by_token(rows["calibrated_sensor"]),
            annotations=_by_token(rows["sample_annotation"]),
            instance_numbers=dict(zip((row["token"] for row in rows["instance"]), numbers["instance"], strict=True)),
            categories={row["token"]: self._category_names[row["category_token"]] for row in rows["instance"]},
            category_numbers=self.category_numbers,
        )


def _by_token(rows: list[Row]) -> dict[str, Row]:
    return {row["token"]: row for row in rows}
