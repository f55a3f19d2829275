"""What adversaries considered, on disk: of the drive that it is of, or not there."""

from pathlib import Path
from typing import Any

import pytest

from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.search_trace import SearchTraceFrame, read_search_trace, search_trace_path, write_search_trace
from tests.benchmark.records.test_drives import row

FRAMES = (
    SearchTraceFrame(frame=12, time_us=1_000_000, did="track"),
    SearchTraceFrame(
        frame=24, time_us=2_000_000, did="searched", scores=(None, -2.5), chosen=1,
        candidates=(((0.0, 0.0), (4.0, 1.0)), ((0.0, 0.0), (4.0, -1.0))),
    ),
)  # fmt: skip


def pursued(y: float = 0.0) -> EpisodeRow:
    adversary = {"agent": 0, "uuid": "a", "start": 12, "poses": [[0.0, y, 0.0]]}
    return row(adversary={**adversary, "replanned": [12, 24], "scores": [None, -2.5]})


def test_it_reads_back_for_its_own_drive_alone(tmp_path: Path) -> None:
    assert read_search_trace(tmp_path, pursued()) is None
    write_search_trace(tmp_path, pursued(), FRAMES)
    assert read_search_trace(tmp_path, pursued()) == FRAMES
    assert read_search_trace(tmp_path, pursued(y=1.0)) is None
    assert read_search_trace(tmp_path, row()) is None


@pytest.mark.parametrize("damage", ["{", "[]", '{"adversary": "x"}'])
def test_what_is_damaged_is_not_there(tmp_path: Path, damage: str) -> None:
    write_search_trace(tmp_path, pursued(), FRAMES)
    search_trace_path(tmp_path, "scene-1", 0).write_text(damage)
    assert read_search_trace(tmp_path, pursued()) is None


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"scores": (None,)}, "each candidate"),
        ({"candidates": (((0.0, 0.0),), ((0.0, 0.0), (1.0, 0.0)))}, "each candidate"),
        ({"chosen": 2}, "one of the candidates"),
        ({"chosen": None}, "need a chosen candidate"),
        ({"did": "slowed"}, "need a chosen candidate"),
    ],
)
def test_what_does_not_fit_together_is_refused(changes: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        SearchTraceFrame.model_validate({**FRAMES[1].model_dump(), **changes})
