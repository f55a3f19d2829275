"""Scenes and roots whose key frames are not half a second apart, and the slow truth of their steps."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmark.geometry import Floats, quaternion_from_yaw
from benchmark.scene import Annotations, Scene
from tests.benchmark.edited_roots import Row as Row
from tests.benchmark.edited_roots import edit, remove_annotations, samples_of

STEP_US = 500_000


def with_key_frames(scene: Scene, frames: Any) -> Scene:
    """The same scene with other frames as key frames, annotated where its tracks are there."""
    frames = np.asarray(frames, np.int64)
    agents, shape = scene.agents, (len(scene.agents), len(frames))
    there = agents.valid[:, frames].any(axis=1)
    assert there.all(), "an object would be without annotations"
    annotations = Annotations(
        position=agents.position[:, frames], rotation=quaternion_from_yaw(agents.yaw[:, frames]),
        size=np.repeat(agents.size[:, None], shape[1], axis=1), valid=agents.valid[:, frames],
        attribute=np.full(shape, "vehicle.moving"), visibility=np.full(shape, 4), num_lidar_pts=np.full(shape, 20),
        num_radar_pts=np.full(shape, 2),
    )  # fmt: skip
    return replace(scene, keyframes=frames, annotations=annotations)


def without_key_frames(scene: Scene, *numbers: int) -> Scene:
    """The same scene, some of its key frames being frames like others."""
    left = np.delete(np.arange(len(scene.keyframes)), numbers)
    known = scene.annotations
    names = ("position", "rotation", "size", "valid", "attribute", "visibility", "num_lidar_pts", "num_radar_pts")
    return replace(
        scene,
        keyframes=scene.keyframes[left],
        annotations=Annotations(**{name: getattr(known, name)[:, left] for name in names}),
    )


def at_other_times(scene: Scene, key_frame_gaps_s: Any) -> Scene:
    """The same poses at other times: the gaps between key frames are given."""
    at = np.concatenate([[0.0], np.cumsum(key_frame_gaps_s)])
    seconds = np.interp(np.arange(len(scene.timestamps_us)), scene.keyframes, at)
    return replace(scene, timestamps_us=scene.timestamps_us[0] + np.rint(seconds * 1e6).astype(np.int64))


def without_sample(root: Path, scene: str, number: int) -> None:
    """Take a sample out of the tables of a root; its sensor rows become sweeps, all links are mended."""
    before, gone, after = (row["token"] for row in samples_of(root, scene)[number - 1 : number + 2])

    def mended(rows: list[Row]) -> list[Row]:
        for one in rows:
            one["next"] = after if one["token"] == before else one["next"]
            one["prev"] = before if one["token"] == after else one["prev"]
        return [one for one in rows if one["token"] != gone]

    def fewer(rows: list[Row]) -> None:
        for one in rows:
            one["nbr_samples"] -= one["name"] == scene

    def sweeps(rows: list[Row]) -> None:
        for one in rows:
            if one["sample_token"] == gone:
                one.update(sample_token=before, is_key_frame=False)

    edit(root, "sample", mended)
    edit(root, "scene", fewer)
    edit(root, "sample_data", sweeps)
    remove_annotations(root, lambda row: bool(row["sample_token"] == gone))


def at_rate(root: Path, factor: float) -> None:
    """All that happens in a root takes so many times as long."""

    def slower(rows: list[Row]) -> None:
        first = min(one["timestamp"] for one in rows)
        for one in rows:
            one["timestamp"] = first + round((one["timestamp"] - first) * factor)

    for name in ("sample", "sample_data", "ego_pose"):
        edit(root, name, slower)


@dataclass
class SlowStep:
    """What is known at a time: the ego's axle, global, and boxes by instance; nothing where it is not known."""

    recorded: bool
    known: bool
    axle: Floats
    boxes: dict[str, Floats]


def slow_steps(scene: Scene, index: int, count: int = 6) -> list[SlowStep]:
    """Steps 0 .. count of a sample by the clock, step by step and object by object."""
    times: NDArray[np.int64] = scene.timestamps_us[scene.keyframes]
    return [_slow_step(scene, times, index, int(times[index]) + number * STEP_US) for number in range(count + 1)]


def _slow_step(scene: Scene, times: NDArray[np.int64], index: int, wanted: int) -> SlowStep:
    on = [number for number, time in enumerate(times) if abs(int(time) - wanted) <= 1000]
    earlier = [number for number, time in enumerate(times) if time <= wanted]
    later = [number for number, time in enumerate(times) if time >= wanted]
    before, after = (on[0], on[0]) if on else (earlier[-1] if earlier else None, later[0] if later else None)
    axle = _between_frames(scene, wanted)
    if before is None or after is None:
        return SlowStep(False, False, axle, {})
    first, last = min(index, before), max(index, after)
    known = all(times[number + 1] - times[number] <= 750_000 for number in range(first, last))
    boxes: dict[str, Floats] = {}
    notes = scene.annotations
    for agent, name in enumerate(scene.agents.ids):
        if not (known and notes.valid[agent, before] and notes.valid[agent, after]):
            continue
        fraction = 0.0 if after == before else (wanted - times[before]) / (times[after] - times[before])
        start, end = notes.position[agent, before], notes.position[agent, after]
        yaws = [2 * np.arctan2(q[3], q[0]) for q in (notes.rotation[agent, before], notes.rotation[agent, after])]
        turn = (yaws[1] - yaws[0] + np.pi) % (2 * np.pi) - np.pi
        boxes[name] = np.array(
            [*(start + fraction * (end - start))[:2], *notes.size[agent, before][:2], yaws[0] + fraction * turn]
        )
    return SlowStep(True, known, axle, boxes)


def _between_frames(scene: Scene, wanted: int) -> Floats:
    poses, times = scene.ego.pose, scene.timestamps_us
    if wanted <= times[0]:
        return np.asarray(poses[0])
    for frame in range(len(times) - 1):
        if times[frame] <= wanted <= times[frame + 1]:
            fraction = (wanted - times[frame]) / (times[frame + 1] - times[frame])
            step = poses[frame + 1] - poses[frame]
            step[2] = (step[2] + np.pi) % (2 * np.pi) - np.pi
            return np.asarray(poses[frame] + fraction * step)
    return np.asarray(poses[-1])
