"""A session that is over as a scene of ours, with what the adversary decided and whether a careful human survives it.

The scene is that which the other simulator showed: its ego where it was told, everybody else where they were answered.
Written as a data set (`SessionWriter`), all that is done with adversarial scenes can be done with it.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, Final

import numpy as np

from benchmark.closed_loop.reference_drivers import simulate_reference_drivers
from benchmark.closed_loop.simulation_config import build_simulation_config
from benchmark.constants import EGO_CENTER_FROM_REAR_AXLE_M, FRAMES_PER_KEYFRAME, OFFICIAL_LOCATIONS
from benchmark.datasets.scenarionet_map import move_map
from benchmark.extensions.alpasim.poses import SECOND_US
from benchmark.extensions.alpasim.traffic.session_log import EGO
from benchmark.extensions.alpasim.traffic.session_scene import annotate
from benchmark.extensions.alpasim.traffic.session_world import SessionWorld
from benchmark.geometry import Floats, quaternion_from_yaw, yaw_of_quaternion
from benchmark.interactions.reaction import Driver
from benchmark.scene import Scene

SessionWriter = Callable[[Scene, dict[str, Any]], None]
"""Takes the scene of a session, and its report as plain JSON."""
_SHORTEST_KEYFRAMES: Final = 3
_MARGIN_M: Final = 100.0
"""Around what happened, so that no coordinate is negative."""


def build_session_scene(world: SessionWorld) -> Scene | None:
    """What happened in a session, in the frame of its map; ``None`` of one that was over at once."""
    count = int(np.searchsorted(world.scene.timestamps_us, world.reached_us, side="right"))
    count = (count - 1) // FRAMES_PER_KEYFRAME * FRAMES_PER_KEYFRAME + 1
    if count <= (_SHORTEST_KEYFRAMES - 1) * FRAMES_PER_KEYFRAME:
        return None
    scene = world.scene.first_frames(count)
    agents, times = scene.agents, scene.timestamps_us
    position, yaw, valid = agents.position.copy(), agents.yaw.copy(), np.zeros(agents.valid.shape, np.bool_)
    for row in range(len(agents)):
        for frame, time_us in enumerate(times.tolist()):
            placed = world.place(row, time_us)
            if placed is not None:
                flat = np.array([*placed[0][:2], float(yaw_of_quaternion(placed[1]))])
                x, y, yaw[row, frame] = world.frame.to_map(flat)
                position[row, frame], valid[row, frame] = (x, y, placed[0][2]), True
    driven = replace(agents, position=position, yaw=yaw, valid=valid)
    ego = np.array([world.ego_at(time_us) for time_us in times.tolist()])
    heading = np.column_stack([np.cos(ego[:, 2]), np.sin(ego[:, 2])])
    axle = np.column_stack([ego[:, :2] - EGO_CENTER_FROM_REAR_AXLE_M * heading, scene.ego.position[:, 2]])
    track = world.adversary
    return replace(
        scene,
        ego=replace(scene.ego, position=axle, rotation=quaternion_from_yaw(ego[:, 2])),
        agents=driven,
        annotations=annotate(driven, scene.keyframes),
        adversaries=() if track is None or len(track.poses) < 2 else (agents.ids[track.agent],),
    )


def is_survived(world: SessionWorld, scene: Scene) -> bool | None:
    """Whether a careful human on the ego's path, from the hand-over on, touches nobody; all answer it as they did."""
    start = int(np.searchsorted(scene.timestamps_us[scene.keyframes], world.log.handover_us))
    if start >= len(scene.keyframes) - 1:
        return None
    course = build_simulation_config(scene, policy=world.policy, keyframe=start)
    return simulate_reference_drivers(scene, course, [Driver.CC])[Driver.CC].survives


def report_of(world: SessionWorld, scene: Scene) -> dict[str, Any]:
    """What is told of a session beside its scene; times are seconds from the hand-over."""
    track = world.adversary
    names, times = world.scene.agents.ids, world.scene.timestamps_us
    decisions = () if track is None else track.replanned
    return {
        "scene_id": world.log.scene_id,
        "seed": int(world.log.seed),
        "adversary": None if track is None else names[track.agent],
        "chosen": "by name" if world.scene.adversaries else "by what it can do",
        "decisions": [
            {"seconds": _since(world, int(times[each.frame])), "score": each.score, "braked": each.braked}
            for each in decisions
        ],
        "touched": [
            {"who": [one, other], "seconds": _since(world, at_us)} for (one, other), at_us in world.touched.items()
        ],
        "ego_touched": any(EGO in pair for pair in world.touched),
        "careful_human_survives": is_survived(world, scene),
        "plans": len(world.planned_s),
        "map": "given" if world.frame.road_map.location else "estimated from the tracks",
    }


def _since(world: SessionWorld, time_us: int) -> float:
    return round((time_us - world.log.handover_us) / SECOND_US, 3)


def place_on_map(scene: Scene) -> Scene:
    """The scene where no coordinate is negative, on a map with a name that nuScenes' tools accept."""
    if scene.road_map.location:
        return scene
    everything = np.concatenate([scene.ego.position[:, :2], scene.agents.position[scene.agents.valid][:, :2]])
    shift = np.ceil(_MARGIN_M - everything.min(axis=0))
    width, height = (float(value) for value in np.ceil(everything.max(axis=0) + shift + _MARGIN_M))
    road_map = replace(move_map(scene.road_map, shift), location=OFFICIAL_LOCATIONS[0], canvas_m=(width, height))
    agents = replace(scene.agents, position=_shift(scene.agents.position, shift))
    return replace(
        scene,
        road_map=road_map,
        ego=replace(scene.ego, position=_shift(scene.ego.position, shift)),
        agents=agents,
        annotations=annotate(agents, scene.keyframes),
    )


def _shift(position: Floats, shift: Floats) -> Floats:
    return np.asarray(position + [*shift, 0.0])


class SessionRecorder:
    """Records sessions one after the other, beside those that go on; ``close`` waits for the last."""

    def __init__(self, write: SessionWriter, notify: Callable[[str], None]) -> None:
        self._write, self._notify = write, notify
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="sessions")

    def record(self, world: SessionWorld) -> None:
        """Take a session that is over."""
        self._thread.submit(self._record, world)

    def close(self) -> None:
        """Wait until all are written."""
        self._thread.shutdown(wait=True)

    def _record(self, world: SessionWorld) -> None:
        try:
            scene = build_session_scene(world)
            if scene is None:
                self._notify(f"session of {world.scene.name} is too short to be kept")
                return
            self._write(place_on_map(scene), report_of(world, scene))
        except Exception as error:
            self._notify(f"session of {world.scene.name} could not be kept: {type(error).__name__}: {error}")
