"""A build in shards has the bytes of one that was never cut; what is missing, damaged or of other options is made."""

import json
import multiprocessing
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.runs.units import Shard
from generation.pipeline import shards as sharded
from generation.pipeline.settings import BuildSettings
from generation.pipeline.shards import build_shard, draw_frozen_shard
from generation.pipeline.split import NothingSurvivedError, build_split
from generation.pipeline.surrogate import PlannerUnderTest
from generation.search.hyperparameters import HyperParameters
from generation.splits.building import build_frozen
from generation.splits.packaged import NamedSplit, read_frozen_split
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.planners import Factory
from tests.generation.labels.recorded_roads import CHEAP as DEAR
from tests.generation.labels.recorded_roads import contents, recorded, write_source
from tests.generation.splits.frozen_files import FrontRenderer
from tests.hand_made import Car

CHEAP = replace(DEAR, hyper=HyperParameters(candidates=4, rounds=0, tries=1))
DRAWN = replace(CHEAP, renderer=FrontRenderer(48, 32), frames="keyframes", keep_rounds=True, limit=2)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    ahead = {"scene-9901": 10.0, "scene-9902": 2.0, "scene-9903": 6.0}
    roads = [recorded(name, (Car(52.0 + ahead_m, 194.75, 9.0),)) for name, ahead_m in ahead.items()]
    return write_source(tmp_path_factory.mktemp("recorded"), *roads)


