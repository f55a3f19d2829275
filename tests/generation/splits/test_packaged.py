"""The frozen splits that come with the package: in the wheel, valid, and building for ever."""

import tomllib
from collections.abc import Callable
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

import numpy as np
import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.geometry import boxes_overlap
from generation.labels.labelling import read_agent_boxes
from generation.search.verify import find_contacts
from generation.sources.embedded import format_town
from generation.sources.mini import TownSettings, build_town_data_set
from generation.splits import packaged
from generation.splits.building import build_frozen
from generation.splits.format import write_frozen
from generation.splits.packaged import NamedSplit, list_packaged_splits, read_frozen_split, read_newest_split
from tests.generation.sources.first_towns import FIRST_SPLITS, list_numbers, write_first_town
from tests.generation.splits.frozen_files import BUILT
from tests.generation.splits.test_format import split

ROOT = Path(__file__).resolve().parents[3]
FILES = sorted((ROOT / "generation" / "splits").glob("*.json"))


@pytest.fixture(scope="module")
def towns(tmp_path_factory: pytest.TempPathFactory) -> Callable[[NamedSplit], DataSet]:
    """The town of a split up to its first recording, without images."""
    first = write_first_town(tmp_path_factory.mktemp("first"), 0)

    def find(named: NamedSplit) -> DataSet:
        if named.name in FIRST_SPLITS:
            return first
        settings = TownSettings(val_scenes=list_numbers(named)[0] + 1, images=False, version=2)
        root = tmp_path_factory.mktemp("town")
        return open_data(build_town_data_set(root, settings, workers=1), name=format_town(2))

    return find


def test_every_file_has_a_name_and_comes_with_the_wheel() -> None:
    config = tomllib.loads((ROOT / "pyproject.toml").read_text())
    patterns = config["tool"]["setuptools"]["package-data"]["generation.splits"]
    assert "mini-adv-1" in list_packaged_splits() and len(list_packaged_splits()) == len(FILES)
    for file in FILES:
        assert any(fnmatch(file.name, pattern) for pattern in patterns)
        assert file.stem in list_packaged_splits()


@pytest.mark.parametrize("name", list_packaged_splits("mini"))
def test_each_is_small_valid_and_still_builds(
    name: str, towns: Callable[[NamedSplit], DataSet], tmp_path: Path
) -> None:
    named = read_frozen_split(name)
    town = towns(named)
    assert len(named.frozen.text()) / len(named.frozen.scenes) < 10_000
    first = next(scene for scene in named.frozen.scenes if scene.source == town.scene_names("val")[-1])
    report = build_frozen(town, named, replace(BUILT, out=tmp_path, renderer=None, scenes=(first.name,)))
    assert (report.written, report.other_tables) == ((first.name,), ())
    scene = open_data(tmp_path).scene(first.name)
    agent, start = scene.agents.ids.index(scene.adversaries[0]), first.adversaries[0].launch_frame
    boxes = read_agent_boxes(scene, agent)[start:]
    assert not boxes_overlap(boxes, scene.ego.boxes[start:]).any()
    assert not len(find_contacts(boxes, scene, agent, np.arange(start, start + len(boxes)))[0])


def test_the_newest_has_the_highest_number(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("mini-adv-2", "mini-adv-10", "mini-adv-9", "maxi-adv-11", "notes"):
        write_frozen(tmp_path / f"{name}.json", split())
    monkeypatch.setattr(packaged, "_FOLDER", tmp_path)
    assert list_packaged_splits("mini") == ("mini-adv-2", "mini-adv-9", "mini-adv-10")
    assert read_newest_split("mini").name == "mini-adv-10"
    assert list_packaged_splits()[0] == "maxi-adv-11"
    with pytest.raises(InputError, match="no frozen split adv of midi"):
        read_newest_split("midi")


def test_a_split_is_a_name_or_a_file(tmp_path: Path) -> None:
    write_frozen(tmp_path / "mine.json", split())
    assert read_frozen_split(tmp_path / "mine.json").name == "mine"
    assert read_frozen_split("mini-adv-1").frozen.recordings.name == "mini"
    with pytest.raises(InputError, match="mini-adv-1"):
        read_frozen_split("mini-adv-0")
