"""The devkit's object, of one scene where the tables can be taken apart, or of all of them.

The devkit holds each row as a dictionary, several kilobytes for each camera image: too much for all scenes of a large
data set, little for one.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Final

from benchmark.datasets.scene_tables import SceneTables, read_scene_tables
from benchmark.datasets.tables import Row, Tables, check_tables, read_tables
from benchmark.errors import InputError

_FURTHER_TABLES: Final = ("lidarseg", "panoptic", "image_annotations")
"""Tables that the devkit reads and checks where they are, and nobody here."""


class OpenTables(ABC):
    """Checked tables of a data set."""

    @abstractmethod
    def rows(self, table: str) -> list[Row]:
        """Rows of the table ``scene`` or ``log``."""

    @abstractmethod
    def keyframe_images(self) -> Iterable[str]:
        """File names of the camera keyframes of all scenes, relative to the root."""

    @abstractmethod
    def of_scene(self, scene: Row) -> Any:
        """``NuScenes`` of the devkit, with the rows of at least one scene.

        Args:
            scene: Row of the scene table.

        Raises:
            InputError: If a table has changed since it was opened.
        """


class SceneByScene(OpenTables):
    """The devkit is given the rows of one scene at a time; only the last one is kept.

    Args:
        root: Root of the data set.
        version: Version folder.
        tables: Its tables.
    """

    def __init__(self, root: Path, version: str, tables: SceneTables) -> None:
        self._root, self._version, self._tables = root, version, tables
        self._kept: tuple[str, Any] = ("", None)

    def rows(self, table: str) -> list[Row]:
        """Rows of the table ``scene`` or ``log``."""
        return self._tables.shared[table]

    def keyframe_images(self) -> Iterable[str]:
        """File names of the camera keyframes of all scenes."""
        return self._tables.keyframe_images

    def of_scene(self, scene: Row) -> Any:
        """``NuScenes`` of the devkit with the rows of this scene alone."""
        token = scene["token"]
        if self._kept[0] != token:
            self._kept = ("", None)
            self._kept = (token, _devkit_with(self._root, self._version, self._tables.of_scene(token)))
        return self._kept[1]


class AllScenes(OpenTables):
    """The devkit has read the tables.

    Args:
        nusc: ``NuScenes`` of the devkit.
    """

    def __init__(self, nusc: Any) -> None:
        self._nusc = nusc

    def rows(self, table: str) -> list[Row]:
        """Rows of the table ``scene`` or ``log``."""
        rows: list[Row] = getattr(self._nusc, table)
        return rows

    def keyframe_images(self) -> Iterable[str]:
        """File names of the camera keyframes of all scenes."""
        rows = self._nusc.sample_data
        return (row["filename"] for row in rows if row["is_key_frame"] and row["sensor_modality"] == "camera")

    def of_scene(self, scene: Row) -> Any:
        """``NuScenes`` of the devkit with all rows."""
        return self._nusc


def open_tables(root: Path, version: str) -> OpenTables:
    """Check the tables of a data set.

    Args:
        root: Root of the data set.
        version: Version folder, with all 13 tables.

    Returns:
        The tables, scene by scene where they can be taken apart.

    Raises:
        InputError: If a table is broken, or links to nothing.
    """
    if not any((root / version / f"{table}.json").exists() for table in _FURTHER_TABLES):
        tables = read_scene_tables(root / version)
        if tables is not None and all((root / str(row["filename"])).is_file() for row in tables.shared["map"]):
            return SceneByScene(root, version, tables)
    return AllScenes(_whole_devkit(root, version))


def _devkit_with(root: Path, version: str, tables: Tables) -> Any:
    from nuscenes.nuscenes import NuScenes

    class NuScenesWithRows(NuScenes):  # type: ignore[misc]
        """Is given its rows instead of reading files."""

        def __load_table__(self, table: str) -> list[Row]:
            return tables[table]

    try:
        return NuScenesWithRows(version=version, dataroot=str(root), verbose=False)
    except Exception as error:
        raise _cannot_open(root, version, error) from error


def _whole_devkit(root: Path, version: str) -> Any:
    """The devkit crashes on broken tables, so they are then read again to say what is wrong."""
    from nuscenes.nuscenes import NuScenes

    try:
        nusc = NuScenes(version=version, dataroot=str(root), verbose=False)
    except Exception as error:
        tables = read_tables(root / version)
        _check(tables, root, version)
        raise _cannot_open(root, version, error) from error
    _check({table: getattr(nusc, table) for table in nusc.table_names if hasattr(nusc, table)}, root, version)
    return nusc


def _cannot_open(root: Path, version: str, error: Exception) -> InputError:
    return InputError(
        f"nuscenes-devkit cannot open {root / version} ({type(error).__name__}: {error}); correct the tables"
    )


def _check(tables: Tables, root: Path, version: str) -> None:
    check_tables(tables, root / version)
    for row in tables["map"]:
        if not (root / str(row["filename"])).is_file():
            raise InputError(
                f"map mask {root / str(row['filename'])} of map.json is missing; the devkit needs the file (any small "
                "PNG does)"
            )
