"""Data sets in nuScenes format, through the devkit, one scene at a time."""

import functools
from collections import Counter, OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Self

from shapely.geometry import MultiPolygon

from benchmark.constants import LIDAR_NAME
from benchmark.datasets.annotated_objects import AnnotationCount, read_objects
from benchmark.datasets.can_bus import CanBus
from benchmark.datasets.categories import KNOWN, LIDAR_PLACE, SENSOR, CategoryNames
from benchmark.datasets.devkit import OpenTables, open_tables
from benchmark.datasets.drawn_later import Artist
from benchmark.datasets.fingerprint import compute_fingerprint
from benchmark.datasets.map_layers import find_expansion_file, read_road_map
from benchmark.datasets.observations import read_observations
from benchmark.datasets.sample_truth import compute_truth
from benchmark.datasets.scene_assessments import read_assessments
from benchmark.datasets.scene_facts import build_scene_facts
from benchmark.datasets.scene_names import PROVENANCE, find_name_fault, rename_scenes
from benchmark.datasets.schema import FaultList
from benchmark.datasets.sensors import read_cameras, read_lidar, read_sweep_poses, read_videos
from benchmark.datasets.split_names import list_split_names, read_splits, select_scenes
from benchmark.datasets.split_reviews import read_root_review
from benchmark.datasets.steps import list_samples, read_timeline
from benchmark.datasets.tables import Row, find_version
from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import content_key, read_json
from benchmark.planning import CameraView, Observation
from benchmark.records.review import SplitReview, read_review
from benchmark.records.run_schema import SceneFacts
from benchmark.records.scene_assessment import SceneAssessment
from benchmark.road_map import Handedness, RoadMap
from benchmark.scene import Scene
from benchmark.truth import SampleTruth

MAP_MARGIN_M: Final = 120.0
"""A scene's map reaches this far around everything that the ego visits."""
_CACHED_SCENES: Final = 4