@pytest.fixture(scope="module")
def whole(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("whole") / "adv"
    build_split(source, "adv", replace(CHEAP, out=out))
    return out


def shards(
    source: DataSet, settings: BuildSettings, of: int, split: str = "adv", numbers: Sequence[int] | None = None
) -> list[str]:
    """What each of the shards did; no two of them, nor one twice, write the same file."""
    did: list[str] = []
    written = written_below(settings.out)
    for number in numbers or range(1, of + 1):
        did.append(build_shard(source, split, settings, Shard(number, of)).did)
        now = written_below(settings.out)
        assert written.items() <= now.items()
        written = now
    assert not list(settings.out.glob("*/challenger.json"))
    return did


def written_below(out: Path) -> dict[Path, tuple[int, int]]:
    """Every file with what changes when it is written again."""
    files = [path for path in out.rglob("*") if path.is_file()]
    return {path: (path.stat().st_ino, path.stat().st_mtime_ns) for path in files}


@pytest.mark.parametrize(("of", "draw"), [(3, 0), (2, 3)])
def test_shards_become_the_bytes_of_a_build_that_was_never_cut(
    source: DataSet, whole: Path, tmp_path: Path, of: int, draw: int
) -> None:
    settings = replace(CHEAP, out=tmp_path / "adv")
    assert shards(source, settings, of, numbers=range(of, 0, -1)) == ["searched"] * of
    if draw:
        assert shards(source, settings, draw) == ["drawn"] * draw
    before = written_below(settings.out)
    build_split(source, "adv", settings)
    kept = [path for path in before if path.parent.name in ("attempts", "fragments")]
    assert kept and all(written_below(settings.out)[path] == before[path] for path in kept)
    assert contents(settings.out) == contents(whole)
    assert folders(settings.out) == folders(whole)


def folders(root: Path) -> set[Path]:
    return {path.relative_to(root) for path in root.rglob("*") if path.is_dir()}


def test_several_adversaries_and_a_choice_of_the_best_can_be_cut(tmp_path: Path) -> None:
    cars = Car(62.0, 194.75, 9.0), Car(45.0, 201.75, 8.0)
    source = write_source(tmp_path / "recorded", recorded("scene-9901", cars), recorded("scene-9902", cars))
    wanted = replace(CHEAP, adversaries=2, total=1)
    build_split(source, "adv", replace(wanted, out=tmp_path / "whole"))
    settings = replace(wanted, out=tmp_path / "cut")
    assert shards(source, settings, 2) == ["searched", "searched"]
    assert shards(source, settings, 2) == ["drawn", "drawn"]
    build_split(source, "adv", settings)
    assert contents(tmp_path / "cut") == contents(tmp_path / "whole")


def test_originals_are_drawn_in_shards_at_once(source: DataSet, tmp_path: Path) -> None:
    build_split(source, "val-r", replace(DRAWN, out=tmp_path / "whole"))
    settings = replace(DRAWN, out=tmp_path / "cut")
    assert shards(source, settings, 2, "val-r", [2]) == ["drawn"]
    assert shards(source, settings, 2, "val-r", [1]) == ["drawn"]
    build_split(source, "val-r", settings)
    assert contents(tmp_path / "cut") == contents(tmp_path / "whole")


def test_a_frozen_split_is_drawn_in_shards(source: DataSet, tmp_path: Path) -> None:
    file = tmp_path / "frozen.json"
    build_split(source, "adv", replace(CHEAP, out=tmp_path / "searched", limit=2, freeze=file))
    split: NamedSplit = read_frozen_split(file)
    build_frozen(source, split, replace(CHEAP, out=tmp_path / "whole"))
    settings = replace(CHEAP, out=tmp_path / "cut")
    draw_frozen_shard(source, split, settings, Shard(2, 2))
    draw_frozen_shard(source, split, replace(settings, frames="keyframes"), Shard(1, 2))
    build_frozen(source, split, settings)
    assert contents(tmp_path / "cut") == contents(tmp_path / "whole")


def both_at_once(root: Path, settings: BuildSettings, number: int) -> str:
    return build_shard(open_data(root), "adv", settings, Shard(number, 2)).did


def test_two_shards_at_once_do_not_disturb_each_other(source: DataSet, whole: Path, tmp_path: Path) -> None:
    settings = replace(CHEAP, out=tmp_path / "adv")
    with multiprocessing.get_context("forkserver").Pool(2) as pool:
        for did in ("searched", "drawn"):
            work = [(source.root, settings, number) for number in (1, 2)]
            assert pool.starmap(both_at_once, work, chunksize=1) == [did, did]
    build_split(source, "adv", settings)
    assert contents(settings.out) == contents(whole)


def test_a_shard_that_was_killed_goes_on(
    source: DataSet, whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = replace(CHEAP, out=tmp_path / "adv")

    def killed(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    for step in ("run_search", "write_scenes"):
        shards(source, settings, 2, numbers=[1])
        with monkeypatch.context() as patched, pytest.raises(KeyboardInterrupt):
            patched.setattr(sharded, step, killed)
            build_shard(source, "adv", settings, Shard(2, 2))
        shards(source, settings, 2, numbers=[2])
    build_split(source, "adv", settings)
    assert contents(settings.out) == contents(whole)


def test_what_is_damaged_is_made_again(source: DataSet, whole: Path, tmp_path: Path) -> None:
    settings = replace(CHEAP, out=tmp_path / "adv")
    shards(source, settings, 3)
    attempts = sorted((settings.out / ".challenger" / "attempts").iterdir())
    of_second = [path for path in attempts if '"scene-9902"' in path.read_text()]
    of_second[0].write_text(of_second[0].read_text()[:-9])
    assert build_shard(source, "adv", settings, Shard(2, 3)).did == "searched"
    assert shards(source, settings, 3) == ["drawn"] * 3
    of_second[0].unlink()
    fragment = next(iter((settings.out / ".challenger" / "fragments").iterdir()))
    fragment.write_text(fragment.read_text()[:-9])
    build_split(source, "adv", settings)
    assert contents(settings.out) == contents(whole)


def test_shards_of_other_options_are_not_taken_for_these(source: DataSet, whole: Path, tmp_path: Path) -> None:
    settings = replace(CHEAP, out=tmp_path / "adv")
    shards(source, replace(settings, seed=1), 2)
    assert shards(source, settings, 2) == ["searched"] * 2
    assert shards(source, replace(settings, frames="keyframes"), 2) == ["drawn"] * 2
    assert build_shard(source, "adv", settings, Shard(1, 2)).did == "drawn"
    build_split(source, "adv", settings)
    tables = {name: held for name, held in contents(settings.out).items() if ".challenger" not in str(name)}
    assert tables == {name: held for name, held in contents(whole).items() if ".challenger" not in str(name)}


def test_shards_that_find_nothing_end_as_a_build_does(source: DataSet, tmp_path: Path) -> None:
    nothing = replace(CHEAP, out=tmp_path / "cut", hyper=replace(CHEAP.hyper, close_gap_m=0.0))
    with pytest.raises(NothingSurvivedError):
        build_split(source, "adv", replace(nothing, out=tmp_path / "whole"))
    assert shards(source, nothing, 2) == ["searched"] * 2
    assert shards(source, nothing, 2) == ["drawn"] * 2
    with pytest.raises(NothingSurvivedError):
        build_split(source, "adv", nothing)
    assert contents(tmp_path / "cut") == contents(tmp_path / "whole")


def test_a_shard_draws_into_nobody_elses_data_set(source: DataSet, tmp_path: Path) -> None:
    theirs = write_source(tmp_path / "theirs", recorded("scene-9909")).root
    shutil.rmtree(theirs / ".challenger")
    before = contents(theirs)
    with pytest.raises(InputError, match="holds a foreign data set"):
        build_shard(source, "val-r", replace(CHEAP, out=theirs), Shard(1, 2))
    assert contents(theirs) == before and not (theirs / ".challenger").exists()


def test_a_surrogate_needs_all_scenes_together(source: DataSet, tmp_path: Path) -> None:
    settings = replace(CHEAP, out=tmp_path / "adv", surrogate=PlannerUnderTest(Factory(), images=False))
    with pytest.raises(InputError, match="a surrogate needs all scenes together"):
        build_shard(source, "adv", settings, Shard(1, 2))
    assert not settings.out.exists()


def test_the_command_searches_draws_and_finishes(source: DataSet, tmp_path: Path) -> None:
    given = ("--data", source.root, "--workers", "1", "--out", tmp_path)
    cheap = ("--renderer", "none", "--frames", "keyframes")
    search = ("generate", *given, *cheap, "--limit", "1", "--vehicles", "1", "--candidates", "4", "--rounds", "0")
    done = run_here(*search, "--device", "cpu", "--shard", "1/2", "--json")
    assert done.code == 0 and [each["searched"] for each in json.loads(done.out)] == [1], done.err
    originals = ("generate", "--split", "val-r", *given, *cheap)
    drawn = run_here(*originals, "--shard", "1/2")
    assert drawn.code == 0 and "shard 1/2, 2 of 3 scenes drawn" in drawn.out and "once all shards are done" in drawn.err
    assert run_here(*originals, "--shard", "2/2").code == 0
    assert run_here(*originals).code == 0
    assert len(open_data(tmp_path / "data" / source.name / "val-r").scene_names("val-r")) == 3
