"""The seam between folders of recordings and windows: what kinds of recordings there are and how each is read."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Final

from benchmark.datasets.roots import open_data
from benchmark.datasets.tables import version_folders
from benchmark.errors import InputError
from benchmark.machine.storage import content_key, file_sha256
from generation.extensions.denoiser_training.nuplan import NUPLAN_LICENCE, read_nuplan
from generation.extensions.denoiser_training.nuscenes_tracks import NUSCENES_LICENCE, read_nuscenes
from generation.extensions.denoiser_training.tracks import TrackFile, Windows, cut_windows, read_tracks

WINDOW_LIMIT: Final = 200_000
"""Windows of one source that are kept; 160 MB. Beyond it every second one is dropped, again and again."""


class Recording(StrEnum):
    """Kinds of recordings."""

    TRACK_FILE = "track file"
    NUPLAN = "nuPlan databases"
    NUSCENES = "nuScenes root"


@dataclass(frozen=True, slots=True)
class TrackSource:
    """One source of tracks, its name unique in the folder.

    ``paths`` are files, or the one root folder; ``version`` is the version folder of a nuScenes root.
    """

    name: str
    kind: Recording
    paths: tuple[Path, ...]
    version: str = ""

    def read(self) -> Iterator[TrackFile]:
        """Tracks in portions that fit into memory."""
        if self.kind is Recording.TRACK_FILE:
            yield read_tracks(self.paths[0])
        elif self.kind is Recording.NUPLAN:
            for path in self.paths:
                yield from read_nuplan(path, self.name)
        else:
            yield from read_nuscenes(self.paths[0], self.version, self.name)

    def content(self) -> str:
        """Hash of everything that is read."""
        if self.kind is Recording.NUSCENES:
            return open_data(self.paths[0], version=self.version).fingerprint()
        hashes = [file_sha256(path) for path in self.paths]
        return hashes[0] if self.kind is Recording.TRACK_FILE else content_key(hashes)


def find_track_sources(folder: Path) -> tuple[TrackSource, ...]:
    """Sources in a folder, sorted by name.

    ``NAME.npz`` is a track file; ``*.db`` beside each other are nuPlan databases and together one source; a folder
    with nuScenes tables is a nuScenes root. Databases and roots may lie in the folder itself or one level below.
    """
    if not folder.is_dir():
        raise InputError(f"no folder of tracks at {folder}; pass the folder that holds the <source>.npz files")
    try:
        found = sorted(_sources_in(folder), key=lambda source: source.name)
    except OSError as error:
        raise InputError(f"cannot look into {folder} ({error}); make it readable or pass another folder") from error
    if not found:
        raise InputError(
            f"{folder} holds no track files (.npz), nuPlan databases (.db) or nuScenes roots; pass a folder that does"
        )
    for one, other in itertools.pairwise(found):
        if one.name == other.name:
            raise InputError(f"{folder} has two sources called {one.name}; rename {other.paths[0]}")
    return tuple(found)


def _sources_in(folder: Path) -> Iterator[TrackSource]:
    for path in folder.glob("*.npz"):
        yield TrackSource(path.stem, Recording.TRACK_FILE, (path,))
    for place in (folder, *(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))):
        name = place.resolve().name
        if databases := tuple(sorted(place.glob("*.db"))):
            yield TrackSource("nuplan" if place is folder else name, Recording.NUPLAN, databases)
        versions = version_folders(place)
        for version in versions:
            title = name if len(versions) == 1 else f"{name}_{version}"
            yield TrackSource(title, Recording.NUSCENES, (place,), version)


def source_windows(source: TrackSource, stride_s: float, limit: int = WINDOW_LIMIT) -> tuple[Windows, str]:
    """Windows of a source and its licence in words; a long source is thinned out evenly to ``limit`` windows.

    It is read portion by portion; ``stride_s`` lies between the starts of windows.
    """
    parts: list[Windows] = []
    licence = NUPLAN_LICENCE if source.kind is Recording.NUPLAN else NUSCENES_LICENCE
    seen, every, tracks = 0, 1, 0
    for portion in source.read():
        licence = portion.licence
        windows = cut_windows(portion, stride_s)
        numbered = replace(windows, track=windows.track + tracks)
        parts.append(numbered.every(every, -seen % every))
        seen, tracks = seen + len(windows.previous), tracks + len(portion.tracks)
        while sum(len(part.previous) for part in parts) > limit:
            parts, every = [Windows.joined(parts).every(2, 0)], every * 2
    return Windows.joined(parts), licence
