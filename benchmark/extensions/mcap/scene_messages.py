"""A scene on a timeline: frames, boxes with the adversary marked, cameras with their images, the map."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from benchmark.extensions.mcap.camera_images import CameraImages, add_images
from benchmark.extensions.mcap.timeline import EGO_FRAME, MAP, Primitives, Timeline
from benchmark.geometry import Bools, Floats, quaternion_from_yaw
from benchmark.report.palette import ADVERSARY, EGO, FAINT_INK, RULE
from benchmark.runs.encounters import find_recorded_agent
from benchmark.scene import Scene

ADVERSARY_TOPIC: Final = "/adversary/track"
_OTHER_BOXES: Final = (120, 140, 175)
_MAP_MARGIN_M: Final = 60.0


@dataclass(frozen=True, slots=True)
class AdversaryFacts:
    """What is known of a scene's adversaries.

    Attributes:
        launches: Frames at which they take over, by instance.
        manoeuvre: Of the first of them, in words.
        recorded: The scene that they were made from, where it is at hand.
    """

    launches: Mapping[str, int]
    manoeuvre: str | None = None
    recorded: Scene | None = None


def add_scene(timeline: Timeline, make: Primitives, scene: Scene, images: CameraImages, facts: AdversaryFacts) -> None:
    """Everything of a scene that no planner has said."""
    # Frames must be known before the first image, which may be earlier than the first frame.
    start = min((int(scene.timestamps_us[0]), *images.first_us))
    _add_frames(timeline, make, scene, start)
    _add_boxes(timeline, make, scene)
    _add_map(timeline, make, scene, start)
    _add_adversaries(timeline, make, scene, start, facts)
    add_images(timeline, make, images)


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
    first = int(scene.timestamps_us[0])
    timeline.add(first, "/ego", make.ego_body(first, EGO_FRAME, EGO, 0.8))


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


def _add_adversaries(timeline: Timeline, make: Primitives, scene: Scene, start: int, facts: AdversaryFacts) -> None:
    """The whole track of each adversary and, thinner, the recorded one, at the beginning and when it takes over."""
    colour, faint = make.colour(ADVERSARY), make.colour(_OTHER_BOXES)
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
        recorded, note = _find_recorded_track(scene, name, facts)
        parts: dict[str, Any] = {
            "lines": [make.line(track, colour, 0.3)],
            "texts": [make.text(words, track[0], colour)],
            "facts": {"recorded track": note},
        }
        if recorded is not None:
            parts["lines"].append(make.line(recorded, faint, 0.1))
            parts["texts"].append(make.text("as recorded", recorded[-1], faint))
        for time_us in times:
            timeline.add(time_us, ADVERSARY_TOPIC, make.update([make.entity(time_us, f"track {name}", **parts)]))
        if launch is not None:
            timeline.add(times[-1], "/log", make.log(times[-1], "Info", f"{words} takes over ({name})", "scene"))


def _find_recorded_track(scene: Scene, name: str, facts: AdversaryFacts) -> tuple[Floats | None, str]:
    """(N, 3) where the adversary went in the recording, and a note that says whether that is known."""
    if facts.recorded is None:
        return None, "not shown: the recording is not at hand"
    launch, there = facts.launches.get(name), facts.recorded.agents
    agent = find_recorded_agent(scene, name, facts.recorded, np.inf if launch is None else scene.seconds[launch])
    if agent is None:
        return None, "none: it is not in the recording"
    return there.position[agent][there.valid[agent]], "the thin line"
