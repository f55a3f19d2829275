"""The parts cover each test once, each extension has a golden path, and a change finds the tests of its folder."""

import subprocess
from pathlib import Path

import pytest

from tests.parts import PARTS, ROOT, list_changed, select_touched

pytest_plugins = ["pytester"]

TESTS = """
import pytest

def test_plain(): pass

@pytest.mark.path
def test_path(): pass

@pytest.mark.slow
def test_slow(): pass
"""


def test_each_test_is_in_one_part(pytester: pytest.Pytester) -> None:
    pytester.makeconftest("from tests.conftest import *")
    pytester.makeini("[pytest]\nmarkers = path\n slow\n")
    for folder in ("room", "extensions/one"):
        (pytester.path / folder).mkdir(parents=True)
        (pytester.path / folder / f"test_{folder[0]}.py").write_text(TESTS)
    listed = {}
    for part in PARTS:
        lines = pytester.runpytest("--collect-only", "-q", "-p", "no:cacheprovider", "--part", part).outlines
        listed[part] = [line for line in lines if "::" in line]
    room, one = "room/test_r.py::test_", "extensions/one/test_e.py::test_"
    assert sorted(listed["core"]) == sorted([f"{room}plain", f"{room}path", f"{one}path"])
    assert listed["extensions"] == [f"{one}plain"]
    assert sorted(listed["slow"]) == sorted([f"{room}slow", f"{one}slow"])


def test_no_test_starts_after_the_budget(pytester: pytest.Pytester) -> None:
    pytester.makeconftest("from tests.conftest import *")
    pytester.makepyfile("def test_a(): pass\n\ndef test_b(): pass\n")
    for budget, outcomes in (("0", {"skipped": 2}), ("1000", {"passed": 2})):
        pytester.runpytest("--budget", budget, "-p", "no:cacheprovider").assert_outcomes(**outcomes)


def test_each_extension_has_a_golden_path() -> None:
    folders = sorted(path for path in ROOT.glob("tests/*/extensions/*/") if list(path.glob("test_*.py")))
    without = [
        str(folder.relative_to(ROOT))
        for folder in folders
        if not any("pytest.mark.path" in path.read_text() for path in folder.glob("test_*.py"))
    ]
    assert not without


@pytest.mark.parametrize(
    ("changed", "selected"),
    [
        ("benchmark/protocols/uniad.py", ["tests/benchmark/protocols"]),
        ("benchmark/extensions/http/server.py", ["tests/benchmark/extensions/http"]),
        ("tests/benchmark/protocols/test_uniad.py", ["tests/benchmark/protocols/test_uniad.py"]),
        ("tests/benchmark/protocols/cases.py", ["tests/benchmark/protocols"]),
        ("benchmark/geometry.py", ["tests/benchmark/test_geometry.py"]),
        ("benchmark/errors.py", ["tests/benchmark/test_geometry.py"]),
        ("pyproject.toml", []),
    ],
)
def test_a_changed_file_touches_the_tests_of_its_folder(tmp_path: Path, changed: str, selected: list[str]) -> None:
    for name in ("protocols/test_uniad.py", "extensions/http/test_server.py", "test_geometry.py"):
        path = tmp_path / "tests/benchmark" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("")
    assert select_touched([changed], tmp_path) == sorted([*selected, "tests/test_layers.py"])


def test_changed_files_are_those_of_the_tree_or_else_of_the_last_commit(tmp_path: Path) -> None:
    def git(*words: str) -> None:
        who = ["-c", "user.name=a", "-c", "user.email=a@b"]
        subprocess.run(["git", *who, *words], cwd=tmp_path, check=True, capture_output=True)

    git("init")
    for name in ("one", "two"):
        (tmp_path / name).write_text(name)
        git("add", ".")
        git("commit", "-m", name)
    assert list_changed(tmp_path) == ["two"]
    (tmp_path / "one").write_text("changed")
    (tmp_path / "three").write_text("new")
    assert list_changed(tmp_path) == ["one", "three"]
