"""Roots that can be read and cannot be right: `data check` warns of each, and records of runs on them say so."""

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from adapters.registry import planner_factory
from benchmark.datasets.roots import open_data
from benchmark.datasets.schema.check import check_tables
from benchmark.evaluation import EvalSettings, evaluate, evaluate_together
from benchmark.geometry import quaternion_from_yaw
from tests.benchmark.edited_roots import Row, copy_of, edit

EXACT = EvalSettings(protocols=("exact",))


def in_each(table: str, change: Callable[[Row], None]) -> Callable[[Path], None]:
    def of_rows(rows: list[Row]) -> None:
        for row in rows:
            change(row)

    return lambda root: edit(root, table, of_rows)


def moved_away(row: Row) -> None:
    row["translation"][0] += 500.0


def exchanged(row: Row) -> None:
    row["size"] = [row["size"][1], row["size"][0], row["size"][2]]


def turned(row: Row) -> None:
    """As boxes of another convention: the same rectangle, with another front."""
    w, _, _, z = row["rotation"]
    row["rotation"] = quaternion_from_yaw(2 * np.arctan2(z, w) + np.pi / 2).tolist()
    exchanged(row)


def w_last(row: Row) -> None:
    row["rotation"] = [*row["rotation"][1:], row["rotation"][0]]


def one_jumps(root: Path) -> None:
    def change(rows: list[Row]) -> None:
        next(row for row in rows if row["prev"] and row["next"])["translation"][0] += 80.0

    edit(root, "sample_annotation", change)


def far_from_the_map(root: Path) -> None:
    for table in ("ego_pose", "sample_annotation"):
        in_each(table, moved_away)(root)


def maps_one_folder_up(root: Path) -> None:
    (root.parent / "maps").mkdir()
    (root / "maps" / "expansion").rename(root.parent / "maps" / "expansion")


def maps_without_their_folder(root: Path) -> None:
    for path in (root / "maps" / "expansion").glob("*.json"):
        path.rename(root / "maps" / path.name)


IMPLAUSIBLE: dict[str, tuple[Callable[[Path], None], str, str, str]] = {
    "a box jumps": (one_jumps, "would have moved at 1.. m/s", "boxes", "2 annotations of objects that jump"),
    "the map does not fit": (
        far_from_the_map, "off the drivable area of boston-seaport in 100 %", "map", "in 100 % of the samples"
    ),
    "width and length are exchanged": (
        in_each("sample_annotation", exchanged), "lie across their motion", "boxes", "lie across their motion"
    ),
    "headings are turned": (
        in_each("sample_annotation", turned), "lie across their motion", "boxes", "lie across their motion"
    ),
    "ego rotations have w last": (in_each("ego_pose", w_last), " as x, y, z, w", "pose", " as x, y, z, w"),
    "boxes' rotations have w last": (
        in_each("sample_annotation", w_last), " as x, y, z, w", "pose", " as x, y, z, w"
    ),
    "maps are one folder up": (
        maps_one_folder_up, r"lies at \.\./maps/expansion/boston-seaport\.json", "map", "has no map with lanes"
    ),
    "maps lie in maps": (
        maps_without_their_folder, r"lies at maps/boston-seaport\.json", "map", "has no map with lanes"
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", IMPLAUSIBLE)
def test_each_is_a_warning_of_data_check_and_a_caveat_of_the_record(case: str, town: Path, tmp_path: Path) -> None:
    change, says, kind, sentence = IMPLAUSIBLE[case]
    root = copy_of(town, tmp_path / "data" / "root")
    change(root)
    if kind != "map":
        # Most of a check is about the map.
        shutil.rmtree(root / "maps" / "expansion")
    faults = check_tables(root)
    assert faults and {fault.severity for fault in faults} == {"warning"}
    assert any(re.search(says, fault.sentence) for fault in faults), faults
    record = evaluate(open_data(root), "val", planner_factory("stop"), tmp_path / "runs", EXACT)
    assert any(caveat.kind == kind and sentence in caveat.sentence for caveat in record.run.caveats)


def test_a_sound_root_has_neither(town: Path, tmp_path: Path) -> None:
    assert check_tables(town) == []
    names = ("idm", "ego-status", "constant-velocity-on-path", "log-replay")
    planners = [(planner_factory(name), EXACT) for name in names]
    for record in evaluate_together(open_data(town), "val", planners, tmp_path / "runs"):
        assert record.run.caveats == []
