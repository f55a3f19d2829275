"""The main path of scene sheets: data set in, sheets and pictures out; finished work is found and kept.

What is shown of a whole split: its scenes, its numbers, and what the search for adversaries tried.
"""

import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from benchmark.datasets.statistics import statistics
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings
from benchmark.machine.storage import (
    content_key,
    file_name,
    only_writer,
    read_kept_json,
    write_bytes,
    write_json,
    writing_to,
)
from benchmark.machine.workers import LocalProcesses, default_workers
from benchmark.records.attempts import ATTEMPTS_FILE, read_attempts
from benchmark.records.run_schema import DataFacts
from benchmark.records.scenes import (
    ROUNDS_FILE,
    SCENES_FOLDER,
    SCHEMA,
    SHEET_FILE,
    SPLIT_FILE,
    AttemptFacts,
    Sheet,
    SplitSheet,
    kept_rounds_path,
    split_folder,
)
from benchmark.records.statistics import Runtime, SplitStatistics
from benchmark.report.words import counted
from benchmark.runs.scene_work import reopening
from benchmark.runs.units import ResultStore, run_units
from benchmark.scene_pages.making import (
    KEY,
    MAKING_VERSION,
    Job,
    WrittenSheet,
    planned_sheet,
    rounds_fit,
    written_sheet,
)

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


def write_split_sheet(
    directory: Path,
    data: "DataSet",
    split: str,
    facts: DataFacts,
    runtime: Runtime | None,
    hyper: Mapping[str, Any] | None = None,
) -> SplitSheet:
    """Describe a split in ``split.json``.

    Args:
        hyper: Settings of the search, if they are known.
    """
    review = data.review(split).facts
    reviewed = [] if review is None else [review.content]
    key = content_key("split sheet", [MAKING_VERSION, SCHEMA], facts.model_dump(mode="json"), split, *reviewed)
    store: ResultStore[SplitStatistics] = ResultStore(directory, SplitStatistics)
    sheet = SplitSheet(
        schema=SCHEMA,
        data=facts,
        split=split,
        scenes=data.scene_names(split),
        # Counting the tables of all nuScenes takes minutes.
        statistics=store.get(key, KEY) or statistics(data.root, split=split, version=data.version),
        attempts=_attempts(data, split),
        runtime=runtime,
        review=review,
        hyper=dict(hyper or {}),
    )
    write_json(directory / SPLIT_FILE, sheet.model_dump(mode="json", by_alias=True), indent=None)
    store.put(key, sheet.statistics, KEY)
    return sheet


def _attempts(data: "DataSet", split: str) -> tuple[AttemptFacts, ...]:
    """Attempts of the search; none where the root was not generated for this split."""
    provenance = data.provenance()
    path = data.root / ATTEMPTS_FILE
    if provenance is None or provenance.get("split") != split or not path.is_file():
        return ()
    return tuple(AttemptFacts.of(attempt) for attempt in read_attempts(path))


_WIDTHS_PX: Final = (16, 4096)


@dataclass(frozen=True, slots=True)
class SheetSettings:
    """Settings of sheets.

    Attributes:
        pictures: Which frames get a picture of all cameras; ``all`` are those at 12 Hz.
        cell_width_px: Widest picture of one camera. 480 pixels are sharp enough where one camera fills half a page, and
            are twice the bytes of 320.
        scenes: Only these scenes of the split.
        limit: Only the first so many scenes.
        workers: Number of processes; 0 is one for each processor. The result does not depend on it.
        rounds: Whether to show the rounds of refinement that the search kept.
    """

    pictures: Literal["keyframes", "all", "none"] = "keyframes"
    cell_width_px: int = 480
    scenes: tuple[str, ...] | None = None
    limit: int | None = None
    workers: int = 0
    rounds: bool = False

    def __post_init__(self) -> None:
        if self.workers < 0:
            raise InputError(f"--workers must be 0 or more, got {self.workers}")
        if not _WIDTHS_PX[0] <= self.cell_width_px <= _WIDTHS_PX[1]:
            raise InputError(
                f"--cell-width must be {_WIDTHS_PX[0]} to {_WIDTHS_PX[1]} pixels, got {self.cell_width_px}"
            )


@dataclass(frozen=True, slots=True)
class WrittenSheets:
    """Outcome for a split; ``directory`` holds its ``split.json``.

    Attributes:
        scenes: One for each scene that was asked for.
        traced: How many of them show the rounds of refinement; ``None`` if that was not asked for.
    """

    directory: Path
    scenes: tuple[WrittenSheet, ...]
    traced: int | None = None

    def as_json(self) -> dict[str, Any]:
        """The same in numbers."""
        return {
            "directory": str(self.directory),
            "scenes": [page.scene for page in self.scenes],
            "made": sum(page.made for page in self.scenes),
            "pictures": sum(page.pictures for page in self.scenes),
            "sheet_bytes": sum(page.sheet_bytes for page in self.scenes),
            "picture_bytes": sum(page.picture_bytes for page in self.scenes),
            **({} if self.traced is None else {"traced": self.traced}),
        }

    def sentence(self) -> str:
        """The same in words."""
        total = self.as_json()
        new_count, cached_count = total["made"], len(self.scenes) - total["made"]
        when = (
            f"{new_count} made, the others were there"
            if new_count and cached_count
            else "made now"
            if new_count
            else "there already"
        )
        return (
            f"{counted(len(self.scenes), 'sheet')} in {self.directory} ({when}): "
            f"{total['sheet_bytes'] / 1e6:.1f} MB, with {counted(total['pictures'], 'picture')} of "
            f"{total['picture_bytes'] / 1e6:.1f} MB"
            + ("" if self.traced is None else f"\nrounds of refinement of {counted(self.traced, 'scene')}")
        )


