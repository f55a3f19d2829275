"""On the embedded data set, split ``adv`` is what was generated below ``--out``, else the newest frozen split."""

import subprocess
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from adapters.registry import planner_factory
from benchmark import api
from benchmark.errors import InputError
from benchmark.evaluation import evaluate
from benchmark.machine.storage import lock_folder
from benchmark.machine.workspace import is_finished
from benchmark.protocols import STANDARD
from benchmark.records.run import load_record
from benchmark.runs.rescoring import rescore_all
from generation.pipeline.split import build_split
from generation.search.hyperparameters import HyperParameters
from generation.sources import mini
from generation.sources.mini import TownSettings, build_town_data_set
from generation.splits.packaged import NamedSplit, read_newest_split
from tests.benchmark.cli.cli_runs import bytes_below
from tests.generation.sources.first_towns import list_numbers
from tests.generation.splits.frozen_files import BUILT

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(autouse=True)
def small(cache: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[NamedSplit]:
    """A town without cameras up to the first scene of its newest frozen split, of which that scene is left."""
    newest = read_newest_split("mini")
    one = min(newest.frozen.scenes, key=lambda scene: scene.name)
    few = NamedSplit("mini-adv-7", newest.frozen.model_copy(update={"scenes": (one,)}))
    count = list_numbers(few)[0] + 1
    monkeypatch.setattr("generation.sources.mini.TownSettings", partial(TownSettings, val_scenes=count, images=False))
    monkeypatch.setattr("generation.splits.cached.read_newest_split", lambda *_: few)
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(cache))
    yield few


def no_search(*_: object, **__: object) -> None:
    raise AssertionError("somebody searches")


def test_it_is_built_into_the_cache_without_a_search_and_the_record_says_so(
    small: NamedSplit, cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("generation.search.chains.search_chains", no_search)
    monkeypatch.setattr("generation.pipeline.split.search_chains", no_search)
    monkeypatch.setattr("generation.search.definition._load_prior", no_search)
    source = api.open_data("mini", workers=1)
    data = api.open_split(source, "adv", tmp_path / "out", workers=1)
    assert data.root.parent == cache and data.root.name.startswith("mini-adv-7-")
    assert data.scene_names("adv") == api.known_scenes("mini", "adv", tmp_path / "out")
    assert not (tmp_path / "out").exists()
    assert "building the frozen split mini-adv-7" in capsys.readouterr().err
    runs, planner = tmp_path / "out" / "runs", planner_factory("constant-velocity")
    assert load_record(evaluate(data, "adv", planner, runs).directory).run.frozen_split == "mini-adv-7"
    assert load_record(evaluate(source, "val", planner, runs).directory).run.frozen_split is None
    before = bytes_below(data.root)
    again = api.open_split(source, "adv", tmp_path / "out", workers=1)
    assert again.root == data.root and bytes_below(data.root) == before
    assert "is the frozen split mini-adv-7" in capsys.readouterr().err
    opener = partial(api.open_split, source, out=tmp_path / "out", workers=1)
    found = list(rescore_all(runs, opener, "mini", STANDARD))
    assert [result.sentence for result in found] == ["current", "current"]


def test_an_interrupted_build_goes_on_and_two_at_once_do_not_disturb_each_other(cache: Path, tmp_path: Path) -> None:
    source = api.open_data("mini", workers=1)
    root = api.open_split(source, "adv", tmp_path / "out", workers=1).root
    before = bytes_below(root)
    next(root.glob("*/challenger.json")).unlink()
    next(root.glob("*/sample.json")).unlink()
    with lock_folder(root), pytest.raises(InputError, match="another command is writing"):
        api.open_split(source, "adv", tmp_path / "out", workers=1)
    assert not is_finished(root)
    assert api.open_split(source, "adv", tmp_path / "out", workers=1).root == root
    assert bytes_below(root) == before


def test_what_was_generated_below_out_comes_first(tmp_path: Path) -> None:
    source = api.open_data("mini", workers=1)
    target = api.workspace(tmp_path).split_root("mini", "adv")
    hyper = HyperParameters(candidates=16, rounds=1)
    build_split(source, "adv", replace(BUILT, out=target, hyper=hyper, renderer=None))
    data = api.open_split(source, "adv", tmp_path, workers=1)
    assert data.root == target
    assert data.scene_names("adv") == api.known_scenes("mini", "adv", tmp_path)
    assert (data.provenance() or {}).get("frozen") is None


def test_scenes_of_other_splits_and_data_sets_are_not_known_without_opening_them(tmp_path: Path) -> None:
    assert api.known_scenes("mini", "val", tmp_path) is None
    assert api.known_scenes(tmp_path, "adv", tmp_path) is None


def test_names_are_known_without_torch_and_the_devkit() -> None:
    program = (
        "import sys, pathlib; from benchmark import api; "
        "assert len(api.known_scenes('mini@1', 'adv', pathlib.Path('/none'))) == 19; "
        "assert api.known_scenes('mini', 'adv', pathlib.Path('/none')); "
        "assert not {'torch', 'nuscenes'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", program], cwd=ROOT, check=True)


def test_samples_are_enough_unless_somebody_asks_for_more(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CHALLENGER_BENCH_CACHE", str(tmp_path / "cache"))
    town = build_town_data_set(
        api.workspace(tmp_path).split_root("demo", "val"), TownSettings(val_scenes=1, images=False), workers=1
    )
    asked: list[tuple[Path, TownSettings]] = []

    def noted(root: Path, settings: TownSettings, *, workers: int) -> Path:
        asked.append((root, settings))
        return town

    monkeypatch.setattr(mini, "build_town_data_set", noted)
    monkeypatch.setattr(mini, "TownSettings", TownSettings)
    for sweeps in (False, True):
        api.open_data("mini@1", sweeps=sweeps)
        api.open_data("demo", out=tmp_path, sweeps=sweeps)
    (first, few), (later, all_of_it), (demo, its_own) = asked
    assert first == later and (few.pictures, all_of_it.pictures) == ("keyframes", "all")
    assert demo == town and its_own == TownSettings(val_scenes=1)
