"""Scenes that were edited in ScenarioNet files, as a frozen split: what differs from the recordings."""

from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.roots import DataSet
from benchmark.datasets.scenario_map import ExchangedScene
from benchmark.datasets.scenarionet import find_scenarionet, read_exchanged_scene
from benchmark.errors import InputError
from benchmark.geometry import Bools, wrap_angle
from benchmark.machine.storage import make_token
from benchmark.scene import Scene
from benchmark.untrusted.files import to_one_line
from generation.nuscenes_writer import DataSetPlan, SourceInfo
from generation.nuscenes_writer.numbering import number_scenes
from generation.splits.format import (
    EDITED,
    FrozenAdversary,
    FrozenScene,
    FrozenSplit,
    RecordingsIdentity,
    SceneChoice,
    SearchMetadata,
)
from generation.splits.packaged import NamedSplit
from generation.splits.tracks import (
    SAME_M,
    add_frozen_adversaries,
    add_number,
    compute_tables_digest,
    read_recorded_pose,
    round_pose,
)

_SAME_SIZE_M: Final = 0.005
_SAME_TIME_S: Final = 1e-3
_UNKNOWN: Final = "0" * 64


EditedScenes = tuple[tuple[Path, ExchangedScene], ...]
"""Files and what was read of them."""


def read_edited(path: Path) -> EditedScenes:
    """Read a ScenarioNet file, or a folder of them."""
    return tuple((file, read_exchanged_scene(file)) for file in find_scenarionet(path))


def build_edited_split(source: DataSet, path: Path, edited: EditedScenes | None = None) -> NamedSplit:
    """Changes of edited files in the recordings, as a split that is built like any frozen one.

    Args:
        source: The recordings.
        edited: Content of the files, if already read.
        path: A ScenarioNet file of an edited scene, or a folder of them: files that `data export scenarionet` wrote, of
            the recordings or of generated scenes, or others whose tracks have the recordings' identifiers.

    Returns:
        The split, called after the file or folder. Vehicles that at a keyframe are not where they were recorded are the
        adversaries of a scene, from the last keyframe before on.

    Raises:
        InputError: If a file is refused, its scene was not recorded here, nothing differs, or something else than
            vehicles does: the ego, times, objects that are missing or new, sizes, or a vehicle that is not there to the
            end.
    """
    plan = DataSetPlan(root=Path(), split="adv", source=SourceInfo.of(source))
    scenes: dict[str, FrozenScene] = {}
    times: dict[str, tuple[int, int]] = {}
    files = read_edited(path) if edited is None else edited
    for file, exchanged in files:
        recorded = _read_recording(source, exchanged, file)
        frozen = build_edited_scene(exchanged.scene, recorded, file)
        if frozen.name in scenes:
            raise InputError(f"{file} holds the same scene as another file of {path}; keep one of them")
        scenes[frozen.name] = frozen
        times[frozen.name] = int(recorded.timestamps_us[0]), int(recorded.timestamps_us[-1])
    numbers = number_scenes(times, {frozen.source for frozen in scenes.values()})
    for name, unnumbered in scenes.items():
        frozen = add_number(unnumbered, numbers.get(name))
        changed = add_frozen_adversaries(frozen, source.scene(frozen.source))
        scenes[name] = frozen.model_copy(update={"tables": compute_tables_digest(plan, changed, frozen)})
    split = FrozenSplit(
        recordings=RecordingsIdentity(name=source.name, fingerprint=source.fingerprint()),
        search=SearchMetadata(algorithm=EDITED, hyper=EDITED, prior=EDITED, seed=0),
        chosen=SceneChoice(
            scenes=len({scene.source for scene in scenes.values()}),
            tried=len(files),
            survived=len(scenes),
            per_scene=None,
            total=None,
            surrogate=None,
        ),
        images=None,
        scenes=tuple(scenes.values()),
    )
    return NamedSplit(path.resolve().stem, split)


def _read_recording(source: DataSet, exchanged: ExchangedScene, file: Path) -> Scene:
    names = source.scene_names(None)
    recorded_name = next((name for name in (exchanged.source_scene, exchanged.scene.name) if name in names), None)
    if recorded_name is None:
        raise InputError(
            f"{file} was made from {to_one_line(exchanged.source_scene, 80)}, which {source.name} has no recording of; "
            "choose the recordings that it was exported from with --data"
        )
    return source.scene(recorded_name)


def build_edited_scene(scene: Scene, recorded: Scene, file: Path) -> FrozenScene:
    """Change of an edited scene in its recording, adversaries in order of departure, without hashes."""
    _require_same_drive(scene, recorded, file)
    rows = _match_objects(scene, recorded, file)
    adversaries = []
    for agent, row in enumerate(rows.tolist()):
        differs = _find_differences(scene, row, recorded, agent)
        if differs.any():
            adversaries.append(_build_adversary(scene, row, recorded, agent, differs, file))
    if not adversaries:
        raise InputError(f"{file} holds {recorded.name} unchanged; move a vehicle in it, or leave it out")
    adversaries.sort(key=lambda each: (each.launch_frame, recorded.agents.ids.index(each.instance)))
    stem = recorded.name.replace("/", "-")
    suffix = make_token("edited", recorded.name, [adversary.model_dump(mode="json") for adversary in adversaries])[:8]
    return FrozenScene(name=f"{stem}-{suffix}", source=recorded.name, adversaries=tuple(adversaries), tables=_UNKNOWN)


