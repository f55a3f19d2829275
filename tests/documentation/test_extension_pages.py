"""Every extension has its page below docs/extensions, and its row in the list there."""

import re
from pathlib import Path

import yaml

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "extensions"
PACKAGES = ("adapters", "benchmark", "generation", "leaderboard")
ALIASES = {"alpasim_table": "alpasim_score", "reproduction": "reproduce"}
"""Extensions that share the page of another."""


def packages_of_extensions() -> dict[str, list[str]]:
    """The packages that have a part of each extension, by its name."""
    found: dict[str, list[str]] = {}
    for package in PACKAGES:
        for path in sorted((ROOT / package / "extensions").glob("*/__init__.py")):
            found.setdefault(path.parent.name, []).append(package)
    return found


def test_every_extension_has_its_page_and_no_page_is_without_one() -> None:
    pages = {path.stem for path in FOLDER.glob("*.md")} - {"README"}
    assert {ALIASES.get(name, name) for name in packages_of_extensions()} == pages


def test_the_list_has_every_extension_with_its_packages_and_its_page() -> None:
    rows = re.findall(
        r"^\| (\w+) \| ([\w, ]+) \| .* \| \[\w+\]\((\w+)\.md\) \|$", (FOLDER / "README.md").read_text(), re.M
    )
    expected = [
        (name, ", ".join(packages), ALIASES.get(name, name)) for name, packages in packages_of_extensions().items()
    ]
    assert rows == sorted(expected)


def test_every_old_address_leads_to_a_page_and_is_none_itself() -> None:
    plugins = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["plugins"]
    (moved,) = (each["redirects"]["redirect_maps"] for each in plugins if "redirects" in each)
    for old, new in moved.items():
        assert not (ROOT / "docs" / old).exists() and (ROOT / "docs" / new).is_file(), old
