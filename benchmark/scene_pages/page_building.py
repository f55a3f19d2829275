"""The sheet of one scene: its content, its pictures, whether it is there already, and the road around the ego's way."""

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
from benchmark.machine.storage import content_key, file_sha256, read_cached_json, write_bytes, write_json, writing_to
from benchmark.records.attempts import list_stored_labels
from benchmark.records.run_schema import DataFacts
from benchmark.records.scene_pages import (
    ROUNDS_FILE,
    SCHEMA,
    SHEET_FILE,
    PageDivider,
    PageMap,
    Point,
    RefinementTrace,
    Ring,
    ScenePage,
    picture_name,
    read_scene_page,
    scene_folder,
)
from benchmark.records.scene_pages import Polygon as SheetPolygon
from benchmark.records.store import validate_stored
from benchmark.road_map import RoadMap, as_multipolygon
from benchmark.runs.units import ResultStore
from benchmark.scene import Scene
from benchmark.scene_pages.page_pictures import (
    Videos,
    draw_mosaic,
    keep_existing_images,
    lay_out_cameras,
    project_adversary_edges,
    select_pictured_frames,
    select_sweeps,
)
from benchmark.scene_pages.page_tracks import build_agent_tracks, build_ego_track, find_origin

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet

AROUND_M: Final = 70.0
"""The road reaches this far around the ego's way."""
_SIMPLIFIED_M: Final = 0.05
_LEAST_AREA_M2: Final = 0.05


def build_page_map(road_map: RoadMap, way: Floats, origin: Point) -> PageMap:
    """Layers of a map within `AROUND_M` of the ego's global (T, 2) way, simplified to 5 cm and rounded to centimetres.

    Positions become relative to ``origin``. Rings are closed: their last point is their first.
    """
    window = _build_corridor(way)
    near = road_map.near(shapely.bounds(window).tolist())

    def polygons(shapes: Iterable[shapely.Geometry]) -> tuple[SheetPolygon, ...]:
        return tuple(polygon for shape in shapes for polygon in _simplify_polygons(shape, window, origin))

    lines = []
    for divider in near.dividers:
        for points in _simplify_lines(divider.line, window, origin):
            lines.append(PageDivider(points=points, paint=divider.kind.value))
    return PageMap(
        drivable=polygons([near.drivable_area]),
        crossings=polygons(_sort_polygons(near.ped_crossings)),
        walkways=polygons(_sort_polygons(near.walkways)),
        carparks=polygons(_sort_polygons(near.carparks)),
        dividers=tuple(lines),
    )


def _build_corridor(way: Floats) -> Polygon:
    points = MultiPoint(np.unique(way, axis=0))
    line = LineString(way).simplify(1.0) if len(points.geoms) > 1 else points.geoms[0]
    return line.buffer(AROUND_M, quad_segs=4)


def _sort_polygons(layer: dict[str, Polygon]) -> list[Polygon]:
    return [layer[name] for name in sorted(layer)]


def _simplify_polygons(shape: shapely.Geometry, window: Polygon, origin: Point) -> list[SheetPolygon]:
    sound = shape if shape.is_valid else shapely.make_valid(shape)
    simple = shapely.simplify(as_multipolygon(shapely.intersection(sound, window)), _SIMPLIFIED_M)
    polygons = []
    for part in as_multipolygon(simple).geoms:
        if part.area >= _LEAST_AREA_M2:
            holes = [hole for hole in part.interiors if Polygon(hole).area >= _LEAST_AREA_M2]
            polygons.append(tuple(_round_points(ring.coords, origin) for ring in (part.exterior, *holes)))
    return polygons


def _simplify_lines(line: Floats, window: Polygon, origin: Point) -> list[Ring]:
    inside = shapely.simplify(shapely.intersection(LineString(line), window), _SIMPLIFIED_M)
    parts = [part for part in shapely.get_parts(inside) if isinstance(part, LineString) and part.length > 0]
    return [_round_points(part.coords, origin) for part in parts]


