"""What a data set holds, counted."""

import json
from pathlib import Path

import pytest

from benchmark.datasets.contents import contents, format_contents
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.datasets.roots import open_data
from benchmark.evaluation import EvalSettings
from tests.benchmark.datasets.nuscenes_tables import TinyRoot
from tests.benchmark.fake_data import town_of_two
from tests.hand_made import scene_on_straight_road


def test_samples_objects_and_annotations_are_counted_by_split() -> None:
    found = contents(town_of_two(slow_leader=True))
    assert found["splits"]["val"] == {
        "scenes": ["scene-9901", "scene-9902"],
        "samples": 32,
        "instances": 6,
        "annotations": 6 * 16,
        "adversaries": 0,
    }
    assert (found["name"], found["made_from"]) == ("fake", None)


SPLITS: dict[str, dict[str, list[str]] | None] = {
    "nothing is said": None,
    "one is empty": {"train": [], "val": ["scene-9901"]},
    "one names a scene that is not there": {"train": ["scene-9900"], "val": ["scene-9901"]},
    "all are broken": {"train": [], "val": ["scene-9900"]},
}


@pytest.mark.parametrize("case", SPLITS)
def test_splits_that_are_listed_can_be_evaluated_and_others_say_why_not(case: str, tmp_path: Path) -> None:
    root, said = TinyRoot.of(tmp_path, [scene_on_straight_road(name="scene-9901", seconds=3.0)]).write(), SPLITS[case]
    if said is not None:
        (root / "splits.json").write_text(json.dumps(said))
    found = contents(NuScenesData.open(root))
    for split, held in found["splits"].items():
        assert EvalSettings().chosen(open_data(root), split) == tuple(held["scenes"])
    assert {*found["splits"], *found["unusable_splits"]} == set(said or {"val": []})
    assert all(split in ("train", "val") and "splits.json" in why for split, why in found["unusable_splits"].items())
    text = format_contents(found, 300)
    assert all(f"{split} cannot be evaluated: " in text for split in found["unusable_splits"])


def test_official_splits_are_listed_by_their_names(tmp_path: Path) -> None:
    root = TinyRoot.of(tmp_path, [scene_on_straight_road(name="scene-0103", seconds=3.0)]).write()
    assert list(contents(NuScenesData.open(root))["splits"]) == ["mini_val", "val"]
