"""Look at a built documentation site: ``python built_site.py FOLDER``; standard library alone.

Every link and picture leads to a file of the site, every anchor to an element of its page, and no page asks another
server for anything.
"""

import sys
from dataclasses import dataclass, field
from functools import cache
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADS = {"script": "src", "img": "src", "link": "href", "iframe": "src", "source": "src", "video": "src"}
FIRST_PAGE = "index.html"


@dataclass
class Named(HTMLParser):
    """What a page names: anchors of its own, links, and what is loaded with it."""

    anchors: set[str] = field(default_factory=set)
    links: list[str] = field(default_factory=list)
    loads: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__(convert_charrefs=True)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = dict(attrs)
        self.anchors |= {value for name in ("id", "name") if (value := known.get(name))}
        if tag == "a" and known.get("href"):
            self.links.append(known["href"] or "")
        elif tag in LOADS and known.get(LOADS[tag]) and known.get("rel") != "canonical":
            self.loads.append(known[LOADS[tag]] or "")


@cache
def read(page: Path) -> Named:
    """What a page names."""
    named = Named()
    named.feed(page.read_text())
    return named


def faults(folder: Path) -> list[str]:
    """One sentence for every link that leads nowhere and every request that would leave the site."""
    folder = folder.resolve()
    pages = [page for page in sorted(folder.rglob("*.html")) if page.name != "404.html"]
    if not pages:
        return [f"{folder} holds no page"]
    return [f"{page.relative_to(folder)}: {fault}" for page in pages for fault in _faults_of(page, folder)]


def _faults_of(page: Path, folder: Path) -> list[str]:
    named, found = read(page), []
    for address in named.loads:
        if urlsplit(address).netloc:
            found.append(f"asks another server for {address}")
    for address in [*named.links, *named.loads]:
        parts = urlsplit(address)
        if parts.scheme or parts.netloc:
            continue
        target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
        if target.is_dir():
            target = target / FIRST_PAGE
        if not target.is_file() or folder not in target.parents:
            found.append(f"{address} leads nowhere")
        elif parts.fragment and target.suffix == ".html" and unquote(parts.fragment) not in read(target).anchors:
            found.append(f"{address} has no such place")
    return found


if __name__ == "__main__":
    wrong = faults(Path(sys.argv[1]))
    print("\n".join(wrong) or f"every link of {sys.argv[1]} works, and nothing is asked of another server")
    sys.exit(1 if wrong else 0)
