"""What the planners of this project depend on: their own networks, and nothing of training or of other networks."""

import importlib
import shutil
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import pytest

import adapters
import benchmark
from adapters.registry import BUILT_IN, MINIATURES, WITH_WEIGHTS, planner
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.planning import PrivilegedPlanner, SceneInfo
from benchmark.runs import code_identity
from benchmark.runs.code_identity import Definition, code_sha256, dependencies_of
from generation.sources.mini import TownSettings, build_town

PLANNERS = {
    "vad": "adapters.networks.vad.planner:VADPlanner",
    "uniad": "adapters.networks.uniad.planner:UniADPlanner",
    "sparse": "adapters.networks.sparse.planner:SparsePlanner",
}
MADE_BY = BUILT_IN | WITH_WEIGHTS | MINIATURES
FAMILIES = {"sparsedrive": "sparse", "diffusiondrive": "sparse"}


def planner_class(reference: str) -> type:
    module, _, name = reference.partition(":")
    found = getattr(importlib.import_module(module), name)
    assert isinstance(found, type)
    return found


def family_of(name: str) -> str:
    first = name.partition("-")[0]
    return FAMILIES.get(first, first)


def class_of(name: str) -> type:
    return planner_class(BUILT_IN.get(name) or PLANNERS[family_of(name)])


@pytest.mark.parametrize("name", MADE_BY)
def test_planners_depend_on_their_own_network_and_on_no_training(name: str) -> None:
    found = dependencies_of(class_of(name), made_by=MADE_BY[name], name=name)
    modules = {each.module for each in found}
    assert not [module for module in modules if "training" in module or "verification" in module]
    assert not modules & {
        "adapters.native_models",
        "adapters.registry",
        "benchmark.evaluation",
        "benchmark.records.run",
    }
    others = set() if name in BUILT_IN else {family_of(name)}
    for family in set(PLANNERS) - others:
        assert not [module for module in modules if module.startswith(f"adapters.networks.{family}.")]
    if name not in BUILT_IN:
        assert {
            f"adapters.networks.{family_of(name)}.model",
            "adapters.networks.layers.resnet",
            "adapters.camera_inputs",
        } <= modules


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the code, from which identities are computed."""
    for package in (adapters, benchmark):
        there, here = Path(package.__path__[0]), tmp_path / package.__name__
        for path in there.rglob("*.py"):
            copy = here / path.relative_to(there)
            copy.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(path, copy)
        monkeypatch.setattr(package, "__path__", [str(here)])
        monkeypatch.setattr(package, "__file__", str(here / "__init__.py"))
    return tmp_path


def edited(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))


@pytest.mark.parametrize("name", ["vad-tiny", "vad-mini", "uniad-mini", "diffusiondrive-mini"])
def test_an_edit_of_the_network_counts_and_of_anything_else_does_not(copied: Path, name: str) -> None:
    def identity() -> str | None:
        code_identity._identity.cache_clear()
        return code_sha256(class_of(name), made_by=MADE_BY[name], name=name)

    before = identity()
    edited(copied / "adapters/networks/layers/resnet.py", '"""', '"""Again: ')
    for path in [*copied.glob("adapters/training/*.py"), *copied.glob("adapters/training/*/*.py")]:
        path.write_text(f"{path.read_text()}\n\nADDED = 1\n")
    edited(copied / "benchmark/constants.py", "PLAN_STEPS: Final = 6", "NEW_CONSTANT = 3\nPLAN_STEPS: Final = 6")
    assert identity() == before is not None
    edited(copied / "adapters/networks/layers/resnet.py", "EXPANSION = 4", "EXPANSION = 3")
    assert identity() != before


def test_a_planner_that_is_made_by_its_own_class_has_one_identity() -> None:
    made = class_of("constant-velocity")
    assert code_sha256(made, made_by=BUILT_IN["constant-velocity"], name="constant-velocity") == code_sha256(made)


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    root = build_town(tmp_path_factory.mktemp("town"), TownSettings(val_scenes=1, frames="keyframes"), workers=1)
    return NuScenesData.open(root)


@pytest.mark.parametrize("name", BUILT_IN | MINIATURES)
def test_all_that_runs_while_a_planner_plans_is_in_its_identity(town: NuScenesData, name: str) -> None:
    scene = town.scene(town.scene_names("val")[0])
    observations = list(town.observations(scene.name))[:3]
    ran: set[Definition] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        module = frame.f_globals.get("__name__", "")
        # Images are read by the data set, which the planner is given.
        ours = module.startswith(("adapters.", "benchmark.")) and "datasets" not in module
        if ours and event == "call" and frame.f_code.co_filename.endswith(".py"):
            ran.add(Definition(module, frame.f_code.co_qualname.partition(".")[0]))

    driver = planner(name)
    sys.setprofile(note)
    try:
        driver.reset(SceneInfo(scene.name, scene.road_map.location, scene.cameras))
        if isinstance(driver, PrivilegedPlanner):
            driver.reveal(scene)
        for observation in observations:
            driver.plan(observation)
    finally:
        sys.setprofile(None)
    found = set(dependencies_of(type(driver), made_by=MADE_BY[name], name=name))
    assert ran and {each for each in ran if not each.name.startswith("<")} <= found
