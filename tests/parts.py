"""The parts of the tests, and which of them a change touches."""

import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PARTS = ("core", "extensions", "slow")
"""`make test` runs the first, `make test-extensions` the second, `make test-slow` the last, at night."""


def part_of(item: pytest.Item) -> str:
    """A test is slow if it is marked so; of an extension, its marked golden path (``path``) runs with the core."""
    if item.get_closest_marker("slow"):
        return "slow"
    # Below the root: the checkout itself may lie in a folder of any name.
    folders = item.path.relative_to(item.config.rootpath).parts
    in_extension = "extensions" in folders and not item.get_closest_marker("path")
    return "extensions" if in_extension else "core"


def list_changed(root: Path = ROOT) -> list[str]:
    """Changed and new files of the working tree, or the files of the last commit where nothing is changed."""

    def git(*words: str) -> list[str]:
        done = subprocess.run(["git", *words], cwd=root, capture_output=True, text=True, check=True)
        return done.stdout.splitlines()

    diff = ("diff", "--name-only", "--no-renames")
    changed = [*git(*diff, "HEAD"), *git("ls-files", "--others", "--exclude-standard")]
    return changed or git(*diff, "HEAD~1", "HEAD")


def select_touched(changed: Iterable[str], root: Path = ROOT) -> list[str]:
    """Test folders and modules that mirror the changed files; the layers' tests always.

    A file of ``benchmark/protocols`` touches ``tests/benchmark/protocols``; a module right below ``benchmark`` touches
    its own tests or else those beside them. A changed test module touches itself.
    """
    selected = {"tests/test_layers.py"}
    for name in changed:
        path = Path(name)
        if path.parts[0] == "tests" and path.name.startswith("test_"):
            selected |= {name} if (root / path).exists() else set()
            continue
        mirror = path if path.parts[0] == "tests" else Path("tests") / path
        folder = next((above for above in mirror.parents if (root / above).is_dir()), Path("tests"))
        if len(folder.parts) > 2:
            selected.add(str(folder))
        elif len(folder.parts) == 2:
            own = folder / f"test_{path.stem}.py"
            modules = [own] if (root / own).exists() else (root / folder).glob("test_*.py")
            selected |= {str(folder / module.name) for module in modules}
    folders = {name for name in selected if not name.endswith(".py")}
    return sorted(name for name in selected if not any(str(above) in folders for above in Path(name).parents))


if __name__ == "__main__":
    sys.stdout.write("\n".join(select_touched(list_changed())) + "\n")
