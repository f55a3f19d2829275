"""Where the product's messages and docstrings send a reader, and where pages send one within pages, is there."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

from tests.documentation.lines_of_code import PAGES, ROOT

CODE = ("benchmark", "generation", "adapters", "leaderboard", "examples", "bench")
NAMED = re.compile(r'docs/[\w./-]+\.md(?:#(?P<anchor>[\w-]+))?(?:`{0,2}, "(?P<section>[^"]+)")?')
"""A page, perhaps with an anchor, or with the heading of a section in quotes behind it."""
LINK = re.compile(r"\]\(([^)#:\s]*)#([\w-]+)\)")


def texts(path: Path) -> Iterator[str]:
    """String literals of a Python file, docstrings included; the whole of a script."""
    if path.suffix != ".py":
        yield path.read_text()
        return
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield " ".join(node.value.split())


@cache
def headings(page: Path) -> dict[str, str]:
    """Headings of a page in plain words, by their anchor on the site."""
    text = re.sub(r"^```.*?^```", "", page.read_text(), flags=re.DOTALL | re.MULTILINE)
    found: dict[str, str] = {}
    for heading in re.findall(r"^#+ (.*?)(?: \{.*\})?$", text, re.MULTILINE):
        plain = re.sub(r"[`*]|\[([^\]]*)\]\([^)]*\)", r"\1", heading)
        slug = re.sub(r"[-\s]+", "-", re.sub(r"[^\w\s-]", "", plain.encode("ascii", "ignore").decode()).strip().lower())
        found[next(name for name in _numbered(slug) if name not in found)] = plain
    return found


def _numbered(slug: str) -> Iterator[str]:
    yield slug
    yield from (f"{slug}_{number}" for number in range(1, 100))


def wrong(text: str) -> Iterator[str]:
    """What a text names and is not there."""
    for named in NAMED.finditer(text):
        page = ROOT / re.split("[#`,]", named.group(), maxsplit=1)[0]
        if not page.is_file():
            yield f"{named.group()}: no such page"
        elif named["anchor"] and named["anchor"] not in headings(page):
            yield f"{named.group()}: no such anchor"
        elif named["section"] and named["section"].rstrip(".,") not in headings(page).values():
            yield f"{named.group()}: no such section"


@pytest.mark.parametrize("package", CODE)
def test_what_the_code_names_is_there(package: str) -> None:
    files = sorted(path for path in (ROOT / package).rglob("*") if path.suffix in (".py", ".js"))
    assert files
    found = [f"{path.relative_to(ROOT)}: {fault}" for path in files for text in texts(path) for fault in wrong(text)]
    assert not found, "\n".join(found)


def test_a_name_that_leads_nowhere_is_found() -> None:
    assert not list(wrong('see ``docs/data.md``, "Truth that a root lacks"; docs/data.md#what-a-root-must-hold)'))
    assert list(wrong("see docs/nothing.md.")) and list(wrong("docs/data.md#nothing"))
    assert list(wrong('``docs/data.md``, "Nothing"'))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_every_anchor_that_a_page_names_is_there(page: Path) -> None:
    targets = [(page.parent / name if name else page, anchor) for name, anchor in LINK.findall(page.read_text())]
    lost = [f"{target.name}#{anchor}" for target, anchor in targets if anchor not in headings(target.resolve())]
    assert not lost
