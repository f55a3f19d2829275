"""Truth that is missing though the tables are sound: labels, sizes, tracks, nuScenes' categories, poses that move."""

from collections import Counter, defaultdict
from collections.abc import Mapping
from typing import Final

import numpy as np

from benchmark.datasets.annotated import has_size
from benchmark.datasets.annotation_counts import AnnotationCount
from benchmark.datasets.categories import KNOWN, names_in
from benchmark.datasets.labelled import labelled_keyframes
from benchmark.datasets.schema import FaultList
from benchmark.datasets.schema.table_checks import CheckedTables
from benchmark.datasets.truth_facts import MOTIONLESS_S
from benchmark.report.words import counted

_LABELS: Final = "scenes without labels"


def check_truth(tables: CheckedTables, categories: Mapping[str, str], faults: FaultList) -> None:
    """Warn of scenes and objects of which commands that judge say nothing, or less.

    Args:
        categories: What other names of categories mean (`benchmark.datasets.categories.read_categories`).
    """
    if "sample_annotation" in tables.unreadable:
        return
    _check_labels(tables, faults)
    _check_boxes(tables, faults)
    _check_categories(tables, categories, faults)
    _check_poses(tables, faults)


def _check_labels(tables: CheckedTables, faults: FaultList) -> None:
    """Scenes that are not labelled, or in a part only."""
    boxes = Counter(row["sample_token"] for row in tables.having("sample_annotation", "sample_token", "size"))
    samples: defaultdict[str, list[tuple[int, str]]] = defaultdict(list)
    for row in tables.having("sample", "scene_token", "timestamp"):
        samples[row["scene_token"]].append((row["timestamp"], row["token"]))
    for scene in tables.having("scene", "name"):
        counts = np.array([boxes[token] for _, token in sorted(samples[scene["token"]])], np.int64)
        missing = np.flatnonzero(~labelled_keyframes(counts))
        if not len(missing):
            continue
        if not counts.any():
            sentence = f"{scene['name']} has no annotations: no contact there can be judged, and no rate counts it"
        else:
            sentence = (
                f"{scene['name']} has no annotations at {len(missing)} of {counted(len(counts), 'sample')}, the first "
                f"of them number {missing[0]}: no contact that falls there can be judged"
            )
        faults.add(_LABELS, "scene", scene["token"], sentence, severity="warning")


def _check_boxes(tables: CheckedTables, faults: FaultList) -> None:
    """Boxes without a size, and instances without a box."""
    for row in tables.having("sample_annotation", "size"):
        if not has_size(row):
            sentence = f"its size is {row['size']}: the box is ignored, nothing can touch it"
            faults.add("boxes without a size", "sample_annotation", row["token"], sentence, severity="warning")
    tracked = {row["instance_token"] for row in tables.having("sample_annotation", "instance_token")}
    for row in tables.rows["instance"]:
        if row["token"] not in tracked:
            sentence = "no annotation is of this instance: it is ignored"
            faults.add("instances without a track", "instance", row["token"], sentence, severity="warning")


def _check_categories(tables: CheckedTables, categories: Mapping[str, str], faults: FaultList) -> None:
    """Categories that are not nuScenes', once for the whole data set."""
    names = {row["token"]: row["name"] for row in tables.having("category", "name")}
    names |= {token: dict(names_in(names.values(), categories)).get(name, name) for token, name in names.items()}
    category_of = {
        row["token"]: names.get(row["category_token"]) for row in tables.having("instance", "category_token")
    }
    found = Counter(
        category_of.get(row["instance_token"]) for row in tables.having("sample_annotation", "instance_token")
    )
    unknown = {name: count for name, count in found.items() if name is not None and name not in KNOWN}
    if unknown:
        counts = AnnotationCount(found.total(), unknown)
        so = "say nothing of contacts" if counts.foreign else "do not see them"
        sentence = f"{counts.sentence}: protocols that go by categories {so}; say what they mean with --categories"
        faults.add("unknown categories", "category", "", sentence, severity="warning")


def _check_poses(tables: CheckedTables, faults: FaultList) -> None:
    """Scenes in which the ego pose never changes."""
    poses: defaultdict[str, set[tuple[float, ...]]] = defaultdict(set)
    times_us: defaultdict[str, list[int]] = defaultdict(list)
    for row in tables.having("sample_data", "sample_token", "ego_pose_token", "is_key_frame"):
        sample = tables.get("sample", row["sample_token"], "scene_token", "timestamp")
        pose = tables.get("ego_pose", row["ego_pose_token"], "translation", "rotation")
        if row["is_key_frame"] and sample is not None and pose is not None:
            poses[sample["scene_token"]].add((*pose["translation"], *pose["rotation"]))
            times_us[sample["scene_token"]].append(sample["timestamp"])
    for scene in tables.having("scene", "name"):
        times = times_us[scene["token"]]
        if len(poses[scene["token"]]) == 1 and (max(times) - min(times)) * 1e-6 >= MOTIONLESS_S:
            sentence = f"the ego pose of {scene['name']} is the same at every sample, as if there were none"
            faults.add("ego poses that never move", "scene", scene["token"], sentence, severity="warning")
