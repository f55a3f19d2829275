"""Kept plans are taken while the code they were made by is the same, and made again when it is not."""

import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

from adapters.models import MODELS, baselines, miniatures, resolve
from adapters.registry import build_planner, describe_maker, planner_factory
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.planning import PrivilegedPlanner, SceneInfo
from benchmark.runs.code_identity import APART, code_sha256
from generation.sources.town import build_town_scene
from tests.benchmark.fake_data import town_of_two
from tests.generation.nuscenes_writer.written_roots import write_root

LONELY = """
import beside, importlib, pathlib
import numpy as np
from benchmark import Plan, PlanFrame

class Planner:
    name = "lonely"

    def reset(self, scene):
        with open("asked", "a") as stream:
            stream.write("x")

    def plan(self, observation):
        found = importlib.import_module("_".join(["named", "later"]))
        return Plan(np.full((6, 2), beside.GAIN * found.GAIN), PlanFrame.EGO)
"""


@pytest.fixture
def asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Evaluates a planner in a lone file, and says of how many scenes it was asked."""
    monkeypatch.chdir(tmp_path)
    for name, text in (("lonely", LONELY), ("beside", "GAIN = 1.0"), ("named_later", "GAIN = 1.0")):
        (tmp_path / f"{name}.py").write_text(text)

    one = EvalSettings(scenes=("scene-9901",), protocols=("exact",))

    def count() -> int:
        (tmp_path / "asked").write_text("")
        evaluate(town_of_two(), "val", planner_factory("lonely:Planner"), tmp_path / "runs", one)
        return len((tmp_path / "asked").read_text())

    return count


@pytest.mark.parametrize("helper", ["beside", "named_later"])
def test_an_edited_helper_beside_a_lone_planner_is_planned_again(tmp_path: Path, asked: Any, helper: str) -> None:
    assert asked() == 1
    path = tmp_path / f"{helper}.py"
    path.write_text("GAIN = 1.0  # the same")
    assert asked() == 0
    path.write_text("GAIN = 2.0")
    assert asked() == 1 and asked() == 0


def class_of(name: str) -> type:
    found = resolve(MODELS[name].planner)
    assert isinstance(found, type)
    return found


def test_a_planner_that_is_made_by_its_own_class_has_one_identity() -> None:
    made = class_of("constant-velocity")
    assert code_sha256(made, made_by=describe_maker("constant-velocity")) == code_sha256(made)


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    """The first seconds of one scene."""
    root = tmp_path_factory.mktemp("town")
    write_root(root, [build_town_scene("val", 0).first_frames(60)])
    return NuScenesData.open(root)


@pytest.mark.parametrize("name", baselines() | miniatures())
def test_all_that_runs_while_a_planner_plans_is_in_its_identity(town: NuScenesData, name: str) -> None:
    scene = town.scene(town.scene_names("val")[0])
    observations = list(town.observations(scene.name))[:3]
    ran: set[str] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            ran.add(frame.f_globals.get("__name__", ""))

    driver = build_planner(name)
    sys.setprofile(note)
    try:
        driver.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
        if isinstance(driver, PrivilegedPlanner):
            driver.reveal(scene)
        for observation in observations:
            driver.plan(observation)
    finally:
        sys.setprofile(None)
    apart = tuple(each.replace("/", ".") for each in APART)
    assert ran and not [module for module in ran if module.startswith((*apart, "generation", "leaderboard"))]
