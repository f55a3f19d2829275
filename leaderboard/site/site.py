"""The files of the site: pages, index and scenes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final
from urllib.parse import quote

from benchmark.machine.extension import call_extension, list_offers
from benchmark.machine.storage import sanitise_file_name
from leaderboard.frame.results import LeaderboardResults
from leaderboard.page.sections import TABS
from leaderboard.site.drive_data import build_drive_files
from leaderboard.site.index_data import PlacedFigure, PlacedTable, build_index
from leaderboard.site.packing import encode_script
from leaderboard.site.scene_data import build_scene_files

INDEX_PATH: Final = "data/index.js"
"""Written first: where it is, the folder is a site of ours."""
_ASSETS: Final = (".html", ".css", ".js")
_ASSETS_FOLDER: Final = Path(__file__).parent / "assets"


def build_site_files(
    results: LeaderboardResults,
    tables: Sequence[PlacedTable],
    figures: Sequence[PlacedFigure] = (),
    drawn: Mapping[str, bytes] | None = None,
) -> dict[str, bytes | Path]:
    """Every file of the site by path below its folder; a path as value means a copy of that file.

    `drawn` are the pictures of `figures` by path below the site's folder, which can be moved alone.
    """
    pictures = drawn or {}
    index = build_index(results, tables, figures, frozenset(pictures))
    pages = {scene["key"]: scene.pop("page") for scene in index["scenes"]}
    scenes = build_scene_files(results.sheets, results.runs, pages) | build_drive_files(results.drives, results.sheets)
    assets = {path.name: path.read_bytes() for path in sorted(_ASSETS_FOLDER.iterdir()) if path.suffix in _ASSETS}
    index["pages"], of_extensions = [], {}
    for offer in list_offers("page"):
        tab, name = _place_page(offer)
        path = f"pages/{sanitise_file_name(name)}.html"
        index["pages"].append({"tab": tab, "name": name, "path": quote(path)})
        of_extensions[path] = call_extension("page", offer, results).encode()
    return {INDEX_PATH: encode_script("window.CHALLENGER", index), **assets, **pictures, **scenes, **of_extensions}


def _place_page(offer: str) -> tuple[str, str]:
    """Tab and name of an extension's page: ``protocols margins`` is below protocols, ``margins`` below results."""
    tab, _, name = offer.partition(" ")
    return (tab, name) if tab in TABS and name else (TABS[0], offer)
