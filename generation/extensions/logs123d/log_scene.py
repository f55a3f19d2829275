"""A log as a `Scene`: frames, key frames, ego, boxes and cameras, in a place of its own."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from shapely.geometry import MultiPolygon

from benchmark.constants import OFFICIAL_LOCATIONS
from benchmark.datasets.annotated_objects import find_nearest_valid
from benchmark.datasets.scenarionet_map import move_map
from benchmark.datasets.sensors import make_standard_lidar
from benchmark.errors import InputError
from benchmark.geometry import Floats, quaternion_from_yaw, rotation_matrix, yaw_of_quaternion
from benchmark.machine.storage import content_seed, make_token
from benchmark.road_map import RoadMap
from benchmark.scene import Agents, Annotations, LidarMount, Scene
from generation.extensions.logs123d.cameras import Lens, name_missing_views, read_lens
from generation.extensions.logs123d.key_frames import CameraFrames, choose_key_frames, pair_images
from generation.extensions.logs123d.labels import find_category, find_label_class, name_label
from generation.extensions.logs123d.log_files import (
    BOXES,
    EGO,
    LIDAR,
    BoxRows,
    LogTables,
    Table,
    find_map,
    read_boxes,
    read_map_objects,
    to_pose,
)
from generation.extensions.logs123d.poses import IDENTITY, compose, interpolate, invert, shift, to_track
from generation.extensions.logs123d.road_maps import ReadMap, build_road_map, find_extent

NUSCENES: Final = "nuscenes"
_FIRST_US, _LAST_US = 946_684_800_000_000, 4_102_444_800_000_000
"""The years 2000 to 2100."""
_CLOCK_START_US: Final = 1_577_836_800_000_000
_CLOCK_SPAN_S: Final = 300_000_000
_REACH_M: Final = 250.0
"""Of the map, around the ego's path."""
_FARTHEST_M: Final = 3000.0
"""That an object of it reaches beyond that: masks of maps have a pixel for each 0.1 m."""
_MARGIN_M: Final = 20.0
_VISIBLE: Final = 4
"""Fully visible, which is what readers take for nothing known."""
_EGO_BEYOND_US, _EGO_GAP_US = 200_000, 1_500_000
_UNITED_STATES: Final = ("av2", "wod", "nuplan", "pandaset")
_NAMED_BY_COUNTRY: Final = ("us-", "sg-", "boston", "singapore", "las-vegas", "pittsburgh")


@dataclass(frozen=True, slots=True)
class EgoBody:
    """The ego's track and frames: (T,) times, (T, 7) IMU poses, and (7,) poses of its parts in the IMU frame.

    ``base`` is the rear axle on the ground, nuScenes' ego frame.
    """

    times_us: NDArray[np.int64]
    imu: Floats
    rear_axle: Floats
    centre: Floats
    base: Floats

    @classmethod
    def of(cls, table: Table) -> "EgoBody":
        """From a log's file."""
        times, imu = table.times_us(), table.poses("imu_se3")
        if not len(times) or np.isnan(imu).any():
            raise table.damaged("a row has no pose of the ego, or there is none")
        centre, rear_axle = table.pose("center_to_imu_se3"), table.pose("rear_axle_to_imu_se3")
        above_ground = 0.5 * table.number("height") - (centre[2] - rear_axle[2])
        lowered = IDENTITY - [0.0, 0.0, above_ground, 0.0, 0.0, 0.0, 0.0]
        return cls(times, imu, rear_axle, centre, compose(rear_axle, lowered))

    def base_at(self, times_us: NDArray[np.int64]) -> Floats:
        """(N, 7) nuScenes' ego poses at (N,) times, in the log's world."""
        return compose(interpolate(self.imu, self.times_us, times_us), self.base)


@dataclass(frozen=True, slots=True)
class LogCamera:
    """A camera of a log: its file, lens, (R, 7) poses in the world of all rows, and the images that are taken."""

    key: str
    table: Table
    lens: Lens
    in_world: Floats
    images: CameraFrames


@dataclass(frozen=True, slots=True)
class LogScene:
    """A log, ready to be written.

    Attributes:
        log: Where it came from.
        scene: Without cameras, which need the size of their images.
        body: Of the ego.
        cameras: In the order of their names.
        by_m: (3,) how far its world was moved.
        by_us: How much later its times are.
        facts: What it lacks and what was done to it, for ``challenger.json``.
    """

    log: LogTables
    scene: Scene
    body: EgoBody
    cameras: tuple[LogCamera, ...]
    by_m: Floats
    by_us: int
    facts: Mapping[str, Any]


