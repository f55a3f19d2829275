"""Frozen tracks put into the recorded scenes that they belong to, and hashes of tables and images to compare them."""

import hashlib
from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Final

import numpy as np

from benchmark.errors import InputError
from benchmark.fairness.scene_assessment import AdversaryProvenance
from benchmark.geometry import Floats, wrap_angle
from benchmark.machine.storage import content_key, file_sha256
from benchmark.records.attempts import Approach, Attempt
from benchmark.scene import Scene
from generation.labels.labelling import compute_labels, compute_times_to_collision, find_closest_approach
from generation.nuscenes_writer import DataSetPlan
from generation.nuscenes_writer.numbering import SceneNumber
from generation.nuscenes_writer.plan import SceneNames
from generation.nuscenes_writer.rows import build_channels, build_scene_tables
from generation.nuscenes_writer.scenes import encode_jpeg
from generation.nuscenes_writer.vocabulary import LabelVocabulary
from generation.render.contract import SlowRenderer
from generation.search.driven_tracks import DrivenTracks
from generation.search.ranking import compute_challenge_score
from generation.splits.format import (
    METRE_DIGITS,
    YAW_DIGITS,
    FrozenAdversary,
    FrozenDrive,
    FrozenScene,
    ImageMetadata,
    Pose,
)

SAME_M: Final = 0.01
"""How far the recorded body may be from where the frozen split has it at the launch."""
_ROTATION_DIGITS: Final = 9
"""Sines differ in their last bit between processors; rounded, the tables are the same everywhere."""
_REPORT_DIGITS: Final = 6


def add_frozen_adversaries(frozen: FrozenScene, scene: Scene) -> Scene:
    """A recorded scene with frozen adversaries; refused if its length or a vehicle's place at the launch differs."""
    changed = scene if frozen.driven is None else _put_drive_into(scene, frozen.driven)
    for adversary in frozen.adversaries:
        agent, stop = _find_vehicle(adversary, scene), adversary.launch_frame + len(adversary.track)
        changed = changed.with_adversary(agent, slice(adversary.launch_frame, stop), np.array(adversary.track))
        inside = (scene.keyframes >= adversary.launch_frame) & (scene.keyframes < stop)
        rotation = changed.annotations.rotation
        rotation[agent, inside] = np.round(rotation[agent, inside], _ROTATION_DIGITS) + 0.0
    return changed


def _put_drive_into(scene: Scene, driven: FrozenDrive) -> Scene:
    frames = len(scene.timestamps_us)
    known = all(
        other.instance in scene.agents.ids and other.first_frame + len(other.track) <= frames for other in driven.others
    )
    if len(driven.ego) != frames or not known:
        raise InputError(
            f"{scene.name} does not fit the driven ego of the frozen split; these are not the recordings that it was "
            "made from, choose those with --data"
        )
    others = {other.instance: (other.first_frame, np.array(other.track)) for other in driven.others}
    return DrivenTracks(np.array(driven.ego), others).put_into(scene)


def add_number(frozen: FrozenScene, number: SceneNumber | None) -> FrozenScene:
    """The scene with its name and times in the tables."""
    if number is None:
        return frozen
    return frozen.model_copy(update={"numbered": number.name, "shift_us": number.shift_us})


def find_number(frozen: FrozenScene) -> SceneNumber | None:
    """Name and times of a scene in the tables, if they are not those of older splits."""
    return None if frozen.numbered is None else SceneNumber(frozen.numbered, frozen.shift_us or 0)


def _find_vehicle(adversary: FrozenAdversary, scene: Scene) -> int:
    if adversary.instance not in scene.agents.ids:
        raise InputError(
            f"{scene.name} has no object {adversary.instance}, its adversary in the frozen split; these are "
            "not the recordings that it was made from, choose those with --data"
        )
    agent, start, frames = scene.agents.ids.index(adversary.instance), adversary.launch_frame, len(scene.timestamps_us)
    if start + len(adversary.track) != frames:
        raise InputError(
            f"{scene.name} has {frames} frames but the frozen split needs {start + len(adversary.track)}; these are "
            "not the recordings that it was made from, choose those with --data"
        )
    away = _compute_distance(scene, agent, start, adversary)
    if away > SAME_M:
        raise InputError(
            f"{adversary.instance} in {scene.name} was recorded {away:.3f} m from its position in the frozen split at "
            f"launch (frame {start}); these are not the recordings that it was made from, choose those with --data"
        )
    return agent


def _compute_distance(scene: Scene, agent: int, frame: int, adversary: FrozenAdversary) -> float:
    """Distance of the two bodies, at most, metres: the centres, and what the heading moves the corners."""
    x, y, yaw = adversary.recorded
    position, size = scene.agents.position[agent, frame], scene.agents.size[agent]
    if not scene.agents.valid[agent, frame]:
        return float("inf")
    turned = abs(float(wrap_angle(scene.agents.yaw[agent, frame] - yaw)))
    return float(np.hypot(position[0] - x, position[1] - y) + 0.5 * np.hypot(size[0], size[1]) * turned)


def build_tracks(frozen: FrozenScene) -> AdversaryProvenance:
    """Tracks by which the adversaries of a frozen scene were made: at 12 Hz, and then rounded along both axes."""
    launches = {adversary.instance: adversary.launch_frame for adversary in frozen.adversaries}
    return AdversaryProvenance(
        generated=True, launches=launches, rounded_m=float(np.hypot(0.5, 0.5)) * 10**-METRE_DIGITS
    )


