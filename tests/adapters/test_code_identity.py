"""What the planners of this project depend on: their own networks, and nothing of training or of other networks."""

import importlib
import shutil
from pathlib import Path

import pytest

import adapters
import benchmark
from adapters.registry import BUILT_IN, MINIATURES, WITH_WEIGHTS
from benchmark.runs import code_identity
from benchmark.runs.code_identity import code_sha256, dependencies_of

PLANNERS = {
    "vad": "adapters.vad.planner:VADPlanner",
    "uniad": "adapters.uniad.planner:UniADPlanner",
    "sparse": "adapters.sparse.planner_adapter:SparsePlanner",
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
    assert not modules & {"adapters.native_models", "adapters.registry", "benchmark.evaluate", "benchmark.records"}
    others = set() if name in BUILT_IN else {family_of(name)}
    for family in set(PLANNERS) - others:
        assert not [module for module in modules if module.startswith(f"adapters.{family}.")]
    if name not in BUILT_IN:
        assert {f"adapters.{family_of(name)}.model", "adapters.layers.resnet", "adapters.camera_inputs"} <= modules


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
    path.write_text(text.replace(old, new))


@pytest.mark.parametrize("name", ["vad-tiny", "vad-mini", "uniad-mini", "diffusiondrive-mini"])
def test_an_edit_of_the_network_counts_and_of_anything_else_does_not(copied: Path, name: str) -> None:
    def identity() -> str | None:
        code_identity._identity.cache_clear()
        return code_sha256(class_of(name), made_by=MADE_BY[name], name=name)

    before = identity()
    edited(copied / "adapters/layers/resnet.py", '"""', '"""Again: ')
    for path in [*copied.glob("adapters/training/*.py"), *copied.glob("adapters/*/training*.py")]:
        path.write_text(f"{path.read_text()}\n\nADDED = 1\n")
    edited(copied / "benchmark/constants.py", "PLAN_STEPS: Final = 6", "NEW_CONSTANT = 3\nPLAN_STEPS: Final = 6")
    assert identity() == before is not None
    edited(copied / "adapters/layers/resnet.py", "EXPANSION = 4", "EXPANSION = 3")
    assert identity() != before
