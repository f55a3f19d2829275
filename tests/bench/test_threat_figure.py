"""What the picture of searches shows: a point a setting, shares of what it kept."""

from pathlib import Path
from typing import Any

import pytest

from bench.threat_figure import points, write_figure


def scene(name: str, *faults: str, colliding: int = 0, at_fault: bool = False, careful: bool = True) -> dict[str, Any]:
    return {
        "scene": name,
        "faults": list(faults),
        "colliding": colliding,
        "at_fault": at_fault,
        "careful_survives": careful,
    }


ROWS = [
    {
        "setting": "near",
        "tried": 5,
        "each": [
            scene("scene-1-aa", "hovering", colliding=3, at_fault=True, careful=False),
            scene("scene-1-ab", colliding=1, at_fault=True),
        ],
    },
    {"setting": "aim", "tried": 4, "each": []},
    {"setting": "near", "tried": 3, "each": [scene("scene-2-aa"), scene("scene-2-ab")]},
]


def test_seeds_of_a_setting_are_one_point_and_who_kept_nothing_is_none() -> None:
    (point,) = points(ROWS)
    assert (point.label, point.kept, point.tried) == ("near", 4, 8)
    assert point.valid.value == 0.75
    assert {name: rate.value for name, rate in point.success.items()} == {"contact": 0.5, "attributable": 0.25}


def test_intervals_draw_recordings_not_scenes() -> None:
    (point,) = points(ROWS)
    # Of two recordings one has both contacts: what is drawn has none, half or all.
    assert (point.success["contact"].low, point.success["contact"].high) == (0.0, 1.0)


@pytest.mark.parametrize("suffix", [".png", ".svg"])
def test_the_picture_is_the_same_bytes_every_time(suffix: str, tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_figure(ROWS, tmp_path / f"{name}{suffix}")
    drawn = (tmp_path / f"a{suffix}").read_bytes()
    assert drawn == (tmp_path / f"b{suffix}").read_bytes() and len(drawn) > 1000
