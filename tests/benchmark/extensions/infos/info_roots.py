"""Small roots to export info files of, and golden sets made of what is exported."""

import copy
import json
import lzma
import pickle
import tarfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmark.constants import CATEGORIES, NUSCENES_TABLES
from benchmark.extensions.infos.exporting import InfoSettings, export_infos
from benchmark.extensions.infos.repositories import REPOSITORIES, RepositoryName
from benchmark.geometry import quaternion_from_yaw
from benchmark.machine.storage import file_sha256
from benchmark.scene import Camera, Scene
from benchmark.untrusted.children import read_pickle
from generation.nuscenes_writer import DataSetPlan, finish_data_set, write_scene
from generation.render.contract import Images
from tests.generation.nuscenes_writer.written_roots import SolidRenderer, short_scene, with_adversary, write_root

Contents = dict[str, dict[str, Any]]

SECONDS = 4.5
"""Nine samples: the first ones have six after them."""


class LargeRenderer(SolidRenderer):
    """The rows of images of the size that SparseDrive needs; the files hold one pixel, for nobody looks at them."""

    def cameras(self, scene: Scene) -> tuple[Camera, ...]:
        return tuple(camera.resized(1600, 900) for camera in scene.cameras)

    def render(self, scene: Scene, frames: Any) -> Iterator[Images]:
        blank = np.zeros((900, 1600, 3), np.uint8)
        for _ in frames:
            yield {camera.name: blank for camera in scene.cameras}


def plain_root(root: Path, *names: str, **plan: Any) -> Path:
    """Ordinary scenes with official names."""
    write_root(root, [short_scene(name, seconds=SECONDS) for name in names or ("scene-9901",)], **plan)
    return root


def variant_root(root: Path, **plan: Any) -> Path:
    """Three variants of one recording in one root, as generated ones lie there."""
    settings: dict[str, Any] = {"split": "adv", "renderer": SolidRenderer(), **plan}
    scene, written = short_scene(seconds=SECONDS), DataSetPlan(root=root, **settings)
    said: dict[str, Any] = {"source_scene": "scene-9901", "report": {}}
    variants = [(with_adversary(scene, agent), f"scene-9901-{letter * 8}") for agent, letter in enumerate("cab")]
    keys = [write_scene(written, variant, name=name, **said) for variant, name in variants]
    finish_data_set(written, keys)
    return root


def as_roots_were(root: Path) -> Path:
    """Give a root the category table of 23 rows, and the map of its own city alone."""
    path = next(root.glob("v1.0-*")) / "category.json"
    known = {row["name"]: row for row in json.loads(path.read_text())}
    path.write_text(json.dumps([known[name] for name in CATEGORIES]))
    for other in (root / "maps" / "expansion").glob("singapore-*.json"):
        other.unlink()
    return root


def exported(root: Path, to: Path, repository: RepositoryName, **settings: Any) -> list[dict[str, Any]]:
    """Infos of the file that official configurations evaluate."""
    export_infos(root, to, InfoSettings(repository, **settings))
    return read(to / REPOSITORIES[repository].file_name("v1.0-trainval", "val"))


def read(path: Path) -> list[dict[str, Any]]:
    """Infos of a file, through the door that strangers' files come by."""
    content = read_pickle(path)
    assert list(content) == ["infos", "metadata"]
    infos: list[dict[str, Any]] = content["infos"]
    return infos


def scene_names(root: Path) -> dict[str, str]:
    """Names by token."""
    rows = json.loads(next(root.glob("v1.0-*/scene.json")).read_text())
    return {row["token"]: row["name"] for row in rows}


def golden_contents(root: Path, beside: Path) -> Contents:
    """What a golden set of a root would hold: info files by repository, and under ``manifest`` the manifest."""
    version = next(path.parent for path in root.glob("*/scene.json"))
    contents: Contents = {}
    files: dict[str, Any] = {}
    for repository in REPOSITORIES:
        done = export_infos(root, beside / repository, InfoSettings(repository, as_converted=True))
        path = next(path for path in done.files if path.name.endswith("_val.pkl"))
        contents[repository] = read_pickle(path)
        files[repository] = {
            "path": f"files/{repository}.pkl.xz",
            "official_name": path.name,
            "infos_in": {"train": 0, "val": done.files[path]},
            "left_out": [],
        }
    row = {
        "version": version.name,
        "recipe": "none",
        "tables": f"tables/{root.name}.tar.xz",
        "fingerprint": {"sha256": {table: file_sha256(version / f"{table}.json") for table in NUSCENES_TABLES}},
        "files": files,
    }
    return {**contents, "manifest": {"tolerance": dict.fromkeys(files, TOLERANCE), "roots": {root.name: row}}}


def write_golden(contents: Contents, root: Path, golden: Path) -> Path:
    """Write a golden set; of the info files only those that are among the contents."""
    for folder in ("tables", "files"):
        (golden / folder).mkdir(parents=True)
    manifest = copy.deepcopy(contents["manifest"])
    row = manifest["roots"][root.name]
    row["files"] = {name: found for name, found in row["files"].items() if name in contents}
    (golden / "manifest.json").write_text(json.dumps(manifest))
    with tarfile.open(golden / "tables" / f"{root.name}.tar.xz", "w:xz") as archive:
        for part in (row["version"], "can_bus", "maps/expansion"):
            archive.add(root / part, f"{root.name}/{part}")
    for name in row["files"]:
        (golden / "files" / f"{name}.pkl.xz").write_bytes(lzma.compress(pickle.dumps(contents[name], protocol=2)))
    return golden


TOLERANCE = {
    "sensor2lidar_rotation": 1e-12,
    "sensor2lidar_translation": 1e-9,
    "gt_boxes, gt_velocity": 1e-9,
    "fut_traj": 1e-9,
    "gt_agent_fut_trajs, gt_agent_lcf_feat, gt_ego_his_trajs, gt_ego_fut_trajs, gt_ego_lcf_feat, ego_status": 1e-5,
    "gt_agent_fut_yaw": 1e-6,
    "map_annos": "every vertex of one to the line of the other, both ways, <= 1e-6",
}
"""As the official sets have them."""


def tilted(scene: Scene, roll_rad: float) -> Scene:
    """The scene with every box rolled about its own x axis."""
    yaw = quaternion_from_yaw(scene.agents.yaw[:, scene.keyframes])
    cos, sin = np.cos(roll_rad / 2), np.sin(roll_rad / 2)
    w, z = yaw[..., 0], yaw[..., 3]
    rolled = np.stack([w * cos, w * sin, z * sin, z * cos], axis=-1)
    return replace(scene, annotations=replace(scene.annotations, rotation=rolled))
