import ast
import importlib
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from benchmark.runs.code_identity import Dependency, code_sha256, dependencies_of, parts_of

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
    "made_up/unrelated.py": "raise RuntimeError('nobody imports this')",
}
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


@pytest.fixture
def ours(monkeypatch: pytest.MonkeyPatch) -> None:
    """Counts the made-up package as one of this project."""
    for module in ("code_identity", "module_files"):
        monkeypatch.setattr(f"benchmark.runs.{module}.OURS", frozenset({"benchmark", "adapters", "made_up"}))


def test_what_says_nothing_and_where_it_lies_does_not_count(identity: Identify) -> None:
    before = identity(FILES)
    assert before is not None and before == identity(FILES)
    documented = changed("made_up/layers/gain.py", "def gain(value):", 'def gain(value):\n    """Louder."""  # much')
    spaced = changed("made_up/net.py", "gain(observation)", "gain(\n            observation\n        )")
    empty = changed("made_up/planner.py", "pass", '"""Nothing is remembered."""')
    moved = {name: text for name, text in FILES.items() if name != "made_up/layers/gain.py"}
    moved["made_up/deep/__init__.py"] = '"""Layers."""'
    moved["made_up/deep/loud.py"] = GAIN
    moved = changed("made_up/net.py", "made_up.layers.gain", "made_up.deep.loud", moved)
    later = changed(
        "made_up/net.py", "        return gain", "        from .layers.gain import gain\n        return gain"
    )
    later = changed("made_up/net.py", "from made_up.layers.gain import gain\n\n", "import math, sys\n\n", later)
    apart = {**FILES, "made_up/constants.py": "GAIN = 2.0"}
    apart = changed("made_up/layers/gain.py", "GAIN = 2.0", "from made_up.constants import GAIN", apart)
    for version in (documented, spaced, empty, moved, later, apart):
        assert identity(version) == before
    assert identity(changed("made_up/unrelated.py", "nobody", "somebody")) == before


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


def test_what_an_imported_name_stands_for_counts_though_the_import_line_does_not(
    identity: Identify, ours: None
) -> None:
    layers = {**FILES, "made_up/layers/gain.py": GAIN + "\ndef other(value):\n    return value\n"}
    both = changed("made_up/planner.py", "pass", "from made_up.layers.gain import gain, other; gain(other(1))", layers)
    swapped = changed("made_up/net.py", "import gain", "import other as gain", both)
    assert identity(both) != identity(swapped)
    one = changed("made_up/net.py", "from made_up.layers.gain import gain", "from math import sin as gain")
    two = changed("made_up/net.py", "from math import sin as gain", "from math import cos as gain", one)
    assert identity(one) != identity(two)
    dotted = changed("made_up/net.py", "from math import sin as gain", "from cmath import sin as gain", one)
    assert identity(dotted) != identity(one)


def test_of_this_project_only_definitions_that_are_reached_count(identity: Identify, ours: None) -> None:
    before = identity(FILES)
    beside = {**FILES, "made_up/layers/gain.py": GAIN + "\nLOSS = 3.0\n\ndef train(): ...\n"}
    assert identity(beside) == before
    assert identity(changed("made_up/layers/gain.py", "2.0", "2.5")) != before
    assert identity({**FILES, "made_up/layers/gain.py": GAIN + "\nprint(gain(1))\n"}) != before
    typed = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from made_up.unrelated import X\n"
    assert identity({**FILES, "made_up/net.py": typed + NET}) == before
    run = "\nif __name__ == '__main__':\n    import made_up.unrelated\n"
    assert identity({**FILES, "made_up/planner.py": PLANNER + run}) == before
    whole = changed("made_up/net.py", "from made_up.layers.gain import gain", "import made_up.layers.gain as layers")
    whole = changed("made_up/net.py", "gain(observation)", "getattr(layers, 'gain')(observation)", whole)
    assert identity(whole) != identity(changed("made_up/layers/gain.py", "GAIN = 2.0", "A = 1; GAIN = 2.0", whole))


