"""What this project's own search makes, by every preset, is no cheating."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.extensions.challenge.checking import check_entry
from benchmark.extensions.challenge.rules import RULE_SETS
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import build_split
from generation.search.presets import PRESETS, Preset, build_hyper_parameters
from generation.splits.building import build_frozen
from generation.splits.packaged import NamedSplit, read_frozen_split
from tests.generation.labels.recorded_roads import CHEAP
from tests.generation.sources.first_towns import FIRST_SPLITS, write_first_town
from tests.generation.splits.frozen_files import recordings


def at_night(names: Sequence[str], *slow: str) -> list[Any]:
    """Searches and splits take seconds each: some of them run at night."""
    return [pytest.param(name, marks=[pytest.mark.slow] if name in slow else []) for name in names]


@pytest.fixture(scope="module")
def road(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return recordings(tmp_path_factory.mktemp("road"))


@pytest.mark.parametrize("preset", at_night(PRESETS, "near", "reference"))
def test_no_entry_of_a_preset_is_refused(preset: Preset, road: DataSet, tmp_path: Path) -> None:
    hyper = replace(build_hyper_parameters(preset), candidates=24, rounds=2)
    build_split(road, "adv", replace(CHEAP, out=tmp_path, hyper=hyper, per_scene=3))
    entry, has_limits = open_data(tmp_path), preset in ("default", "near")
    for rules in ("paper", *(["default", "strict"] if has_limits else [])):
        verdict = check_entry(entry, road, RULE_SETS[rules])
        assert verdict.scenes and verdict.accepted, verdict
    if not has_limits:
        # Searches that mind neither limits nor road in what they drop may break these rules, and no others.
        reasons = [
            reason for scene in check_entry(entry, road, RULE_SETS["default"]).scenes for reason in scene.reasons
        ]
        assert {reason.rule.split(".")[0] for reason in reasons} <= {"motion", "road"}


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return write_first_town(tmp_path_factory.mktemp("town"), 0)


@pytest.mark.parametrize("name", at_night(FIRST_SPLITS, "mini-adv-2"))
def test_no_scene_of_a_packaged_split_is_refused(name: str, town: DataSet, tmp_path: Path) -> None:
    packaged = read_frozen_split(name)
    few = [scene for scene in packaged.frozen.scenes if scene.source in town.scene_names(None)]
    split = NamedSplit(name, packaged.frozen.model_copy(update={"scenes": tuple(few)}))
    build_frozen(town, split, BuildSettings(out=tmp_path, version="v1.0-mini", renderer=None, frames="keyframes"))
    verdict = check_entry(open_data(tmp_path), town, RULE_SETS["strict"])
    assert len(verdict.scenes) == len(few) > 0 and verdict.accepted, verdict
