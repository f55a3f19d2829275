"""The main path of scene sheets: data set in, sheets and pictures out; finished work is found and kept."""

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
    lock_folder,
    read_cached_json,
    sanitise_file_name,
    write_bytes,
    write_json,
    writing_to,
)
from benchmark.machine.workers import LocalProcesses, default_workers
from benchmark.records.attempts import ATTEMPTS_FILE, read_attempts
from benchmark.records.run_schema import DataFacts
from benchmark.records.scene_pages import (
    ROUNDS_FILE,
    SCENES_FOLDER,
    SCHEMA,
    SHEET_FILE,
    SPLIT_FILE,
    AttemptFacts,
    ScenePage,
    SplitPage,
    kept_rounds_path,
    split_folder,
)
from benchmark.records.statistics import BuildRuntime, SplitStatistics
from benchmark.report.words import pluralise
from benchmark.runs.scene_work import make_reopener
from benchmark.runs.units import ResultStore, run_units
from benchmark.scene_pages.page_building import (
    KEY,
    MAKING_VERSION,
    PageJob,
    WrittenPage,
    do_rounds_fit,
    preview_page,
    write_page,
)

if TYPE_CHECKING:
    from benchmark.datasets.roots import DataSet


def write_split_page(
    directory: Path,
    data: "DataSet",
    split: str,
    facts: DataFacts,
    runtime: BuildRuntime | None,
    hyper: Mapping[str, Any] | None = None,
) -> SplitPage:
    """Describe a split in ``split.json``; ``hyper`` are the settings of the search, if they are known."""
    review = data.review(split).facts
    reviewed = [] if review is None else [review.content]
    key = content_key("split sheet", [MAKING_VERSION, SCHEMA], facts.model_dump(mode="json"), split, *reviewed)
    store: ResultStore[SplitStatistics] = ResultStore(directory, SplitStatistics)
    sheet = SplitPage(
        schema=SCHEMA,
        data=facts,
        split=split,
        scenes=data.scene_names(split),
        # Counting the tables of all nuScenes takes minutes.
        statistics=store.get(key, KEY) or statistics(data.root, split=split, version=data.version),
        attempts=_read_attempts(data, split),
        runtime=runtime,
        review=review,
        hyper=dict(hyper or {}),
    )
    write_json(directory / SPLIT_FILE, sheet.model_dump(mode="json", by_alias=True), indent=None)
    store.put(key, sheet.statistics, KEY)
    return sheet


def _read_attempts(data: "DataSet", split: str) -> tuple[AttemptFacts, ...]:
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
class WrittenPages:
    """Outcome for a split; ``directory`` holds its ``split.json``.

    Of the scenes that were asked for, ``traced`` show the rounds of refinement; ``None`` if that was not asked for.
    """

    directory: Path
    scenes: tuple[WrittenPage, ...]
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
            f"{new_count} made, the others existed"
            if new_count and cached_count
            else "made now"
            if new_count
            else "already made"
        )
        return (
            f"{pluralise(len(self.scenes), 'sheet')} in {self.directory} ({when}): {total['sheet_bytes'] / 1e6:.1f} "
            f"MB, with {pluralise(total['pictures'], 'picture')} of {total['picture_bytes'] / 1e6:.1f} MB"
            + ("" if self.traced is None else f"\nrounds of refinement of {pluralise(self.traced, 'scene')}")
        )


def write_sheets(
    data: "DataSet",
    split: str,
    root: Path,
    settings: SheetSettings,
    *,
    runtime: BuildRuntime | None = None,
    hyper: Mapping[str, Any] | None = None,
    reopen: Callable[[], "DataSet"] | None = None,
) -> WrittenPages:
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
            f"{data.root} has no rounds of refinement; run challenger-bench generate --split adv --keep-rounds "
            "(it searches again where they are missing)"
        )
    job = _build_job(data, split, root, settings)
    # Errors in the first scene are reported before anything is written.
    data.scene(chosen[0])
    directory = split_folder(root, data.name, split)
    with lock_folder(directory):
        _remove_outdated(directory, job.facts, data.scene_names(split))
        write_split_page(directory, data, split, job.facts, runtime, hyper)
        workers = settings.workers or default_workers()
        opener = reopen or make_reopener(data)
        work = partial(write_page, job, data) if workers == 1 else partial(_write_in_worker, job, opener)
        where = LocalProcesses(workers)
        written = tuple(run_units(work, chosen, where, total=len(chosen), label="scene sheets"))
        traced = sum(_copy_rounds(job.folder(name), data.root, name) for name in chosen) if settings.rounds else None
    return WrittenPages(directory, written, traced)


def _copy_rounds(folder: Path, data_root: Path, scene: str) -> bool:
    """Put the rounds that the search kept beside a scene's sheet; whether there are any that belong to it."""
    cached_rounds = kept_rounds_path(data_root, scene)
    if not do_rounds_fit(cached_rounds, ScenePage.model_validate(read_cached_json(folder / SHEET_FILE))):
        return False
    content, page_rounds = cached_rounds.read_bytes(), folder / ROUNDS_FILE
    if not page_rounds.is_file() or page_rounds.read_bytes() != content:
        write_bytes(page_rounds, content)
    return True


def describe_plan(data: "DataSet", split: str, root: Path, settings: SheetSettings) -> str:
    """One sentence that says what would be done: for ``--dry-run``."""
    chosen = EvalSettings(scenes=settings.scenes, limit=settings.limit).chosen(data, split)
    job = _build_job(data, split, root, settings)
    planned = [preview_page(job, data, name) for name in chosen]
    return (
        f"would write {pluralise(len(chosen), 'sheet')} with "
        f"{pluralise(sum(page.pictures for page in planned), 'picture')} to "
        f"{split_folder(root, data.name, split)}; {sum(not page.made for page in planned)} already exist"
    )


def _build_job(data: "DataSet", split: str, root: Path, settings: SheetSettings) -> PageJob:
    facts = DataFacts(name=data.name, version=data.version, fingerprint=data.fingerprint())
    return PageJob(root, facts, split, settings.pictures, settings.cell_width_px)


_DATA_OF_WORKER: dict[str, "DataSet"] = {}
"""Data set of a worker process, opened once."""


def _write_in_worker(job: PageJob, reopen: Callable[[], "DataSet"], scene: str) -> WrittenPage:
    if job.facts.fingerprint not in _DATA_OF_WORKER:
        _DATA_OF_WORKER[job.facts.fingerprint] = reopen()
    return write_page(job, _DATA_OF_WORKER[job.facts.fingerprint], scene)


def _remove_outdated(directory: Path, facts: DataFacts, scenes: tuple[str, ...]) -> None:
    """Remove what is no longer a part of the split: other scenes, and scenes of another version of the data set."""
    wanted = {sanitise_file_name(name) for name in scenes}
    for folder in _iterate_folders(directory / SCENES_FOLDER):
        stored = read_cached_json(folder / SHEET_FILE)
        known = stored.get("data") if isinstance(stored, dict) else None
        if folder.name not in wanted or (known is not None and known != facts.model_dump(mode="json")):
            with writing_to(folder):
                shutil.rmtree(folder)


def _iterate_folders(folder: Path) -> Iterator[Path]:
    if folder.is_dir():
        yield from (path for path in sorted(folder.iterdir()) if path.is_dir() and not path.is_symlink())