def build_log_scene(log: LogTables, maps: Path | None, *, images: bool) -> LogScene:
    """The scene of a log; what the log lacks is missing and named.

    Raises:
        InputError: If the log is damaged, of a kind that is not known, or no frame can be a sample.
    """
    times = log.times_us()
    body = EgoBody.of(log.others[EGO])
    _require_ego(log, body, times)
    lenses, lacks = _read_lenses(log) if images else ({}, ["images, which were not asked for"])
    wanted = choose_key_frames(times)
    rows = {key: (log.others[key].times_us(), log.rows_of(key)) for key in lenses}
    key_frames, paired, missing = pair_images(times, wanted, rows)
    if not len(key_frames):
        worst = max(missing, key=lambda key: missing[key], default="")
        raise InputError(
            f"{log.folder} has no frame with an image of every camera; {worst} lacks most: import it with --no-images, "
            "or leave it out"
        )
    cameras = tuple(
        LogCamera(key, log.others[key], lens, _place_camera(log.others[key], lens, body), paired[key])
        for key, lens in sorted(lenses.items(), key=lambda item: item[1].name)
    )
    ego = body.base_at(times)
    place, named_after, left_out = _read_place(log, maps, ego)
    by_m = _find_shift(log, place, ego)
    by_us = 0 if _FIRST_US <= times[0] <= _LAST_US else _choose_start_us(log, int(times[0])) - int(times[0])
    road_map = place if place.location in OFFICIAL_LOCATIONS else move_map(place, by_m[:2])
    agents, annotations, unlabelled = _read_objects(log, key_frames, by_m)
    views = {camera.lens.name: camera.lens.view_deg() for camera in cameras}
    lacks += [f"camera that looks {side}" for side in (name_missing_views(views) if cameras else ())]
    lacks += [name for name, there in (("boxes", BOXES in log.others), ("map", named_after is not None)) if not there]
    scene = Scene(
        name=log.text("log_name"),
        token=make_token("scene", log.title),
        description="",
        log=log.text("log_name"),
        vehicle=str(log.others[EGO].metadata.get("vehicle_name", ""))[:100],
        date=datetime.fromtimestamp(times[0] * 1e-6, UTC).date().isoformat() if by_us == 0 else "1970-01-01",
        timestamps_us=times + by_us,
        keyframes=key_frames,
        ego=to_track(shift(ego, by_m)),
        agents=agents,
        annotations=annotations,
        cameras=(),
        lidar=_find_lidar(log, body, lacks),
        road_map=road_map,
    )
    facts = {
        "form": "123d",
        "written_by": f"py123d {log.sync.metadata['version']}",
        "dataset": log.text("dataset"),
        "log": log.title,
        "lacks": lacks,
        "left_out": [*left_out, *(f"{count} boxes {name}" for name, count in sorted(unlabelled.items())), *log.unused],
        "key_frames_without_image": {lenses[key].name: count for key, count in sorted(missing.items()) if count},
        "moved_m": by_m.tolist(),
        "later_us": by_us,
        "views_deg": {name: [round(angle, 3) for angle in view] for name, view in views.items()},
        "redrawn": [camera.lens.name for camera in cameras if camera.lens.project is not None],
    }
    return LogScene(log, scene, body, cameras, by_m, by_us, facts)


def _require_ego(log: LogTables, body: EgoBody, times_us: NDArray[np.int64]) -> None:
    """Refuse a log whose frames begin or end far from its ego's track, or one with gaps: nothing is made up there."""
    log.rows_of(EGO)
    outside_us = max(body.times_us[0] - times_us[0], times_us[-1] - body.times_us[-1])
    longest_us = np.diff(body.times_us).max(initial=0)
    if outside_us > _EGO_BEYOND_US or longest_us > _EGO_GAP_US:
        raise log.others[EGO].damaged(
            f"frames lie up to {max(0, outside_us) * 1e-6:g} s before or behind the ego's track, or it has a gap of "
            f"{longest_us * 1e-6:g} s"
        )


def _read_lenses(log: LogTables) -> tuple[dict[str, Lens], list[str]]:
    """Lenses by key, and what is lacking."""
    found = {key: read_lens(log.others[key]) for key in log.cameras}
    lacks = [f"intrinsics of {key}" for key, lens in found.items() if lens is None]
    lenses = {key: lens for key, lens in found.items() if lens is not None and log.others[key].rows}
    lacks += [f"images of {lens.name}" for key, lens in found.items() if lens is not None and key not in lenses]
    lacks += [] if found else ["cameras"]
    names = Counter(lens.name for lens in lenses.values())
    if names and max(names.values()) > 1:
        raise log.sync.damaged(f"two cameras have the name {names.most_common(1)[0][0]}")
    return lenses, lacks


