"""A planner in the loop: only scenes in which it collides are written."""

import json
import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine.workspace import is_finished
from benchmark.records.rows import find_scene_failures
from benchmark.scene import Camera, Scene
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import NothingSurvivedError, build_split
from generation.pipeline.surrogate import PlannerUnderTest
from generation.render.contract import Images
from tests.generation.labels.recorded_roads import QUICK, contents, recorded, write_source
from tests.generation.search.drivers import Drivers, LookingDriver, RaisingDriver
from tests.generation.splits.frozen_files import FrontRenderer

FAST = PlannerUnderTest(Drivers(speed=10.0), images=False)
SLOWER = PlannerUnderTest(Drivers(speed=9.0), images=False)
"""Fails on some of the adversaries of a single scene, where the faster one may fail on all."""
LOOKING = PlannerUnderTest(Drivers(LookingDriver, 9.0))


@dataclass
class CountingRenderer:
    """Draws as the schematic one and remembers what it drew, in this process."""

    name: str = "schematic"
    version: str = "counted"
    drawn: list[str] = field(default_factory=list, compare=False)

    def cameras(self, scene: Scene) -> tuple[Camera, ...]:
        return FrontRenderer(64, 40).cameras(scene)

    def render(self, scene: Scene, frames: Sequence[int]) -> Iterator[Images]:
        self.drawn.append(" ".join(scene.adversaries))
        return FrontRenderer(64, 40).render(scene, frames)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    root = tmp_path_factory.mktemp("recorded")
    return write_source(root, recorded("scene-9901"), recorded("scene-9902", seconds=9.0))


@pytest.fixture(scope="module")
def built(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("failing") / "out"
    build_split(source, "adv", replace(QUICK, out=out, surrogate=FAST))
    return out


def searched(built: Path, out: Path) -> Path:
    """A root in which the search is done and nothing else."""
    attempts = Path(".challenger", "attempts")
    shutil.copytree(built / attempts, out / attempts)
    return out


def failures(root: Path, out: Path) -> dict[str, bool | None]:
    record = evaluate(open_data(root), "adv", Drivers(speed=10.0), out, EvalSettings(protocols=("exact",)))
    return find_scene_failures(record.rows, "exact")


def test_what_is_written_fails_the_surrogate_and_what_is_not_does_not(
    source: DataSet, built: Path, tmp_path: Path
) -> None:
    out = searched(built, tmp_path / "all")
    everything = build_split(source, "adv", replace(QUICK, out=out))
    expected = {name for name, failed in failures(out, tmp_path / "runs").items() if failed}
    assert 0 < len(expected) < len(everything.written)
    assert set(open_data(built).scene_names("adv")) == expected
    assert all(failures(built, tmp_path / "again").values())


def test_the_report_says_what_the_surrogate_did(built: Path) -> None:
    report = json.loads((built / "report.json").read_text())
    said = report["surrogate"]
    assert said["scenes_failed"] == len(report["written"])
    assert said["scenes"] == report["survived"] == said["scenes_failed"] + report["dropped"]["surrogate-does-not-fail"]
    assert 0 < said["colliding_samples"] < said["samples"]
    assert (built / said["record"] / "run.json").is_file()


def test_kills_do_not_change_the_bytes(
    source: DataSet, built: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = searched(built, tmp_path / "out")
    settings = replace(QUICK, out=out, surrogate=FAST)

    def killed(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    for place in (
        "generation.pipeline.selection.evaluate_surrogate",
        "generation.pipeline.split.publish_reports",
        "generation.pipeline.split.write_scenes",
    ):
        with monkeypatch.context() as context:
            context.setattr(place, killed)
            with pytest.raises(KeyboardInterrupt):
                build_split(source, "adv", settings)
        assert not is_finished(out)
    build_split(source, "adv", settings)
    assert contents(out) == contents(built)


def counted(built: Path, out: Path, **changes: Any) -> tuple[CountingRenderer, BuildSettings]:
    """Of one scene, in which the search is done."""
    renderer = CountingRenderer()
    return renderer, replace(QUICK, out=searched(built, out), renderer=renderer, frames="keyframes", limit=1, **changes)


def test_pictures_drawn_for_the_surrogate_are_used_again(source: DataSet, built: Path, tmp_path: Path) -> None:
    renderer, settings = counted(built, tmp_path / "out", layout="per-variant", surrogate=LOOKING)
    report = build_split(source, "adv", settings)
    assert 0 < len(report.written) < report.survived == len(renderer.drawn) == len(set(renderer.drawn))
    pictures = sorted((tmp_path / "out").glob("**/samples/CAM_FRONT/*.jpg"))
    assert pictures
    assert all(path.stat().st_nlink == 2 for path in pictures if ".challenger" not in path.parts)
    before = contents(tmp_path / "out")
    build_split(source, "adv", settings)
    assert len(renderer.drawn) == report.survived
    assert contents(tmp_path / "out") == before
    data = open_data(tmp_path / "out")
    assert len(data.scene_names("adv")) == len(report.written)


def test_a_planner_that_does_not_look_costs_no_pictures(source: DataSet, built: Path, tmp_path: Path) -> None:
    renderer, settings = counted(built, tmp_path / "out", surrogate=SLOWER)
    report = build_split(source, "adv", settings)
    assert len(renderer.drawn) == len(report.written) < report.survived


def test_limits_count_scenes_that_fail(source: DataSet, built: Path, tmp_path: Path) -> None:
    out = Path(shutil.copytree(built, tmp_path / "out"))
    report = build_split(source, "adv", replace(QUICK, out=out, surrogate=FAST, per_scene=1))
    scenes = {name.rsplit("-", 1)[0] for name in report.written}
    assert len(report.written) == len(scenes) == 2
    assert set(report.written) < set(open_data(built).scene_names("adv"))
    assert report.dropped.keys() == {"surrogate-does-not-fail", "beyond-the-number-kept"}


def test_a_surrogate_that_raises_is_no_surrogate(source: DataSet, built: Path, tmp_path: Path) -> None:
    raising = PlannerUnderTest(Drivers(RaisingDriver), images=False)
    out = searched(built, tmp_path / "out")
    with pytest.raises(InputError, match=r"raising raised on \d+ of \d+ samples"):
        build_split(source, "adv", replace(QUICK, out=out, surrogate=raising, limit=1))
    assert not is_finished(out)


def test_a_surrogate_that_never_fails_leaves_nothing(source: DataSet, built: Path, tmp_path: Path) -> None:
    out = Path(shutil.copytree(built, tmp_path / "out"))
    settings = replace(QUICK, out=out, surrogate=PlannerUnderTest(Drivers(speed=8.0), images=False))
    with pytest.raises(NothingSurvivedError, match="surrogate-does-not-fail"):
        build_split(source, "adv", settings)
    assert not is_finished(out)


def test_the_surrogate_never_drives_scenes_of_another_layout(source: DataSet, built: Path, tmp_path: Path) -> None:
    settings = replace(QUICK, out=Path(shutil.copytree(built, tmp_path / "out")), surrogate=FAST)
    build_split(source, "adv", replace(settings, layout="per-variant", limit=1))
    report = build_split(source, "adv", settings)
    assert set(report.written) == set(open_data(built).scene_names("adv"))
    assert set(open_data(settings.out).scene_names("adv")) == set(report.written)
