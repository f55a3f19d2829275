"""Films of scenes on disk as WebM, PNG frames or animated WebP; the same frames give the same bytes."""

import io
from collections.abc import Callable, Iterable, Iterator, Sequence
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import Any, Final

from PIL import Image

from benchmark.errors import InputError
from benchmark.machine.storage import sanitise_file_name, write_bytes
from benchmark.records.drives import DriveRecord
from benchmark.records.run import RunRecord, find_records
from benchmark.records.scene_pages import (
    SCENES_FOLDER,
    SHEET_FILE,
    SPLIT_FILE,
    read_scene_page,
    scene_folder,
    split_folder,
)
from benchmark.report.canvas import Picture, encode_png
from benchmark.report.episode_page import EpisodePage
from benchmark.report.words import format_options, format_split
from leaderboard.extensions.films.drive_film import DriveFilm
from leaderboard.extensions.films.film import Film, FilmSettings

FINE, COMPACT = 32, 38
"""VP9's scale from 0 (best) to 63: of scenes, and of drives, which there are many of and whose whole view moves."""
_SPEED: Final = 5
_WEBP_QUALITY: Final = 62


def encode_webm(frames: Iterable[Picture], fps: float, quality: int = FINE) -> bytes:
    """VP9 in WebM of frames, each (h, w, 3) RGB of the same even size; the quality is `FINE` or `COMPACT`."""
    av = _import_pyav()
    rate = Fraction(fps).limit_denominator(1000)
    target = io.BytesIO()
    # Without bitexact the file has a random identifier and the library's version.
    with av.open(target, "w", format="webm", options={"fflags": "+bitexact"}) as container:
        stream: Any = None
        for frame in frames:
            if stream is None:
                stream = container.add_stream("libvpx-vp9", rate=rate)
                stream.height, stream.width = frame.shape[:2]
                stream.pix_fmt = "yuv420p"
                stream.thread_count = 1
                stream.options = {
                    "crf": str(quality),
                    "b": "0",
                    "deadline": "realtime",
                    "cpu-used": str(_SPEED),
                    "flags": "+bitexact",
                }
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        if stream is not None:
            container.mux(stream.encode(None))
    return target.getvalue()


def encode_animated_webp(frames: Iterable[Picture], fps: float) -> bytes:
    """Endless animated WebP of equal (h, w, 3) RGB frames, for pages that show pictures but no films."""
    pictures = [Image.fromarray(frame) for frame in frames]
    # Whole milliseconds that add up to the film's length.
    ends = [round(1000 * (number + 1) / fps) for number in range(len(pictures))]
    durations = [end - start for start, end in zip([0, *ends], ends)]
    target = io.BytesIO()
    pictures[0].save(
        target,
        format="WEBP",
        save_all=True,
        append_images=pictures[1:],
        duration=durations,
        loop=0,
        quality=_WEBP_QUALITY,
        method=4,
        minimize_size=False,
    )
    return target.getvalue()


def require_webm() -> None:
    """Raise `InputError` if WebM files cannot be written here."""
    _import_pyav()


def _import_pyav() -> Any:
    try:
        import av
    except ImportError as error:
        raise InputError(
            "WebM films need PyAV, which is not installed; run pip install 'challenger-bench[video]', or choose "
            "--format png or --format webp"
        ) from error
    return av


LONGEST_WEBP: Final = 400
"""Frames of an animated WebP, which is made in memory."""
FrameProgress = Callable[[Iterable[Picture], int, str], Iterable[Picture]]
"""Passes frames on and shows how far the work is: frames, how many, what is done."""


class FilmFormat(StrEnum):
    """Format of a film."""

    WEBM = "webm"
    PNG = "png"
    WEBP = "webp"


def find_data_set_name(data: str) -> str:
    """The name under which sheets and records know what ``--data`` names: that of its folder."""
    return Path(data).resolve().name


def find_planner_folder(root: Path, data: str, split: str) -> Path:
    """Folder of the run records of a split, below the folder of all run records."""
    return root / sanitise_file_name(find_data_set_name(data)) / sanitise_file_name(split)


def find_scene_page_folders(root: Path, data: str, split: str, scenes: Sequence[str] | None) -> list[Path]:
    """Folders of the sheets of some scenes, by scene; of all that have one by default."""
    data_name = find_data_set_name(data)
    make = f"make it with: challenger-bench sheets{format_options(data=data, split=split, out=root.parent)}"
    if scenes is None:
        page_files = sorted(split_folder(root, data_name, split).glob(f"{SCENES_FOLDER}/*/{SHEET_FILE}"))
        if not page_files:
            raise InputError(
                f"{format_split(split, data_name)} has no scene sheet below {root}; {_list_other_pages(root)}{make}"
            )
        return [path.parent for path in page_files]
    folders = [scene_folder(root, data_name, split, scene) for scene in scenes]
    for scene, folder in zip(scenes, folders):
        if not (folder / SHEET_FILE).is_file():
            raise InputError(f"scene {scene} of {format_split(split, data_name)} has no sheet at {folder}; {make}")
    return folders