class NuScenesData:
    """One root in nuScenes format.

    `InputError` is raised by all methods for a scene or split that does not exist, or rows that are broken.
    """

    def __init__(self, tables: OpenTables, root: Path, version: str, name: str) -> None:
        self.root = root
        self.version = version
        self.name = name
        self.categories = tables.categories
        self.driving_side: Handedness | None = None
        self._tables = tables
        self._rows: dict[str, Row] = {row["name"]: row for row in tables.rows("scene")}
        self._logs: dict[str, Row] = {row["token"]: row for row in tables.rows("log")}
        self._splits = read_splits(root, version)
        self._provenance = _read_provenance(root / version / PROVENANCE, set(self._rows))
        self._artist = Artist.of(root, self._provenance)
        self._verdicts = read_review(root)
        self._scenes: OrderedDict[str, Scene] = OrderedDict()
        self._maps: dict[str, RoadMap] = {}
        self._fingerprint: str | None = None
        self._judged: dict[str, tuple[SceneAssessment, ...]] | None = None

    @classmethod
    def open(
        cls,
        root: Path,
        *,
        version: str | None = None,
        name: str | None = None,
        rates: FaultList | None = None,
        categories: Mapping[str, str] | None = None,
    ) -> Self:
        """Open a data set: any version folder, any scene names, with or without CAN bus, lidar or image files.

        ``root`` contains the version folder, which is needed only where there are several; ``name`` is the root's name
        by default. ``rates`` gets scenes whose keyframes are not half a second apart; ``categories`` is as of
        `benchmark.datasets.categories.read_names`. Refuses a table that is missing, broken, or links to nothing.
        """
        root = Path(root)
        version = find_version(root, version)
        return cls(open_tables(root, version, rates, categories), root, version, name or root.resolve().name)

    def __reduce__(self) -> tuple[Any, ...]:
        """Travel to another process as a path; each process loads the tables once."""
        return _reopen, (str(self.root), self.version, self.name, self.categories, self.driving_side)

    def with_categories(self, categories: CategoryNames) -> Self:
        """The same root with other names of categories replaced."""
        if categories == self.categories:
            return self
        named = type(self).open(self.root, version=self.version, name=self.name, categories=dict(categories))
        return named.with_driving_side(self.driving_side)

    def with_driving_side(self, side: Handedness | None) -> Self:
        """The same root where traffic keeps to a side, as the user states; ``None``: it has to be found."""
        # Not `copy`, which goes by `__reduce__`.
        sided = object.__new__(type(self))
        sided.__dict__ |= self.__dict__ | {"driving_side": side, "_scenes": OrderedDict()}
        return sided

    def annotation_counts(self, names: Sequence[str]) -> dict[str, AnnotationCount]:
        """Number of annotations of scenes, and those of no nuScenes category; scenes are read only for the latter."""
        foreign = {row["name"] for row in self._tables.rows("category")} - KNOWN
        counts = {}
        for name in names:
            row = self._row(name)
            by_category = self._tables.annotations_by_category(row) if foreign else Counter()
            unknown = {category: count for category, count in by_category.items() if category in foreign}
            counts[name] = AnnotationCount(self._tables.annotation_count(row), unknown)
        return counts

    def splits(self) -> dict[str, tuple[str, ...]]:
        """Splits that ``splits.json`` defines (in the version folder or in the root), scene names by split."""
        return dict(self._splits)

    def split_names(self) -> tuple[str, ...]:
        """Names of all splits, of ``splits.json`` or by the rules of `select_scenes`."""
        return list_split_names(tuple(self._rows), self._splits, self._find_built_split)

    def scene_names(self, split: str | None = None) -> tuple[str, ...]:
        """Sorted names of all scenes, or of a split by the rules of `select_scenes`, in which no rejected scene is."""
        return tuple(sorted(self._rows)) if split is None else self.review(split).kept(self._listed(split))

    def review(self, split: str | None = None) -> SplitReview:
        """Verdicts of inspectors on a split (`benchmark.records.review`); without a split, on all scenes."""
        names = tuple(sorted(self._rows)) if split is None else self._listed(split)
        tokens = {name: str(self._rows[name]["token"]) for name in names}
        return read_root_review(self.root, tokens, self._provenance, split, self._verdicts)

    def _listed(self, split: str) -> tuple[str, ...]:
        """Scenes of a split, with any verdict of inspectors or none."""
        present = tuple(sorted(self._rows))
        return select_scenes(split, present, self._splits, where=str(self.root), built_as=self._find_built_split)

    @property
    def _find_built_split(self) -> str | None:
        return self._provenance.get("split") if self._provenance else None

    def scene(self, name: str) -> Scene:
        """Read one scene, at 12 Hz from the first to the last keyframe; the last few are kept in memory.

        Its map is cropped to 120 m around the ego's path, and empty where the data set has no map expansion for its
        location (see `has_map`).
        """
        if name in self._scenes:
            self._scenes.move_to_end(name)
            return self._scenes[name]
        scene = self._read_scene(self._row(name))
        self._scenes[name] = scene
        if len(self._scenes) > _CACHED_SCENES:
            self._scenes.popitem(last=False)
        return scene

    def observations(self, name: str) -> Iterator[Observation]:
        """Inputs that a planner may see, one observation a sample, in time order."""
        scene, row = self.scene(name), self._row(name)
        nusc = self._devkit(row)
        samples, can_bus = list_samples(nusc, row), CanBus.read(self.root, name)
        yield from read_observations(nusc, self.root, scene, samples, can_bus, self._artist)

    def videos(self, name: str, *, sweeps: bool) -> dict[str, tuple[CameraView, ...]]:
        """Camera images of a scene by camera name, in time order (`read_videos`); opened only when a view is loaded.

        ``sweeps`` adds the images between keyframes. What is drawn later (`benchmark.datasets.drawn_later`) is drawn.
        """
        row = self._row(name)
        nusc = self._devkit(row)
        videos = read_videos(nusc, self.root, list_samples(nusc, row), sweeps=sweeps)
        if self._artist is not None:
            self._artist.draw(row["name"], (view.path for views in videos.values() for view in views), sweeps=sweeps)
        return videos

    def truth(self, name: str) -> tuple[SampleTruth, ...]:
        """Recorded truth of each sample, in time order."""
        row = self._row(name)
        samples = list_samples(self._devkit(row), row)
        return compute_truth(self.scene(name), [sample["token"] for sample in samples])

    def keyframe_rows(self, name: str) -> dict[str, str]:
        """Sample tokens by the tokens of their keyframe rows in ``sample_data.json``, one per sample and sensor."""
        row = self._row(name)
        samples = list_samples(self._devkit(row), row)
        return {token: sample["token"] for sample in samples for token in sample["data"].values()}

    def has_map(self, name: str) -> bool:
        """Whether there is a map expansion file for the location of a scene."""
        return find_expansion_file(self.root, self._log(self._row(name))["location"]) is not None

    def has_lidar(self, name: str) -> bool:
        """Whether it is said where the lidar of a scene sits (`make_standard_lidar` is taken where it is not)."""
        row = self._row(name)
        return LIDAR_PLACE in dict(self.categories) or LIDAR_NAME in list_samples(self._devkit(row), row)[0]["data"]

    def fingerprint(self) -> str:
        """Content hash of tables, maps and file manifest (`compute_fingerprint`), 64 hexadecimal digits.

        Names that were replaced are content, too: planners go by those of cameras and categories. Images that are drawn
        later are not: they are not there yet.
        """
        if self._fingerprint is None:
            images = () if self._artist else self._tables.keyframe_images()
            fingerprint = compute_fingerprint(self.root, self.version, images)
            replaced = tuple((name, to) for name, to in self.categories if name != f"{SENSOR}{to}")
            self._fingerprint = content_key("categories", fingerprint, replaced) if replaced else fingerprint
        return self._fingerprint

    def provenance(self) -> dict[str, Any] | None:
        """Report on how the data set was made (``challenger.json`` in the version folder), or ``None`` without one."""
        return self._provenance

    def scene_facts(self, names: Sequence[str]) -> dict[str, SceneFacts]:
        """Source of scenes, manoeuvre of their first adversary, judgements, by name (see `build_scene_facts`)."""
        scene_reports = self._provenance["scenes"] if self._provenance else {}
        known = {name: self._row(name) for name in names}
        if self._judged is None:
            self._judged = read_assessments(self.root / self.version)
        judged = self._judged
        return {
            name: build_scene_facts(
                name, scene_reports.get(name, {}), str(row.get("description", "")), judged.get(name, ())
            )
            for name, row in known.items()
        }

    def _row(self, name: str) -> Row:
        if name not in self._rows:
            known_names = ", ".join(sorted(self._rows)[:5]) + (", ..." if len(self._rows) > 5 else "")
            raise InputError(f"{self.root} has no scene {name!r}; it has {len(self._rows)}: {known_names}")
        return self._rows[name]

    def _devkit(self, row: Row) -> Any:
        return self._tables.of_scene(row, self._adversaries(row["name"]))

    def _adversaries(self, name: str) -> tuple[str, ...]:
        report = self._provenance["scenes"].get(name, {}) if self._provenance else {}
        return tuple(report.get("adversaries", ()))

    def _log(self, row: Row) -> Row:
        return self._logs[row["log_token"]]

    def _read_scene(self, row: Row) -> Scene:
        nusc, log = self._devkit(row), self._log(row)
        samples = list_samples(nusc, row)
        timeline = read_timeline(nusc, samples)
        cameras = read_cameras(nusc, samples[0])
        agents, annotations = read_objects(nusc, samples, timeline.keyframes)
        return Scene(
            name=row["name"],
            token=row["token"],
            description=str(row.get("description", "")),
            log=str(log["logfile"]),
            vehicle=str(log.get("vehicle", "")),
            date=str(log.get("date_captured", "")),
            timestamps_us=timeline.timestamps_us,
            keyframes=timeline.keyframes,
            ego=timeline.ego,
            agents=agents,
            annotations=annotations,
            cameras=cameras,
            lidar=read_lidar(nusc, samples[0], dict(self.categories).get(LIDAR_PLACE)),
            road_map=self._map_around(str(log["location"]), timeline.ego.position),
            adversaries=self._adversaries(row["name"]),
            sweep_poses=read_sweep_poses(nusc, samples, timeline.keyframes, [camera.name for camera in cameras]),
            driving_side=self.driving_side,
        )

    def _map_around(self, location: str, position: Floats) -> RoadMap:
        if location not in self._maps:
            path = find_expansion_file(self.root, location)
            self._maps[location] = read_road_map(path, self.categories) if path else RoadMap(location, MultiPolygon())
        low, high = position[:, :2].min(axis=0) - MAP_MARGIN_M, position[:, :2].max(axis=0) + MAP_MARGIN_M
        return self._maps[location].near((float(low[0]), float(low[1]), float(high[0]), float(high[1])))