def _require_same_drive(scene: Scene, recorded: Scene, file: Path) -> None:
    """Refuse other times, and an ego that drives elsewhere."""
    if len(scene.timestamps_us) != len(recorded.timestamps_us):
        raise InputError(
            f"{file} has {len(scene.timestamps_us)} frames but {recorded.name} was recorded with "
            f"{len(recorded.timestamps_us)}; export it again from these recordings"
        )
    apart = np.abs(scene.seconds - recorded.seconds).max()
    if apart > _SAME_TIME_S or not np.array_equal(scene.keyframes, recorded.keyframes):
        raise InputError(f"{file}: its times are not those of {recorded.name}; export it again from these recordings")
    # Between keyframes poses may have been interpolated: of roots that were written with keyframes alone.
    at = recorded.keyframes
    away = np.linalg.norm(scene.ego.position[at, :2] - recorded.ego.position[at, :2], axis=1)
    turned = np.abs(wrap_angle(scene.ego.yaw[at] - recorded.ego.yaw[at]))
    if away.max() > SAME_M or turned.max() > SAME_M:
        worst = int(np.argmax(away + turned))
        raise InputError(
            f"{file}: the ego of {recorded.name} is {away[worst]:.3f} m and {turned[worst]:.3f} rad from where it was "
            f"recorded at keyframe {worst}; only vehicles around it may be edited"
        )


def _match_objects(scene: Scene, recorded: Scene, file: Path) -> NDArray[np.int64]:
    ids = {name: row for row, name in enumerate(scene.agents.ids)}
    # Generated scenes that share a root have new identifiers, derived from those of the recording.
    called = [name if name in ids else make_token("instance", scene.name, name) for name in recorded.agents.ids]
    missing = [name for name, own in zip(recorded.agents.ids, called, strict=True) if own not in ids]
    added = sorted(set(ids) - set(called))
    if missing or added:
        problem = f"lacks {missing[0]} of {recorded.name}" if missing else f"adds {to_one_line(added[0], 80)}"
        raise InputError(f"{file} {problem}; vehicles may be moved, but not added or removed")
    rows = np.array([ids[own] for own in called], np.int64)
    sizes = np.abs(scene.agents.size[rows] - recorded.agents.size).max(axis=1, initial=0.0)
    kinds = [scene.agents.categories[row] for row in rows.tolist()]
    for agent, name in enumerate(recorded.agents.ids):
        if sizes[agent] > _SAME_SIZE_M or kinds[agent] != recorded.agents.categories[agent]:
            raise InputError(f"{file}: {name} of {recorded.name} has another size or category; it may only be moved")
    return rows


def _find_differences(scene: Scene, row: int, recorded: Scene, agent: int) -> Bools:
    """(K,) keyframes at which an object is not where it was recorded: by a centimetre at its corners, or not there."""
    at = recorded.keyframes
    edited_valid, recorded_valid = scene.agents.valid[row, at], recorded.agents.valid[agent, at]
    steps = scene.agents.position[row, at, :2] - recorded.agents.position[agent, at, :2]
    turned = np.abs(wrap_angle(scene.agents.yaw[row, at] - recorded.agents.yaw[agent, at]))
    away = np.linalg.norm(steps, axis=1) + 0.5 * np.hypot(*recorded.agents.size[agent, :2]) * turned
    return np.asarray((edited_valid != recorded_valid) | (edited_valid & recorded_valid & (away > SAME_M)))


def _build_adversary(
    scene: Scene, row: int, recorded: Scene, agent: int, differs: Bools, file: Path
) -> FrozenAdversary:
    """One edited vehicle: from the last keyframe at which it is where it was recorded."""
    name, category = recorded.agents.ids[agent], recorded.agents.categories[agent]
    described = f"{file}: {name} of {recorded.name}"
    if not category.startswith("vehicle."):
        raise InputError(f"{described} ({category}) was moved; only vehicles may be edited")
    recorded_valid = recorded.agents.valid[agent, recorded.keyframes]
    first = int(np.argmax(differs))
    before = np.flatnonzero(recorded_valid[:first])
    if not len(before) and not recorded_valid[first]:
        begins = int(recorded.keyframes[np.argmax(recorded_valid)])
        raise InputError(f"{described} exists before frame {begins}, where its recording begins; start it there")
    launch = int(recorded.keyframes[before[-1] if len(before) else first])
    missing = np.flatnonzero(~scene.agents.valid[row, launch:])
    if len(missing):
        raise InputError(
            f"{described} is absent at frame {launch + int(missing[0])}; a vehicle that is edited must be there from "
            f"its first change to the end (frame {len(scene.timestamps_us) - 1})"
        )
    poses = np.column_stack([scene.agents.position[row, launch:, :2], scene.agents.yaw[row, launch:]])
    return FrozenAdversary(
        instance=name,
        launch_frame=launch,
        recorded=round_pose(read_recorded_pose(recorded, agent, launch)),
        track=tuple(map(round_pose, poses)),
    )