def _place_camera(table: Table, lens: Lens, body: EgoBody) -> Floats:
    """(R, 7) poses of a camera: the log's own, where it has none the ego's at that time and the camera on it."""
    poses = table.poses("camera_to_global_se3")
    unknown = np.isnan(poses[:, 0])
    composed = compose(interpolate(body.imu, body.times_us, table.times_us()), lens.camera_to_imu)
    return np.where(unknown[:, None], composed, poses)


def _read_place(log: LogTables, maps: Path | None, ego: Floats) -> tuple[RoadMap, str | None, tuple[str, ...]]:
    """The map around the ego's path, what its identifiers are made of (none without a map), and what it leaves out."""
    place, is_nuscenes = log.text("location"), log.text("dataset") == NUSCENES
    location = place if is_nuscenes and place in OFFICIAL_LOCATIONS else _name_location(log)
    path = find_map(log, maps)
    if path is None:
        return RoadMap(location, MultiPolygon()), None, ()
    low, high = ego[:, :2].min(axis=0) - _REACH_M, ego[:, :2].max(axis=0) + _REACH_M
    bounds = (float(low[0]), float(low[1]), float(high[0]), float(high[1]))
    named_after = location if location == place else log.title
    objects = read_map_objects(path, bounds)[1]
    read: ReadMap = build_road_map(
        objects, path=path, location=location, named_after=named_after, only_drivable=is_nuscenes
    )
    # Scenes of one place share its map, of which each brings the objects around it, whole.
    road_map = read.road_map if location == place else read.road_map.near(bounds)
    lowest, highest = find_extent(road_map)
    if (lowest < low - _FARTHEST_M).any() or (highest > high + _FARTHEST_M).any():
        raise InputError(
            f"{path} has an object near {log.folder} that reaches more than {_FARTHEST_M:g} m from it; convert the map "
            "again"
        )
    return road_map, named_after, read.left_out


def _name_location(log: LogTables) -> str:
    """A place for one log alone; the first words tell on which side traffic keeps, where that is known."""
    place = (log.text("location") or "unknown").replace("_", "-")
    known = place.lower().startswith(_NAMED_BY_COUNTRY)
    country = "us-" if not known and log.text("dataset").startswith(_UNITED_STATES) else ""
    return f"{country}{place}-{log.text('dataset')}-{log.text('log_name')}"


def _find_shift(log: LogTables, road_map: RoadMap, ego: Floats) -> Floats:
    """(3,) whole metres to a world near the origin where all of it is positive; nuScenes' own places stay."""
    if road_map.location in OFFICIAL_LOCATIONS:
        return np.zeros(3)
    low = np.minimum(find_extent(road_map)[0], ego[:, :2].min(axis=0))
    if BOXES in log.others:
        centres = read_boxes(log.others[BOXES]).box[:, :2]
        near = centres[(np.abs(centres - ego[0, :2]) < 10 * _REACH_M + np.ptp(ego[:, :2])).all(axis=1)]
        low = np.minimum(low, near.min(axis=0, initial=np.inf))
    return np.array([*(_MARGIN_M - np.floor(low)), 0.0])


def _choose_start_us(log: LogTables, first_us: int) -> int:
    """A time in the years from 2020 for logs without a calendar, a whole number of seconds later than theirs."""
    start_s = _CLOCK_START_US // 1_000_000 + content_seed("123d clock", log.title) % _CLOCK_SPAN_S
    return start_s * 1_000_000 + first_us % 1_000_000


def _find_lidar(log: LogTables, body: EgoBody, lacks: list[str]) -> LidarMount:
    """Where the highest lidar sits, with nuScenes' axes (+y ahead), which plans are given in; else nuScenes' place."""
    mounts = []
    for key, table in sorted(log.others.items()):
        if key.startswith(LIDAR):
            given = [table.metadata, *table.metadata.values()]
            poses = [one["lidar_to_imu_se3"] for one in given if isinstance(one, dict) and "lidar_to_imu_se3" in one]
            mounts += [to_pose(pose, f"{table.path}: its lidar_to_imu_se3") for pose in poses]
    if not mounts:
        lacks.append("lidar: its frame is where nuScenes' lidar sits")
        return make_standard_lidar()
    mount = compose(invert(body.base), max(mounts, key=lambda pose: pose[2]))
    points_ahead = rotation_matrix(mount[3:])[0, 1] > np.cos(np.pi / 4)
    return LidarMount(mount[:3], mount[3:] if points_ahead else quaternion_from_yaw(np.array(-np.pi / 2)))


