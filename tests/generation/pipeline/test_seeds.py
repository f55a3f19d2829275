"""Splits of several seeds: each a root of its own, the same scenes that one seed alone gives, frozen and rebuilt."""

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

import benchmark
from benchmark.datasets.roots import DataSet, open_data
from benchmark.errors import InputError
from benchmark.evaluation import evaluate
from benchmark.machine.workspace import Workspace
from benchmark.records.run import RunRecord
from benchmark.records.seed_splits import format_seed_split, is_adversarial, parse_seed
from generation.pipeline.split import build_split
from generation.splits.building import build_frozen
from generation.splits.packaged import format_seed_path, parse_seeds, read_frozen_of_seed
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.contents import drawn_seeds_table
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.cli.in_process import run_here
from tests.generation.labels.recorded_roads import CHEAP, write_source
from tests.generation.pipeline.test_split import few_cars

SEEDS = (0, 1)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    root = tmp_path_factory.mktemp("recorded")
    return write_source(root, few_cars("scene-9901", 10.0), few_cars("scene-9902", 2.0))


@pytest.fixture(scope="module")
def space(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> Workspace:
    """Two seeds, frozen as well."""
    made = Workspace(tmp_path_factory.mktemp("seeds"))
    for seed in SEEDS:
        root = made.split_root(source.name, format_seed_split(seed))
        freeze = format_seed_path(made.out / "road.json", seed)
        build_split(source, format_seed_split(seed), replace(CHEAP, out=root, seed=seed, freeze=freeze))
    return made


def run_on(space: Workspace, source: DataSet, seed: int) -> RunRecord:
    split = format_seed_split(seed)
    return evaluate(
        space.open_split(source, split), split, benchmark.load_planner("constant-velocity"), space.run_root()
    )


def test_names_of_splits_are_those_of_their_seeds() -> None:
    assert [parse_seed(format_seed_split(seed)) for seed in (0, 7, 10**17)] == [0, 7, 10**17]
    for name in ("adv", "adv-seed-", "adv-seed-01", "adv-seed-1x", "val-seed-1", "adv-seed--1"):
        assert parse_seed(name) is None, name
    assert is_adversarial("adv") and is_adversarial("adv-seed-3") and not is_adversarial("val-r")


def test_a_split_of_a_seed_has_the_scenes_that_the_seed_alone_gives(
    source: DataSet, space: Workspace, tmp_path: Path
) -> None:
    alone = build_split(source, "adv", replace(CHEAP, out=tmp_path / "out", seed=1))
    own = open_data(space.split_root(source.name, "adv-seed-1"))
    assert own.scene_names("adv-seed-1") == tuple(sorted(alone.written))
    name = alone.written[0]
    one, other = own.scene(name), open_data(tmp_path / "out").scene(name)
    assert (one.agents.position == other.agents.position).all()
    with pytest.raises(InputError, match="no split 'adv'"):
        own.scene_names("adv")


def test_records_name_seed_and_search_and_stand_in_one_table(source: DataSet, space: Workspace) -> None:
    records = [run_on(space, source, seed) for seed in SEEDS]
    made = [record.run.generated for record in records]
    assert [None if facts is None else facts.seed for facts in made] == list(SEEDS)
    hashes = {None if facts is None else facts.search for facts in made}
    assert len(hashes) == 1 and hashes != {None}
    table = drawn_seeds_table(DataSetRuns(source.name, records), "exact")
    assert table is not None and [row[2] for row in table.rows] == ["0", "1", "all"]


def test_a_seed_under_the_name_of_another_is_refused(source: DataSet, space: Workspace, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="searched with seed 2, so it is not adv-seed-1; build it as adv-seed-2"):
        build_split(source, "adv-seed-1", replace(CHEAP, out=tmp_path / "out", seed=2))
    named = read_frozen_of_seed(space.out / "road.json", 1)
    with pytest.raises(InputError, match="so it is not adv-seed-0"):
        build_frozen(source, named, replace(CHEAP, out=tmp_path / "out"), as_split="adv-seed-0")
    (tmp_path / "wrong-seed-0.json").write_bytes(format_seed_path(space.out / "road.json", 1).read_bytes())
    with pytest.raises(InputError, match="was searched with seed 1"):
        read_frozen_of_seed(tmp_path / "wrong.json", 0)


def test_frozen_splits_of_seeds_are_rebuilt_as_what_they_were(
    source: DataSet, space: Workspace, tmp_path: Path
) -> None:
    rebuilt = Workspace(tmp_path)
    for seed in SEEDS:
        named = read_frozen_of_seed(space.out / "road.json", seed)
        settings = replace(CHEAP, out=rebuilt.split_root(source.name, format_seed_split(seed)))
        report = build_frozen(source, named, settings, as_split=format_seed_split(seed))
        assert report.other_tables == () and report.split == format_seed_split(seed)
    records = [run_on(rebuilt, source, seed) for seed in SEEDS]
    assert drawn_seeds_table(DataSetRuns(source.name, records), "exact") is not None
    searched = run_on(space, source, 0).run.generated
    assert records[0].run.generated == searched and records[0].run.frozen_split == "road-seed-0"


@pytest.mark.parametrize("text", ["", "1", "0,0", "0,-1", "0,1.5", "0,01", "a,b", "0,", f"0,{10**19}"])
def test_seeds_are_two_or_more_different_whole_numbers(text: str) -> None:
    with pytest.raises(InputError, match="such as 0,1,2"):
        parse_seeds(text)


def test_the_command_refuses_what_contradicts_itself(source: DataSet, tmp_path: Path) -> None:
    refused = partial(refusal, "generate", "--data", source.root, "--out", tmp_path / "out")
    assert "--seed and --seeds exclude" in refused("--seeds", "0,1", "--seed", "1")
    assert "leave --split out" in refused("--seeds", "0,1", "--split", "val-r")
    assert "no file" in refused("--seeds", "0,1", "--from", tmp_path / "town.json")
    assert "generate --data" in (said := refusal(
        "eval", "--data", source.root, "--split", "adv-seed-3", "--model", "idm", "--out", tmp_path / "out"
    )) and "--seeds 3,4" in said  # fmt: skip
    assert "--seeds 3,4" in refusal("eval", "--split", "adv-seed-3", "--model", "idm", "--out", tmp_path / "out")


def test_the_command_builds_one_root_for_each_seed(source: DataSet, tmp_path: Path) -> None:
    options = ("--data", source.root, "--out", tmp_path, "--renderer", "none", "--seeds", "0,1", "--json")
    quick = ("--candidates", "16", "--rounds", "1", "--vehicles", "1", "--dry-run")
    done = run_here("generate", *options, *quick)
    assert done.code == 0, done.err
    said = [(each["split"], each["dry_run"]) for each in json.loads(done.out)]
    assert said == [("adv-seed-0", True), ("adv-seed-1", True)]
