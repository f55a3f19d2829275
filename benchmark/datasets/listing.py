"""Which scenes and splits a data set has, from its small files alone, without the devkit and the large tables."""

from pathlib import Path

from benchmark.datasets.split_names import read_splits, scenes_of_split
from benchmark.datasets.table_rows import table_rows
from benchmark.datasets.tables import find_version, variant_folders
from benchmark.machine.storage import read_kept_json


def listed_scenes(root: Path, split: str | None = None, *, version: str | None = None) -> tuple[str, ...]:
    """Names of scenes as an opened data set has them (`benchmark.datasets.nuscenes.NuScenesData.scene_names`).

    Args:
        root: A nuScenes-format root, or a folder of variant roots.
        split: A split, or ``None`` for all scenes.
        version: Version folder; needed only where there are several.

    Returns:
        Names, in the order of the data set.

    Raises:
        InputError: If there is no such data set or split, or its list of scenes is broken.
    """
    variants = variant_folders(root)
    if variants:
        return tuple(f"{folder}/{name}" for folder in variants for name in _listed(root / folder, split, version))
    return _listed(root, split, version)


def _listed(root: Path, split: str | None, version: str | None) -> tuple[str, ...]:
    version = find_version(root, version)
    present = tuple(sorted(str(row["name"]) for row in table_rows(root / version / "scene.json", "name")))
    if split is None:
        return present
    said = read_kept_json(root / version / "challenger.json")
    built_as = said.get("split") if isinstance(said, dict) else None
    return scenes_of_split(split, present, read_splits(root, version), where=str(root), built_as=built_as)
