"""What makes kept plans stale: code of the planner and of this project, and nothing that says nothing."""

import importlib
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from benchmark.runs import code_identity
from benchmark.runs.code_identity import code_sha256, hash_loaded_code, is_current, list_part_classes, project_sha256

PLANNER = """
from made_up.net import Net

class Planner:
    name = "made-up"

    def __init__(self):
        self.net = Net()

    def reset(self, scene):
        pass

    def plan(self, observation):
        return self.net.forward(observation)
"""
NET = """
from made_up.layers.gain import gain

class Net:
    def forward(self, observation):
        return gain(observation)
"""
GAIN = """
GAIN = 2.0

def gain(value):
    return GAIN * value
"""
FILES = {
    "made_up/__init__.py": "",
    "made_up/planner.py": PLANNER,
    "made_up/net.py": NET,
    "made_up/layers/__init__.py": "",
    "made_up/layers/gain.py": GAIN,
    "made_up/unrelated.py": "raise RuntimeError('not imported')",
}
ROOT = Path(__file__).resolve().parents[3]
Identify = Callable[..., str | None]


def written(folder: Path, files: dict[str, str]) -> None:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def forget(*tops: str) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] in tops]:
        del sys.modules[name]
    importlib.invalidate_caches()


@pytest.fixture
def load(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Writes a version of some files and imports the planner's module of them."""
    versions = 0
    tops: set[str] = set()

    def loaded(files: dict[str, str], module: str = "made_up.planner") -> ModuleType:
        nonlocal versions
        versions += 1
        folder = tmp_path / str(versions)
        written(folder, files)
        tops.update(name.partition("/")[0].removesuffix(".py") for name in files)
        forget(*tops)
        monkeypatch.syspath_prepend(str(folder))
        return importlib.import_module(module)

    yield loaded
    forget(*tops)


@pytest.fixture
def identity(load: Callable[..., ModuleType]) -> Identify:
    def computed(files: dict[str, str], module: str = "made_up.planner", **given: Any) -> str | None:
        return code_sha256(load(files, module).Planner, **given)

    return computed


def changed(name: str, old: str, new: str, files: dict[str, str] = FILES) -> dict[str, str]:
    assert old in files[name]
    return {**files, name: files[name].replace(old, new)}


def test_what_says_nothing_does_not_count(identity: Identify) -> None:
    before = identity(FILES)
    assert before is not None and before == identity(FILES)
    documented = changed("made_up/layers/gain.py", "def gain(value):", 'def gain(value):\n    """Louder."""  # much')
    spaced = changed("made_up/net.py", "gain(observation)", "gain(\n            observation\n        )")
    empty = changed("made_up/planner.py", "pass", '"""Nothing is remembered."""')
    for version in (documented, spaced, empty, changed("made_up/unrelated.py", "not", "never")):
        assert identity(version) == before


def test_what_a_plan_depends_on_counts(identity: Identify) -> None:
    versions = [
        FILES,
        changed("made_up/layers/gain.py", "2.0", "2.5"),
        changed("made_up/layers/gain.py", "2.0", "2"),
        changed("made_up/layers/gain.py", "GAIN * value", "value * GAIN"),
        changed("made_up/net.py", "class Net:", "class Net(list):"),
        changed("made_up/planner.py", '"made-up"', '"other"'),
        {**FILES, "made_up/layers/__init__.py": "import made_up.patches", "made_up/patches.py": "PATCHED = True"},
    ]
    hashes = [identity(version) for version in versions]
    assert len(set(hashes)) == len(versions) and None not in hashes


@pytest.mark.parametrize(
    "reaches",
    [
        "    def plan(self, observation):\n        from made_up.far import far\n        return far()",
        "    def plan(self, observation):\n        import made_up.far\n        return made_up.far.far()",
        "    def plan(self, observation):\n        from . import far as f\n        return f.far()",
        "    def plan(self, observation):\n        from .far import far as f\n        return f()",
        "    @decorated\n    def plan(self, observation): ...",
    ],
)
def test_every_import_counts_wherever_it_stands(identity: Identify, reaches: str) -> None:
    files = {
        "made_up/__init__.py": "",
        "made_up/planner.py": (
            f"from made_up.tables import decorated\n\nclass Planner:\n{reaches}\n    def reset(self, scene): ...\n"
        ),
        "made_up/tables.py": "def decorated(f):\n    from made_up.far import far\n    return far\n",
        "made_up/far.py": "from made_up.farther import FARTHER\n\ndef far():\n    return FARTHER\n",
        "made_up/farther.py": "from made_up import far\n\nFARTHER = 1\n",
    }
    assert identity(files) != identity(changed("made_up/farther.py", "1", "2", files))


def test_imports_for_type_checkers_do_not_count(identity: Identify) -> None:
    typed = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from made_up.unrelated import X\n"
    files = {**FILES, "made_up/net.py": typed + NET}
    assert identity(files) == identity(changed("made_up/unrelated.py", "not", "never", files))


def test_base_classes_of_another_package_and_modules_beside_a_script_count(identity: Identify) -> None:
    files = {
        "lonely.py": "import beside\nfrom made_up.net import Net\n\nclass Planner(Net):\n    reset = beside.reset\n",
        "beside.py": "def reset(self, scene): return 1\n",
        **FILES,
    }
    before = identity(files, "lonely")
    assert before != identity(changed("beside.py", "1", "2", files), "lonely")
    assert before != identity(changed("made_up/layers/gain.py", "2.0", "3.0", files), "lonely")
    assert before == identity(changed("made_up/unrelated.py", "not", "never", files), "lonely")


def test_who_made_a_planner_and_what_it_was_given_count(load: Callable[..., ModuleType]) -> None:
    files = {
        "made_up/__init__.py": "",
        "made_up/planner.py": "class Planner:\n    def __init__(self, net): self.net = net\n",
        "made_up/making.py": (
            "from made_up.planner import Planner\nfrom made_up.net import Net\n\n"
            "def made():\n    return Planner(Net())\n"
        ),
        "made_up/net.py": "class Net:\n    SIZE = 64\n",
    }

    def hashes(files: dict[str, str]) -> tuple[str | None, ...]:
        planner = load(files, "made_up.making").made()
        made = type(planner)
        by = code_sha256(made, made_by="made_up.making:made")
        return code_sha256(made), by, code_sha256(made, parts=list_part_classes(planner))

    before, after = hashes(files), hashes(changed("made_up/net.py", "64", "65", files))
    assert [one == two for one, two in zip(before, after)] == [True, False, False]


def test_packages_without_init_files_import_cycles_and_broken_files(identity: Identify) -> None:
    files = {
        "made_up/planner.py": "from made_up.parts.one import one\n\nclass Planner:\n    plan = one\n",
        "made_up/parts/one.py": "from made_up.parts import two\n\ndef one(self): return two.two()\n",
        "made_up/parts/two.py": (
            "import made_up.parts.one as one\n\n"
            "def two():\n    import made_up.old\n    import made_up.absent\n    return 1\n"
        ),
        "made_up/old.py": "print 'written for an older Python'\n",
    }
    before = identity(files)
    assert before is not None
    assert before != identity(changed("made_up/parts/two.py", "return 1", "return 2", files))
    assert before != identity(changed("made_up/old.py", "older", "much older", files))


def test_an_installed_planner_counts_with_its_package_and_without_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def installed(version: str, other: str) -> str | None:
        folder = tmp_path / f"{version}-{other}" / "site-packages"
        planner = "import other_lib\nfrom made_up import net\n\nclass Planner:\n    plan = net.plan\n"
        written(folder, {"made_up/__init__.py": "", "made_up/planner.py": planner, "other_lib.py": f"A = {other}\n"})
        written(folder, {"made_up/net.py": f"def plan(self, seen): return {version}\n"})
        forget("made_up", "other_lib")
        monkeypatch.syspath_prepend(str(folder))
        return code_sha256(importlib.import_module("made_up.planner").Planner)

    assert installed("1", "1") == installed("1", "2") != installed("2", "2")
    forget("made_up", "other_lib")


def test_classes_without_a_file_have_no_hash() -> None:
    namespace: dict[str, Any] = {"__name__": "nowhere"}
    exec("class Planner:\n    name = 'typed in'", namespace)
    assert code_sha256(namespace["Planner"]) is None


def test_what_was_loaded_is_known_and_checked(load: Callable[..., ModuleType], tmp_path: Path) -> None:
    load(FILES)
    loaded = {file: sha256 for file, sha256 in hash_loaded_code().items() if Path(file).is_relative_to(tmp_path)}
    assert {Path(file).name for file in loaded} == {"__init__.py", "planner.py", "net.py", "gain.py"}
    gain = next(Path(file) for file in loaded if file.endswith("gain.py"))
    assert is_current(loaded)
    gain.write_text(f"# commented\n{GAIN}")
    assert is_current(loaded)
    gain.write_text(GAIN.replace("2.0", "2.25"))
    assert not is_current(loaded)
    gain.unlink()
    assert not is_current(loaded)


@pytest.fixture
def copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of some of this project's code, from which its hash is computed."""
    for part in ("benchmark/cli", "adapters/networks/layers", "adapters/extensions/training", "generation/pipeline"):
        shutil.copytree(ROOT / part, tmp_path / part, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "benchmark" / "constants.py", tmp_path / "benchmark")
    monkeypatch.setattr(code_identity, "__file__", str(tmp_path / "benchmark" / "runs" / "code_identity.py"))
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    return tmp_path


def hashed() -> str:
    project_sha256.cache_clear()
    found = project_sha256()
    project_sha256.cache_clear()
    return found


def test_code_of_this_project_counts_and_what_no_plan_depends_on_does_not(copied: Path) -> None:
    def edited(name: str, old: str, new: str) -> None:
        text = (copied / name).read_text()
        assert old in text
        (copied / name).write_text(text.replace(old, new, 1))

    before = hashed()
    edited("adapters/networks/layers/resnet.py", '"""', '"""Again: ')
    edited("benchmark/constants.py", "PLAN_STEPS: Final = 6", "PLAN_STEPS: Final = 6  # of 0.5 s")
    for apart in ("benchmark/cli/drive.py", "adapters/extensions/training/trainer.py", "generation/pipeline/split.py"):
        (copied / apart).write_text(f"{(copied / apart).read_text()}\nADDED = 1\n")
    assert hashed() == before
    edited("adapters/networks/layers/resnet.py", "EXPANSION = 4", "EXPANSION = 3")
    other = hashed()
    edited("benchmark/constants.py", "PLAN_STEPS: Final = 6", "PLAN_STEPS: Final = 7")
    assert len({before, other, hashed()}) == 3


def test_the_hash_of_this_project_is_kept_and_needs_no_cache(copied: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    before = hashed()
    assert len(list((copied / "cache" / "code").iterdir())) == 1
    (copied / "file").write_text("in the way")
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(copied / "file"))
    assert hashed() == before