def write_sheets(
    data: "DataSet",
    split: str,
    root: Path,
    settings: SheetSettings,
    *,
    runtime: Runtime | None = None,
    hyper: Mapping[str, Any] | None = None,
    reopen: Callable[[], "DataSet"] | None = None,
) -> WrittenSheets:
    """Write the sheets of a split; the same command goes on, and does nothing where nothing has changed.

    Args:
        data: The data set.
        split: One of its splits.
        root: Folder of all sheets.
        settings: What to write.
        runtime: Seconds of each stage of generation, if they are known.
        hyper: Settings of the search that the scenes come from, if they are known.
        reopen: Opens the data set in another process; by default from its root, version and name.

    Returns:
        What there is now. Sheets of scenes that the split no longer has, or of another version of the data set, are
        removed.

    Raises:
        InputError: If the split or a scene is unknown, something in it is broken, some of its images are missing,
            another command is writing there, or rounds are asked for and none were kept.
    """
    chosen = EvalSettings(scenes=settings.scenes, limit=settings.limit).chosen(data, split)
    if settings.rounds and not any(kept_rounds_path(data.root, name).is_file() for name in chosen):
        raise InputError(
            f"{data.root} has no rounds of refinement; challenger-bench generate --split adv --keep-rounds keeps them "
            "(run again, it searches anew where they are missing)"
        )
    job = _job(data, split, root, settings)
    # What is wrong with the first scene is said before anything is written.
    data.scene(chosen[0])
    directory = split_folder(root, data.name, split)
    with only_writer(directory):
        _tidy(directory, job.facts, data.scene_names(split))
        write_split_sheet(directory, data, split, job.facts, runtime, hyper)
        workers = settings.workers or default_workers()
        opener = reopen or reopening(data)
        work = partial(written_sheet, job, data) if workers == 1 else partial(_in_worker, job, opener)
        where = LocalProcesses(workers)
        written = tuple(run_units(work, chosen, where, total=len(chosen), label="scene sheets"))
        traced = sum(_show_rounds(job.folder(name), data.root, name) for name in chosen) if settings.rounds else None
    return WrittenSheets(directory, written, traced)


def _show_rounds(folder: Path, data_root: Path, scene: str) -> bool:
    """Put the rounds that the search kept beside a scene's sheet; whether there are any that belong to it."""
    cached_rounds = kept_rounds_path(data_root, scene)
    if not rounds_fit(cached_rounds, Sheet.model_validate(read_kept_json(folder / SHEET_FILE))):
        return False
    content, page_rounds = cached_rounds.read_bytes(), folder / ROUNDS_FILE
    if not page_rounds.is_file() or page_rounds.read_bytes() != content:
        write_bytes(page_rounds, content)
    return True


def plan_of(data: "DataSet", split: str, root: Path, settings: SheetSettings) -> str:
    """One sentence that says what would be done: for ``--dry-run``."""
    chosen = EvalSettings(scenes=settings.scenes, limit=settings.limit).chosen(data, split)
    job = _job(data, split, root, settings)
    planned = [planned_sheet(job, data, name) for name in chosen]
    return (
        f"would write {counted(len(chosen), 'sheet')} with "
        f"{counted(sum(page.pictures for page in planned), 'picture')} to "
        f"{split_folder(root, data.name, split)}; {sum(not page.made for page in planned)} are there already"
    )


def _job(data: "DataSet", split: str, root: Path, settings: SheetSettings) -> Job:
    facts = DataFacts(name=data.name, version=data.version, fingerprint=data.fingerprint())
    return Job(root, facts, split, settings.pictures, settings.cell_width_px)


_in_this_process: dict[str, "DataSet"] = {}
"""Data set of a worker process, opened once."""


def _in_worker(job: Job, reopen: Callable[[], "DataSet"], scene: str) -> WrittenSheet:
    if job.facts.fingerprint not in _in_this_process:
        _in_this_process[job.facts.fingerprint] = reopen()
    return written_sheet(job, _in_this_process[job.facts.fingerprint], scene)


def _tidy(directory: Path, facts: DataFacts, scenes: tuple[str, ...]) -> None:
    """Remove what is no longer a part of the split: other scenes, and scenes of another version of the data set."""
    wanted = {file_name(name) for name in scenes}
    for folder in _folders(directory / SCENES_FOLDER):
        stored = read_kept_json(folder / SHEET_FILE)
        known = stored.get("data") if isinstance(stored, dict) else None
        if folder.name not in wanted or (known is not None and known != facts.model_dump(mode="json")):
            with writing_to(folder):
                shutil.rmtree(folder)


def _folders(folder: Path) -> Iterator[Path]:
    if folder.is_dir():
        yield from (path for path in sorted(folder.iterdir()) if path.is_dir() and not path.is_symlink())
