"""Builds of reviewed splits: what an inspector rejected is not written again, and the next best takes its place."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.datasets.split_reviews import record_verdicts, scene_tokens
from benchmark.records.review import Verdict
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import NothingSurvivedError, build_split
from generation.splits.building import build_frozen
from generation.splits.packaged import read_frozen_split
from tests.generation.labels.recorded_roads import CHEAP, contents, write_source
from tests.generation.pipeline.test_split import few_cars


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    root = tmp_path_factory.mktemp("recorded")
    return write_source(root, few_cars("scene-9901", 10.0), few_cars("scene-9902", 2.0))


@pytest.fixture(scope="module")
def searched(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The work of a search: what is built in a copy of it searches nothing again."""
    settings = replace(CHEAP, out=tmp_path_factory.mktemp("searched") / "out")
    build_split(source, "adv", settings)
    return settings.out


@pytest.fixture
def settings(searched: Path, tmp_path: Path) -> BuildSettings:
    return replace(CHEAP, out=Path(shutil.copytree(searched, tmp_path / "out")))


def reject(root: Path, *names: str) -> None:
    tokens = scene_tokens(root)
    record_verdicts(
        root, {name: Verdict(verdict="rejected", reason="drives oddly", token=tokens[name]) for name in names}
    )


@pytest.mark.parametrize("layout", ["suffixed", "per-variant"])
def test_rejected_scenes_are_not_written_again_and_the_next_best_is(
    source: DataSet, settings: BuildSettings, layout: Literal["suffixed", "per-variant"]
) -> None:
    settings = replace(settings, layout=layout)
    whole = build_split(source, "adv", settings)
    assert len(whole.written) >= 2, "the test needs a scene to reject and one to keep"
    tokens = scene_tokens(settings.out)
    few = replace(settings, total=1)
    best = build_split(source, "adv", few)
    assert best.written == whole.written[:1]
    (name,) = open_data(settings.out).scene_names("adv")
    reject(settings.out, name)
    report = build_split(source, "adv", few)
    assert report.written == whole.written[1:2]
    assert report.dropped["rejected-by-hand"] == 1 and "rejected-by-hand" in report.summary()
    data = open_data(settings.out)
    (other,) = data.scene_names("adv")
    # The scene that moved up has the token that it had, so that a verdict on it would stand.
    assert other != name and scene_tokens(settings.out)[other] == tokens[other]
    facts = data.review("adv").facts
    assert facts is not None and (facts.rejected, facts.accepted, facts.not_reviewed) == (1, 0, 1)
    before = contents(settings.out)
    build_split(source, "adv", few)
    assert contents(settings.out) == before


def test_a_verdict_on_another_motion_of_the_same_name_does_not_stand(source: DataSet, settings: BuildSettings) -> None:
    written = build_split(source, "adv", settings).written
    record_verdicts(settings.out, {written[0]: Verdict(verdict="rejected", reason="x", token="0" * 32)})
    assert build_split(source, "adv", settings).written == written
    assert open_data(settings.out).review("adv").outdated == (written[0],)


def test_what_was_rejected_before_freezing_is_counted_where_it_is_rebuilt(
    source: DataSet, settings: BuildSettings, tmp_path: Path
) -> None:
    written = build_split(source, "adv", settings).written
    reject(settings.out, written[0])
    build_split(source, "adv", replace(settings, freeze=tmp_path / "road-adv-1.json"))
    named = read_frozen_split(tmp_path / "road-adv-1.json")
    assert written[0] not in {scene.name for scene in named.frozen.scenes}
    rebuilt = replace(CHEAP, out=tmp_path / "rebuilt")
    build_frozen(source, named, rebuilt)
    review = open_data(rebuilt.out).review("adv")
    assert review.rejected == {written[0]: "drives oddly"} and len(review.waiting) == len(written) - 1


def test_splits_that_nobody_reviewed_say_nothing_of_a_review(
    source: DataSet, settings: BuildSettings, tmp_path: Path
) -> None:
    build_split(source, "adv", replace(settings, freeze=tmp_path / "road-adv-1.json"))
    made = open_data(settings.out).provenance()
    assert made is not None and "left_out" not in made
    stored = json.loads((tmp_path / "road-adv-1.json").read_text())
    assert set(stored["chosen"]) == {"scenes", "tried", "survived", "per_scene", "total", "surrogate"}


def test_when_all_are_rejected_nothing_is_written_and_it_says_why(source: DataSet, settings: BuildSettings) -> None:
    written = build_split(source, "adv", settings).written
    reject(settings.out, *written)
    with pytest.raises(NothingSurvivedError, match=f"{len(written)} rejected-by-hand"):
        build_split(source, "adv", settings)


def test_a_rejected_recording_is_no_source(source: DataSet, tmp_path: Path) -> None:
    root = write_source(tmp_path / "recorded", few_cars("scene-9901", 10.0), few_cars("scene-9902", 2.0)).root
    reject(root, "scene-9902")
    report = build_split(open_data(root), "adv", replace(CHEAP, out=tmp_path / "out"))
    assert report.scenes == 1 and all(name.startswith("scene-9901") for name in report.written)
