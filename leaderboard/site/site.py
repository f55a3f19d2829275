"""The files of the site: pages, index and scenes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from leaderboard.frame.results import LeaderboardResults
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
    return {INDEX_PATH: encode_script("window.CHALLENGER", index), **assets, **copied, **scenes}
