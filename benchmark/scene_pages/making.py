"""The sheet of one scene: what stands in it, its pictures, and whether it is there already.

The road around the ego's way, as small as it can be and still look the same.
"""

import shutil
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import cv2
import numpy as np
import shapely
from pydantic import ValidationError
from shapely.geometry import LineString, MultiPoint, Polygon

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import content_key, file_sha256, read_kept_json, write_bytes, write_json, writing_to
from benchmark.records.attempts import stored_labels
from benchmark.records.run_schema import DataFacts
from benchmark.records.scenes import (
    ROUNDS_FILE,
    SCHEMA,
    SHEET_FILE,
    Point,
    RefinementTrace,
    Ring,
    Sheet,
    SheetLine,
    SheetMap,
    picture_name,
    read_sheet,
    scene_folder,
)
from benchmark.records.scenes import Polygon as SheetPolygon
from benchmark.records.store import validated
from benchmark.road_map import RoadMap, as_multipolygon
from benchmark.runs.units import ResultStore
from benchmark.scene import Scene
from benchmark.scene_pages.motion import agents_of, ego_of, origin_of
from benchmark.scene_pages.pictures import (
    Videos,
    adversary_edges,
    between_samples,
    layout,
    mosaic,
    pictured_frames,
    with_files,
)

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

AROUND_M: Final = 70.0
"""The road reaches this far around the ego's way."""
_SIMPLIFIED_M: Final = 0.05
_LEAST_AREA_M2: Final = 0.05


def road_around(road_map: RoadMap, way: Floats, origin: Point) -> SheetMap:
    """Layers of a map within `AROUND_M` of the ego's way, simplified to 5 cm and rounded to centimetres.

    Rings are closed: their last point is their first.

    Args:
        way: (T, 2) positions of the ego, global.
        origin: What positions become relative to.
    """
    window = _corridor(way)
    near = road_map.near(shapely.bounds(window).tolist())

    def polygons(shapes: Iterable[shapely.Geometry]) -> tuple[SheetPolygon, ...]:
        return tuple(polygon for shape in shapes for polygon in _polygons(shape, window, origin))

    lines = []
    for divider in near.dividers:
        for points in _lines(divider.line, window, origin):
            lines.append(SheetLine(points=points, paint=divider.kind.value))
    return SheetMap(
        drivable=polygons([near.drivable_area]),
        crossings=polygons(_in_order(near.ped_crossings)),
        walkways=polygons(_in_order(near.walkways)),
        carparks=polygons(_in_order(near.carparks)),
        dividers=tuple(lines),
    )


def _corridor(way: Floats) -> Polygon:
    points = MultiPoint(np.unique(way, axis=0))
    line = LineString(way).simplify(1.0) if len(points.geoms) > 1 else points.geoms[0]
    return line.buffer(AROUND_M, quad_segs=4)


def _in_order(layer: dict[str, Polygon]) -> list[Polygon]:
    return [layer[name] for name in sorted(layer)]


def _polygons(shape: shapely.Geometry, window: Polygon, origin: Point) -> list[SheetPolygon]:
    sound = shape if shape.is_valid else shapely.make_valid(shape)
    simple = shapely.simplify(as_multipolygon(shapely.intersection(sound, window)), _SIMPLIFIED_M)
    polygons = []
    for part in as_multipolygon(simple).geoms:
        if part.area >= _LEAST_AREA_M2:
            holes = [hole for hole in part.interiors if Polygon(hole).area >= _LEAST_AREA_M2]
            polygons.append(tuple(_rounded(ring.coords, origin) for ring in (part.exterior, *holes)))
    return polygons


def _lines(line: Floats, window: Polygon, origin: Point) -> list[Ring]:
    inside = shapely.simplify(shapely.intersection(LineString(line), window), _SIMPLIFIED_M)
    parts = [part for part in shapely.get_parts(inside) if isinstance(part, LineString) and part.length > 0]
    return [_rounded(part.coords, origin) for part in parts]


def _rounded(points: Sequence[Sequence[float]], origin: Point) -> Ring:
    # Adding zero turns a negative zero into zero.
    places = np.round(np.asarray(points, np.float64)[:, :2] - origin, 2) + 0.0
    return tuple((float(x), float(y)) for x, y in places)