@functools.lru_cache(maxsize=2)
def _reopen(root: str, version: str, name: str, categories: CategoryNames, side: Handedness | None) -> NuScenesData:
    data = NuScenesData.open(Path(root), version=version, name=name, categories=dict(categories))
    return data.with_driving_side(side)


def _read_provenance(path: Path, scenes: set[str]) -> dict[str, Any] | None:
    if not path.is_file():
        return None
    value = read_json(path)
    scene_reports = value.get("scenes") if isinstance(value, dict) else None
    if not isinstance(value, dict) or not isinstance(scene_reports, dict) or not isinstance(value.get("split"), str):
        raise InputError(f"{path} must be an object with a split and its scenes; write the data set again")
    if wrong := find_name_fault(value):
        raise InputError(f"{path}: {wrong}; write the data set again")
    value = rename_scenes(value)
    scene_reports = value["scenes"]
    for name, entry in scene_reports.items():
        adversaries = entry.get("adversaries", []) if isinstance(entry, dict) else None
        if not isinstance(adversaries, list) or not all(
            isinstance(token, str) and token.isprintable() for token in adversaries
        ):
            raise InputError(f"{path}: scene {name} must be an object with a list of adversaries; write it again")
        if not isinstance(entry.get("source_scene", ""), str):
            raise InputError(f"{path}: the source_scene of {name} must be the name of a scene; write it again")
        if name not in scenes:
            raise InputError(f"{path} names the scene {name}, which is not in scene.json; write the data set again")
    if left_out := sorted(scenes - set(scene_reports)):
        raise InputError(f"{path} leaves out the scene {left_out[0]} of scene.json; write the data set again")
    return value
