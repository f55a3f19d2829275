"""Copies of a root with edited tables: files are linked, tables are one's own."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import benchmark
from generation.sources.mini import TownSettings

Row = dict[str, Any]


def small_town(root: Path, scenes: int = 1, *, images: bool = False) -> Path:
    """Some scenes of the embedded town, all of them in ``val``."""
    return benchmark.build_town(root, TownSettings(val_scenes=scenes, images=images), workers=1)


def copy_of(source: Path, target: Path) -> Path:
    """A copy whose tables and maps can be edited; everything else is linked.

    Args:
        source: Root with one version folder.
        target: Folder that does not exist yet.

    Returns:
        The copy.
    """
    target.mkdir(parents=True)
    version = version_of(source)
    for entry in source.iterdir():
        if entry.name in (version, "maps", "can_bus"):
            for path in entry.rglob("*"):
                copied = target / path.relative_to(source)
                if path.is_dir():
                    copied.mkdir(parents=True, exist_ok=True)
                else:
                    copied.parent.mkdir(parents=True, exist_ok=True)
                    copied.write_bytes(path.read_bytes())
        else:
            (target / entry.name).symlink_to(entry)
    return target


def version_of(root: Path) -> str:
    """Name of the only version folder of a root."""
    (table,) = root.glob("*/scene.json")
    return table.parent.name


def table_of(root: Path, name: str) -> Path:
    """Path of a table."""
    return root / version_of(root) / f"{name}.json"


def edit(root: Path, name: str, change: Callable[[list[Row]], list[Row] | None]) -> None:
    """Change a table in place.

    Args:
        root: A copy.
        name: Table, without its ending.
        change: Given the rows, changes them or returns others.
    """
    path = table_of(root, name)
    rows = json.loads(path.read_text())
    changed = change(rows)
    path.write_text(json.dumps(rows if changed is None else changed))


def without_annotations(root: Path, scenes: set[str] | None = None) -> None:
    """Take all annotations of scenes away, of all scenes by default."""
    tables = {name: json.loads(table_of(root, name).read_text()) for name in ("scene", "sample", "sample_annotation")}
    tokens = {row["token"] for row in tables["scene"] if scenes is None or row["name"] in scenes}
    samples = {row["token"] for row in tables["sample"] if row["scene_token"] in tokens}
    left = [row for row in tables["sample_annotation"] if row["sample_token"] not in samples]
    named = {row["instance_token"] for row in left}
    edit(root, "sample_annotation", lambda _: left)
    edit(root, "instance", lambda rows: [row for row in rows if row["token"] in named])


def annotated_until(root: Path, scene: str, samples: int) -> None:
    """Take the annotations of a scene away from a sample on, as where labelling stopped half-way."""
    tables = {name: json.loads(table_of(root, name).read_text()) for name in ("scene", "sample", "sample_annotation")}
    (token,) = (row["token"] for row in tables["scene"] if row["name"] == scene)
    own = sorted((row for row in tables["sample"] if row["scene_token"] == token), key=lambda row: row["timestamp"])
    gone = {row["token"] for row in own[samples:]}
    left = [row for row in tables["sample_annotation"] if row["sample_token"] not in gone]
    tokens = {row["token"] for row in left}
    chains: dict[str, list[Row]] = {}
    for row in left:
        row["next"] = row["next"] if row["next"] in tokens else ""
        chains.setdefault(row["instance_token"], []).append(row)

    def shortened(rows: list[Row]) -> list[Row]:
        for row in rows:
            chain = chains.get(row["token"], [])
            row["nbr_annotations"] = len(chain)
            row["last_annotation_token"] = next((each["token"] for each in chain if not each["next"]), "")
        return [row for row in rows if row["token"] in chains]

    edit(root, "sample_annotation", lambda _: left)
    edit(root, "instance", shortened)


def rename_categories(root: Path, renamed: Callable[[str], str]) -> None:
    """Give the categories of a root other names."""

    def change(rows: list[Row]) -> None:
        for row in rows:
            row["name"] = renamed(row["name"])

    edit(root, "category", change)
