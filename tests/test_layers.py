"""The direction of imports that keeps the four packages apart, and the shape of the tree."""

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
ALLOWED = {
    "benchmark": {"benchmark"},
    "generation": {"benchmark", "generation"},
    "adapters": {"benchmark", "adapters"},
    "leaderboard": {"benchmark", "leaderboard"},
}
LEADERBOARD_MAY_READ = (
    "benchmark.records",
    "benchmark.metrics",
    "benchmark.report",
    "benchmark.published",
    "benchmark.machine.extension",
    "benchmark.machine.storage",
    "benchmark.errors",
    "benchmark.constants",
    "benchmark.geometry",
    "benchmark.waypoints",
)
GOLDEN_SETS_READ = ("benchmark.verification", "benchmark.untrusted")
"""What ``verification.py`` of an extension of the leaderboard reads too."""
FLAT_MODULES = {"benchmark": 12, "generation": 3, "adapters": 7, "leaderboard": 3}
MOST_ROOMS = 20
"""Folders of the core of `benchmark`."""
NEEDS = {"adapters.extensions.golden_sets": {"benchmark.extensions.golden_sets"}}
"""Extensions that import another one: this is the part of golden sets that reads files of results."""


def is_composition_root(path: Path) -> bool:
    """What puts all packages together, inside functions: the face, the command line and that of each extension."""
    of_extension = path.name == "cli.py" and path.parent.parent.name == "extensions"
    return of_extension or any(ROOT / "benchmark" / name in path.parents for name in ("api", "cli"))


def modules() -> dict[str, Path]:
    found = {}
    for package in ALLOWED:
        for path in (ROOT / package).rglob("*.py"):
            found[".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")] = path
    return found


def guards_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"


@cache
def import_statements(path: Path) -> tuple[tuple[frozenset[str], bool, bool], ...]:
    """Of each import: what it names, whether it is for types alone, and whether it stands in a function."""
    found = []
    waiting: list[tuple[ast.AST, bool, bool]] = [(ast.parse(path.read_text()), False, False)]
    while waiting:
        node, for_types, inside = waiting.pop()
        for_types |= guards_types(node)
        inside |= isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        if isinstance(node, ast.Import):
            found.append((frozenset(alias.name for alias in node.names), for_types, inside))
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            names = {node.module or "", *(f"{node.module}.{alias.name}" for alias in node.names)}
            found.append((frozenset(names), for_types, inside))
        inner = (child for child in ast.iter_child_nodes(node) if not isinstance(child, ast.expr))
        waiting += [(child, for_types, inside) for child in inner]
    return tuple(found)


def imports(path: Path, *, at_run_time: bool = False, inside_functions: bool = True) -> set[str]:
    """Modules that a file imports, and what it takes from them as ``module.name`` too."""
    return {
        name
        for names, for_types, inside in import_statements(path)
        for name in names
        if not (at_run_time and for_types) and (inside_functions or not inside)
    }


def packages_of(names: set[str]) -> set[str]:
    return {name.split(".")[0] for name in names} & set(ALLOWED)


@pytest.mark.parametrize("package", ALLOWED)
def test_packages_import_in_one_direction(package: str) -> None:
    files = [path for path in (ROOT / package).rglob("*.py") if not is_composition_root(path)]
    assert files
    for path in files:
        assert packages_of(imports(path)) <= ALLOWED[package], path


def test_the_composition_root_imports_other_packages_inside_functions_only() -> None:
    files = [path for path in (ROOT / "benchmark").rglob("*.py") if is_composition_root(path)]
    assert files
    for path in files:
        assert packages_of(imports(path, at_run_time=True, inside_functions=False)) <= {"benchmark"}, path


def test_leaderboard_reads_records_only() -> None:
    for path in (path for path in (ROOT / "leaderboard").rglob("*.py") if not is_composition_root(path)):
        for name in imports(path):
            readable = (*LEADERBOARD_MAY_READ, *(GOLDEN_SETS_READ if path.name == "verification.py" else ()))
            allowed = any(name == known or name.startswith(f"{known}.") for known in readable)
            assert not name.startswith("benchmark.") or allowed or name == "benchmark.machine", (path, name)


def extension_of(name: str) -> str | None:
    """``package.extensions.name``, if a module is of an extension."""
    parts = name.split(".")
    return ".".join(parts[:3]) if len(parts) > 2 and parts[1] == "extensions" else None


def test_the_core_imports_no_extension_and_an_extension_only_those_that_it_needs() -> None:
    needed: dict[str, set[str]] = {}
    for name, path in modules().items():
        own = extension_of(name)
        # The face has its types from everywhere.
        found = {of for each in imports(path, at_run_time=own is None) if (of := extension_of(each)) is not None}
        if own is None:
            assert not found, (path, found)
        elif not is_composition_root(path):
            needed[own] = needed.get(own, set()) | (found - {own})
    here = {own: found for own, found in NEEDS.items() if own in needed}
    assert {own: found for own, found in needed.items() if found} == here


def test_the_core_of_benchmark_has_few_rooms() -> None:
    rooms = {path.parent for path in (ROOT / "benchmark").rglob("*.py") if "extensions" not in path.parts}
    assert len(rooms - {ROOT / "benchmark"}) <= MOST_ROOMS, sorted(str(room) for room in rooms)


def test_no_circle_of_imports_not_even_inside_functions() -> None:
    known = modules()
    arrows = {
        name: {found for found in imports(path, at_run_time=True) if found in known and found != name}
        for name, path in known.items()
    }
    # A package's face hands on what its rooms define; rooms do not count as importing it back.
    faces = {name for name, path in known.items() if path.name == "__init__.py"}
    while arrows:
        free = {name for name, targets in arrows.items() if not (targets - faces) & set(arrows)}
        assert free, f"these import one another in a circle: {', '.join(sorted(arrows))}"
        arrows = {name: targets for name, targets in arrows.items() if name not in free}


@pytest.mark.parametrize("package", FLAT_MODULES)
def test_few_modules_lie_flat(package: str) -> None:
    flat = sorted(path.stem for path in (ROOT / package).glob("*.py") if path.name != "__init__.py")
    assert len(flat) <= FLAT_MODULES[package], flat


def test_help_and_the_public_face_do_not_import_the_heavy_packages() -> None:
    program = "import sys, benchmark, benchmark.cli; print(*sys.modules)"
    said = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    names = said.stdout.split()
    assert not {name.split(".")[0] for name in names} & {"torch", "numpy", "nuscenes", "pyarrow"}
    # Of the other packages the commands of extensions alone, below packages that hold nothing.
    others = [name for name in names if name.split(".")[0] in {"generation", "adapters", "leaderboard"}]
    assert {name for name in others if not re.fullmatch(r"\w+(\.extensions(\.\w+(\.cli)?)?)?", name)} == set()
