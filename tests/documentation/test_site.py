"""The documentation site, as far as it can be looked at without mkdocs: navigation, made pages, links."""

import re
import runpy
from pathlib import Path
from typing import Any

import pytest
import typer
import yaml

import benchmark
from benchmark.cli.app import app
from tests.documentation.built_site import faults

ROOT = Path(__file__).resolve().parents[2]
MAKING = ROOT / "docs" / "making"
SETTINGS = yaml.safe_load((ROOT / "mkdocs.yml").read_text())
PAGES = runpy.run_path(str(MAKING / "pages.py"))
COMMANDS = runpy.run_path(str(MAKING / "commands.py"))
FACE = runpy.run_path(str(MAKING / "public_face.py"))


def addresses(entries: list[Any]) -> list[str]:
    """Every page that a part of the navigation names, in its order."""
    found: list[str] = []
    for entry in entries:
        for inner in entry.values() if isinstance(entry, dict) else (entry,):
            found += addresses(inner) if isinstance(inner, list) else [inner]
    return found


def test_every_page_of_docs_is_in_one_place_of_the_navigation() -> None:
    named = [address for address in addresses(SETTINGS["nav"]) if not address.endswith("/")]
    assert sorted(named) == sorted(PAGES["site_pages"]()), "mkdocs.yml: nav names every page of docs/ once"


def test_the_navigation_has_five_parts_and_the_folders_of_made_pages() -> None:
    parts = ["Start", "How to", "Reference", "Explanation", "Project"]
    assert [name for part in SETTINGS["nav"] for name in part] == parts
    made = {address for address in addresses(SETTINGS["nav"]) if address.endswith("/")}
    pages = [*COMMANDS["command_pages"](), *FACE["face_pages"]()]
    assert made == {f"{Path(address).parent.as_posix()}/" for address in pages}


def commands(command: Any, path: str = "") -> dict[str, Any]:
    """All commands and groups, by the words that lead to them."""
    found = {path: command} if path else {}
    for name, inner in getattr(command, "commands", {}).items():
        found |= commands(inner, f"{path} {name}".strip())
    return found


def test_the_reference_of_commands_has_every_command_and_every_option() -> None:
    pages = COMMANDS["command_pages"]()
    for path, command in commands(typer.main.get_command(app)).items():
        page = pages[f"commands/{path.split(' ')[0]}.md"]
        _, _, section = page.partition(f"# {path} {{ #{path.replace(' ', '-')} }}\n")
        section = re.split(r"^## ", section, maxsplit=1, flags=re.MULTILINE)[0]
        assert section, f"{path} is on no page"
        for option in (name for each in command.params for name in each.opts if name.startswith("--")):
            assert f"{option}" in section, f"{path} {option}"
        assert f"[`{path}`]" in pages["commands/index.md"]


def test_the_reference_of_python_has_every_name_where_it_is_defined() -> None:
    text = "\n".join(FACE["face_pages"]().values())
    for name in vars(benchmark)["_PLACES"]:
        assert f"## {name} {{ #{name} }}" in text and f"::: {FACE['defined_in']()[name]}\n" in text, name


def test_names_of_pages_become_links_from_wherever_they_stand() -> None:
    on_the_site, docs = PAGES["on_the_site"], ROOT / "docs"
    title = (docs / "data.md").read_text().splitlines()[0].removeprefix("# ")
    assert on_the_site("see `docs/data.md`.", ROOT / "README.md", "index.md") == f"see [{title}](data.md)."
    decision = docs / "decisions" / "0001-nuscenes-format-is-the-joint.md"
    assert on_the_site("`docs/data.md`", decision, "decisions/0001.md") == f"[{title}](../data.md)"
    assert on_the_site("`data.md`", docs / "limits.md", "limits.md") == f"[{title}](data.md)"
    assert on_the_site("![x](docs/images/site.png)", ROOT / "README.md", "index.md") == "![x](images/site.png)"
    badge = "[![test](../../actions/workflows/test.yml/badge.svg)](../../actions/workflows/test.yml)\n"
    assert on_the_site(f"# Name\n\n{badge}\nText.", ROOT / "README.md", "index.md") == "# Name\n\nText."
    assert on_the_site("[a](records.md#rows)", docs / "severity.md", "severity.md") == "[a](records.md#rows)"
    script = "[script](examples/torch_planner.py)"
    assert on_the_site(script, ROOT / "README.md", "index.md") == "`examples/torch_planner.py`"
    assert on_the_site("`nothing.md` `docs/`", docs / "data.md", "data.md") == "`nothing.md` `docs/`"
    block = "```\ncat `docs/data.md`\n```"
    assert on_the_site(block, docs / "data.md", "data.md") == block


@pytest.mark.parametrize(
    ("body", "sentence"),
    [
        ('<a href="other.html#here">x</a>', None),
        ('<a href="none.html">x</a>', "none.html leads nowhere"),
        ('<a href="other.html#there">x</a>', "other.html#there has no such place"),
        ('<a href="#mine">x</a>', "#mine has no such place"),
        ('<img src="a%20b.png">', None),
        ('<script src="https://elsewhere.example/x.js"></script>', "asks another server"),
        ('<a href="https://elsewhere.example/">x</a>', None),
        ('<a href="../outside.html">x</a>', "leads nowhere"),
    ],
)
def test_a_link_that_does_not_work_is_found(body: str, sentence: str | None, tmp_path: Path) -> None:
    site = tmp_path / "site"
    site.mkdir()
    (tmp_path / "outside.html").write_text("")
    (site / "a b.png").write_bytes(b"")
    (site / "other.html").write_text('<h1 id="here">x</h1>')
    (site / "index.html").write_text(body)
    found = faults(site)
    assert (sentence is None and not found) or (len(found) == 1 and sentence is not None and sentence in found[0]), (
        found
    )
