"""Scene sheets and the leaderboard, from everything that an output folder holds."""

from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from benchmark.api.opening import OUT, notify_once, workspace
from benchmark.machine.extension import AbsentExtensionError, import_from_extension

if TYPE_CHECKING:
    from collections.abc import Sequence

    from benchmark.datasets.roots import DataSet
    from benchmark.scene_pages.writing import SheetSettings, WrittenPages
    from leaderboard.frame.results import LeaderboardResults

_Record = TypeVar("_Record")


def write_sheets(dataset: "DataSet", split: str, root: Path, settings: "SheetSettings") -> "WrittenPages":
    """Write the scene sheets of a split.

    Args:
        dataset: The data set that holds the split.
        split: The split.
        root: Folder of all sheets.
        settings: What the sheets show.

    Returns:
        The sheets.

    Raises:
        InputError: If the split or a scene is unknown, the data is broken, or rounds are asked for and none were kept.
    """
    from benchmark.machine.workspace import is_generated
    from benchmark.scene_pages.writing import write_sheets as write
    from generation.nuscenes_writer.plan import STATE_FOLDER
    from generation.pipeline.estimate import read_runtime_table
    from generation.pipeline.recorded_settings import read_recorded_settings

    hyper = read_recorded_settings(dataset.root, dataset.provenance()) if is_generated(split) else {}
    runtime = read_runtime_table(dataset.root / STATE_FOLDER, workspace(root.parent).timings_of(dataset.root))
    return write(dataset, split, root, settings, runtime=runtime, hyper=hyper)


def write_leaderboard(
    out: Path = OUT,
    to: Path | None = None,
    records: "Sequence[Path] | None" = None,
    *,
    site: bool = True,
    figures: bool = False,
) -> list[Path]:
    """Write tables and site from everything that an output folder holds.

    Args:
        out: The output folder: run records, records of drives, scene sheets, video quality, ablation studies, scores
            of challenges.
        to: Folder of the leaderboard; ``<out>/leaderboard`` by default.
        records: Folders of run records and of records of drives, if not ``<out>/runs`` and ``<out>/drives``.
        site: Whether to write the site too.
        figures: Whether to write every figure as PNG and SVG, too; those of an earlier leaderboard are else removed.

    Returns:
        The files.

    Raises:
        InputError: If there is nothing to show, records cannot stand in one table, or files cannot be written.
    """
    results = _collect_results(out, records)
    from leaderboard.build import write_leaderboard as write

    return write(results, to or out / "leaderboard", site=site, figures=figures)


def stale_leaderboard(
    out: Path = OUT,
    to: Path | None = None,
    records: "Sequence[Path] | None" = None,
    *,
    site: bool = True,
    figures: bool = False,
) -> list[str]:
    """Paths, below a written leaderboard, of all that `write_leaderboard` would write otherwise now."""
    from leaderboard.build import find_stale_files

    return find_stale_files(_collect_results(out, records), to or out / "leaderboard", site=site, figures=figures)


def _collect_results(out: Path, folders: "Sequence[Path] | None") -> "LeaderboardResults":
    """Sources of a leaderboard; without run records it may be made from the rest."""
    from benchmark.records.ablation import find_ablations
    from benchmark.records.challenge import find_scores
    from benchmark.records.drives import find_drives
    from benchmark.records.quality import find_quality
    from benchmark.records.record_costs import with_cost, with_drive_cost
    from benchmark.records.reproduction import find_reproductions, with_reproductions
    from benchmark.records.run import find_records
    from benchmark.records.scene_pages import find_scene_pages

    space = workspace(out)
    quality = _with_tables("quality", find_quality(space.quality_root()))
    sheets = find_scene_pages(space.sheet_root())
    ablations = find_ablations(space.ablation_root())
    drive_folders = [space.drive_root()] if space.drive_root().is_dir() else []
    drives = [
        with_drive_cost(drive_record, folders or drive_folders, space.timings_of)
        for drive_record in find_drives(*(folders or drive_folders))
    ]
    scored = any(space.challenge_root().glob("scores-*.json"))
    others = bool(quality or sheets.splits or ablations or drives or scored)
    no_runs = others and folders is None and not space.run_root().exists()
    roots = folders or [space.run_root()]
    records = [] if no_runs else with_reproductions(find_records(*roots), find_reproductions(roots))
    records = [with_cost(record, roots, space.timings_of) for record in records]
    challenges = _with_tables("challenges", find_scores(space.challenge_root()))
    abilities = find_in_extension("records", "abilities", out, records, drives)
    from leaderboard.frame.results import read_results

    return read_results(records, quality, sheets, ablations, drives, challenges, abilities)


def find_in_extension(kind: str, name: str, out: Path, *given: Any) -> "list[Any]":
    """Whatever an extension makes of its folder below an output folder; nothing where that is missing, or it is."""
    if not (out / name).is_dir():
        return []
    try:
        found: list[Any] = import_from_extension(kind, name)(out, *given)
    except AbsentExtensionError as absent:
        notify_once(f"the {name} below {out} are not shown: {absent}")
        return []
    return found


def _with_tables(kind: str, records: "list[_Record]") -> "list[_Record]":
    """Records of an extension, or none, and a sentence, where the one that makes tables of them is not installed."""
    if records:
        try:
            import_from_extension("section", kind)
        except AbsentExtensionError as absent:
            notify_once(f"the records of {kind} are not shown: {absent}")
            return []
    return records
