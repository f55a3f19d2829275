"""The files of the site: pages, index and scenes."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from benchmark.records.drives import DriveRecord
from benchmark.records.quality import QualityRecord
from benchmark.records.run import RunRecord
from benchmark.records.scenes import Sheets
from leaderboard.site.drive_data import drive_files, drive_index
from leaderboard.site.index_data import PlacedFigure, PlacedTable, index_data
from leaderboard.site.scene_data import scene_files
from leaderboard.site.scripts import data_script

INDEX_PATH: Final = "data/index.js"
"""Written first: where it is, the folder is a site of ours."""
_ASSETS: Final = (".html", ".css", ".js")
_ASSETS_FOLDER: Final = Path(__file__).parent / "assets"


def site_files(
    records: Sequence[RunRecord],
    tables: Sequence[PlacedTable],
    quality: Sequence[QualityRecord],
    sheets: Sheets,
    figures: Sequence[PlacedFigure] = (),
    downloads: Mapping[str, bytes] | None = None,
    drives: Sequence[DriveRecord] = (),
) -> dict[str, bytes | Path]:
    """Every file of the site.

    Args:
        records: Run records that stand in tables (`leaderboard.selection.one_run_each`).
        tables: Tables in the order in which they are read.
        quality: Records of video quality.
        sheets: What is drawn of scenes; scenes without a sheet have a page too.
        figures: Figures that are among the downloads.
        downloads: Files that pages link or show, by their path below the leaderboard's folder; they lie at the same
            path below the site's, so that the site can be moved alone.

        drives: Records of drives; those on scenes with a sheet are played.

    Returns:
        Bytes by path below the site's folder; a path as value means a copy of that file.

    Raises:
        InputError: If a sheet was made from other content than a record of its split.
    """
    copied = downloads or {}
    scenes = scene_files(sheets, records) | drive_files(drives, sheets)
    index = index_data(records, tables, quality, sheets, figures, frozenset({*copied, *scenes}))
    index["drives"] = drive_index(drives, sheets)
    assets = {path.name: path.read_bytes() for path in sorted(_ASSETS_FOLDER.iterdir()) if path.suffix in _ASSETS}
    return {INDEX_PATH: data_script("window.CHALLENGER", index), **assets, **copied, **scenes}
