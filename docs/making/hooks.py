"""Hooks of mkdocs: pages that lie beside docs/, pages that are made, and links between them."""

import re
from pathlib import Path
from typing import Any

import pages
from commands import command_pages
from mkdocs.structure.files import File, Files
from mkdocs.utils import get_relative_url
from public_face import face_pages

_SEARCH_ON_DISK = re.compile(r'<script src="https://[^"]*/iframe-worker/[^"]*"></script>')


def on_config(config: Any) -> Any:
    """Put the pages that are made into the navigation, where mkdocs.yml names their folders."""
    made = command_pages() | face_pages()
    for part in config.nav:
        for entries in part.values():
            for entry in entries:
                for name, target in entry.items() if isinstance(entry, dict) else ():
                    if isinstance(target, str) and target.endswith("/"):
                        entry[name] = [address for address in made if address.startswith(target)]
    return config


def on_files(files: Files, config: Any) -> Files:
    """Add README and its neighbours, and the pages that are made."""
    beside = {address: (pages.ROOT / name).read_text() for name, address in pages.OUTSIDE.items()}
    for address, content in (beside | command_pages() | face_pages()).items():
        files.append(File.generated(config, address, content=content))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Files) -> str:
    """Make links of names of pages."""
    address = page.file.src_uri
    beside = {site: pages.ROOT / name for name, site in pages.OUTSIDE.items()}
    source = beside.get(address, Path(config.docs_dir) / address)
    if not source.exists():
        return markdown
    return pages.on_the_site(markdown, source, address)


def on_post_page(output: str, page: Any, config: Any) -> str:
    """Take the script that lets a page on disk be searched from here instead of from a server."""
    ours = get_relative_url("making/search_from_disk.js", page.url)
    return _SEARCH_ON_DISK.sub(f'<script src="{ours}"></script>', output)


def on_post_template(output: str, template_name: str, config: Any) -> str:
    """The same for the page of wrong addresses."""
    return _SEARCH_ON_DISK.sub('<script src="/making/search_from_disk.js"></script>', output)
