"""Check that pages work on any static host: all they load is in the folder, with no requests to other hosts."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from html.parser import HTMLParser
from pathlib import PurePosixPath
from typing import Final, Literal
from urllib.parse import unquote, urlsplit

FindingKind = Literal["path", "host", "user", "secret", "picture", "request", "link", "name"]


@dataclass(frozen=True, slots=True, order=True)
class PublicationFinding:
    """Trace of the house, or a fault on other hosts; lines count from 1, 0 where there are none.

    `file` is below the folder, ``/`` between parts; empty where it is about several.
    """

    file: str
    line: int
    kind: FindingKind
    says: str

    def sentence(self) -> str:
        """Sentence for a terminal."""
        where = f"{self.file}:{self.line}: " if self.line else f"{self.file}: " if self.file else ""
        return f"{self.kind}: {where}{self.says}"

    def as_json(self) -> dict[str, str | int]:
        """JSON for machines."""
        return asdict(self)


_LOADS: Final = {
    "script": ("src",),
    "img": ("src", "srcset"),
    "link": ("href",),
    "iframe": ("src",),
    "source": ("src", "srcset"),
    "video": ("src", "poster"),
    "audio": ("src",),
    "object": ("data",),
    "embed": ("src",),
    "form": ("action",),
    "base": ("href",),
}
"""Attributes that a browser follows by itself."""
_ASKS: Final = re.compile(
    r"""(?:fetch|importScripts|sendBeacon|WebSocket|EventSource|import|\.open)\s*\(\s*(?:["'`][A-Z]+["'`]\s*,\s*)?"""
    r"""["'`]((?:https?:|wss?:)?//[^"'`]+)|(?:\.src|\.href)\s*=\s*["'`]((?:https?:)?//[^"'`]+)"""
    r"""|\bimport\s[^;]*?from\s*["'`]((?:https?:)?//[^"'`]+)"""
)
"""Calls of scripts that leave the folder."""
_STYLE_URL: Final = re.compile(r"""url\(\s*["']?([^"')]+)["']?\s*\)|@import\s+["']([^"']+)["']""")
_PAGE_LINK: Final = re.compile(r"\]\(([^)#\s]+)(?:#[^)]*)?\)")
_LARGEST_BYTES: Final = 100 * 1024 * 1024
"""Largest file on free static hosts."""
_INSIDE: Final = ("data", "blob", "mailto")


class _PageParser(HTMLParser):
    """Addresses that a page loads and links, and its security policy."""

    def __init__(self) -> None:
        super().__init__()
        self.loads: list[tuple[int, str]] = []
        self.links: list[tuple[int, str]] = []
        self.policies: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        known = {name: value or "" for name, value in attrs}
        line = self.getpos()[0]
        for name in _LOADS.get(tag, ()):
            for part in known.get(name, "").split(",") if name == "srcset" else [known.get(name, "")]:
                if part.strip():
                    self.loads.append((line, part.split()[0] if name == "srcset" else part.strip()))
        if tag == "a" and known.get("href"):
            self.links.append((line, known["href"]))
        if tag == "meta" and known.get("http-equiv", "").lower() == "content-security-policy":
            self.policies.append(known.get("content", ""))


def check_page(
    file: str, text: str, there: Mapping[str, int], *, is_whole: bool = True
) -> Iterator[PublicationFinding]:
    """Requests of an HTML page that leave the folder or that it lacks; one that ``is_whole`` has a security policy."""
    page = _PageParser()
    page.feed(text)
    if is_whole and not any("default-src 'none'" in policy for policy in page.policies):
        yield PublicationFinding(
            file, 0, "request", "no security policy forbids requests to other hosts (default-src 'none')"
        )
    for policy in page.policies:
        for source in re.findall(r"(?:https?|wss?):\S*", policy):
            yield PublicationFinding(file, 0, "request", f"its security policy allows {source.rstrip(';')}")
    for line, address in page.loads:
        yield from _check_address(file, line, address, there)
    for line, address in page.links:
        if not urlsplit(address).scheme and not address.startswith("//"):
            yield from _check_address(file, line, address, there)


def check_style(file: str, text: str, there: Mapping[str, int]) -> Iterator[PublicationFinding]:
    """Findings of addresses that a style sheet loads and that do not work elsewhere; as `check_page`."""
    for match in _STYLE_URL.finditer(text):
        yield from _check_address(file, _find_line(text, match.start()), match[1] or match[2], there)


def check_script(file: str, text: str) -> Iterator[PublicationFinding]:
    """Calls of a script that leave the folder."""
    for match in _ASKS.finditer(text):
        address = next(group for group in match.groups() if group)
        yield PublicationFinding(file, _find_line(text, match.start()), "request", f"asks {address[:120]}")


def check_markdown(file: str, text: str, there: Mapping[str, int]) -> Iterator[PublicationFinding]:
    """Links of a Markdown page to what is not in the folder."""
    for match in _PAGE_LINK.finditer(text):
        if not urlsplit(match[1]).scheme:
            yield from _check_address(file, _find_line(text, match.start()), match[1], there)


def check_file_names(there: Mapping[str, int]) -> Iterator[PublicationFinding]:
    """Names and sizes of files that some hosts do not serve."""
    files_by_lower_name: dict[str, str] = {}
    for file, size in there.items():
        other = files_by_lower_name.setdefault(file.lower(), file)
        if other != file:
            yield PublicationFinding(
                file, 0, "name", f"differs from {other} only in capitals; some hosts keep only one of them"
            )
        if any(part.startswith(("_", ".")) for part in PurePosixPath(file).parts) and file != ".nojekyll":
            yield PublicationFinding(file, 0, "name", "begins with _ or a dot; some hosts do not serve such names")
        if re.search(r'[?#:*"<>|\\\x00-\x1f]', file):
            yield PublicationFinding(file, 0, "name", "has a character that URLs or other systems do not allow")
        if size > _LARGEST_BYTES:
            yield PublicationFinding(
                file, 0, "name", f"has {size:,} bytes; some hosts take no more than {_LARGEST_BYTES:,}"
            )


def _check_address(file: str, line: int, address: str, there: Mapping[str, int]) -> Iterator[PublicationFinding]:
    """Findings of an address that is followed from a file."""
    parts = urlsplit(address)
    if parts.scheme in _INSIDE:
        return
    if parts.scheme or address.startswith("//"):
        yield PublicationFinding(file, line, "request", f"asks {address[:120]}")
        return
    if not parts.path:
        return
    path = unquote(parts.path)
    if path.startswith("/"):
        yield PublicationFinding(
            file, line, "link", f"{path[:120]} begins at the host's root, which breaks it on a site in a subfolder"
        )
        return
    target_parts: list[str] = list(PurePosixPath(file).parent.parts)
    for part in PurePosixPath(path).parts:
        if part == ".." and not target_parts:
            yield PublicationFinding(file, line, "link", f"{path[:120]} points outside the folder")
            return
        if part == "..":
            target_parts.pop()
        else:
            target_parts.append(part)
    target = "/".join(target_parts)
    if target not in there and not any(name.startswith(f"{target}/") for name in there):
        yield PublicationFinding(file, line, "link", f"{path[:120]} is not in the folder")


def _find_line(text: str, place: int) -> int:
    return text.count("\n", 0, place) + 1
