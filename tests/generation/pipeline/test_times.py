"""Estimates before the work, and where the time went after it."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmark.datasets.roots import DataSet
from benchmark.published import RUNTIME_S
from benchmark.scene import Scene
from generation.pipeline.estimate import (
    WorkEstimate,
    build_runtime_table,
    compute_mean_seconds,
    estimate_rendering,
    format_duration,
)
from generation.pipeline.report import estimate_build
from generation.pipeline.split import build_split
from generation.render.schematic import SchematicRenderer
from tests.generation.labels.recorded_roads import BUSY, CHEAP, write_source
from tests.hand_made import scene_on_straight_road


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return write_source(tmp_path_factory.mktemp("recorded"), scene_on_straight_road(BUSY, seconds=8.0))


def test_durations_are_said_as_people_do() -> None:
    said = [format_duration(seconds) for seconds in (0.4, 9.96, 35.2, 119.0, 720.0, 12600.0, 360000.0)]
    assert said == ["0.4 s", "10 s", "35 s", "119 s", "12 min", "3.5 h", "100 h"]


def test_work_is_shared_by_workers() -> None:
    text = WorkEstimate(90, 8.0, 36, 20.0, 2, 2).sentence()
    expected = "6.0 min of planning (90 attempts at 8 s) and 6.0 min of rendering (36 scenes at 20 s)"
    assert text == f"about {expected} on 2 workers"
    assert (
        WorkEstimate(90, 8.0, 0, 0.0, None, None).sentence() == "about 12 min of planning (90 attempts at 8 s) in all"
    )
    assert WorkEstimate(0, 0.0, 0, 0.0, 1, 1).sentence() == "about no time"


def test_a_dry_run_estimates_each_stage(source: DataSet, tmp_path: Path) -> None:
    settings = replace(CHEAP, out=tmp_path / "out", renderer=SchematicRenderer(64, 40), frames="keyframes")
    before = estimate_build(source, "adv", replace(settings)).estimate
    assert before is not None
    assert before.attempts == 3
    assert before.attempt_s > 0.0
    assert before.scene_s > 0.0
    report = build_split(source, "adv", settings)
    assert report.runtime is not None
    after = estimate_build(source, "adv", replace(settings)).estimate
    assert after is not None
    assert after.attempts == 0
    stages = ("sampling", "physics", "scoring", "other")
    assert after.attempt_s == pytest.approx(sum(report.runtime.each_s(stage) or 0.0 for stage in stages))
    more = estimate_build(source, "adv", replace(settings, out=tmp_path / "more", adversaries=2)).estimate
    assert more is not None
    assert more.attempts > before.attempts
    originals = estimate_build(source, "val-r", replace(settings, out=tmp_path / "val-r")).summary()
    assert "of rendering (1 scene at" in originals and "planning" not in originals


def test_the_runtime_table_adds_up_notes(tmp_path: Path) -> None:
    attempts, scenes = [tmp_path / name for name in ("a", "b", "c")], [tmp_path / "d"]
    for path in attempts[:2]:
        path.write_text('{"seconds": {"sampling": 1.0, "physics": 2.0, "scoring": 3.0, "unheard-of": 0.5}}')
    attempts[2].write_text('{"seconds": ')
    scenes[0].write_text('{"seconds": {"rendering": 10.0}}')
    table = build_runtime_table(attempts, scenes)
    assert (table.attempts, table.scenes) == (2, 1)
    assert table.total_s == {"sampling": 2.0, "physics": 4.0, "scoring": 6.0, "rendering": 10.0, "other": 1.0}
    assert table.each_s("physics") == 2.0
    lines = table.table().plain().splitlines()
    assert lines[2].split() == ["sampling", "2.00", "1.00", "17.36"]
    assert lines[5].split() == ["rendering", "10.00", "10.00", "395.18"]
    assert lines[7].split() == ["all", "23.00", "16.50", f"{sum(RUNTIME_S.values()):.2f}"]
    assert compute_mean_seconds(attempts) == pytest.approx(6.5)
    nothing = build_runtime_table([tmp_path / "absent"], [])
    assert nothing.each_s("sampling") is None and "-" in nothing.table().plain() and compute_mean_seconds([]) is None


class CountedRenderer:
    """Takes 5 s before the first picture of a scene, then 0.1 s a picture, by a clock of its own."""

    seconds = 0.0

    def render(self, scene: Scene, frames: Sequence[int]) -> Iterator[None]:
        self.seconds += 5.0
        for _ in frames:
            self.seconds += 0.1
            yield None


def test_what_a_scene_costs_before_its_first_picture_is_counted_once(
    source: DataSet, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    counted, scene = CountedRenderer(), source.scene(source.scene_names("val")[0])
    renderer: Any = counted
    monkeypatch.setattr("generation.pipeline.estimate.time.process_time", lambda: counted.seconds)
    few = estimate_rendering(renderer, scene, "keyframes", tmp_path)
    many = estimate_rendering(renderer, scene, "all", tmp_path)
    assert few == pytest.approx(5.0 + 0.1 * len(scene.keyframes))
    assert many == pytest.approx(5.0 + 0.1 * len(scene.timestamps_us))
    assert estimate_rendering(None, scene, "all", tmp_path) == 0.0
