"""What a wheel of this project holds, and what it asks for."""

import json
import re
import subprocess
import sys
import tomllib
from importlib.util import find_spec

import pytest

from tests.packaging.contents import PACKAGES, ROOT, files_of_packages
from tests.test_layers import imports

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
MODULE_OF = {
    "nuscenes-devkit": "nuscenes", "opencv-python-headless": "cv2", "pyyaml": "yaml", "pillow": "PIL",
    "foxglove-sdk": "foxglove", "grpcio": "grpc", "protobuf": "google",
}  # fmt: skip
BROUGHT_BY_OTHERS = {
    "huggingface_hub": "transformers and diffusers need it; `weights fetch` says so where it is missing"
}
SERVERS = {f"benchmark/extensions/{name}/server.py" for name in ("http", "alpasim")}
"""Need an extra when they are imported: `serve` imports them when everything was looked at."""
_IMPORTED_BY_NAME = re.compile(r'\bimport_(?:devkit_)?module\("(\w+)')
NEEDED_BY_OTHERS = {"sentencepiece": "the tokenizer of transformers that renderers load"}


def distribution_names(requirements: list[str]) -> set[str]:
    """Names alone of requirements such as ``numpy>=1.26``."""
    return {re.split(r"[\[<>=!~; ]", each, maxsplit=1)[0].lower() for each in requirements}


REQUIRED = distribution_names(PROJECT["dependencies"])
OPTIONAL = {
    extra: distribution_names(needed) for extra, needed in PROJECT["optional-dependencies"].items() if extra != "dev"
}


def module_of(distribution: str) -> str:
    return MODULE_OF.get(distribution, distribution)


def third_party_imports(*, at_import: bool) -> set[str]:
    """Top-level modules of others that the four packages import; with ``at_import`` outside functions and servers."""
    found: set[str] = set()
    for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        if at_import and path.relative_to(ROOT).as_posix() in SERVERS:
            continue
        found |= {name.partition(".")[0] for name in imports(path, at_run_time=True, inside_functions=not at_import)}
        if not at_import:
            found |= set(_IMPORTED_BY_NAME.findall(path.read_text()))
    return found - set(sys.stdlib_module_names) - set(PACKAGES)


def test_every_import_is_declared_and_every_required_package_is_imported() -> None:
    declared = REQUIRED.union(*OPTIONAL.values()) - set(NEEDED_BY_OTHERS)
    imported = third_party_imports(at_import=False)
    assert imported - set(BROUGHT_BY_OTHERS) <= {module_of(name) for name in declared}
    assert {module_of(name) for name in REQUIRED - set(NEEDED_BY_OTHERS)} <= imported


def test_no_module_needs_an_extra_to_be_imported() -> None:
    of_extras = {module_of(name) for name in set().union(*OPTIONAL.values()) - REQUIRED}
    assert of_extras and not third_party_imports(at_import=True) & of_extras


def test_every_extra_that_a_sentence_names_is_one() -> None:
    named = {
        extra
        for path in (path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))
        for extra in re.findall(r"challenger-bench\[(\w+)\]", path.read_text())
    }
    assert named and named <= set(OPTIONAL)


def test_all_that_setup_and_docs_install_is_pinned() -> None:
    pinned = distribution_names((ROOT / "constraints.txt").read_text().splitlines()[1:])
    installed = distribution_names(PROJECT["optional-dependencies"]["dev"]) | OPTIONAL["docs"] | REQUIRED
    assert installed - {"challenger-bench"} <= pinned


@pytest.mark.skipif(find_spec("setuptools") is None, reason="setuptools is what makes wheels")
def test_every_file_of_the_packages_is_in_the_wheel() -> None:
    # What setuptools would pack, without packing 18 MB.
    program = """
import json, sys
from setuptools import Distribution
project = Distribution({"script_name": "setup.py"})
project.parse_config_files(["pyproject.toml"])
build = project.get_command_obj("build_py")
build.ensure_finalized()
assert project.include_package_data is False
data = [f"{folder}/{name}" for package, folder, _, names in build.data_files for name in names]
folders = {package: build.get_package_dir(package) for package in project.packages}
code = [path for package in folders for _, _, path in build.find_package_modules(package, folders[package])]
print(json.dumps(data + code))
"""
    said = subprocess.run([sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True)
    packed = set(json.loads(said.stdout.splitlines()[-1]))
    expected = files_of_packages()
    assert any(name.endswith(".safetensors") for name in expected)
    assert {name for name in expected if not name.endswith(".py")} <= packed
    assert packed == expected
