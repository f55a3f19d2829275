"""Plan of a data set to be written: facts known in advance, and the keys and names that follow from them."""

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any, Final, Literal, Self

import numpy as np
import shapely

from benchmark.constants import NUSCENES_TABLES
from benchmark.datasets.categories import CategoryNames
from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.machine.storage import content_key, make_token
from benchmark.machine.workspace import strip_version
from benchmark.records.review import StandingVerdict
from benchmark.records.seed_splits import RECORDED_EGO
from benchmark.runs.units import ResultStore
from benchmark.scene import Camera, Scene
from generation.nuscenes_writer.numbering import SceneNumber
from generation.render.contract import Renderer

WRITER_VERSION: Final = 1
"""Part of every content key; raised when the same scene would be written differently."""
SHARED_TABLES_VERSION: Final = 2
"""Raised when what scenes share is written differently: labels, maps. Scenes that are written stay; 2 has the table of
32 categories, and maps of all cities."""
STATE_FOLDER: Final = ".challenger"
_PLAIN_NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._+-]*")


@dataclass(frozen=True, slots=True)
class SourceInfo:
    """The data set that another one derives from: maps, CAN bus files and label tokens come from its ``root``.

    ``version`` may stay ``None`` where the root has only one; ``names`` are those that were replaced in it.
    """

    name: str
    fingerprint: str
    root: Path | None = None
    version: str | None = None
    names: CategoryNames = ()

    @classmethod
    def of(cls, source: DataSet) -> Self:
        """A data set, of an earlier town by the name that it had: what is made from it stays the same to the byte."""
        name = strip_version(source.name)
        return cls(name, source.fingerprint(), source.root, source.version, source.categories)


@dataclass(frozen=True, slots=True)
class DataSetPlan:
    """One data set to write.

    Attributes:
        layout: ``suffixed``: one root for all scenes. ``per-variant``: complete roots ``v0``, ``v1``, ... with the
            original scene names, which official model code accepts unpatched.
        renderer: Draws the camera images; ``None`` for a data set without cameras.
        frames: Which frames get rows and files: all 12 Hz frames or the 2 Hz keyframes.
        pictures: Which of these frames get camera images now. ``keyframes`` leaves out files that the rows name, which
            the same plan with ``all`` adds later: tables, tokens and keys are the same with and without them. ``none``
            leaves out all.
        drawn_by: Who draws images that are not there (`benchmark.datasets.drawn_later`), or ``None``.
        jpeg_quality: 1..100.
        lossless: Beside each JPEG file a PNG file of the same name, which no table names.
        frozen: Name and content hash of the frozen split that it is built from, if it is.
        search: Hash of what decided its search beside the seed; of splits that are called after their seed alone.
        panel: Planners that chose among its scenes, with their seeds; empty where none did.
        left_out: Scenes that an inspector rejected, each with the number of its variant; none of another split.
        ego: Who drives the ego: ``recorded``, or the reference driver that drove its poses.
        keeps_instances: Whether identifiers of objects stay what they are in every scene, because each is in one scene
            alone: of imported scenes, which may be variants that had identifiers of their own already.
    """

    root: Path
    split: str
    version: str = "v1.0-trainval"
    layout: Literal["suffixed", "per-variant"] = "suffixed"
    renderer: Renderer | None = None
    frames: Literal["all", "keyframes"] = "all"
    pictures: Literal["all", "keyframes", "none"] = "all"
    jpeg_quality: int = 92
    lossless: bool = False
    drawn_by: str | None = None
    source: SourceInfo | None = None
    frozen: tuple[str, str] | None = None
    search: str | None = None
    left_out: tuple[tuple[int, StandingVerdict], ...] = ()
    keeps_instances: bool = False
    panel: str = ""
    ego: str = RECORDED_EGO

    def __post_init__(self) -> None:
        if not 1 <= self.jpeg_quality <= 100:
            raise InputError(f"the JPEG quality must be 1 to 100, got {self.jpeg_quality}")
        for kind, name in (("version folder", self.version), ("split", self.split)):
            require_plain_name(kind, name)

    @property
    def state(self) -> Path:
        """Folder of what the writer remembers between runs."""
        return self.root / STATE_FOLDER

    def data_root(self, variant: int) -> Path:
        """The nuScenes-format root that a scene belongs to."""
        return self.root if self.layout == "suffixed" else self.root / f"v{variant}"

    @property
    def fragments(self) -> ResultStore[dict[str, Any]]:
        """Table rows of finished scenes; one that is there means that all files of its scene are."""
        return ResultStore(self.state / "fragments", dict[str, Any])

    def claim_path(self, variant: int, name: str) -> Path:
        """Which key, and which files, a scene name stands for at the moment."""
        return self.state / "claims" / f"v{variant}-{name}.json"

    def map_path(self, map_key: str) -> Path:
        """A stored road map."""
        return self.state / "maps" / f"{map_key}.json"

    def drawn_path(self, root: Path) -> Path:
        """Folder of notes on which maps of a data root have been drawn from what."""
        return self.state / "drawn" / ("root" if root == self.root else root.name)


