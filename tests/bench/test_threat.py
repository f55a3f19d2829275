"""The measuring stick of searches that threaten: what counts as a hit at fault, and how rows are summed up."""

from typing import Any, cast

import numpy as np
import pytest

import bench.attacked
from bench.attacked import judged_plans
from bench.threat import Setting, entropy_bits, table
from benchmark.datasets.roots import DataSet
from benchmark.errors import InputError
from benchmark.interactions.tracks import Tracks
from tests.hand_made import Car, scene_on_straight_road

STRAIGHT = np.stack([np.zeros(6), 4.0 * np.arange(1, 7)], axis=-1)
"""Straight ahead at 8 m/s, in the frame of the lidar."""


def judged(monkeypatch: pytest.MonkeyPatch, car: Car, plan: Any = STRAIGHT) -> tuple[bool, int, int]:
    scene = scene_on_straight_road((car,), seconds=6.0)
    plans = np.repeat(plan[None], len(scene.keyframes), axis=0)
    monkeypatch.setattr(bench.attacked, "_plans", lambda source, name: plans)
    return judged_plans(cast(DataSet, None), scene, scene.name, Tracks.of_scene(scene), 0)


def test_running_into_what_stands_ahead_is_at_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    blamed, colliding, samples = judged(monkeypatch, Car(90.0, 198.25))
    # Twelve samples, six of them with 3 s of recording left.
    assert blamed and samples == 6 and colliding > 0


def test_being_hit_from_behind_is_a_hit_but_not_at_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    blamed, colliding, _ = judged(monkeypatch, Car(20.0, 198.25, 16.0))
    assert colliding > 0 and not blamed


def test_turning_into_the_next_lane_is_at_fault_and_driving_beside_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    beside = Car(51.0, 194.75, 8.0)
    assert judged(monkeypatch, beside)[:2] == (False, 0)
    turning = np.stack([0.8 * np.arange(1, 7), 4.0 * np.arange(1, 7)], axis=-1)
    assert judged(monkeypatch, beside, turning)[0]


def test_a_setting_is_a_label_a_preset_and_changes() -> None:
    assert Setting.parse("today=") == Setting("today", "default", ())
    assert Setting.parse("a=preset=paper,rounds=2,tries=3") == Setting("a", "paper", ("rounds=2", "tries=3"))


def test_a_preset_that_there_is_not_is_one_sentence() -> None:
    with pytest.raises(InputError, match="no preset 'mine'"):
        Setting.parse("a=preset=mine")


def test_entropy_of_manoeuvres() -> None:
    assert entropy_bits({}) == 0.0
    assert entropy_bits({"a": 3}) == 0.0
    assert entropy_bits({"a": 2, "b": 2, "c": 2, "d": 2, "e": 0}) == 2.0


def row(seed: int, kept: int, **changed: Any) -> dict[str, Any]:
    base = {
        "data": "rec", "setting": "new", "seed": seed, "tried": 10, "kept": kept, "scenes": 2,
        "why_not": {"leaves-the-area-around-the-ego": 1, "never-gets-close": 9 - kept},
        "manoeuvres": {"cut-in-left": kept - 1, "squeezing-left": 1}, "gaps": [0.5], "careful": kept, "constant": 1,
        "at_fault": 2, "attributable": 1, "colliding": 5, "samples": 50, "faults": {"hovering": 1},
        "features": {"speed": 0.9, "gap": 0.7 + 0.1 * seed}, "seconds": 12.0,
    }  # fmt: skip
    return base | changed


def test_seeds_of_a_setting_are_one_row() -> None:
    lines = table([row(0, 4), row(1, 6), row(0, 3, setting="old", features=None)]).splitlines()
    assert len(lines) == 4
    assert lines[2] == (
        "| rec | new | 2 | 20 | 10 (50 %) | 10 % | 20 % | 80 % | 0.72 | 100 % | 20 % | 40 % | 10 % "
        "| gap 0.70, gap 0.80 | 2 hovering | 2.4 | 8 cut-in-left, 2 squeezing-left "
        "| 8 never-gets-close, 2 leaves-the-area-around-the-ego |"
    )
    assert "| old | 1 | 10 | 3 (30 %) |" in lines[3] and "| - | 1 hovering |" in lines[3]