def _list_other_pages(root: Path) -> str:
    """Sheets that there are instead, in words."""
    splits = sorted(f"{path.parent.name} of {path.parent.parent.name}" for path in root.glob(f"*/*/{SPLIT_FILE}"))
    return f"there are sheets of split {', '.join(splits)}; name one with --data and --split, or " if splits else ""


def write_films(
    sheets: Path,
    runs: Path | Sequence[Path],
    data: str,
    split: str,
    to: Path,
    models: Sequence[str] = (),
    *,
    scenes: Sequence[str] | None = None,
    limit: int | None = None,
    form: FilmFormat = FilmFormat.WEBM,
    settings: FilmSettings | None = None,
    watch: FrameProgress = lambda frames, _total, _label: frames,
) -> Iterator[Path]:
    """Film scenes one after the other.

    Args:
        sheets: Folder of all sheets.
        runs: Folder of all run records, or the folders of those that have the planners' plans.
        data: Name or root of the data set.
        split: Its split.
        to: Folder to write to.
        models: Planners to show, as tables name them.
        scenes: Scene names; all that have a sheet by default.
        limit: Only the first so many of them.
        form: File format.
        settings: How films are made.
        watch: Shows how far the work is.

    Yields:
        Files written for each scene (`write_film`).

    Raises:
        InputError: If a scene has no sheet, there are no records, or as `write_film` does.
    """
    folders = find_scene_page_folders(sheets, data, split, scenes)[:limit]
    places = [find_planner_folder(runs, data, split)] if isinstance(runs, Path) else runs
    records = find_records(*places) if models else []
    for folder in folders:
        yield write_film(folder, records, models, to, form, settings or FilmSettings(), watch=watch)


def write_film(
    folder: Path,
    records: Sequence[RunRecord],
    models: Sequence[str],
    to: Path,
    form: FilmFormat,
    settings: FilmSettings,
    *,
    watch: FrameProgress = lambda frames, _total, _label: frames,
) -> Path:
    """Write one scene's film.

    ``<scene>.webm``, ``<scene>.webp``, or a folder ``<scene>`` of PNG files that are numbered from 0; refused are a
    folder of other frames and a film that is too long for its format.
    """
    if form is FilmFormat.WEBM:
        require_webm()
    film = Film(read_scene_page(folder), records, models, settings)
    scene = film.stored.sheet.scene
    return write_frames(film, to / sanitise_file_name(scene), form, settings.fps, watch=watch, label=f"filming {scene}")


def write_drive_film(
    driven: EpisodePage,
    record: DriveRecord,
    name: str,
    to: Path,
    form: FilmFormat,
    settings: FilmSettings,
    *,
    watch: FrameProgress = lambda frames, _total, _label: frames,
) -> Path:
    """Write ``<scene>-<planner>-<engine>-<agents>-<sensor>``, with latency and run if any, as `write_film`."""
    film, facts = DriveFilm(driven, record, name, settings), record.facts
    parts = [driven.row.scene, name, facts.measured.engine, facts.measured.agents, facts.measured.sensor]
    parts += [f"{facts.measured.latency_ms}ms"] if facts.measured.latency_ms else []
    parts += [] if facts.measured.window == "scene" else [facts.measured.window]
    parts += facts.measured.until_words
    window = driven.row.window
    parts += ["as", window.of] if window is not None and window.of != driven.row.scene else []
    parts += [driven.row.family] if driven.row.family else []
    parts += [f"run{driven.row.run}"] if facts.runs > 1 else []
    target, label = to / sanitise_file_name("-".join(parts)), f"filming {name} in {driven.row.scene}"
    return write_frames(film, target, form, settings.fps, watch=watch, label=label)


def write_frames(
    film: Film | DriveFilm, target: Path, form: FilmFormat, fps: float, *, watch: FrameProgress, label: str
) -> Path:
    """Write the frames of a film to a target, given without a suffix."""
    frames = watch(film, len(film), label)
    if form is FilmFormat.PNG:
        return _write_frames(target, frames, len(film))
    if form is FilmFormat.WEBP and len(film) > LONGEST_WEBP:
        raise InputError(
            f"an animated WebP has {LONGEST_WEBP} frames at most, and this one has {len(film)}; choose a part with "
            "--from and --until, a smaller --fps, or --format webm"
        )
    path = target.with_name(f"{target.name}.{form.value}")
    quality = COMPACT if isinstance(film, DriveFilm) else FINE
    data = encode_webm(frames, fps, quality) if form is FilmFormat.WEBM else encode_animated_webp(frames, fps)
    write_bytes(path, data)
    return path


def _write_frames(target: Path, frames: Iterable[Picture], count: int) -> Path:
    names = [f"{number:06d}.png" for number in range(count)]
    others = sorted({path.name for path in target.glob("*.png")} - set(names)) if target.is_dir() else []
    if others:
        raise InputError(f"{target} has other frames ({others[0]}); delete them or choose another folder with --to")
    for name, frame in zip(names, frames, strict=True):
        write_bytes(target / name, encode_png(frame), durable=False)
    return target
