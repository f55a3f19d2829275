"""Scene sheets on disk: their schema, and how they are read.

``<sheets>/<data set>/<split>/split.json`` is a `SplitPage`; ``.../<split>/scenes/<scene>/`` holds ``sheet.json`` (a
`ScenePage`), pictures below ``cameras/`` and, where the search kept its rounds, ``rounds.json`` (a `RefinementTrace`).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, TypeVar

from pydantic import Field

from benchmark.errors import InputError
from benchmark.machine.storage import file_sha256, read_json, sanitise_file_name
from benchmark.records.attempts import Attempt
from benchmark.records.run_schema import DataFacts, ReviewFacts
from benchmark.records.statistics import BuildRuntime, SplitStatistics
from benchmark.records.store import validate_stored
from benchmark.records.stored import Stored

SCHEMA: Final = 1
SHEET_FILE, ROUNDS_FILE, SPLIT_FILE = "sheet.json", "rounds.json", "split.json"
SCENES_FOLDER: Final = "scenes"
KEPT_ROUNDS_FOLDER: Final = "rounds"
"""Below a generated root: a `RefinementTrace` for each scene, where the search kept its rounds."""
CAMERA_GRID: Final = (
    ("CAM_FRONT_LEFT", "CAM_FRONT", "CAM_FRONT_RIGHT"),
    ("CAM_BACK_LEFT", "CAM_BACK", "CAM_BACK_RIGHT"),
)
"""Where each camera stands in a picture of all six."""

Point = tuple[float, float]
Ring = tuple[Point, ...]
Polygon = tuple[Ring, ...]
"""Outer ring first, then holes."""
Segment = tuple[float, float, float, float]


class PageEgo(Stored):
    """Recorded motion of the ego's rear axle, one value a frame, relative to the sheet's origin.

    ``centre_ahead_m`` is the centre of the body ahead of the rear axle.

    Attributes:
        x_m: East of the origin.
        y_m: North of the origin.
        yaw_rad: Heading.
        length_m: Of the body.
        width_m: Of the body.
    """

    x_m: tuple[float, ...]
    y_m: tuple[float, ...]
    yaw_rad: tuple[float, ...]
    length_m: float
    width_m: float
    centre_ahead_m: float


class PageAgent(Stored):
    """One annotated object: its box centres relative to the sheet's origin, and headings.

    ``size_m`` is length, width, height. The values begin at frame ``first`` and are null where it is not there.

    Attributes:
        id: Instance identifier.
        category: In nuScenes' words.
        adversary: Whether it is one.
        x_m: East of the origin.
        y_m: North of the origin.
        yaw_rad: Heading.
    """

    id: str
    category: str
    size_m: tuple[float, float, float]
    adversary: bool
    first: int
    x_m: tuple[float | None, ...]
    y_m: tuple[float | None, ...]
    yaw_rad: tuple[float | None, ...]


class PageDivider(Stored):
    """A divider; ``paint`` is a `benchmark.road_map.DividerKind`.

    Attributes:
        points: Of the line.
    """

    points: Ring
    paint: str


class PageMap(Stored):
    """The road around the ego's way.

    Attributes:
        drivable: Drivable area.
        crossings: Pedestrian crossings.
        walkways: Pavements.
        carparks: Car parks.
        dividers: Lane and road dividers.
    """

    drivable: tuple[Polygon, ...] = ()
    crossings: tuple[Polygon, ...] = ()
    walkways: tuple[Polygon, ...] = ()
    carparks: tuple[Polygon, ...] = ()
    dividers: tuple[PageDivider, ...] = ()


class PageCamera(Stored):
    """Cell of one camera in the pictures, pixels of the picture.

    Attributes:
        name: Of the camera.
        left: First column.
        top: First row.
        width: Of the cell.
        height: Of the cell.
    """

    name: str
    left: int
    top: int
    width: int
    height: int


class ScenePage(Stored):
    """Content of the page of one scene.

    Attributes:
        schema_version: Version of the format.
        data: Data set that it shows.
        split: Split of the data set.
        scene: Name of the scene.
        source: Recorded scene that it was made from; its own name if it is a recording.
        description: Free text of the tables.
        labels: Labels of each adversary (``generation.labels.labelling``), as the data set says it.
        origin_m: (x, y) in the global frame; all positions are relative to it.
        timestamps_us: One a frame (12 Hz).
        keyframes: Frames that are samples.
        sample_tokens: One for each sample.
        ego: The recorded ego.
        agents: Everything annotated; adversaries last.
        road: The map around it.
        cameras: Where each camera is in the pictures.
        pictures: Frames that have a picture of all cameras, ``cameras/<frame, six digits>.webp``.
        adversary_edges: For such a frame (as text) and each camera that sees an adversary: edges of its 3-D box as
            (x1, y1, x2, y2) in pixels of the picture, cut at the cell's borders.
        files: SHA-256 of each picture by its path below the sheet's folder.
        drawn_by: Renderer of the images; null where the data set does not say, as of recordings, and in older sheets.
    """

    schema_version: int = Field(alias="schema")
    data: DataFacts
    split: str
    scene: str
    source: str
    description: str
    labels: tuple[dict[str, Any], ...]
    origin_m: Point
    timestamps_us: tuple[int, ...]
    keyframes: tuple[int, ...]
    sample_tokens: tuple[str, ...]
    ego: PageEgo
    agents: tuple[PageAgent, ...]
    road: PageMap
    cameras: tuple[PageCamera, ...]
    pictures: tuple[int, ...]
    adversary_edges: dict[str, dict[str, tuple[Segment, ...]]]
    files: dict[str, str]
    drawn_by: str | None = None

    @property
    def manoeuvre(self) -> str | None:
        """Primary manoeuvre of the first adversary that has labels."""
        named = (label.get("manoeuvre") for label in self.labels)
        return next((name for name in named if isinstance(name, str)), None)


class TraceRound(Stored):
    """One round of refinement: (B, M) simulated points (x, y) relative to the sheet's origin, half a second apart.

    ``scores`` are (B,), lower is better, null where infinite; ``collision_free`` is how many candidates touch nothing.

    Attributes:
        candidates: Simulated tracks.
    """

    candidates: tuple[Ring, ...]
    scores: tuple[float | None, ...]
    collision_free: int


class TraceFrame(Stored):
    """One planning frame: its rounds, and which candidate of which round was executed.

    Attributes:
        frame: Index in the scene.
        rounds: Rounds of refinement.
        chosen_round: Round of the executed candidate.
        chosen: Its place in the round.
    """

    frame: int
    rounds: tuple[TraceRound, ...]
    chosen_round: int
    chosen: int


class RefinementTrace(Stored):
    """``rounds.json``: the search for one adversary, with version and fingerprint of it and its trajectory model.

    Attributes:
        schema_version: Version of the format.
        scene: Name of the scene.
        agent: The adversary's instance.
        origin_m: As in the sheet.
        search: Version and fingerprints.
        frames: Planning frames.
    """

    schema_version: int = Field(alias="schema")
    scene: str
    agent: str
    origin_m: Point
    search: dict[str, Any]
    frames: tuple[TraceFrame, ...]


class AttemptFacts(Stored):
    """One vehicle that the search tried, with the scene that it became or the reason why not; the other is null.

    Attributes:
        source: Recorded scene.
        agent: Vehicle that was tried.
        scene: Scene that it became.
        discarded: Reason why it became none.
        manoeuvre: Primary manoeuvre.
    """

    source: str
    agent: str
    scene: str | None
    discarded: str | None
    manoeuvre: str | None

    @classmethod
    def of(cls, attempt: Attempt) -> "AttemptFacts":
        """Facts of an attempt."""
        return cls(
            source=attempt.scene,
            agent=attempt.agent,
            scene=attempt.written,
            discarded=attempt.discard or attempt.dropped,
            manoeuvre=None if attempt.labels is None else attempt.labels.manoeuvre,
        )


class SplitPage(Stored):
    """Content of the page of one split.

    ``attempts`` are of generated splits, ``runtime`` is there if this machine measured the seconds of each stage.
    ``review`` is null where no verdict stands, and ``hyper``, the settings of the search, empty where they are not
    known.

    Attributes:
        schema_version: Version of the format.
        data: Data set.
        split: Split of the data set.
        scenes: Names of its scenes.
        statistics: The split in numbers.
    """

    schema_version: int = Field(alias="schema")
    data: DataFacts
    split: str
    scenes: tuple[str, ...]
    statistics: SplitStatistics
    attempts: tuple[AttemptFacts, ...] = ()
    runtime: BuildRuntime | None = None
    review: ReviewFacts | None = None
    hyper: dict[str, Any] = Field(default_factory=dict)


_Read = TypeVar("_Read", ScenePage, SplitPage, RefinementTrace)


@dataclass(frozen=True, slots=True)
class StoredScenePage:
    """A sheet, the folder of its ``sheet.json``, and the search for its adversary, if its rounds were kept."""

    directory: Path
    sheet: ScenePage
    rounds: RefinementTrace | None

    def picture_path(self, frame: int) -> Path:
        """File of a frame's cameras."""
        return self.directory / picture_name(frame)


