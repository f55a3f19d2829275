"""Golden files of the protocols: scenes as plain arrays, plans, and what the official code says about them."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from benchmark.constants import FARTHEST_WAYPOINT_M, LIDAR_FROM_REAR_AXLE_M, PLAN_STEPS
from benchmark.errors import InputError
from benchmark.extensions.golden_sets.protocols.arrays import ProtocolArrays
from benchmark.extensions.golden_sets.protocols.given_roads import read_roads
from benchmark.geometry import Floats
from benchmark.machine.storage import file_sha256, read_json
from benchmark.planning import Command
from benchmark.report.words import counted
from benchmark.truth import SampleTruth
from benchmark.verification.golden import golden_directory

_KEYFRAMES: Final = PLAN_STEPS + 1
PAST: Final = "past_frames"
"""Array that tells the two forms of inputs apart."""
_VISIBLE: Final = 1
"""Annotated there and more than 40 % visible; 0 is hidden, -1 not annotated."""
_OFFICIAL, _EXACT, _MANIFEST = "_official", "_exact", "manifest.json"


@dataclass(frozen=True, slots=True)
class GoldenScene:
    """One scene with S samples and P plans for each.

    Attributes:
        name: Name of the file without its ending.
        truths: S samples.
        plans: (S, P, 6, 2) waypoints in the lidar frame, metres.
        plan_names: P names.
        official: What the official code says.
        inputs: What the samples were made from.
        official: What the official code says.
        exact: What exact polygons say, if the set has that.
        with_roads: Whether it is of the form that has roads and the past, with the verdicts of further protocols.
    """

    name: str
    truths: tuple[SampleTruth, ...]
    plans: Floats
    plan_names: tuple[str, ...]
    inputs: ProtocolArrays
    official: ProtocolArrays
    exact: ProtocolArrays | None
    with_roads: bool


def golden_inputs(golden: Path) -> list[Path]:
    """The files of a set that hold scenes and plans.

    Args:
        golden: Directory of the set.

    Returns:
        Paths by name.

    Raises:
        InputError: If the directory is absent, holds no such set, or a file of verdicts has no inputs beside it.
    """
    folder = golden_directory(golden, "protocols", f"*{_OFFICIAL}.npz")
    endings = (_OFFICIAL, _EXACT)
    judged = {path.stem.removesuffix(end) for end in endings for path in folder.glob(f"*{end}.npz")}
    scenes = {path.stem for path in folder.glob("*.npz") if not path.stem.endswith(endings)}
    for name in sorted(judged | scenes):
        for needed in (f"{name}.npz", f"{name}{_OFFICIAL}.npz"):
            if not (folder / needed).is_file():
                raise InputError(
                    f"the golden set {folder} has no {needed}; a scene needs NAME.npz and NAME{_OFFICIAL}.npz"
                )
    return [folder / f"{name}.npz" for name in sorted(scenes)]


def read_golden_scene(path: Path) -> GoldenScene:
    """Read a scene.

    Args:
        path: One of `golden_inputs`.

    Returns:
        The scene.

    Raises:
        InputError: If a file is damaged or its arrays do not fit together.
    """
    stored = ProtocolArrays.read(path)
    plans = stored.floats("plans", None, None, PLAN_STEPS, 2)
    if not plans.size:
        raise InputError(f"{path} has no samples or no plans; leave it out of the set")
    _refuse_far(stored, "plans", plans)
    names = stored.labels("plan_names", plans.shape[1])
    if len(set(names)) < len(names):
        raise InputError(f"plan_names in {path} has a name twice; give each plan its own")
    exact = path.with_stem(path.stem + _EXACT)
    with_roads = PAST in stored.names
    truths = truths_of(stored, len(plans))
    return GoldenScene(
        name=path.stem,
        truths=tuple(_with_past_and_roads(stored, truths) if with_roads else truths),
        plans=plans,
        plan_names=tuple(names),
        inputs=stored,
        official=ProtocolArrays.read(path.with_stem(path.stem + _OFFICIAL)),
        exact=ProtocolArrays.read(exact) if exact.is_file() else None,
        with_roads=with_roads,
    )


def _with_past_and_roads(stored: ProtocolArrays, truths: list[SampleTruth]) -> list[SampleTruth]:
    """Samples with what the further protocols ask for beside boxes: poses, who was seen before, and roads.

    Raises:
        InputError: If an array is absent, damaged, or does not fit the others.
    """
    samples = len(truths)
    before = stored.integers(PAST, samples)
    now = stored.floats("ego_pose", samples, 3)
    poses = stored.floats("ego_pose_fut", samples, PLAN_STEPS, 3)
    visibility = stored.integers("obj_past_visibility", sum(len(truth.instances) for truth in truths), PLAN_STEPS // 2)
    seen = (visibility == _VISIBLE).any(axis=-1)
    ends = np.cumsum([0, *(len(truth.instances) for truth in truths)])
    roads = read_roads(stored, samples)
    return [
        replace(
            truth,
            index=int(before[index]),
            axle_poses=np.concatenate([now[index : index + 1], _held(now[index], poses[index], truth)]),
            seen_before=seen[ends[index] : ends[index + 1]],
            roads=roads[index],
        )
        for index, truth in enumerate(truths)
    ]


def _held(now: Floats, poses: Floats, truth: SampleTruth) -> Floats:
    """(6, 3) poses at the steps, the last recorded one after the end of the scene."""
    last = int(truth.ego_future_valid.sum())
    return np.where(truth.ego_future_valid[:, None], poses, poses[last - 1] if last else now)


def remarks(paths: Iterable[Path], with_roads: Collection[str] = ()) -> list[str]:
    """What a reader should know about the files of a set.

    Args:
        paths: All of `golden_inputs`.
        with_roads: Names of those of the form that has no exact verdicts.

    Returns:
        Short texts: files without exact verdicts, files that the manifest lists and the folder lacks, files that are
        not those the manifest describes.

    Raises:
        InputError: If the manifest is not readable.
    """
    scenes = list(paths)
    found = [counted(len(scenes), "file")]
    without = [path.stem for path in scenes if not path.with_stem(path.stem + _EXACT).is_file()]
    without = [name for name in without if name not in with_roads]
    if without:
        found.append(f"no exact verdicts for {', '.join(without)}")
    folder = scenes[0].parent
    if not (folder / _MANIFEST).is_file():
        return [*found, f"no {_MANIFEST}"]
    manifest = read_json(folder / _MANIFEST)
    files = manifest.get("files") if isinstance(manifest, dict) else None
    if not isinstance(files, dict):
        raise InputError(f"{folder / _MANIFEST} lists no files; make it again or leave it away")
    absent = sorted(name for name in files if not (folder / name).is_file())
    if absent:
        found.append(f"{len(absent)} more in {_MANIFEST} are not there")
    changed = [name for name in sorted(files) if name not in absent and _differs(folder / name, files[name])]
    if changed:
        found.append(f"not as {_MANIFEST} describes them: {', '.join(changed)}")
    return found


def _differs(path: Path, facts: Any) -> bool:
    wanted = facts.get("sha256") if isinstance(facts, dict) else None
    return wanted is not None and file_sha256(path) != wanted


def _refuse_far(stored: ProtocolArrays, name: str, values: Floats) -> None:
    if np.abs(values).max(initial=0.0) > FARTHEST_WAYPOINT_M:
        raise InputError(f"array {name} in {stored.path} has numbers beyond 10 km, which are no metres; make it again")


def truths_of(stored: ProtocolArrays, samples: int) -> list[SampleTruth]:
    """Samples as the protocols take them; where they are in the world does not matter to any.

    Args:
        stored: Arrays of a file of inputs.
        samples: How many samples it has.

    Returns:
        The samples.

    Raises:
        InputError: If an array is absent, damaged, or does not fit the others.
    """
    future = stored.floats("ego_fut", samples, PLAN_STEPS, 3)
    valid = stored.verdicts("ego_fut_valid", samples, PLAN_STEPS)
    commands = stored.integers("command", samples)
    size = stored.floats("obj_size", None, 2)
    count = len(size)
    pose = stored.floats("obj_box", count, _KEYFRAMES, 3)
    annotated = stored.verdicts("obj_annotated", count, _KEYFRAMES)
    points = stored.verdicts("obj_has_points", count, _KEYFRAMES) & annotated
    kinds, labels = stored.integers("obj_class", count), stored.labels("class_names")
    offset = stored.integers("obj_offset", samples + 1)
    if offset[0] != 0 or offset[-1] != count or (np.diff(offset) < 0).any():
        raise InputError(f"obj_offset in {stored.path} does not divide its {count} objects; make the file again")
    if count and (kinds.min() < 0 or kinds.max() >= len(labels) or size.min() <= 0):
        raise InputError(f"{stored.path} has objects without a name in class_names or without a size; make it again")
    for name, values in {"ego_fut": future, "obj_box": pose, "obj_size": size}.items():
        _refuse_far(stored, name, values)
    if (valid[:, 1:] & ~valid[:, :-1]).any() or not np.isin(commands, list(Command)).all():
        raise InputError(f"{stored.path} has futures with gaps in ego_fut_valid or an unknown command; make it again")
    boxes = np.concatenate(
        [pose[..., :2], np.broadcast_to(size[:, None], (count, _KEYFRAMES, 2)), pose[..., 2:]], axis=-1
    )
    return [
        SampleTruth(
            scene=stored.path.stem,
            sample_token=str(index),
            index=index,
            timestamp_us=0,
            lidar_pose=np.zeros(3),
            lidar_ahead_m=LIDAR_FROM_REAR_AXLE_M,
            ego_future=future[index],
            ego_future_valid=valid[index],
            command=Command(int(commands[index])),
            instances=tuple(str(row) for row in range(start, stop)),
            categories=tuple(labels[kind] for kind in kinds[start:stop]),
            boxes=boxes[start:stop],
            annotated=annotated[start:stop],
            has_points=points[start:stop],
            has_lidar_points=points[start:stop],
        )
        for index, (start, stop) in enumerate(zip(offset[:-1].tolist(), offset[1:].tolist()))
    ]
