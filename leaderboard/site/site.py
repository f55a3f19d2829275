"""The files of the site: pages, index and scenes."""

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Final

from benchmark.machine.extension import call_extension, list_offers
from benchmark.machine.storage import sanitise_file_name
from leaderboard.frame.results import LeaderboardResults
from leaderboard.site.drive_data import build_drive_files
from leaderboard.site.index_data import PlacedFigure, PlacedTable, build_index
from leaderboard.site.packing import encode_script
from leaderboard.site.scene_data import build_scene_files

INDEX_PATH: Final = "data/index.js"
"""Written first: where it is, the folder is a site of ours."""
_FRONT: Final = "index.html"
_ASSETS: Final = (".html", ".css", ".js")
_ASSETS_FOLDER: Final = Path(__file__).parent / "assets"


def build_site_files(
    results: LeaderboardResults,
    tables: Sequence[PlacedTable],
    figures: Sequence[PlacedFigure] = (),
    downloads: Mapping[str, bytes] | None = None,
) -> dict[str, bytes | Path]:
    """Every file of the site by path below its folder; a path as value means a copy of that file.

    `downloads` are files that pages link or show, by their path below the leaderboard's folder; they lie at the same
    path below the site's, so that the site can be moved alone.
    """
    copied = downloads or {}
    index = build_index(results, tables, figures, frozenset(copied))
    pages = {scene["key"]: scene.pop("page") for scene in index["scenes"]}
    scenes = build_scene_files(results.sheets, results.runs, pages) | build_drive_files(results.drives, results.sheets)
    assets = {path.name: path.read_bytes() for path in sorted(_ASSETS_FOLDER.iterdir()) if path.suffix in _ASSETS}
    extension_pages = {name: f"pages/{sanitise_file_name(name)}.html" for name in list_offers("page")}
    links = "".join(f'<a href="{path}">{escape(name)}</a>\n' for name, path in extension_pages.items())
    assets[_FRONT] = assets[_FRONT].replace(b"</nav>", f"{links}</nav>".encode())
    of_extensions = {path: call_extension("page", name, results).encode() for name, path in extension_pages.items()}
    return {INDEX_PATH: encode_script("window.CHALLENGER", index), **assets, **copied, **scenes, **of_extensions}
