"""Golden files of the protocols: scenes as arrays, plans, official verdicts, stored kerb lines and drivable cells."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmark.constants import LIDAR_FROM_REAR_AXLE_M, PLAN_STEPS
from benchmark.geometry import Bools, Floats
from benchmark.machine.storage import file_sha256
from benchmark.planning import Command
from benchmark.report.words import pluralise
from benchmark.truth import SampleTruth
from benchmark.verification.golden_sets import GoldenArrays, GoldenFolder

_SIDE: Final = 1000


@dataclass(frozen=True, slots=True)
class GoldenRoads:
    """`benchmark.truth.Roads` of one sample: (N, 20, 2) edges, ego frame, metres, and cells, eight to the byte."""

    lines: NDArray[np.float32]
    packed: NDArray[np.uint8]

    @property
    def has_kerbs(self) -> bool:
        """A set of this form has them."""
        return True

    def kerb_lines(self) -> NDArray[np.float32]:
        """(N, 20, 2) edges."""
        return self.lines

    def drivable_cells(self) -> NDArray[np.uint8]:
        """(1000, 1000) ones where drivable."""
        return np.unpackbits(self.packed).reshape(_SIDE, _SIDE)

    def surely_drivable(self, points: Floats, margin_m: float) -> Bools:
        """Nothing is known without looking at the cells."""
        return np.zeros(len(points), dtype=np.bool_)


def read_roads(stored: GoldenArrays, samples: int) -> list[GoldenRoads]:
    """The roads of each sample of a file."""
    lines = stored.floats("boundary_lines", None, 20, 2).astype(np.float32)
    offset = stored.integers("boundary_offset", samples + 1)
    packed = stored.integers("drivable_bits", samples, _SIDE * _SIDE // 8).astype(np.uint8)
    return [GoldenRoads(lines[offset[index] : offset[index + 1]], packed[index]) for index in range(samples)]


_KEYFRAMES: Final = PLAN_STEPS + 1
PAST: Final = "past_frames"
"""Array that tells the two forms of inputs apart."""
_VISIBLE: Final = 1
"""Annotated there and more than 40 % visible; 0 is hidden, -1 not annotated."""
_OFFICIAL, _EXACT, _MANIFEST = "_official", "_exact", "manifest.json"


@dataclass(frozen=True, slots=True)
class ProtocolGoldenScene:
    """Scene with S samples and (S, P, 6, 2) waypoints in the lidar frame, metres; `exact` verdicts are of polygons.

    `with_roads` is the form that has roads and the past, with the verdicts of further protocols.
    """

    name: str
    truths: tuple[SampleTruth, ...]
    plans: Floats
    plan_names: tuple[str, ...]
    inputs: GoldenArrays
    official: GoldenArrays
    exact: GoldenArrays | None
    with_roads: bool


def list_golden_inputs(folder: GoldenFolder) -> list[Path]:
    """The files of a set that hold scenes and plans, each of which has verdicts beside it."""
    endings = (_OFFICIAL, _EXACT)
    scenes = {path.stem.removesuffix(end) for end in ("", *endings) for path in folder.named(f"*{end}.npz")}
    names = sorted(name for name in scenes if not name.endswith(endings))
    for name in (file_name for stem in names for file_name in (f"{stem}.npz", f"{stem}{_OFFICIAL}.npz")):
        if not folder.has(name):
            raise ValueError(f"it has no {name}")
    return [folder.path / f"{name}.npz" for name in names]


def read_golden_scene(path: Path) -> ProtocolGoldenScene:
    """The scene of one of `list_golden_inputs`."""
    stored = GoldenArrays.read(path)
    plans = stored.floats("plans", None, None, PLAN_STEPS, 2)
    exact = path.with_stem(path.stem + _EXACT)
    with_roads = PAST in stored.names
    truths = read_truths(stored, len(plans))
    return ProtocolGoldenScene(
        name=path.stem,
        truths=tuple(_add_past_and_roads(stored, truths) if with_roads else truths),
        plans=plans,
        plan_names=tuple(stored.texts("plan_names", plans.shape[1])),
        inputs=stored,
        official=GoldenArrays.read(path.with_stem(path.stem + _OFFICIAL)),
        exact=GoldenArrays.read(exact) if exact.is_file() else None,
        with_roads=with_roads,
    )


def _add_past_and_roads(stored: GoldenArrays, truths: list[SampleTruth]) -> list[SampleTruth]:
    """Samples with what the further protocols ask for beside boxes: poses, who was seen before, and roads."""
    samples = len(truths)
    before = stored.integers(PAST, samples)
    now = stored.floats("ego_pose", samples, 3)
    poses = stored.floats("ego_pose_fut", samples, PLAN_STEPS, 3)
    visibility = stored.integers("obj_past_visibility", sum(len(truth.instances) for truth in truths), PLAN_STEPS // 2)
    visible = (visibility == _VISIBLE).any(axis=-1)
    ends = np.cumsum([0, *(len(truth.instances) for truth in truths)])
    roads = read_roads(stored, samples)
    return [
        replace(
            truth,
            index=int(before[index]),
            axle_poses=np.concatenate([now[index : index + 1], _hold_last_pose(now[index], poses[index], truth)]),
            seen_before=visible[ends[index] : ends[index + 1]],
            roads=roads[index],
        )
        for index, truth in enumerate(truths)
    ]


def _hold_last_pose(now: Floats, poses: Floats, truth: SampleTruth) -> Floats:
    """(6, 3) poses at the steps, the last recorded one after the end of the scene."""
    last = int(truth.ego_future_valid.sum())
    return np.where(truth.ego_future_valid[:, None], poses, poses[last - 1] if last else now)


def list_remarks(folder: GoldenFolder, paths: list[Path], with_roads: Collection[str]) -> list[str]:
    """Files without exact verdicts (unless ``with_roads``), listed in the manifest but absent, or not as described."""
    sentences = [pluralise(len(paths), "file")]
    names = [path.stem for path in paths if path.stem not in with_roads]
    if without := [name for name in names if not folder.has(f"{name}{_EXACT}.npz")]:
        sentences.append(f"no exact verdicts for {', '.join(without)}")
    if not folder.has(_MANIFEST):
        return [*sentences, f"no {_MANIFEST}"]
    files = folder.facts(_MANIFEST)["files"]
    there = {name: facts for name, facts in sorted(files.items()) if folder.has(name)}
    if len(there) < len(files):
        sentences.append(f"{len(files) - len(there)} more listed in {_MANIFEST} are missing")
    sums = {name: facts["sha256"] for name, facts in there.items() if "sha256" in facts}
    if changed := [name for name, wanted in sums.items() if file_sha256(folder.path / name) != wanted]:
        sentences.append(f"different from {_MANIFEST}: {', '.join(changed)}")
    return sentences


def read_truths(stored: GoldenArrays, samples: int) -> list[SampleTruth]:
    """The samples of a file of inputs as the protocols take them; where they are in the world matters to none."""
    future = stored.floats("ego_fut", samples, PLAN_STEPS, 3)
    valid = stored.verdicts("ego_fut_valid", samples, PLAN_STEPS)
    commands = stored.integers("command", samples)
    size = stored.floats("obj_size", None, 2)
    count = len(size)
    pose = stored.floats("obj_box", count, _KEYFRAMES, 3)
    annotated = stored.verdicts("obj_annotated", count, _KEYFRAMES)
    points = stored.verdicts("obj_has_points", count, _KEYFRAMES) & annotated
    kinds, labels = stored.integers("obj_class", count), stored.texts("class_names")
    offset = stored.integers("obj_offset", samples + 1)
    sizes = np.broadcast_to(size[:, None], (count, _KEYFRAMES, 2))
    boxes = np.concatenate([pose[..., :2], sizes, pose[..., 2:]], axis=-1)
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