def _read_objects(
    log: LogTables, key_frames: NDArray[np.int64], by_m: Floats
) -> tuple[Agents, Annotations, Counter[str]]:
    """Objects at all frames and key frames, and how many boxes of which labels nuScenes has no category for."""
    frames, unlabelled = log.sync.rows, Counter[str]()
    if BOXES not in log.others:
        boxes, rows, categories = _NO_BOXES, np.full(frames, -1, np.int64), {}
    else:
        table = log.others[BOXES]
        boxes, rows = read_boxes(table), log.rows_of(BOXES)
        table.times_us()
        categories = _name_categories(table, boxes, unlabelled)
    frame_of = {row: frame for frame, row in enumerate(rows.tolist()) if row >= 0}
    at = np.array([frame_of.get(row, -1) for row in boxes.row.tolist()], np.int64)
    sampled = {boxes.track[one] for one in np.flatnonzero(np.isin(at, key_frames)).tolist()}
    ids = [track for track in dict.fromkeys(boxes.track) if track in sampled and track in categories]
    number = {track: place for place, track in enumerate(ids)}
    agent = np.array([number.get(track, -1) for track in boxes.track], np.int64)
    used = np.flatnonzero((agent >= 0) & (at >= 0))
    if len(np.unique(np.stack([agent[used], at[used]]), axis=1).T) < len(used):
        raise log.others[BOXES].damaged("a track has two boxes in one frame")
    held = np.zeros((len(ids), frames, 10))
    points = np.zeros((len(ids), frames), np.int64)
    valid = np.zeros((len(ids), frames), np.bool_)
    place = agent[used], at[used]
    held[place], valid[place] = boxes.box[used], True
    held[..., :3] += by_m
    # Nothing known counts as seen: evaluators drop boxes without points.
    points[place] = np.where(boxes.points[used] < 0, 1, boxes.points[used])
    nearest = find_nearest_valid(valid) if len(ids) else np.zeros((0, frames), np.int64)
    filled = np.take_along_axis(held, nearest[..., None], axis=1)
    agents = Agents(
        ids=tuple(ids),
        categories=tuple(categories[track] for track in ids),
        position=filled[..., :3],
        yaw=yaw_of_quaternion(filled[..., 3:7]) if len(ids) else np.zeros((0, frames)),
        size=np.median(filled[..., 7:], axis=1),
        valid=valid,
    )
    at_key_frames = filled[:, key_frames]
    shape = at_key_frames.shape[:2]
    annotations = Annotations(
        position=at_key_frames[..., :3],
        rotation=at_key_frames[..., 3:7],
        size=at_key_frames[..., 7:],
        valid=valid[:, key_frames],
        attribute=np.full(shape, "", dtype=np.str_),
        visibility=np.full(shape, _VISIBLE, np.int64),
        num_lidar_pts=points[:, key_frames],
        num_radar_pts=np.zeros(shape, np.int64),
    )
    return agents, annotations, unlabelled


_NO_BOXES: Final = BoxRows(
    np.zeros(0, np.int64), np.zeros((0, 10)), [], np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros(0, np.int64)
)


def _name_categories(table: Table, boxes: BoxRows, unlabelled: Counter[str]) -> dict[str, str]:
    """Category by track; a track's most frequent label is its label, its median length its length."""
    label_class = find_label_class(table)
    places: dict[str, list[int]] = {}
    for place, track in enumerate(boxes.track):
        places.setdefault(track, []).append(place)
    categories = {}
    for track, its in places.items():
        codes = Counter(boxes.label[its].tolist())
        code = min(codes, key=lambda one: (-codes[one], one))
        name, kind = name_label(label_class, code, table)
        category = find_category(label_class, name, kind, float(np.median(boxes.box[its, 7])))
        if category is None:
            unlabelled[name] += len(its)
        else:
            categories[track] = category
    return categories


def with_cameras(log_scene: LogScene, sizes: Mapping[str, tuple[int, int]]) -> Scene:
    """The scene with its cameras, whose images have some sizes by name."""
    cameras = (camera.lens.to_camera(sizes[camera.lens.name], log_scene.body.base) for camera in log_scene.cameras)
    return replace(log_scene.scene, cameras=tuple(cameras))