MAKING_VERSION: Final = 2
"""Goes up when the same data set would give another sheet."""
KEY: Final = "key"
"""Name of the file beside a sheet, or the sheet of a split, that says what it was made of."""
_PICTURES_FOLDER: Final = "cameras"


@dataclass(frozen=True, slots=True)
class WrittenSheet:
    """Outcome for one scene.

    Attributes:
        made: Whether there was something to do.
        pictures: How many there are.
        sheet_bytes: Size of ``sheet.json``.
    """

    scene: str
    made: bool
    pictures: int
    sheet_bytes: int
    picture_bytes: int

    @property
    def kept(self) -> bool:
        """Whether it was there before."""
        return not self.made


@dataclass(frozen=True, slots=True)
class Job:
    """Facts that every unit of work needs; picklable.

    Attributes:
        root: Folder of all sheets.
        pictures: Which frames have pictures: ``all``, ``keyframes`` or ``none``.
        cell_width_px: Width of one camera in a picture.
    """

    root: Path
    facts: DataFacts
    split: str
    pictures: str
    cell_width_px: int

    def folder(self, scene: str) -> Path:
        """Folder of a scene's sheet."""
        return scene_folder(self.root, self.facts.name, self.split, scene)


def sheets_in(folder: Path) -> ResultStore[str]:
    """Sheets written to a folder, by the hash of ``sheet.json``."""
    return ResultStore(folder, str)


def sheet_of(data: "DataSet", split: str, name: str, facts: DataFacts) -> Sheet:
    """A scene's sheet without pictures."""
    provenance = data.provenance()
    report = provenance["scenes"].get(name, {}).get("report") if provenance else None
    renderer = provenance.get("renderer") if provenance else None
    drawn_by = renderer.get("name") if isinstance(renderer, dict) else None
    scene = f"{data.root}: scene {name}"
    sheet = validated(
        sheet_to_draw,
        data.scene(name),
        lambda where, why: f"{scene} cannot be shown, its {where} is not sound ({why}); correct the tables",
    )
    return sheet.model_copy(
        update={
            "data": facts,
            "split": split,
            "scene": name,
            "source": data.scene_facts([name])[name].source,
            "labels": tuple(label for label in stored_labels(report) if isinstance(label, dict)),
            "sample_tokens": tuple(truth.sample_token for truth in data.truth(name)),
            "drawn_by": drawn_by if isinstance(drawn_by, str) else None,
        }
    )


def sheet_to_draw(scene: Scene) -> Sheet:
    """Sheet of a scene of any data set that is to be drawn and not stored.

    It has no data set, split, labels, sample tokens and pictures.

    Raises:
        ValidationError: If a number in it is not finite.
    """
    origin = origin_of(scene)
    return Sheet(
        schema=SCHEMA,
        data=DataFacts(name="", version="", fingerprint=""),
        split="",
        scene=scene.name,
        source=scene.name,
        description=scene.description,
        labels=(),
        origin_m=origin,
        timestamps_us=tuple(scene.timestamps_us.tolist()),
        keyframes=tuple(scene.keyframes.tolist()),
        sample_tokens=(),
        ego=ego_of(scene, origin),
        agents=agents_of(scene, origin),
        road=road_around(scene.road_map, scene.ego.position[:, :2], origin),
        cameras=(),
        pictures=(),
        adversary_edges={},
        files={},
    )


def written_sheet(job: Job, data: "DataSet", name: str) -> WrittenSheet:
    """One unit of work: a scene's sheet and pictures, if they are not there already."""
    keyframes, sweeps = _videos(job, data, name)
    key = _key(job, name, keyframes, sweeps)
    folder = job.folder(name)
    sheet = _kept(job, name, key)
    is_new = sheet is None
    if sheet is None:
        sheet = _make(job, data, name, keyframes, sweeps)
        sheets_in(folder).put(key, file_sha256(folder / SHEET_FILE), KEY)
    sizes = [(folder / path).stat().st_size for path in sheet.files]
    return WrittenSheet(name, is_new, len(sheet.pictures), (folder / SHEET_FILE).stat().st_size, sum(sizes))


