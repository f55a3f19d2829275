"""``data check`` on roots that are sound and lack truth: one warning each, and none on the town as it is."""

import json
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.annotated_objects import find_labelled_keyframes
from benchmark.datasets.categories import read_categories
from benchmark.datasets.schema import Fault
from benchmark.datasets.schema.check import check_tables
from tests.benchmark.edited_roots import (
    Row,
    annotated_until,
    copy_of,
    edit,
    rename_categories,
    table_of,
    without_annotations,
)


@pytest.fixture
def root(town: Path, tmp_path: Path) -> Path:
    """A copy without the map, whose reading takes most of a check."""
    root = copy_of(town, tmp_path / "data")
    shutil.rmtree(root / "maps" / "expansion")
    return root


def faults_of(root: Path, categories: Mapping[str, str] | None = None) -> list[Fault]:
    """All faults besides that the map is missing."""
    found = check_tables(root, categories=categories)
    return [fault for fault in found if fault.table != "maps/expansion/boston-seaport.json"]


def said(root: Path) -> str:
    """The only other fault, which is a warning."""
    (fault,) = faults_of(root)
    assert fault.severity == "warning"
    return f"{fault.table}: {fault.sentence}"


def scene_of(root: Path) -> str:
    (row,) = json.loads(table_of(root, "scene").read_text())
    return str(row["name"])


def test_the_town_lacks_nothing(town: Path) -> None:
    assert check_tables(town) == []


def stopped_labels(root: Path) -> None:
    annotated_until(root, scene_of(root), 20)


def box_without_size(root: Path) -> None:
    edit(root, "sample_annotation", lambda rows: rows[0]["size"].__setitem__(0, 0.0))


def instance_without_track(root: Path) -> None:
    nothing = {"nbr_annotations": 0, "first_annotation_token": "", "last_annotation_token": ""}
    edit(root, "instance", lambda rows: rows.append({**rows[0], "token": "f" * 32, **nothing}))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (without_annotations, "scene: {} has no annotations: contacts cannot be detected"),
        (stopped_labels, "scene: {} has no annotations at 20 of 40 samples, the first of them number 20"),
        (box_without_size, "the box is ignored"),
        (instance_without_track, "instance: the instance has no annotation and is ignored"),
    ],
)
def test_what_is_missing_is_named(root: Path, change: Callable[[Path], None], words: str) -> None:
    change(root)
    assert words.format(scene_of(root)) in said(root)


def test_unknown_categories_are_counted_and_a_map_of_them_is_taken(root: Path) -> None:
    rename_categories(root, lambda name: name.replace(".", "_"))
    count = len(json.loads(table_of(root, "sample_annotation").read_text()))
    assert f"{count:,} of {count:,} annotations have unknown categories ('vehicle_car', " in said(root)
    assert faults_of(root, read_categories("short")) == []


def test_an_ego_pose_that_never_moves_is_named_and_one_that_trembles_is_not(town: Path, tmp_path: Path) -> None:
    root = copy_of(town, tmp_path / "data")

    def still(rows: list[Row]) -> None:
        for row in rows:
            row.update(translation=list(rows[0]["translation"]), rotation=rows[0]["rotation"])

    edit(root, "ego_pose", still)
    assert "is the same at every sample, as if it were missing" in said(root)

    def trembling(rows: list[Row]) -> None:
        for number, row in enumerate(rows):
            row["translation"][0] += 1e-6 * number

    edit(root, "ego_pose", trembling)
    assert check_tables(root) == []


@pytest.mark.parametrize(
    ("boxes", "labelled"),
    [
        ((0, 0, 0), "..."),
        ((4, 5, 3), "xxx"),
        ((4, 3, 0, 0), "xx.."),
        ((0, 0, 3, 4), "..xx"),
        ((4, 0, 0, 5), "x..x"),
        ((4, 2, 0, 0), "xxxx"),
        ((4, 2, 0, 1, 0), "xxxxx"),
        ((1, 0, 0, 3), "x..x"),
        ((), ""),
    ],
)
def test_a_stretch_without_boxes_beside_three_or_more_is_not_labelled(boxes: tuple[int, ...], labelled: str) -> None:
    found = find_labelled_keyframes(np.array(boxes, np.int64))
    assert "".join("x" if one else "." for one in found) == labelled