@dataclass(frozen=True, slots=True)
class ScenePages:
    """All sheets below a folder, by data set's name, split and scene."""

    splits: Mapping[tuple[str, str], SplitPage]
    scenes: Mapping[tuple[str, str, str], StoredScenePage]


NO_SCENE_PAGES: Final = ScenePages({}, {})


def picture_name(frame: int) -> str:
    """Path of a frame's cameras below the sheet's folder."""
    return f"cameras/{frame:06d}.webp"


def split_folder(root: Path, data_name: str, split: str) -> Path:
    """Folder of a split's sheets below the folder of all sheets."""
    return root / sanitise_file_name(data_name) / sanitise_file_name(split)


def scene_folder(root: Path, data_name: str, split: str, scene: str) -> Path:
    """Folder of a scene's sheet below the folder of all sheets."""
    return split_folder(root, data_name, split) / SCENES_FOLDER / sanitise_file_name(scene)


def kept_rounds_path(root: Path, scene: str) -> Path:
    """File of a generated root with the rounds of the search for a scene's adversary, if they were kept."""
    return root / KEPT_ROUNDS_FOLDER / f"{sanitise_file_name(scene)}.json"


def find_scene_pages(root: Path) -> ScenePages:
    """Read all sheets below a folder, which need not exist; damaged ones and changed pictures are refused."""
    splits = [_read(path, SplitPage) for path in sorted(root.glob(f"*/*/{SPLIT_FILE}"))]
    paths = sorted(root.glob(f"*/*/{SCENES_FOLDER}/*/{SHEET_FILE}"))
    scenes = sorted((read_scene_page(path.parent) for path in paths), key=lambda found: found.sheet.scene)
    return ScenePages(
        {(page.data.name, page.split): page for page in splits},
        {(stored.sheet.data.name, stored.sheet.split, stored.sheet.scene): stored for stored in scenes},
    )


