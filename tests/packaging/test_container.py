"""Dockerfile, development container and workflows: what can be said of them without a daemon and without a server."""

import fnmatch
import re
import shlex
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.packaging.contents import PACKAGES, ROOT

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
PYTORCH = "https://download.pytorch.org/whl/"
REGISTRIES = ("pypi.org", "pythonhosted.org", "npmjs", "anaconda.org", "ghcr.io", "quay.io", "gcr.io", "unpkg.com")


def instructions() -> list[tuple[str, str]]:
    """Instructions of the Dockerfile with what they are given, continued lines joined and comments left out."""
    lines = [line for line in (ROOT / "Dockerfile").read_text().splitlines() if not line.startswith("#")]
    joined = re.sub(r"\\\n\s*", " ", "\n".join(lines))
    found = (line.partition(" ") for line in joined.splitlines() if line.strip())
    return [(name, rest.strip()) for name, _, rest in found]


def given(name: str) -> list[str]:
    return [rest for each, rest in instructions() if each == name]


def ignored(path: str) -> bool:
    """Whether .dockerignore leaves a path out: the last pattern that fits decides."""
    left_out = False
    for line in (ROOT / ".dockerignore").read_text().splitlines():
        pattern = line.removeprefix("!").removeprefix("**/")
        if any(fnmatch.fnmatch(part, pattern) for part in (path, path.split("/")[0], path.split("/")[-1])):
            left_out = not line.startswith("!")
    return left_out


def test_every_file_that_the_image_copies_is_there_and_is_sent() -> None:
    copied = [word for rest in given("COPY") if "--from" not in rest for word in shlex.split(rest)[:-1]]
    assert set(PACKAGES) <= set(copied)
    for name in copied:
        assert (ROOT / name).exists() and not ignored(name), name
    for name in (".git", ".venv", "tests", "docs", "challenger-out", "dist", "benchmark/__pycache__"):
        assert ignored(name), f"{name} would be sent to the daemon"


def make_targets() -> set[str]:
    return set(re.findall(r"^([\w-]+):(?!=)", (ROOT / "Makefile").read_text(), re.MULTILINE))


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_workflows_call_targets_of_make_and_nothing_else(path: Path) -> None:
    workflow: dict[Any, Any] = yaml.safe_load(path.read_text())
    # YAML reads the key `on` as true.
    assert workflow["name"] == path.stem and workflow[True] and workflow["permissions"] == {"contents": "read"}
    steps = [step for job in workflow["jobs"].values() for step in job["steps"]]
    matrices = [job.get("strategy", {}).get("matrix", {}) for job in workflow["jobs"].values()]
    ways = [target for matrix in matrices for target in matrix.get("target", [])]
    lines = [step["run"] for step in steps if "run" in step]
    lines = [line.replace("${{ matrix.target }}", way) for line in lines for way in (ways or [""])]
    assert lines
    for line in lines:
        assert re.fullmatch(r"time make [\w-]+", line) and line.split()[2] in make_targets(), line
    for step in steps:
        assert "run" in step or re.fullmatch(r"actions/[\w-]+@v\d+", step["uses"]), step
    assert all(job["timeout-minutes"] <= 90 for job in workflow["jobs"].values())


def test_no_file_of_these_names_a_registry() -> None:
    files = [
        "Dockerfile",
        ".dockerignore",
        ".devcontainer/devcontainer.json",
        "Makefile",
        "pyproject.toml",
        "mkdocs.yml",
    ]
    for path in [*WORKFLOWS, *(ROOT / name for name in files), *(ROOT / "docs" / "making").iterdir()]:
        if path.is_file() and path.suffix != ".pyc":
            text = path.read_text()
            assert not [name for name in REGISTRIES if name in text], path
            assert all(address.startswith(PYTORCH) for address in re.findall(r"https://[\w./-]+whl[\w./-]*", text)), (
                path
            )