def _round_points(points: Sequence[Sequence[float]], origin: Point) -> Ring:
    # Adding zero turns a negative zero into zero.
    places = np.round(np.asarray(points, np.float64)[:, :2] - origin, 2) + 0.0
    return tuple((float(x), float(y)) for x, y in places)


MAKING_VERSION: Final = 2
"""Goes up when the same data set would give another sheet."""
KEY: Final = "key"
"""Name of the file beside a sheet, or the sheet of a split, that says what it was made of."""
_PICTURES_FOLDER: Final = "cameras"


@dataclass(frozen=True, slots=True)
class WrittenPage:
    """Outcome for one scene; ``made`` is whether there was something to do."""

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
class PageJob:
    """Facts that every unit of work needs; picklable.

    ``pictures`` is ``all``, ``keyframes`` or ``none``; ``cell_width_px`` is the width of one camera in a picture.
    """

    root: Path
    facts: DataFacts
    split: str
    pictures: str
    cell_width_px: int

    def folder(self, scene: str) -> Path:
        """Folder of a scene's sheet."""
        return scene_folder(self.root, self.facts.name, self.split, scene)


def open_page_store(folder: Path) -> ResultStore[str]:
    """Sheets written to a folder, by the hash of ``sheet.json``."""
    return ResultStore(folder, str)


def build_page(data: "DataSet", split: str, name: str, facts: DataFacts) -> ScenePage:
    """A scene's sheet without pictures."""
    provenance = data.provenance()
    report = provenance["scenes"].get(name, {}).get("report") if provenance else None
    renderer = provenance.get("renderer") if provenance else None
    drawn_by = renderer.get("name") if isinstance(renderer, dict) else None
    scene = f"{data.root}: scene {name}"
    sheet = validate_stored(
        build_page_to_draw,
        data.scene(name),
        lambda where, why: f"{scene} cannot be shown: its {where} is invalid ({why}); correct the tables",
    )
    return sheet.model_copy(
        update={
            "data": facts,
            "split": split,
            "scene": name,
            "source": data.scene_facts([name])[name].source,
            "labels": tuple(label for label in list_stored_labels(report) if isinstance(label, dict)),
            "sample_tokens": tuple(truth.sample_token for truth in data.truth(name)),
            "drawn_by": drawn_by if isinstance(drawn_by, str) else None,
        }
    )


def build_page_to_draw(scene: Scene) -> ScenePage:
    """Sheet of a scene that is drawn and not stored: no data set, split, labels, sample tokens and pictures.

    A number that is not finite raises `ValidationError`.
    """
    origin = find_origin(scene)
    return ScenePage(
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
        ego=build_ego_track(scene, origin),
        agents=build_agent_tracks(scene, origin),
        road=build_page_map(scene.road_map, scene.ego.position[:, :2], origin),
        cameras=(),
        pictures=(),
        adversary_edges={},
        files={},
    )


def write_page(job: PageJob, data: "DataSet", name: str) -> WrittenPage:
    """One unit of work: a scene's sheet and pictures, if they are not there already."""
    keyframes, sweeps = _find_videos(job, data, name)
    key = _compute_key(job, name, keyframes, sweeps)
    folder = job.folder(name)
    sheet = _find_cached_page(job, name, key)
    is_new = sheet is None
    if sheet is None:
        sheet = _write_page_files(job, data, name, keyframes, sweeps)
        open_page_store(folder).put(key, file_sha256(folder / SHEET_FILE), KEY)
    sizes = [(folder / path).stat().st_size for path in sheet.files]
    return WrittenPage(name, is_new, len(sheet.pictures), (folder / SHEET_FILE).stat().st_size, sum(sizes))


def preview_page(job: PageJob, data: "DataSet", name: str) -> WrittenPage:
    """Outcome that `write_page` would have, without sizes."""
    keyframes, sweeps = _find_videos(job, data, name)
    is_new = _find_cached_page(job, name, _compute_key(job, name, keyframes, sweeps)) is None
    return WrittenPage(name, is_new, len(select_pictured_frames(data.scene(name), keyframes, sweeps)), 0, 0)


