"""What changes in the text of README and of the pages of docs/ where they become pages of the site.

In the repository they name one another as ``docs/data.md`` in letters of code, which any viewer shows; on the site
such a name is a link with the title of the page.
"""

import posixpath
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OUTSIDE = {"README.md": "index.md", "CONTRIBUTING.md": "contributing.md", "CHANGELOG.md": "changelog.md"}
"""Pages that lie beside docs/, with their address on the site."""
_BLOCK = re.compile(r"^```.*?^```[^\n]*$", re.DOTALL | re.MULTILINE)
_NAMED = re.compile(r"(?<![\[`])`((?:[\w.-]+/)*[\w.-]+\.md|docs/[\w/-]+/)`(?!\])")
_BADGE = re.compile(r"^\[!\[[^\n]*/actions/workflows/[^\n]*\n+", re.MULTILINE)
_LINK = re.compile(r"(!?\[[^\]]*\]\()([^)#:\s]+)((?:#[^)]*)?\))")


def title(text: str) -> str:
    """The first heading of a page."""
    return next(line[2:].strip() for line in text.splitlines() if line.startswith("# "))


def site_pages() -> dict[str, Path]:
    """Address on the site and file of every page that somebody wrote."""
    docs = ROOT / "docs"
    inside = {path.relative_to(docs).as_posix(): path for path in sorted(docs.rglob("*.md"))}
    return {address: ROOT / name for name, address in OUTSIDE.items()} | inside


def address_of(name: str, source: Path) -> str | None:
    """Address on the site of what a page names: from the root of the repository, or from the page's own folder.

    Args:
        name: What stands in the page, such as ``docs/data.md`` or ``data.md``.
        source: File of the page.

    Returns:
        The address, or ``None`` where the site has no such page.
    """
    pages = {path: address for address, path in site_pages().items()}
    for folder in (ROOT, source.parent):
        found = pages.get((folder / name).resolve())
        if found is not None:
            return found
    return None


def on_the_site(text: str, source: Path, address: str) -> str:
    """The text of a page as the site shows it.

    Args:
        text: The page as it stands in the repository.
        source: File of the page.
        address: Its address on the site.

    Returns:
        The text with links to the site's pages, blocks of code untouched; without badges, which are of the repository.
    """
    kept: list[str] = []

    def keep(block: re.Match[str]) -> str:
        kept.append(block.group())
        return f"\0{len(kept) - 1}\0"

    def linked(named: re.Match[str]) -> str:
        target = _folder_page(named.group(1)) or address_of(named.group(1), source)
        return f"[{title(_text(target))}]({_relative(target, address)})" if target else named.group()

    def moved(link: re.Match[str]) -> str:
        before, name, after = link.groups()
        target = address_of(name, source)
        if target is None and name.startswith("docs/"):
            target = name.removeprefix("docs/")
        beside = (source.parent / name).resolve()
        if target is None and beside.is_file() and ROOT / "docs" not in beside.parents:
            # The site has no such file: its name stays.
            return f"`{name}`"
        return f"{before}{_relative(target, address)}{after}" if target else link.group()

    bare = _LINK.sub(moved, _NAMED.sub(linked, _BADGE.sub("", _BLOCK.sub(keep, text))))
    return re.sub(r"\0(\d+)\0", lambda mark: kept[int(mark.group(1))], bare)


def _folder_page(name: str) -> str | None:
    """The first page of a folder that is named as a whole, such as ``docs/decisions/``."""
    if not name.startswith("docs/") or not name.endswith("/"):
        return None
    return next((page for page in site_pages() if page.startswith(name.removeprefix("docs/"))), None)


def _text(address: str) -> str:
    return site_pages()[address].read_text()


def _relative(target: str, address: str) -> str:
    return posixpath.relpath(target, posixpath.dirname(address) or ".")
