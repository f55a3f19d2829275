"""What the planners of this project depend on: their own networks, and nothing of training or of other networks."""

import shutil
import sys
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

import pytest
import torch

import adapters
import benchmark
from adapters.models import MODELS, baselines, miniatures, resolve
from adapters.networks.uniad.config import UniADConfig
from adapters.registry import made_by, planner
from benchmark.datasets.nuscenes import NuScenesData
from benchmark.planning import PrivilegedPlanner, SceneInfo
from benchmark.runs import code_identity
from benchmark.runs.code_identity import Dependency, code_sha256, dependencies_of, parts_of
from generation.sources.mini import TownSettings, build_town

FAMILIES = ("vad", "uniad", "sparse")


@cache
def parts_of_network(name: str) -> frozenset[type]:
    """Classes of a planner's network, which needs no memory on this device."""
    model = MODELS[name]
    if model.network is None:
        return frozenset()
    config = model.configuration() if not model.net.fitted else UniADConfig.base()
    with torch.device("meta"):
        network = resolve(model.net.build)(config)
    return frozenset(type(each) for each in network.modules())


def given(name: str) -> dict[str, Any]:
    return {"made_by": made_by(name), "parts": parts_of_network(name)}


def class_of(name: str) -> type:
    found = resolve(MODELS[name].planner)
    assert isinstance(found, type)
    return found


@pytest.mark.parametrize("name", MODELS)
def test_planners_depend_on_their_own_network_and_on_no_training(name: str) -> None:
    modules = {each.module for each in dependencies_of(class_of(name), **given(name))}
    assert not [module for module in modules if "training" in module or "verification" in module]
    assert not modules & {"adapters.registry", "benchmark.evaluation", "benchmark.records.run"}
    assert Dependency("adapters.models", "MODELS") not in dependencies_of(class_of(name), **given(name))
    own = [family for family in FAMILIES if f".{family}." in MODELS[name].planner]
    for family in FAMILIES:
        reached = [module for module in modules if module.startswith(f"adapters.networks.{family}.")]
        assert bool(reached) == (family in own)
    for family in own:
        network = {f"adapters.networks.{family}.model", "adapters.networks.layers.resnet", "adapters.camera_inputs"}
        assert network <= modules


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
        return code_sha256(class_of(name), **given(name))

    before = identity()
    edited(copied / "adapters/networks/layers/resnet.py", '"""', '"""Again: ')
    for path in [
        *copied.glob("adapters/extensions/training/*.py"),
        *copied.glob("adapters/extensions/training/*/*.py"),
    ]:
        path.write_text(f"{path.read_text()}\n\nADDED = 1\n")
    edited(copied / "benchmark/constants.py", "PLAN_STEPS: Final = 6", "NEW_CONSTANT = 3\nPLAN_STEPS: Final = 6")
    assert identity() == before is not None
    edited(copied / "adapters/networks/layers/resnet.py", "EXPANSION = 4", "EXPANSION = 3")
    assert identity() != before


def test_a_planner_that_is_made_by_its_own_class_has_one_identity() -> None:
    made = class_of("constant-velocity")
    assert code_sha256(made, made_by=made_by("constant-velocity")) == code_sha256(made)


@pytest.fixture(scope="module")
def town(tmp_path_factory: pytest.TempPathFactory) -> NuScenesData:
    root = build_town(tmp_path_factory.mktemp("town"), TownSettings(val_scenes=1, frames="keyframes"), workers=1)
    return NuScenesData.open(root)


@pytest.mark.parametrize("name", baselines() | miniatures())
def test_all_that_runs_while_a_planner_plans_is_in_its_identity(town: NuScenesData, name: str) -> None:
    scene = town.scene(town.scene_names("val")[0])
    observations = list(town.observations(scene.name))[:3]
    ran: set[Dependency] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        module = frame.f_globals.get("__name__", "")
        # Images are read by the data set, which the planner is given, and by the door for it.
        given_by_data = "datasets" in module or module.startswith("benchmark.untrusted.")
        ours = module.startswith(("adapters.", "benchmark.")) and not given_by_data
        if ours and event == "call" and frame.f_code.co_filename.endswith(".py"):
            ran.add(Dependency(module, frame.f_code.co_qualname.partition(".")[0]))

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
    found = set(dependencies_of(type(driver), made_by=made_by(name), parts=parts_of(driver)))
    assert ran and {each for each in ran if not each.name.startswith("<")} <= found
