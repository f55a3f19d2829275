"""A scene on a timeline: frames, boxes with the adversary marked, cameras with their images, the map."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.constants import EGO_BODY_WIDTH_M, EGO_CENTER_FROM_REAR_AXLE_M, EGO_HEIGHT_M, EGO_LENGTH_M
from benchmark.errors import InputError
from benchmark.extensions.mcap.timeline import EGO_FRAME, MAP, Primitives, Timeline
from benchmark.geometry import Bools, Floats, quaternion_from_yaw
from benchmark.planning import CameraView
from benchmark.report.palette import ADVERSARY, EGO, FAINT_INK, RULE
from benchmark.scene import Scene
from benchmark.untrusted.files import PICTURE, read_file

ADVERSARY_TOPIC: Final = "/adversary/track"
_OTHER_BOXES: Final = (120, 140, 175)
_MAP_MARGIN_M: Final = 60.0
_FORMATS: Final = {".jpg": "jpeg", ".jpeg": "jpeg", ".png": "png", ".webp": "webp"}
Images = Mapping[str, Sequence[CameraView]]


def add_scene(timeline: Timeline, make: Primitives, scene: Scene, images: Images, facts: "SceneLabels") -> None:
    """Everything of a scene that no planner has said."""
    start = find_start(scene, images)
    _add_frames(timeline, make, scene, start)
    _add_boxes(timeline, make, scene)
    _add_map(timeline, make, scene, start)
    _add_adversaries(timeline, make, scene, start, facts)
    _add_images(timeline, make, images)


class SceneLabels:
    """Launch frames of adversaries by instance, and what the first of them does, in words."""

    def __init__(self, launches: Mapping[str, int], manoeuvre: str | None) -> None:
        self.launches, self.manoeuvre = launches, manoeuvre


def find_start(scene: Scene, images: Images) -> int:
    """Microseconds of the first message: frames must be known before the first image."""
    first = [int(scene.timestamps_us[0]), *(int(view.timestamp_us) for views in images.values() for view in views[:1])]
    return min(first)


def _add_frames(timeline: Timeline, make: Primitives, scene: Scene, start: int) -> None:
    fixed = [(camera.name.lower(), camera.translation, camera.rotation) for camera in scene.cameras]
    for frame, time_us in enumerate(scene.timestamps_us):
        moved = make.transform(time_us, MAP, EGO_FRAME, scene.ego.position[frame], scene.ego.rotation[frame])
        timeline.add(time_us, "/tf", make.messages.FrameTransforms(transforms=[moved]))
    for time_us in sorted({start, *scene.timestamps_us[scene.keyframes].tolist()}):
        cameras = [make.transform(time_us, EGO_FRAME, child, where, turned) for child, where, turned in fixed]
        if time_us == start and start < scene.timestamps_us[0]:
            cameras.append(make.transform(start, MAP, EGO_FRAME, scene.ego.position[0], scene.ego.rotation[0]))
        if cameras:
            timeline.add(time_us, "/tf", make.messages.FrameTransforms(transforms=cameras))
    centre = np.array([EGO_CENTER_FROM_REAR_AXLE_M, 0.0, EGO_HEIGHT_M / 2])
    size = np.array([EGO_LENGTH_M, EGO_BODY_WIDTH_M, EGO_HEIGHT_M])
    pose = make.pose(centre, np.array([1.0, 0.0, 0.0, 0.0]))
    first = int(scene.timestamps_us[0])
    body = make.entity(first, "ego", EGO_FRAME, cubes=[make.cube(pose, size, make.colour(EGO, 0.8))])
    timeline.add(first, "/ego", make.update([body]))


def _add_boxes(timeline: Timeline, make: Primitives, scene: Scene) -> None:
    """Every object of every frame; one that is gone is deleted, since viewers keep what they were told."""
    agents, adversaries, pair = scene.agents, set(scene.adversaries), make.messages.KeyValuePair
    speeds = compute_speeds(agents.position[..., :2], agents.valid, scene.seconds)
    # Tens of thousands of boxes: what does not change is made once, and digits that nobody needs are not stored.
    poses = _shorten(np.concatenate([agents.position, quaternion_from_yaw(agents.yaw)], axis=2))
    tenths = np.round(10 * speeds).astype(np.int64)
    speed_pairs = {tenth: pair(key="speed", value=f"{tenth / 10:.1f}") for tenth in np.unique(tenths).tolist()}
    colours = [make.colour(ADVERSARY if name in adversaries else _OTHER_BOXES, 0.6) for name in agents.ids]
    sizes = [make.vector(size) for size in agents.size]
    facts = [
        [
            pair(key="category", value=category),
            pair(key="instance", value=name),
            pair(key="adversary", value="true" if name in adversaries else "false"),
        ]
        for name, category in zip(agents.ids, agents.categories, strict=True)
    ]
    vector, quaternion, pose = make.messages.Vector3, make.messages.Quaternion, make.messages.Pose
    cube, entity = make.messages.CubePrimitive, make.messages.SceneEntity
    there = np.zeros(len(agents), np.bool_)
    for frame, time_us in enumerate(scene.timestamps_us):
        now, stamp = agents.valid[:, frame], make.time(time_us)
        rows, entities = np.flatnonzero(now), []
        for row, tenth, (x, y, z, qw, qx, qy, qz) in zip(
            rows.tolist(), tenths[rows, frame].tolist(), poses[rows, frame].tolist(), strict=True
        ):
            place = pose(position=vector(x=x, y=y, z=z), orientation=quaternion(x=qx, y=qy, z=qz, w=qw))
            box = cube(pose=place, size=sizes[row], color=colours[row])
            said = [*facts[row], speed_pairs[tenth]]
            entities.append(
                entity(timestamp=stamp, frame_id=MAP, id=agents.ids[row], frame_locked=True, metadata=said, cubes=[box])
            )
        gone = [make.deletion(time_us, agents.ids[row]) for row in np.flatnonzero(there & ~now)]
        timeline.add(time_us, "/annotations", make.update(entities, gone))
        there = now


def _shorten(values: Floats) -> Floats:
    """Nearest multiples of half a millionth, whose last bits are zeros, which compress."""
    return np.asarray(np.round(values * 2.0**21) / 2.0**21)


def compute_speeds(position: Floats, valid: Bools, seconds: Floats) -> Floats:
    """(N, T) m/s from (N, T, 2) metres: to the next frame, at the last of a stretch from the one before, else 0."""
    known = valid[:, :-1] & valid[:, 1:]
    steps = np.linalg.norm(np.diff(position, axis=1), axis=2) / np.diff(seconds)
    speeds = np.zeros(valid.shape)
    speeds[:, 1:][known] = steps[known]
    speeds[:, :-1][known] = steps[known]
    return speeds


def _add_map(timeline: Timeline, make: Primitives, scene: Scene, start: int) -> None:
    path = scene.ego.position[:, :2]
    (left, low), (right, high) = path.min(axis=0) - _MAP_MARGIN_M, path.max(axis=0) + _MAP_MARGIN_M
    near = scene.road_map.near((left, low, right, high))
    ground = float(np.median(scene.ego.position[:, 2]))

    def lift(points: Any) -> Floats:
        planar = np.asarray(points, np.float64)[:, :2]
        return np.column_stack([planar, np.full(len(planar), ground)])

    rings = [ring for part in near.drivable_area.geoms for ring in (part.exterior, *part.interiors)]
    edge, paint = make.colour(FAINT_INK), make.colour(RULE)
    lines = [make.line(lift(ring.coords), edge, 0.15, closed=True) for ring in rings]
    lines += [make.line(lift(divider.line), paint, 0.1) for divider in near.dividers]
    if lines:
        timeline.add(start, "/map", make.update([make.entity(start, "map", lines=lines)]))


def _add_adversaries(timeline: Timeline, make: Primitives, scene: Scene, start: int, facts: SceneLabels) -> None:
    """The whole track of each adversary, at the beginning and when it takes over."""
    colour = make.colour(ADVERSARY)
    for name in scene.adversaries:
        if name not in scene.agents.ids:
            continue
        row = scene.agents.ids.index(name)
        track = scene.agents.position[row][scene.agents.valid[row]]
        launch = facts.launches.get(name)
        times = [start] if launch is None else [start, int(scene.timestamps_us[launch])]
        if not len(track):
            continue
        words = f"adversary: {facts.manoeuvre or 'vehicle'}"
        for time_us in times:
            parts: dict[str, Any] = {
                "lines": [make.line(track, colour, 0.3)],
                "texts": [make.text(words, track[0], colour)],
            }
            timeline.add(time_us, ADVERSARY_TOPIC, make.update([make.entity(time_us, f"track {name}", **parts)]))
        if launch is not None:
            timeline.add(times[-1], "/log", make.log(times[-1], "Info", f"{words} takes over ({name})", "scene"))


def _add_images(timeline: Timeline, make: Primitives, images: Images) -> None:
    for name, views in images.items():
        frame, topic = name.lower(), f"/{name.lower()}"
        for view in views:
            time_us, camera = int(view.timestamp_us), view.camera
            intrinsic = np.asarray(camera.intrinsic, np.float64)
            calibration = make.messages.CameraCalibration(
                timestamp=make.time(time_us),
                frame_id=frame,
                width=camera.width,
                height=camera.height,
                K=intrinsic.ravel().tolist(),
                R=np.eye(3).ravel().tolist(),
                P=np.column_stack([intrinsic, np.zeros(3)]).ravel().tolist(),
            )
            timeline.add(time_us, f"{topic}/camera_info", calibration)

            def load(path: Path = view.path, time_us: int = time_us, frame: str = frame) -> Any:
                data = read_file(path, PICTURE)
                kind = _FORMATS[path.suffix.lower()]
                return make.messages.CompressedImage(
                    timestamp=make.time(time_us), frame_id=frame, data=data, format=kind
                )

            timeline.add_later(time_us, f"{topic}/image_rect_compressed", load)


def require_images(scene: str, images: Images) -> Images:
    """The images, none where none of their files is there; `InputError` if some are, or a viewer knows no such file."""
    paths = [view.path for views in images.values() for view in views]
    missing = [path for path in paths if not path.is_file()]
    if missing and len(missing) == len(paths):
        return {}
    if missing:
        raise InputError(
            f"image {missing[0]} of scene {scene} is missing; complete the data set, or leave images out with --images "
            "none"
        )
    for path in paths:
        if path.suffix.lower() not in _FORMATS:
            raise InputError(f"image {path} is none that viewers show ({', '.join(_FORMATS)}); use --images none")
    return images