def read_scene_page(directory: Path) -> StoredScenePage:
    """Read one scene's sheet; a damaged one or a changed picture is refused."""
    sheet = _read(directory / SHEET_FILE, ScenePage)
    count = len(sheet.timestamps_us)
    if not count or {len(sheet.ego.x_m), len(sheet.ego.y_m), len(sheet.ego.yaw_rad)} != {count}:
        raise InputError(
            f"{directory / SHEET_FILE} has {count} frames but another number of ego poses, or no frames; run "
            "challenger-bench sheets again"
        )
    if any(second <= first for first, second in pairwise(sheet.timestamps_us)):
        raise InputError(
            f"{directory / SHEET_FILE} has frames that are not in order; run challenger-bench sheets again"
        )
    for name, expected in sheet.files.items():
        path = directory / name
        if not path.resolve().is_relative_to(directory.resolve()):
            raise InputError(f"{directory / SHEET_FILE} names {name!r}, which is outside its folder; write it again")
        if not path.is_file() or file_sha256(path) != expected:
            raise InputError(f"{path} does not match the picture in its sheet; run challenger-bench sheets again")
    rounds = directory / ROUNDS_FILE
    return StoredScenePage(directory, sheet, _read(rounds, RefinementTrace) if rounds.is_file() else None)


def _read(path: Path, model: type[_Read]) -> _Read:
    again = f"run challenger-bench sheets again or delete {path.parent}"
    content = read_json(path)
    version = content.get("schema") if isinstance(content, dict) else None
    if version != SCHEMA:
        raise InputError(f"{path} has schema {version!r}, but this version reads {SCHEMA}; {again}")
    return validate_stored(
        model.model_validate, content, lambda where, why: f"{path} is damaged at {where}: {why}; {again}"
    )
