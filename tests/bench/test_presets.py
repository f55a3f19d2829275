"""The table of the presets: seeds of one data set together, data sets and presets apart."""

from typing import Any

from bench.presets import counts, table
from benchmark.records.attempts import Approach, Attempt


def attempt(gap_m: float | None, discard: str | None = None) -> Attempt:
    """One attempt that came so close, or was discarded."""
    return Attempt(
        scene="scene-1",
        agent="a",
        seed=0,
        kept=discard is None,
        discard=discard,
        launch_frame=0,
        challenge=0.5,
        closest_approach=None if gap_m is None else Approach(gap_m=gap_m, time_s=1.0, side="left"),
        least_time_to_collision_s=None,
    )


def row(preset: str, seed: int, rates: tuple[tuple[int, int], tuple[int, int] | None], *attempts: Attempt) -> Any:
    """What one build is remembered as."""
    said = counts(attempts)
    return {"data": "mini", "preset": preset, "seed": seed, **said, "rates": {"constant-velocity": rates}}


def test_attempts_are_counted_by_fate() -> None:
    said = counts([attempt(0.5), attempt(1.5), attempt(None, "hits-the-ego"), attempt(9.0, "never-gets-close")])
    assert (said["tried"], said["kept"], said["scenes"]) == (4, 2, 1)
    assert said["gaps"] == [0.5, 1.5]
    assert said["why_not"] == {"hits-the-ego": 1, "never-gets-close": 1}


def test_seeds_are_added_up_and_presets_are_not() -> None:
    rows = [
        row("paper", 0, ((1, 100), (4, 20)), attempt(0.5), attempt(None, "hits-the-ego")),
        row("paper", 1, ((1, 100), None), attempt(None, "hits-the-ego")),
        row("reference", 0, ((1, 100), (9, 30)), attempt(0.0), attempt(0.2)),
    ]
    lines = table(rows).splitlines()
    assert lines[2] == ("| mini | paper | 2 | 3 | 1 (33 %) | 1 | 2 hits-the-ego | 0.50 | 0 | - | 1.0 -> 20.0 |")
    assert lines[3] == "| mini | reference | 1 | 2 | 2 (100 %) | 1 |  | 0.10 | 1 | - | 1.0 -> 30.0 |"
    assert "156 scenes" in lines[-1] and "UniAD 0.29 -> 3.95" in lines[-1]
