"""``mini@1`` is the embedded town as it was, whatever ``mini`` is now."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from adapters.registry import planner_factory
from benchmark import api
from benchmark.datasets.roots import open_data
from benchmark.errors import InputError
from benchmark.evaluation import evaluate
from benchmark.machine.workspace import is_finished, strip_version
from benchmark.protocols import STANDARD
from benchmark.runs.rescoring import rescore_all
from generation.sources import embedded
from generation.sources.embedded import TOWNS, find_town
from generation.sources.first_town import read_first_scene
from generation.sources.mini import TownSettings, build_town_data_set
from generation.splits.building import build_frozen
from generation.splits.packaged import read_frozen_split, read_newest_split, require_town
from tests.benchmark.cli.cli_runs import bytes_below, run_main
from tests.generation.sources.first_towns import (
    FIRST_SPLITS,
    FIRST_TOWN,
    digest_exactly,
    digest_files,
    write_first_town,
)
from tests.generation.splits.frozen_files import BUILT, recordings

MADE_THEN = json.loads(Path(__file__).with_name("first_town.json").read_text())
"""Hashes of what the town's own code made, when there was no other version of it."""


def test_every_recording_is_what_it_was() -> None:
    assert [digest_exactly(read_first_scene(number)) for number in range(10)] == MADE_THEN["scenes"]
    names = tuple(read_first_scene(number).name for number in range(10))
    assert find_town(FIRST_TOWN).scene_names() == names


def test_tables_maps_and_can_bus_are_what_they_were(tmp_path: Path) -> None:
    assert digest_files(write_first_town(tmp_path, 3).root) == MADE_THEN["files"]


@pytest.mark.slow
def test_the_whole_town_has_the_fingerprint_that_it_had(tmp_path: Path) -> None:
    root = build_town_data_set(tmp_path, TownSettings(pictures="keyframes", version=1), workers=2)
    assert open_data(root).fingerprint() == TOWNS[1].fingerprints[-1]


def test_what_an_earlier_version_built_into_the_cache_is_taken() -> None:
    town = find_town(FIRST_TOWN)
    assert (town.folder_name(), town.drawn_name()) == ("mini-96cc3dc88486", "mini-c61c79b5424c")
    assert find_town("mini@2").folder_name() == find_town("mini").folder_name() != town.folder_name()


@pytest.mark.parametrize("other", [{"val_scenes": 11}, {"seed": 1}, {"train_scenes": 2}])
def test_what_the_first_town_does_not_have_is_of_the_second(other: dict[str, Any], tmp_path: Path) -> None:
    assert not TownSettings(**other).is_first and not TownSettings().is_first and TownSettings(version=1).is_first
    with pytest.raises(InputError, match="version 1 of the town has 10 evaluation scenes"):
        build_town_data_set(tmp_path / "town", TownSettings(**other, version=1), workers=1)
    assert not list(tmp_path.iterdir())


def test_it_is_built_once_by_one_command_and_goes_on_after_a_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    small = TownSettings(val_scenes=1, width=32, height=18, version=1)
    monkeypatch.setattr(embedded, "_settle", lambda version: small)
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path))
    data = api.open_data(FIRST_TOWN, workers=1)
    assert data.name == FIRST_TOWN and data.root.parent == tmp_path
    before = bytes_below(data.root)
    assert len(list(data.root.glob("samples/CAM*/*.jpg"))) == 6 * 40 and not list(data.root.glob("sweeps/CAM*/*.jpg"))
    assert bytes_below(api.open_data(FIRST_TOWN, workers=1).root) == before
    next(data.root.glob("*/challenger.json")).unlink()
    next(data.root.glob("samples/CAM*/*.jpg")).unlink()
    assert not is_finished(data.root)
    assert bytes_below(api.open_data(FIRST_TOWN, workers=1).root) == before


@pytest.mark.parametrize(
    ("data", "said"), [("mini@7", "choose mini, mini@1, mini@2"), ("mini@0", "there is no folder")]
)
def test_a_version_that_is_not_there_is_refused(data: str, said: str) -> None:
    for command in (("data", "info"), ("eval", "--model", "idm", "--data")):
        run = run_main(*command, data)
        assert run.code == 2 and said in run.err


def test_each_town_has_its_own_splits() -> None:
    assert (find_town("mini@2").name, find_town("mini@1").name) == ("mini", FIRST_TOWN)
    assert read_newest_split(FIRST_TOWN).name == "mini-adv-3"
    for name in FIRST_SPLITS:
        require_town(read_frozen_split(name), FIRST_TOWN)
        with pytest.raises(InputError, match=f"split {name} .* than mini; give --data mini@1"):
            require_town(read_frozen_split(name), "mini")
    # Of other data nothing is claimed.
    require_town(read_frozen_split("mini-adv-1"), "nuscenes")
    run = run_main("generate", "--from", "mini-adv-3", "--dry-run")
    assert run.code == 2 and "give --data mini@1" in run.err


def test_a_split_of_the_current_town_is_none_of_the_first() -> None:
    named = read_frozen_split("mini-adv-3")
    other = named.frozen.recordings.model_copy(update={"fingerprint": "a" * 64})
    newer = replace(named, frozen=named.frozen.model_copy(update={"recordings": other}))
    require_town(newer, "mini")
    with pytest.raises(InputError, match=r"give --data mini$"):
        require_town(newer, FIRST_TOWN)
    # Files and packages may come from anywhere.
    require_town(replace(newer, path=Path("mine.json")), FIRST_TOWN)
    require_town(replace(newer, name="mine"), FIRST_TOWN)


def test_what_is_made_from_it_says_what_it_said(tmp_path: Path) -> None:
    town, split = write_first_town(tmp_path / "town", 0), read_frozen_split("mini-adv-3")
    one = next(scene.name for scene in split.frozen.scenes if scene.source == "scene-8000")
    report = build_frozen(town, split, replace(BUILT, out=tmp_path / "adv", renderer=None, scenes=(one,)))
    assert report.other_tables == ()
    assert (open_data(tmp_path / "adv").provenance() or {})["source"]["name"] == "mini"


def test_records_of_the_town_that_was_mini_are_judged_on_it(tmp_path: Path) -> None:
    town, other, runs = write_first_town(tmp_path / "town", 0), recordings(tmp_path / "other"), tmp_path / "runs"
    evaluate(open_data(town.root, name="mini"), "val", planner_factory("constant-velocity"), runs)
    evaluate(open_data(other.root, name="mini"), "val", planner_factory("stop"), runs)
    said = [result.sentence for result in rescore_all(runs, lambda _: town, FIRST_TOWN, STANDARD)]
    assert said[0] == "current" and said[1].startswith("skipped: ")
    failed = list(rescore_all(runs, lambda _: other, "mini", STANDARD))
    assert [result.failed for result in failed] == [True, False]
    assert "before, mini was what --data mini@1 is now" in failed[0].sentence


def test_names_without_a_version_stay_as_they_are() -> None:
    assert list(map(strip_version, ("mini@1", "mini", "demo", "a@1", "mini@x"))) == [
        "mini",
        "mini",
        "demo",
        "a@1",
        "mini@x",
    ]