def test_methods_may_change_places_and_fields_may_not(identity: Identify) -> None:
    methods = "class Net:\n    {}\n    forward = print\n"
    first, second = "def a(self): return 1", "def b(self): return 2"
    one = {**FILES, "made_up/net.py": methods.format(f"{first}\n    {second}")}
    two = {**FILES, "made_up/net.py": methods.format(f"{second}\n    {first}")}
    assert identity(one) == identity(two)
    one = {**FILES, "made_up/net.py": methods.format("a = 1\n    b = 2")}
    two = {**FILES, "made_up/net.py": methods.format("b = 2\n    a = 1")}
    assert identity(one) != identity(two)


@pytest.mark.parametrize("whose", ["stranger", "project"])
@pytest.mark.parametrize(
    "reaches",
    [
        "    def plan(self, observation):\n        from made_up.far import far\n        return far()",
        "    def plan(self, observation):\n        import made_up.far\n        return made_up.far.far()",
        "    def plan(self, observation):\n        from . import far as f\n        return f.far()",
        "    def plan(self, observation):\n        return importlib.import_module('made_up.far').far()",
        "    def plan(self, observation):\n        return importlib.import_module('.far', __package__).far()",
        "    def plan(self, observation):\n        return importlib.import_module(f'made_up.{self.part}').far()",
        "    def plan(self, observation):\n        return LOOKED_UP['far']()",
        "    @decorated\n    def plan(self, observation): ...",
    ],
)
def test_every_way_to_another_module_counts(
    identity: Identify, reaches: str, whose: str, request: pytest.FixtureRequest
) -> None:
    if whose == "project":
        request.getfixturevalue("ours")
    head = "import importlib\nfrom made_up.tables import LOOKED_UP, decorated\n\nclass Planner:\n"
    files = {
        "made_up/__init__.py": "",
        "made_up/planner.py": f"{head}{reaches}\n    def reset(self, scene): ...\n",
        "made_up/tables.py": (
            "LOOKED_UP = {'far': 'made_up.far:far'}\n\n"
            "def decorated(f):\n    from made_up.far import far\n    return far"
        ),
        "made_up/far.py": "from made_up.farther import FARTHER\n\ndef far():\n    return FARTHER\n",
        "made_up/farther.py": "from made_up import far\n\nFARTHER = 1\n",
    }
    assert identity(files) != identity(changed("made_up/farther.py", "1", "2", files))


@pytest.mark.parametrize(
    "face",
    [
        "{'Net': 'made_up.net'}",
        "{'Net': '.net'}",
        "{'Net': 'made_up.net:Net'}",
        "{'Net': ('made_up.net', 'Net')}",
        "{'made_up.net': ('Net', 'Other'), 'made_up.unrelated': ['X']}",
    ],
)
def test_a_name_from_a_public_face_leads_to_the_module_that_defines_it(
    identity: Identify, ours: None, face: str
) -> None:
    direct = identity(FILES)
    lazy = "def __getattr__(name):\n    return importlib.import_module('made_up.net').Net\n"
    lazy = f"import importlib\nFACE = {face}\n\n{lazy}"
    faced = changed("made_up/planner.py", "from made_up.net", "from made_up", {**FILES, "made_up/__init__.py": lazy})
    assert identity(faced) == direct
    untold = changed("made_up/__init__.py", f"FACE = {face}", "", faced)
    assert identity(untold) == direct
    eager = {**faced, "made_up/__init__.py": "from made_up.net import Net"}
    assert identity(eager) == direct
    dotted = changed("made_up/planner.py", "from made_up import Net", "import made_up", faced)
    dotted = changed("made_up/planner.py", "Net()", "made_up.Net()", dotted)
    assert identity(dotted) != identity(changed("made_up/layers/gain.py", "2.0", "3.0", dotted))


