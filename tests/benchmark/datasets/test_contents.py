"""What a data set holds, counted."""

import json
from pathlib import Path
from typing import Any

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
        "scenes": ["scene-9901", "scene-9902"], "samples": 32, "instances": 6, "annotations": 6 * 16, "adversaries": 0,
    }  # fmt: skip
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


FOUND: dict[str, Any] = {
    "name": "adv", "root": "/data/adv", "version": "v1.0-trainval", "fingerprint": "f" * 64,
    "made_from": {"name": "mini", "fingerprint": "0123456789abcdef" * 4},
    "splits": {"adv": {
        "scenes": [f"scene-{number:04d}-{number:08x}" for number in range(30)],
        "samples": 1200, "instances": 720, "annotations": 158400, "adversaries": 30,
    }},
    "unusable_splits": {},
}  # fmt: skip


def test_a_data_set_is_told_in_words_and_a_table_not_in_dictionaries() -> None:
    text = format_contents(FOUND, 80)
    assert not set("{}[]'") & set(text)
    assert all(len(line) <= 80 for line in text.splitlines())
    assert "made from:   mini (0123456789ab…)" in text and "158,400" in text
    assert "scene-0023" in text and "scene-0024" not in text and "6 more" in text


def test_recordings_are_made_from_nothing_and_foreign_provenance_is_no_crash() -> None:
    assert "made from" not in format_contents({**FOUND, "made_from": None}, 80)
    assert "made from" not in format_contents({**FOUND, "made_from": "somewhere"}, 80)