def planned_sheet(job: Job, data: "DataSet", name: str) -> WrittenSheet:
    """Outcome that `written_sheet` would have, without sizes."""
    keyframes, sweeps = _videos(job, data, name)
    is_new = _kept(job, name, _key(job, name, keyframes, sweeps)) is None
    return WrittenSheet(name, is_new, len(pictured_frames(data.scene(name), keyframes, sweeps)), 0, 0)


def _videos(job: Job, data: "DataSet", name: str) -> tuple[Videos, Videos]:
    """Images of samples and images between them, as far as they are wanted and there."""
    if job.pictures == "none":
        return {}, {}
    keyframes = with_files(name, data.videos(name, sweeps=False))
    if job.pictures == "keyframes" or not keyframes:
        return keyframes, {}
    return keyframes, with_files(name, between_samples(keyframes, data.videos(name, sweeps=True)))


def _key(job: Job, scene: str, keyframes: Videos, sweeps: Videos) -> str:
    """Key of everything that decides what is written; sizes of images show those that were rendered anew."""
    sizes = [
        (name, view.path.name, view.path.stat().st_size)
        for videos in (keyframes, sweeps)
        for name, views in videos.items()
        for view in views
    ]
    facts = job.facts.model_dump(mode="json")
    # Another version of OpenCV may write other bytes.
    made_by = [MAKING_VERSION, SCHEMA, cv2.__version__]
    return content_key("sheet", made_by, facts, job.split, scene, job.pictures, job.cell_width_px, sizes)


def _kept(job: Job, scene: str, key: str) -> Sheet | None:
    """The sheet that is there, if it is what would be written, whole."""
    folder = job.folder(scene)
    if sheets_in(folder).get(key, KEY) is None:
        return None
    try:
        return read_sheet(folder).sheet
    except InputError:
        return None


def _make(job: Job, data: "DataSet", name: str, keyframes: Videos, sweeps: Videos) -> Sheet:
    """Write a sheet; it comes last, so that no sheet stands beside pictures of another."""
    folder, scene = job.folder(name), data.scene(name)
    sheet = sheet_of(data, job.split, name, job.facts)
    with writing_to(folder):
        (folder / SHEET_FILE).unlink(missing_ok=True)
        if (folder / _PICTURES_FOLDER).exists():
            shutil.rmtree(folder / _PICTURES_FOLDER)
        if not rounds_fit(folder / ROUNDS_FILE, sheet):
            (folder / ROUNDS_FILE).unlink(missing_ok=True)
    sheet = sheet.model_copy(update=_write_pictures(job, folder, scene, keyframes, sweeps))
    write_json(folder / SHEET_FILE, sheet.model_dump(mode="json", by_alias=True), indent=None)
    return sheet


def rounds_fit(path: Path, sheet: Sheet) -> bool:
    """Whether the rounds of a search can stand beside a sheet; damaged ones would make the sheet unreadable."""
    try:
        trace = RefinementTrace.model_validate(read_kept_json(path))
    except ValidationError:
        return False
    return (trace.schema_version, trace.scene, trace.origin_m) == (SCHEMA, sheet.scene, sheet.origin_m)


def _write_pictures(job: Job, folder: Path, scene: Scene, keyframes: Videos, sweeps: Videos) -> Mapping[str, Any]:
    """Write all pictures; returns the fields of the sheet that describe them."""
    frames = pictured_frames(scene, keyframes, sweeps)
    cells = layout({name: views[0].camera for name, views in keyframes.items()}, job.cell_width_px)
    edges, files = {}, {}
    for pictured in frames:
        path = picture_name(pictured.frame)
        # The sheet, written last, knows each picture's hash.
        write_bytes(folder / path, mosaic(cells, pictured.views), durable=False)
        files[path] = file_sha256(folder / path)
        edges_of_frame = adversary_edges(scene, cells, pictured.views)
        if edges_of_frame:
            edges[str(pictured.frame)] = edges_of_frame
    pictures = tuple(pictured.frame for pictured in frames)
    return {"cameras": cells, "pictures": pictures, "adversary_edges": edges, "files": files}