def _find_videos(job: PageJob, data: "DataSet", name: str) -> tuple[Videos, Videos]:
    """Images of samples and images between them, as far as they are wanted and there."""
    if job.pictures == "none":
        return {}, {}
    keyframes = keep_existing_images(name, data.videos(name, sweeps=False))
    if job.pictures == "keyframes" or not keyframes:
        return keyframes, {}
    return keyframes, keep_existing_images(name, select_sweeps(keyframes, data.videos(name, sweeps=True)))


def _compute_key(job: PageJob, scene: str, keyframes: Videos, sweeps: Videos) -> str:
    """Key of everything that decides what is written; sizes of images show those that were rendered anew."""
    sizes = [
        (name, view.path.name, view.path.stat().st_size)
        for videos in (keyframes, sweeps)
        for name, views in videos.items()
        for view in views
    ]
    facts = job.facts.model_dump(mode="json")
    # Another version of OpenCV may write different bytes.
    made_by = [MAKING_VERSION, SCHEMA, cv2.__version__]
    return content_key("sheet", made_by, facts, job.split, scene, job.pictures, job.cell_width_px, sizes)


def _find_cached_page(job: PageJob, scene: str, key: str) -> ScenePage | None:
    """The sheet that is there, if it is what would be written, whole."""
    folder = job.folder(scene)
    if open_page_store(folder).get(key, KEY) is None:
        return None
    try:
        return read_scene_page(folder).sheet
    except InputError:
        return None


def _write_page_files(job: PageJob, data: "DataSet", name: str, keyframes: Videos, sweeps: Videos) -> ScenePage:
    """Write a sheet; it comes last, so that no sheet stands beside pictures of another."""
    folder, scene = job.folder(name), data.scene(name)
    sheet = build_page(data, job.split, name, job.facts)
    with writing_to(folder):
        (folder / SHEET_FILE).unlink(missing_ok=True)
        if (folder / _PICTURES_FOLDER).exists():
            shutil.rmtree(folder / _PICTURES_FOLDER)
        if not do_rounds_fit(folder / ROUNDS_FILE, sheet):
            (folder / ROUNDS_FILE).unlink(missing_ok=True)
    sheet = sheet.model_copy(update=_write_pictures(job, folder, scene, keyframes, sweeps))
    write_json(folder / SHEET_FILE, sheet.model_dump(mode="json", by_alias=True), indent=None)
    return sheet


def do_rounds_fit(path: Path, sheet: ScenePage) -> bool:
    """Whether the rounds of a search can stand beside a sheet; damaged ones would make the sheet unreadable."""
    try:
        trace = RefinementTrace.model_validate(read_cached_json(path))
    except ValidationError:
        return False
    return (trace.schema_version, trace.scene, trace.origin_m) == (SCHEMA, sheet.scene, sheet.origin_m)


def _write_pictures(job: PageJob, folder: Path, scene: Scene, keyframes: Videos, sweeps: Videos) -> Mapping[str, Any]:
    """Write all pictures; returns the fields of the sheet that describe them."""
    frames = select_pictured_frames(scene, keyframes, sweeps)
    cells = lay_out_cameras({name: views[0].camera for name, views in keyframes.items()}, job.cell_width_px)
    edges, files = {}, {}
    for pictured in frames:
        path = picture_name(pictured.frame)
        # The sheet is written last because it holds each picture's hash.
        write_bytes(folder / path, draw_mosaic(cells, pictured.views), durable=False)
        files[path] = file_sha256(folder / path)
        edges_of_frame = project_adversary_edges(scene, cells, pictured.views)
        if edges_of_frame:
            edges[str(pictured.frame)] = edges_of_frame
    pictures = tuple(pictured.frame for pictured in frames)
    return {"cameras": cells, "pictures": pictures, "adversary_edges": edges, "files": files}
