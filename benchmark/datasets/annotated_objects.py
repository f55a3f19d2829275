"""Objects of a scene: annotations, tracks in between, at which key frames objects were looked for, truth coverage."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Protocol

import numpy as np
from numpy.typing import NDArray

from benchmark.datasets.tables import Row
from benchmark.errors import InputError
from benchmark.geometry import Bools, poses_between, yaw_of_quaternion
from benchmark.report.words import pluralise
from benchmark.scene import Agents, Annotations

MOST_UNKNOWN: Final = 0.01
"""Share of annotations with unknown categories above which nothing is said that goes by categories."""
_NAMED: Final = 3


@dataclass(frozen=True, slots=True)
class AnnotationCount:
    """Annotations of one scene or several; ``unknown`` are those of categories that nuScenes does not have."""

    annotations: int
    unknown: Mapping[str, int] = field(default_factory=dict)

    @classmethod
    def together(cls, counts: Sequence["AnnotationCount"]) -> "AnnotationCount":
        """The counts of several scenes."""
        unknown: Counter[str] = Counter()
        for count in counts:
            unknown.update(count.unknown)
        return cls(sum(count.annotations for count in counts), unknown)

    @property
    def is_mostly_unknown(self) -> bool:
        """Whether too many categories are unknown for results by category to mean anything."""
        return sum(self.unknown.values()) > MOST_UNKNOWN * self.annotations

    @property
    def sentence(self) -> str:
        """Sentence on the number of annotations of unknown categories, with their names; no full stop at its end."""
        names = sorted(self.unknown, key=lambda name: (-self.unknown[name], name))
        listed = ", ".join(map(repr, names[:_NAMED])) + (", ..." if len(names) > _NAMED else "")
        return (
            f"{sum(self.unknown.values()):,} of {pluralise(self.annotations, 'annotation')} have unknown categories "
            f"({listed})"
        )


class AnnotationCounter(Protocol):
    """The part of a data set that counts its annotations."""

    root: Path

    def annotation_counts(self, names: Sequence[str]) -> dict[str, AnnotationCount]:
        """Counts by scene name."""


def require_annotated(data: AnnotationCounter, split: str, scenes: Sequence[str]) -> AnnotationCount:
    """Refuse scenes none of which has an annotation: there is no truth to judge anything by."""
    total = AnnotationCount.together(list(data.annotation_counts(scenes).values()))
    if not total.annotations:
        which = "none of them" if len(scenes) > 1 else "it"
        raise InputError(
            f"{pluralise(len(scenes), 'scene')} of split {split!r} of {data.root} cannot be scored: {which} has "
            f"{'an' if len(scenes) > 1 else 'no'} annotation; choose labelled scenes (test splits have no labels)"
        )
    return total


LEAVE_TOGETHER: Final = 3


def find_labelled_keyframes(boxes: NDArray[np.int64]) -> Bools:
    """Which key frames were labelled, (K,), from the (K,) numbers of annotations of a scene in time order."""
    if not boxes.any():
        return np.zeros(len(boxes), np.bool_)
    with_boxes = np.flatnonzero(boxes)
    at = np.arange(len(boxes))
    before = with_boxes[np.maximum(np.searchsorted(with_boxes, at, side="right") - 1, 0)]
    after = with_boxes[np.minimum(np.searchsorted(with_boxes, at), len(with_boxes) - 1)]
    return np.asarray((boxes > 0) | (np.maximum(boxes[before], boxes[after]) < LEAVE_TOGETHER))


_VISIBILITY_LEVELS: Final = {"v0-40": 1, "v40-60": 2, "v60-80": 3, "v80-100": 4}


NO_SIZE_M: Final = 1e-3
"""A box that is no longer, wider or higher is none."""


def find_nearest_valid(valid: Bools) -> NDArray[np.int64]:
    """(N, T) index of the nearest valid entry along the last axis, which has to exist; the earlier of two as near."""
    count = valid.shape[-1]
    index = np.arange(count)
    before = np.maximum.accumulate(np.where(valid, index, -1), axis=-1)
    after = np.minimum.accumulate(np.where(valid, index, 2 * count)[..., ::-1], axis=-1)[..., ::-1]
    to_before = np.where(before >= 0, index - before, 2 * count)
    return np.asarray(np.where(to_before <= after - index, before, after), dtype=np.int64)


def read_objects(nusc: Any, samples: list[Row], keyframes: NDArray[np.int64]) -> tuple[Agents, Annotations]:
    """Every annotated object of a scene that has a size, in the order in which the instances first appear.

    An agent is there at its annotated keyframes and between two consecutive ones; a gap in its annotations stays a gap.
    Numbers of annotations are the tables' own. ``keyframes`` is (K,), the frame of each sample.
    """
    annotations_of_samples = [[nusc.get("sample_annotation", token) for token in sample["anns"]] for sample in samples]
    rows = [list(filter(has_size, at_sample)) for at_sample in annotations_of_samples]
    instances = list(dict.fromkeys(row["instance_token"] for at_sample in rows for row in at_sample))
    number = {instance: index for index, instance in enumerate(instances)}
    shape = (len(instances), len(samples))
    position, rotation, size = np.zeros((*shape, 3)), np.zeros((*shape, 4)), np.ones((*shape, 3))
    valid, attribute = np.zeros(shape, dtype=np.bool_), np.full(shape, "", dtype=object)
    counts = {name: np.zeros(shape, dtype=np.int64) for name in ("visibility", "num_lidar_pts", "num_radar_pts")}
    categories = [""] * len(instances)
    for column, at_sample in enumerate(rows):
        for row in at_sample:
            at = (number[row["instance_token"]], column)
            categories[at[0]] = row["category_name"]
            valid[at] = True
            position[at], rotation[at] = row["translation"], row["rotation"]
            width, length, height = row["size"]
            size[at] = length, width, height
            attribute[at] = ";".join(nusc.get("attribute", token)["name"] for token in row["attribute_tokens"])
            counts["visibility"][at] = _visibility(nusc, row.get("visibility_token", ""))
            counts["num_lidar_pts"][at], counts["num_radar_pts"][at] = row["num_lidar_pts"], row["num_radar_pts"]
    nearest = find_nearest_valid(valid)
    pick = (np.arange(len(instances))[:, None], nearest)
    annotations = Annotations(
        position=position[pick],
        rotation=rotation[pick],
        size=size[pick],
        valid=valid,
        attribute=attribute.astype(np.str_),
        **counts,
    )
    return interpolate_tracks(tuple(instances), tuple(categories), annotations, keyframes), annotations


def has_size(annotation: Row) -> bool:
    """Whether the box of a row has length, width and height."""
    return bool(min(annotation["size"]) > NO_SIZE_M)


def interpolate_tracks(
    ids: tuple[str, ...], categories: tuple[str, ...], annotations: Annotations, keyframes: NDArray[np.int64]
) -> Agents:
    """Tracks at frames 0 to ``keyframes[-1]`` from (N, K) annotations: linear position, shortest-arc heading.

    ``keyframes`` is (K,), increasing from 0; sizes are those of each agent's first annotation.
    """
    frames = np.arange(keyframes[-1] + 1)
    left = np.searchsorted(keyframes, frames, side="right") - 1
    right = np.minimum(left + 1, len(keyframes) - 1)
    span = np.maximum(keyframes[right] - keyframes[left], 1)
    fraction = (frames - keyframes[left]) / span
    on_keyframe = frames == keyframes[left]
    is_there = annotations.valid[:, left] & (annotations.valid[:, right] | on_keyframe)
    fraction = np.where(is_there, fraction, np.round(fraction))
    yaw_at = yaw_of_quaternion(annotations.rotation)
    poses = np.concatenate([annotations.position[..., :2], yaw_at[..., None]], axis=-1)
    between = poses_between(poses[:, left], poses[:, right], fraction)
    z = annotations.position[..., 2]
    heights = z[:, left] + fraction * (z[:, right] - z[:, left])
    position, yaw = np.concatenate([between[..., :2], heights[..., None]], axis=-1), between[..., 2]
    pick = (np.arange(len(ids))[:, None], find_nearest_valid(is_there))
    first = annotations.valid.argmax(axis=-1)
    return Agents(
        ids=ids,
        categories=categories,
        position=position[pick],
        yaw=yaw[pick],
        size=annotations.size[np.arange(len(ids)), first],
        valid=is_there,
    )


def _visibility(nusc: Any, token: str) -> int:
    if not token or token not in nusc._token2ind["visibility"]:
        return 0
    row = nusc.get("visibility", token)
    level = _VISIBILITY_LEVELS.get(str(row.get("level", "")), 0)
    return level or (int(token) if token in ("1", "2", "3", "4") else 0)
