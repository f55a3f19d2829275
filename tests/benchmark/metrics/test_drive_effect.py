"""Paired drives: the estimator of the effect table, ratios of sums, and how many recordings would be enough."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.metrics.drive_effect import (
    compute_drive_effect,
    drive_effect_to_json,
    find_unchanged_drives,
)
from benchmark.metrics.rates import compute_paired_difference, count_needed_recordings
from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import DriveRecord
from benchmark.records.run_schema import SceneFacts
from tests.benchmark.records.test_drives import contact, failed, row, scores, written

MEASURED = {"engine": "default", "agents": "idm", "sensor": "none", "window": "encounter"}
OF = {"windows_of": {"split": "adv", "windows": "12345678"}}


def window(of: str, end: int = 9) -> dict[str, Any]:
    return {"of": of, "start": 2, "end": end, "adversaries": ["a"], "departs_s": 4.0}


def drive(scene: str, of: str, *, hit: bool, km: float, end: int = 9) -> EpisodeRow:
    made: dict[str, Any] = {"end": "contact", "contact": contact()} if hit else {}
    return row(scene, window=window(of, end), scores=scores(progress_m=1000.0 * km), **made)


def pair(folder: Path, adversarial: list[EpisodeRow], unchanged: list[EpisodeRow]) -> tuple[DriveRecord, DriveRecord]:
    sources = {each.scene: SceneFacts(source=each.scene.split("-")[0], adversaries=1) for each in adversarial}
    names = [*dict.fromkeys(each.scene for each in unchanged)]
    return (
        written(folder / "adv", *adversarial, scenes=[*sources], scene_facts=sources, measured=MEASURED),
        written(folder / "val", *unchanged, split="val", scenes=names, measured=MEASURED | OF),
    )


def test_each_recording_has_the_same_weight(tmp_path: Path) -> None:
    # Recording a has three variants, all of them hit; b to f have one, one of which is hit on both sides.
    made = [drive(f"a-{number}", f"a-{number}", hit=True, km=0.1) for number in range(3)]
    made += [drive(f"{name}-0", f"{name}-0", hit=name == "b", km=0.1) for name in "bcdef"]
    plain = [drive(each.scene.split("-")[0], each.scene, hit=each.scene == "b-0", km=0.2) for each in made]
    record, unchanged = pair(tmp_path, made, plain)
    effects = {each.measure: each for each in compute_drive_effect(record, unchanged).effects}
    at_fault = effects["at_fault"]
    assert at_fault.adversarial == pytest.approx(2 / 6) and at_fault.unchanged == pytest.approx(1 / 6)
    assert at_fault.difference == compute_paired_difference(np.array([1.0, 0, 0, 0, 0, 0]), np.ones(6))
    km = effects["km_per_incident"]
    assert km.adversarial == pytest.approx(0.6 / 2) and km.unchanged == pytest.approx(1.2 / 1)
    assert km.difference.value == pytest.approx(-0.9) and km.difference.differing == 2
    assert drive_effect_to_json(record, [unchanged])["paired"]["measures"]["at_fault"]["pairs"] == 8


def test_km_per_incident_varies_with_the_recordings(tmp_path: Path) -> None:
    names = "abcdefgh"
    made = [drive(f"{name}-0", f"{name}-0", hit=at % 4 != 3, km=0.1 + 0.01 * at) for at, name in enumerate(names)]
    plain = [drive(name, f"{name}-0", hit=at % 2 == 0, km=0.2) for at, name in enumerate(names)]
    difference = compute_drive_effect(*pair(tmp_path, made, plain)).effects[4].difference
    assert difference.low is not None and difference.high is not None and difference.value is not None

    # Leaving one recording out at a time (jackknife) says about the same.
    def ratio(rows: list[EpisodeRow]) -> float:
        km = sum(each.scores.progress_m for each in rows if each.scores is not None) / 1000.0
        return km / sum(each.contact is not None for each in rows)

    parts = [ratio(made[:at] + made[at + 1 :]) - ratio(plain[:at] + plain[at + 1 :]) for at in range(8)]
    spread = math.sqrt(7 / 8 * sum((each - np.mean(parts)) ** 2 for each in parts))
    assert (difference.high - difference.value) / 2.3646 == pytest.approx(spread, rel=0.2)


def test_what_failed_or_has_another_window_is_in_no_pair(tmp_path: Path) -> None:
    made = [drive("a-0", "a-0", hit=True, km=0.1), drive("b-0", "b-0", hit=True, km=0.1), failed("c-0")]
    plain = [
        drive("a", "a-0", hit=False, km=0.1),
        drive("b", "b-0", hit=False, km=0.1, end=8),
        drive("c", "c-0", hit=False, km=0.1),
    ]
    record, unchanged = pair(tmp_path, made, plain)
    effect = compute_drive_effect(record, unchanged)
    assert effect.unpaired == 2 and effect.effects[0].pairs == 1
    assert find_unchanged_drives(record, [record, unchanged]) is unchanged
    assert find_unchanged_drives(unchanged, [record, unchanged]) is None
    other = written(tmp_path / "x", *plain, split="val", measured={**MEASURED, **OF, "latency_ms": 100})
    another = written(
        tmp_path / "y", *plain, split="val", measured=MEASURED | OF, planner={"name": "else", "privileged": False}
    )
    assert find_unchanged_drives(record, [other, another]) is None and drive_effect_to_json(record, [other]) == {}


def test_so_many_recordings_are_needed() -> None:
    rng = np.random.default_rng(1)
    few = rng.normal(0.2, 0.5, 8).clip(-1.0, 1.0)
    found = compute_paired_difference(few, np.ones(8))
    needed = count_needed_recordings(found)
    assert found.low is not None and found.low < 0.0 and needed is not None and needed > 8
    # As many that are spread alike give an interval that just leaves 0 out.
    scale = np.std(few, ddof=1)
    for count, tells in ((needed, True), (needed - 1, False)):
        like = np.resize([1.0, -1.0], count)
        like = float(np.mean(few)) + (like - like.mean()) / np.std(like, ddof=1) * scale
        again = compute_paired_difference(like, np.ones(count), most=math.inf)
        assert again.low is not None and again.high is not None and (again.low * again.high > 0.0) is tells
    assert count_needed_recordings(compute_paired_difference(np.full(8, 0.5) + few / 10, np.ones(8))) is None
    assert count_needed_recordings(compute_paired_difference(np.zeros(8), np.ones(8))) is None
    too_few = compute_paired_difference(np.array([1.0, 0, 0, 0, 0, 0]), np.ones(6))
    assert count_needed_recordings(too_few) == too_few.enough == 30