@dataclass(frozen=True, slots=True)
class SceneNames:
    """Tokens and file names of one scene; ``suffix`` is what ``name`` has after the name of the source scene.

    Tokens are hashes of ``identity`` and their own parts; ``keeps_instances`` keeps those of the source's instances.
    ``row`` is the scene's name in the tables.
    """

    name: str
    row: str
    suffix: str
    log: str
    identity: tuple[str, ...]
    keeps_instances: bool

    @classmethod
    def of(
        cls,
        plan: DataSetPlan,
        scene: Scene,
        *,
        name: str,
        variant: int,
        source_scene: str,
        identity: str | None = None,
        number: SceneNumber | None = None,
    ) -> "SceneNames":
        """Names of a scene of a plan; see `write_scene` for the arguments."""
        require_plain_name("scene", name)
        suffix = name.removeprefix(source_scene) if name.startswith(source_scene) else ""
        if identity is None:
            identity = content_key(to_digestible((scene.timestamps_us, scene.ego, scene.agents, scene.annotations)))
        return cls(
            name=name,
            row=name if number is None else number.name,
            suffix=suffix,
            log=re.sub(r"[^A-Za-z0-9.+_-]", "_", scene.log or name),
            identity=(plan.split, str(variant), name, identity),
            keeps_instances=plan.keeps_instances or plan.layout == "per-variant" or name == source_scene,
        )

    def token(self, table: str, *parts: Any) -> str:
        """Token of a row that belongs to this scene."""
        return make_token(table, *self.identity, *parts)

    def instance(self, agent_id: str) -> str:
        """Token of an agent: the source's where no other copy of the scene shares the root, else a hash."""
        if self.keeps_instances and re.fullmatch(r"[0-9a-f]{32}", agent_id):
            return agent_id
        return make_token("instance", self.name, agent_id)

    def file(self, channel: str, timestamp_us: int, *, is_keyframe: bool, extension: str) -> str:
        """Path of a sensor file below the data root, in nuScenes' pattern."""
        folder = "samples" if is_keyframe else "sweeps"
        return f"{folder}/{channel}/{self.log}__{channel}__{timestamp_us}{self.suffix}.{extension}"


def compute_scene_key(
    plan: DataSetPlan, scene: Scene, cameras: tuple[Camera, ...], *, map_key: str, labels: Mapping[str, Any]
) -> str:
    """Key, 64 hexadecimal digits, of all that files and rows of a scene depend on; ``cameras`` are as rendered."""
    content = {item.name: to_digestible(getattr(scene, item.name)) for item in fields(scene) if item.name != "road_map"}
    drawn = None
    if plan.renderer is not None:
        drawn = [plan.renderer.name, plan.renderer.version, to_digestible(cameras), plan.jpeg_quality, plan.lossless]
    source = None if plan.source is None else [plan.source.name, plan.source.fingerprint]
    return content_key(
        "writer", WRITER_VERSION, content, map_key, labels, plan.split, plan.layout, plan.frames, drawn, source
    )


def to_digestible(value: Any) -> Any:
    """A JSON value for `benchmark.machine.storage.content_key` that differs whenever the nested content does."""
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "UO":
            return value.tolist()
        data = np.ascontiguousarray(value)
        return [data.dtype.str, list(data.shape), hashlib.sha256(data.tobytes()).hexdigest()]
    if isinstance(value, shapely.Geometry):
        return hashlib.sha256(shapely.to_wkb(value)).hexdigest()
    if is_dataclass(value) and not isinstance(value, type):
        known = {item.name: getattr(value, item.name) for item in fields(value)}
        usual = {
            item.name for item in fields(value) if item.metadata.get("unusual") and known[item.name] == item.default
        }
        return {name: to_digestible(part) for name, part in known.items() if name not in usual}
    if isinstance(value, dict):
        return {str(key): to_digestible(item) for key, item in value.items()}
    if isinstance(value, frozenset):
        return sorted(value)
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, tuple | list):
        return [to_digestible(item) for item in value]
    return value


def require_plain_name(what: str, name: str) -> None:
    """Refuse names that would leave their folder or confuse a shell: letters, digits and ``. _ + -`` are allowed."""
    if not _PLAIN_NAME.fullmatch(name):
        raise InputError(f"{what} name {name!r} cannot be a file name; use letters, digits, dot, dash and underscore")


def require_own_root(plan: DataSetPlan, variant: int) -> None:
    """Refuse to write over a data set that this writer did not make: tables are there, but no state of the writer."""
    folder = plan.data_root(variant) / plan.version
    if plan.state.is_dir() or not any((folder / f"{table}.json").exists() for table in NUSCENES_TABLES):
        return
    raise InputError(f"{folder} holds a foreign data set; choose another --out, nothing was changed")
