"""Search trace of a reactive adversary at each of its planning frames: one file per drive, beside its record.

The files are written on request (`drive --keep-considered`) and do not change the record's bytes.
"""

from pathlib import Path
from typing import Any, Final, Literal, Self

from pydantic import model_validator

from benchmark.machine.storage import content_key, read_cached_json, sanitise_file_name, write_json
from benchmark.records.drive_schema import AdversaryRow, EpisodeRow
from benchmark.records.scene_pages import Ring
from benchmark.records.stored import Stored

SCHEMA: Final = 1
FOLDER: Final = "considered"
"""In the directory of a record of drives."""
FrameAction = Literal["track", "searched", "slowed"]


class SearchTraceFrame(Stored):
    """Candidates and choice of an adversary in one planning frame.

    The track that the scene was made with went on, a candidate of the search was driven, or none was allowed and it
    went on or braked on the path that was meant (``did``). ``candidates`` (B, M) are global x, y, half a second apart,
    none where it did not search; of their ``scores`` lower is better, null is infinite. ``chosen`` is null where none
    was driven.
    """

    frame: int
    time_us: int
    did: FrameAction
    candidates: tuple[Ring, ...] = ()
    scores: tuple[float | None, ...] = ()
    chosen: int | None = None

    @model_validator(mode="after")
    def _agree(self) -> Self:
        if len(self.scores) != len(self.candidates) or len({len(line) for line in self.candidates}) > 1:
            raise ValueError("each candidate needs a score and the same number of points")
        if (self.chosen is not None) != (self.did == "searched"):
            raise ValueError("exactly the frames with a search need a chosen candidate")
        if self.chosen is not None and not 0 <= self.chosen < len(self.candidates):
            raise ValueError("the chosen candidate must be one of the candidates")
        return self


class _SearchTraceFile(Stored):
    """The file of one drive; ``adversary`` is a key of the track that these frames led to."""

    schema_version: Literal[1]
    adversary: str
    frames: tuple[SearchTraceFrame, ...]


def search_trace_path(directory: Path, scene: str, run: int) -> Path:
    """File of a record with the candidates of the adversary of a drive."""
    return directory / FOLDER / f"{sanitise_file_name(scene)}-{run}.json"


def write_search_trace(directory: Path, row: EpisodeRow, frames: tuple[SearchTraceFrame, ...]) -> None:
    """Keep the candidates of a drive's adversary, one entry for each of its planning frames."""
    assert row.adversary is not None
    file = _SearchTraceFile(schema_version=SCHEMA, adversary=_key(row.adversary), frames=frames)
    write_json(search_trace_path(directory, row.scene, row.run), file.model_dump(mode="json"), indent=None)


def read_search_trace(directory: Path, row: EpisodeRow) -> tuple[SearchTraceFrame, ...] | None:
    """Planning frames of a drive's adversary; ``None`` where they were not kept, or were of another drive."""
    if row.adversary is None:
        return None
    stored: Any = read_cached_json(search_trace_path(directory, row.scene, row.run))
    try:
        file = _SearchTraceFile.model_validate(stored)
    except ValueError:
        # A missing or damaged trace is made again by its reader.
        return None
    return file.frames if file.adversary == _key(row.adversary) else None


def _key(adversary: AdversaryRow) -> str:
    return content_key(adversary.model_dump(mode="json"))
