"""The devkit's object over rows that were read here; further tables it reads by itself where they are."""

from pathlib import Path
from typing import Any, Final

from benchmark.datasets.devkit_import import devkit_module
from benchmark.datasets.tables import Row, Tables
from benchmark.errors import InputError

FURTHER_TABLES: Final = ("lidarseg", "panoptic", "image_annotations")
"""Tables that the devkit reads where they are, and nobody here."""


def devkit_with(root: Path, version: str, tables: Tables) -> Any:
    """``NuScenes`` of the devkit with rows that are at hand."""
    as_published: Any = devkit_module("nuscenes.nuscenes").NuScenes

    class NuScenesWithRows(as_published):  # type: ignore[misc]
        """``NuScenes`` that is given its rows and reads no files; it reads tables that this product never uses."""

        def __load_table__(self, table: str) -> list[Row]:
            rows: list[Row] = tables[table] if table in tables else super().__load_table__(table)
            return rows

    try:
        return NuScenesWithRows(version=version, dataroot=str(root), verbose=False)
    except Exception as error:
        raise InputError(
            f"nuscenes-devkit cannot open {root / version} ({type(error).__name__}: {error}); correct the tables"
        ) from error
