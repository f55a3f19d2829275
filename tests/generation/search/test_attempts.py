"""Attempts as units of work: found by content key, computed where missing."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.errors import InputError
from benchmark.machine.workers import LocalProcesses
from benchmark.scene import Scene
from generation.pipeline.estimate import build_runtime_table
from generation.search.attempts import (
    StoredAttempt,
    open_attempt_store,
    open_eligibility_store,
    read_cached_attempt,
    read_or_compute_eligibility,
    run_attempts,
)
from generation.search.definition import EarlierAdversary, PackagedPrior, Search, SearchUnit
from generation.search.presets import SampleSource, build_trajectory_model
from tests.executors import Forbidden
from tests.generation.labels.recorded_roads import HYPER, recorded
from tests.generation.search.driving_prior import DrivingPrior
from tests.generation.search.one_vehicle import choose

SCENE = recorded("scene-9901")


def search_in(folder: Path, seed: int = 0) -> Search:
    return Search("data", HYPER, seed, DrivingPrior, DrivingPrior.fingerprint, folder, folder / "timings")


UNITS = [SearchUnit(SCENE.name, agent, SCENE.agents.ids[agent]) for agent in choose(SCENE, HYPER, 0)]


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kept")


@pytest.fixture(scope="module")
def found(kept: Path) -> list[StoredAttempt]:
    return run_attempts(search_in(kept), UNITS, lambda unit: SCENE, LocalProcesses(1))


@pytest.fixture
def search(kept: Path, found: list[StoredAttempt], tmp_path: Path) -> Search:
    """In a copy of the folder that holds every attempt."""
    return search_in(Path(shutil.copytree(kept, tmp_path / "kept")))


def never(unit: SearchUnit) -> Scene:
    raise AssertionError(f"{unit} is finished and needs no scene")


def test_results_come_in_the_order_of_the_units_and_are_kept(search: Search, found: list[StoredAttempt]) -> None:
    assert [stored.report.agent for stored in found] == [unit.agent_id for unit in UNITS]
    assert run_attempts(search, UNITS, never, Forbidden()) == found
    assert [read_cached_attempt(search, unit) for unit in UNITS] == found


def path_of(search: Search, unit: SearchUnit) -> Path:
    return open_attempt_store(search).path(search.key(unit))


def damaged(data: bytes) -> bytes:
    """An attempt that is whole, but says something else."""
    return data.replace(b'"start":', b'"begin":').replace(b"0.1", b"0.2")


@pytest.mark.parametrize("damage", [damaged, lambda data: b"{"])
def test_only_missing_and_damaged_ones_are_computed(
    search: Search, found: list[StoredAttempt], damage: Callable[[bytes], bytes]
) -> None:
    path, asked = path_of(search, UNITS[1]), []
    whole = path.read_bytes()
    path.write_bytes(damage(whole))
    assert read_cached_attempt(search, UNITS[1]) is None

    def scene_of(unit: SearchUnit) -> Scene:
        asked.append(unit)
        return SCENE

    assert run_attempts(search, UNITS, scene_of, LocalProcesses(1)) == found
    assert asked == [UNITS[1]] and path.read_bytes() == whole


@pytest.mark.parametrize("together", [2, 50])
def test_units_side_by_side_are_as_alone(tmp_path: Path, found: list[StoredAttempt], together: int) -> None:
    run = run_attempts(search_in(tmp_path), UNITS, lambda unit: SCENE, LocalProcesses(1), together=together)
    assert run == found


def test_an_attempt_of_another_vehicle_is_not_taken(search: Search) -> None:
    path_of(search, UNITS[0]).write_bytes(path_of(search, UNITS[1]).read_bytes())
    assert read_cached_attempt(search, UNITS[0]) is None


def test_keys_tell_everything_apart_that_changes_a_result(tmp_path: Path) -> None:
    unit = SearchUnit("scene-9901", 0, "a")
    link = EarlierAdversary("key of the first", 1, "b", 12)
    search = search_in(tmp_path)
    keys = {
        search.key(unit),
        search.key(replace(unit, agent_id="b")),
        search.key(replace(unit, scene_name="scene-9902")),
        search.key(replace(unit, earlier=(link,))),
        search.key(replace(unit, earlier=(replace(link, key="another"),))),
        search.key(replace(unit, earlier=(link, replace(link, key="another")))),
        replace(search, seed=1).key(unit),
        replace(search, fingerprint="identify data").key(unit),
        replace(search, prior_fingerprint="other prior").key(unit),
        replace(search, hyper=replace(HYPER, rounds=1)).key(unit),
    }
    assert len(keys) == 10


def test_times_lie_beside_and_never_in_results(search: Search) -> None:
    table = build_runtime_table([search.timing_path(search.key(unit)) for unit in UNITS], [])
    assert table.attempts == len(UNITS)
    assert table.total_s["physics"] > 0.0
    stored = open_attempt_store(search).get(search.key(UNITS[0]))
    assert stored is not None and not any("seconds" in name for name in stored.report.as_json())


def test_vehicles_are_chosen_once(tmp_path: Path) -> None:
    search = search_in(tmp_path)

    def unread() -> Scene:
        raise AssertionError("the choice is there")

    chosen = open_eligibility_store(search).path(search.compute_eligibility_key(SCENE.name, ()))
    found = read_or_compute_eligibility(search, SCENE.name, (), lambda: SCENE, keep=False)
    assert not chosen.exists()
    assert read_or_compute_eligibility(search, SCENE.name, (), lambda: SCENE, keep=True) == found
    assert read_or_compute_eligibility(search, SCENE.name, (), unread, keep=True) == found
    chosen.write_text('{"objects": 1}')
    assert read_or_compute_eligibility(search, SCENE.name, (), lambda: SCENE, keep=True) == found


def test_a_track_does_not_fit_another_scene(found: list[StoredAttempt]) -> None:
    stored = found[0]
    assert stored.adversarial(SCENE).adversaries == (stored.report.agent,)
    for other in (recorded("scene-9902"), replace(SCENE, agents=recorded("scene-9903", ()).agents)):
        with pytest.raises(InputError, match="does not fit"):
            stored.adversarial(other)


def test_the_packaged_prior_is_loaded_once() -> None:
    assert PackagedPrior()() is PackagedPrior()()


def fresh_search(folder: Path, source: SampleSource = "fresh") -> Search:
    hyper = replace(HYPER, candidates=24, rounds=2, tries=1)
    model = build_trajectory_model(samples=source)
    return Search("data", hyper, 0, model, model().fingerprint, folder, folder / "timings")


def test_fresh_samples_give_the_same_bytes_with_any_number_of_workers(tmp_path: Path) -> None:
    units = UNITS[:3]
    one, two, side_by_side = (fresh_search(tmp_path / name) for name in ("one", "two", "together"))
    found = run_attempts(one, units, lambda unit: SCENE, LocalProcesses(1))
    assert run_attempts(two, units, lambda unit: SCENE, LocalProcesses(2)) == found
    assert run_attempts(side_by_side, units, lambda unit: SCENE, LocalProcesses(1), together=3) == found
    for unit in units:
        assert len({path_of(each, unit).read_bytes() for each in (one, two, side_by_side)}) == 1


def test_where_samples_come_from_is_recorded_and_part_of_the_key(tmp_path: Path) -> None:
    sources: tuple[SampleSource, ...] = ("fresh", "reference", "stored")
    searches = [fresh_search(tmp_path, source) for source in sources]
    said = [json.loads(json.dumps(search.as_json()))["sampler"]["samples"] for search in searches]
    assert said == list(sources)
    assert len({search.key(UNITS[0]) for search in searches}) == 3
    assert searches[0].key(UNITS[0]) == fresh_search(tmp_path / "elsewhere").key(UNITS[0])


def test_presets_that_follow_others_are_not_told_the_speed_and_draw_nothing_again() -> None:
    ours, theirs = build_trajectory_model().sampler, build_trajectory_model("paper").sampler
    assert (ours.samples.value, ours.conditioned, ours.drivable) == ("fresh", True, True)
    assert (theirs.samples.value, theirs.conditioned, theirs.drivable) == ("reference", False, False)
    assert build_trajectory_model("paper", samples="stored").sampler.samples.value == "stored"


def test_settings_that_occur_again_draw_by_the_next_seed(tmp_path: Path) -> None:
    first = replace(search_in(tmp_path, 5), further=(replace(HYPER, threat_weight=7.0), HYPER, HYPER))
    families = first.families
    assert [one.seed for one in families] == [5, 5, 6, 7] and all(not one.further for one in families)
    assert len({one.family for one in families}) == 4 and families[0].family == ""
    again = SearchUnit("scene", 0, "car", family=families[2].family)
    assert families[2].key(again) == replace(first, seed=6, further=()).key(replace(again, family=""))
