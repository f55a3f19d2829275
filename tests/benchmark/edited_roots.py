"""Copies of a root with edited tables: files are linked, tables are one's own."""

import atexit
import json
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import benchmark
from generation.sources.mini import TownSettings

Row = dict[str, Any]


def small_town(root: Path, scenes: int = 1, *, images: bool = False) -> Path:
    """Some scenes of the embedded town's first version, all of them in ``val``; images are small and of keyframes."""
    return Path(shutil.copytree(_built_town(root.name, scenes, images), root, dirs_exist_ok=True))


@cache
def _built_town(name: str, scenes: int, images: bool) -> Path:
    """A town that is copied wherever this process wants such a one."""
    folder = tempfile.mkdtemp(prefix="town-")
    atexit.register(shutil.rmtree, folder)
    settings = TownSettings(val_scenes=scenes, images=images, version=1)
    if images:
        settings = replace(settings, width=96, height=54, frames="keyframes")
    return benchmark.build_town(Path(folder) / name, settings, workers=1)


def copy_of(source: Path, target: Path) -> Path:
    """A new copy whose tables, maps and CAN bus can be edited; everything else is linked."""
    target.mkdir(parents=True)
    for entry in source.iterdir():
        if entry.name in (version_of(source), "maps", "can_bus"):
            shutil.copytree(entry, target / entry.name)
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
    """Change a table of a copy in place; ``change`` changes the rows or returns others."""
    path = table_of(root, name)
    rows = json.loads(path.read_text())
    changed = change(rows)
    path.write_text(json.dumps(rows if changed is None else changed))


def remove_annotations(root: Path, gone: Callable[[Row], bool]) -> None:
    """Take annotations away; chains are mended, instances that are left without any are gone too."""
    rows: list[Row] = []
    edit(root, "sample_annotation", rows.extend)
    by_token = {row["token"]: row for row in rows}
    removed = [row for row in rows if gone(row)]
    for row in removed:
        for link, back in (("prev", "next"), ("next", "prev")):
            if row[link]:
                by_token[row[link]][back] = row[back]
    lost = {row["token"] for row in removed}
    left = [row for row in rows if row["token"] not in lost]
    edit(root, "sample_annotation", lambda _: left)
    touched = {row["instance_token"] for row in removed}

    def counted(instances: list[Row]) -> list[Row]:
        for one in instances:
            if one["token"] in touched:
                own = [row for row in left if row["instance_token"] == one["token"]]
                one["nbr_annotations"] = len(own)
                for field, link in (("first_annotation_token", "prev"), ("last_annotation_token", "next")):
                    one[field] = next((row["token"] for row in own if not row[link]), "")
        return [one for one in instances if one["nbr_annotations"]]

    edit(root, "instance", counted)


def samples_of(root: Path, scene: str) -> list[Row]:
    """The samples of a scene by time."""
    scenes, samples = (json.loads(table_of(root, name).read_text()) for name in ("scene", "sample"))
    (token,) = (row["token"] for row in scenes if row["name"] == scene)
    return sorted((row for row in samples if row["scene_token"] == token), key=lambda row: int(row["timestamp"]))


def without_annotations(root: Path, scenes: set[str] | None = None) -> None:
    """Take all annotations of scenes away, of all scenes by default."""
    names = [row["name"] for row in json.loads(table_of(root, "scene").read_text())]
    for name in names if scenes is None else scenes:
        annotated_until(root, name, 0)


def annotated_until(root: Path, scene: str, samples: int) -> None:
    """Take the annotations of a scene away from a sample on, as where labelling stopped half-way."""
    tokens = {row["token"] for row in samples_of(root, scene)[samples:]}
    remove_annotations(root, lambda row: row["sample_token"] in tokens)


def rename_categories(root: Path, renamed: Callable[[str], str]) -> None:
    """Give the categories of a root other names."""

    def change(rows: list[Row]) -> None:
        for row in rows:
            row["name"] = renamed(row["name"])

    edit(root, "category", change)