def test_the_face_of_this_project_leads_to_what_it_names(load: Callable[..., ModuleType]) -> None:
    planner = "from benchmark.planning import Plan\n\nclass Planner:\n    def reset(self, scene): ...\n"
    found = dependencies_of(load({"made_up/__init__.py": "", "made_up/planner.py": planner}).Planner)
    assert Dependency("benchmark.planning", "Plan") in found and Dependency("made_up.planner", "Planner") in found
    # Whatever a planner imports, the harness gives it observations and takes plans.
    assert Dependency("benchmark.planning", "Observation") in found
    assert not any(each.module.startswith("benchmark.datasets") for each in found)


def test_a_constant_from_a_public_face_leads_to_the_module_that_defines_it(identity: Identify, ours: None) -> None:
    lazy = "def __getattr__(name):\n    import importlib\n    return importlib.import_module('made_up.sizes').SIZES\n"
    files = {**FILES, "made_up/__init__.py": lazy, "made_up/sizes.py": "SIZES = {'a': 1}\nOTHER = 2\n"}
    files = changed("made_up/planner.py", "pass", "print(SIZES)", files)
    files = changed("made_up/planner.py", "from made_up.net", "from made_up import SIZES\nfrom made_up.net", files)
    before = identity(files)
    assert before == identity(changed("made_up/sizes.py", "OTHER = 2", "OTHER = 3", files))
    assert before != identity(changed("made_up/sizes.py", "'a': 1", "'a': 2", files))


def test_what_is_marked_as_outside_is_not_followed(identity: Identify, ours: None) -> None:
    marked = "from benchmark.runs.code_identity import outside_identity\n" + GAIN.replace(
        "def ", "@outside_identity\ndef "
    )
    files = {**FILES, "made_up/layers/gain.py": marked}
    assert identity(files) == identity(changed("made_up/layers/gain.py", "GAIN * value", "value", files))
    assert identity(files) == identity(changed("made_up/layers/gain.py", "2.0", "3.0", files))


def test_base_classes_of_another_local_package_and_modules_beside_a_script_count(identity: Identify) -> None:
    files = {
        "lonely.py": "import beside\nfrom made_up.net import Net\n\nclass Planner(Net):\n    reset = beside.reset\n",
        "beside.py": "def reset(self, scene): return 1\n",
        **FILES,
    }
    before = identity(files, "lonely")
    assert before != identity(changed("beside.py", "1", "2", files), "lonely")
    assert before != identity(changed("made_up/layers/gain.py", "2.0", "3.0", files), "lonely")
    assert before == identity(changed("made_up/unrelated.py", "nobody", "somebody", files), "lonely")


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
        return code_sha256(made), by, code_sha256(made, parts=parts_of(planner))

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


def test_classes_without_a_file_have_no_hash() -> None:
    namespace: dict[str, Any] = {"__name__": "nowhere"}
    exec("class Planner:\n    name = 'typed in'", namespace)
    assert code_sha256(namespace["Planner"]) is None and dependencies_of(namespace["Planner"]) == ()


def test_a_class_inside_a_function_counts_with_the_function() -> None:
    class Planner:
        def reset(self, scene: Any) -> None: ...

    assert Dependency(__name__, "test_a_class_inside_a_function_counts_with_the_function") in dependencies_of(Planner)


def test_modules_of_this_project_do_nothing_when_they_are_imported() -> None:
    root = Path(__file__).parents[3]
    functions = (ast.FunctionDef, ast.AsyncFunctionDef)
    definitions = (ast.Import, ast.ImportFrom, *functions, ast.ClassDef, ast.Assign, ast.AnnAssign, ast.Assert)
    fills_its_table = "benchmark/protocols/__init__.py"
    for path in [*root.glob("adapters/**/*.py"), *root.glob("benchmark/**/*.py")]:
        name = path.relative_to(root).as_posix()
        for statement in ast.parse(path.read_text()).body:
            said = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            typed = isinstance(statement, ast.If) and ast.unparse(statement.test) == "TYPE_CHECKING"
            command = name.startswith(("benchmark/cli", "benchmark/__main__", fills_its_table))
            assert said or typed or command or isinstance(statement, definitions), f"{name}: {ast.unparse(statement)}"