def read_recorded_pose(scene: Scene, agent: int, frame: int) -> Floats:
    """(3,) x, y, yaw of a vehicle as recorded."""
    return np.array([*scene.agents.position[agent, frame, :2], scene.agents.yaw[agent, frame]])


def round_pose(pose: Floats | tuple[float, float, float]) -> Pose:
    """A pose (x, y, yaw) as frozen splits hold it."""
    x, y, yaw = map(float, pose)
    # Adding zero turns -0.0 into 0.0.
    return round(x, METRE_DIGITS) + 0.0, round(y, METRE_DIGITS) + 0.0, round(yaw, YAW_DIGITS) + 0.0


def build_scene_report(frozen: FrozenScene, scene: Scene, seed: int) -> dict[str, Any]:
    """Report on a rebuilt scene for ``challenger.json``, anew from the track; rounded, the same on every machine."""
    reports = [_build_attempt(adversary, frozen.source, scene, seed) for adversary in frozen.adversaries]
    if len(reports) == 1:
        return reports[0]
    challenge = sum(report["challenge"] for report in reports) / len(reports)
    return {"challenge": round(challenge, _REPORT_DIGITS), "adversaries": reports}


def _build_attempt(adversary: FrozenAdversary, source: str, scene: Scene, seed: int) -> dict[str, Any]:
    agent, start = scene.agents.ids.index(adversary.instance), adversary.launch_frame
    closest = find_closest_approach(scene, agent, start)
    soonest = float(compute_times_to_collision(scene, agent, start).min())
    attempt = Attempt(
        scene=source,
        agent=adversary.instance,
        seed=seed,
        kept=True,
        discard=None,
        launch_frame=start,
        challenge=compute_challenge_score(scene, agent, start),
        closest_approach=Approach(gap_m=closest.gap_m, time_s=closest.time_s, side=closest.side),
        least_time_to_collision_s=None if np.isinf(soonest) else soonest,
        labels=compute_labels(scene, agent, start),
    )
    rounded: dict[str, Any] = round_numbers(attempt.as_json(), _REPORT_DIGITS)
    return rounded


def round_numbers(value: Any, digits: int) -> Any:
    """JSON values with every number that is not whole rounded."""
    if isinstance(value, float):
        return round(value, digits) + 0.0
    if isinstance(value, dict):
        return {name: round_numbers(item, digits) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [round_numbers(item, digits) for item in value]
    return value


_NANOMETRE_DIGITS: Final = 9
"""Recordings are interpolated and turned with sines, whose last bits are the processor's own."""


def compute_tables_digest(plan: DataSetPlan, scene: Scene, frozen: FrozenScene) -> str:
    """Hash, 64 hexadecimal digits, of key-frame tables without cameras, to a nanometre: the same in any layout."""
    like = replace(plan, split="adv", layout="suffixed", renderer=None, frames="keyframes")
    names = SceneNames.of(
        like,
        scene,
        name=frozen.name,
        variant=0,
        source_scene=frozen.source,
        identity=frozen.identity,
        number=find_number(frozen),
    )
    timed = replace(scene, timestamps_us=scene.timestamps_us + (frozen.shift_us or 0))
    tables = build_scene_tables(
        names, LabelVocabulary.of(plan.source), timed, build_channels((), {}), scene.keyframes.tolist()
    )
    return content_key(round_numbers(tables, _NANOMETRE_DIGITS))


def build_image_facts(plan: DataSetPlan, scene: Scene) -> ImageMetadata | None:
    """Which images hashes would be of; ``None`` where there are none, or they take too long to be drawn once more."""
    if plan.renderer is None or isinstance(plan.renderer, SlowRenderer):
        return None
    cameras = plan.renderer.cameras(scene)
    if not cameras:
        return None
    row = {"name": plan.renderer.name, "version": plan.renderer.version}
    return parse_image_facts(row | {"width": cameras[0].width, "height": cameras[0].height}, plan.jpeg_quality)


def parse_image_facts(row: dict[str, Any], jpeg_quality: int) -> ImageMetadata:
    """The same from what the writer says of its renderer."""
    return ImageMetadata(
        renderer=row["name"],
        version=row["version"],
        width=row["width"],
        height=row["height"],
        jpeg_quality=jpeg_quality,
    )


def compute_drawn_digest(plan: DataSetPlan, scene: Scene) -> str:
    """Hash of a scene's key frames' images, drawn for it."""
    assert plan.renderer is not None
    drawn = plan.renderer.render(scene, scene.keyframes.tolist())
    return _combine_hashes(
        hashlib.sha256(encode_jpeg(image, plan.jpeg_quality)).hexdigest()
        for images in drawn
        for image in images.values()
    )


def compute_written_digest(plan: DataSetPlan, fragment: dict[str, Any]) -> str:
    """Hash of a written scene's key frames' images, read from the disk."""
    root = plan.data_root(fragment["variant"])
    paths = [path for path in fragment["files"] if path.startswith("samples/") and path.endswith(".jpg")]
    return _combine_hashes(file_sha256(root / path) for path in paths)


def _combine_hashes(hashes: Iterable[str]) -> str:
    # Sorted: file names, and so their order, differ between layouts.
    return content_key(sorted(hashes))
