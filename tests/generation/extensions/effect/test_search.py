"""The search by effect from recordings to a root: families, panel, drop reasons, conflicts, and what tables say."""

import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmark.datasets.roots import DataSet, open_data
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine.workers import LocalProcesses
from benchmark.records.attempts import ATTEMPTS_FILE, read_attempts
from generation.pipeline.panel import PlannerPanel
from generation.pipeline.settings import BuildSettings
from generation.pipeline.split import build_split
from generation.search.hyperparameters import HyperParameters
from generation.search.threat_settings import CandidateProposal
from generation.splits.building import build_frozen
from generation.splits.packaged import read_frozen_split
from tests.generation.labels.recorded_roads import CHEAP, contents, recorded, write_source
from tests.generation.search.drivers import Drivers, SteadyDriver
from tests.hand_made import Car

RETIMED = HyperParameters(
    proposal=CandidateProposal.RETIMED, shortest_drive_frames=36, tries=4, behaviour=True, careful_survives=True
)
REROUTED = replace(RETIMED, proposal=CandidateProposal.REROUTED)


def make_steady(name: str, *, seed: int) -> SteadyDriver:
    """Seed 0 keeps the ego's speed, the other one runs into whoever is ahead."""
    return SteadyDriver(8.0 + 8.0 * seed)


PANEL = PlannerPanel((("steady", 2),), make_steady)
CARS = (Car(68.0, 198.25, 8.0), Car(95.0, 194.5, 0.0), Car(40.0, 201.75, 8.0))
SETTINGS = replace(CHEAP, hyper=RETIMED, further=(REROUTED,), panel=PANEL)


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> DataSet:
    return write_source(tmp_path_factory.mktemp("recorded"), recorded("scene-9901", CARS, seconds=13.0))


@pytest.fixture(scope="module")
def built(source: DataSet, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("effect") / "out"
    build_split(source, "adv", replace(SETTINGS, out=out, freeze=out.parent / "frozen.json"))
    return out


def read(path: Path) -> Any:
    return json.loads(path.read_text())


@pytest.mark.path
def test_both_families_are_tried_and_every_attempt_has_its_fate(source: DataSet, built: Path) -> None:
    attempts, report = read_attempts(built / ATTEMPTS_FILE), read(built / "report.json")
    assert len(attempts) == report["tried"] == 6
    assert report["survived"] >= len(report["written"]) >= 1
    kept = [attempt for attempt in attempts if attempt.kept]
    assert all((attempt.written is None) != (attempt.dropped is None) for attempt in kept)
    assert report["panel"]["members"] == {"steady": 2}
    assert len(report["panel"]["scenes"]) + report["panel"]["inert"] == report["survived"]
    assert Counter(report["dropped"])["touches-no-member-of-the-panel"] == report["panel"]["inert"]
    assert all(each["probability"] > 0 for each in report["panel"]["scenes"].values())


def test_search_json_has_the_settings_of_all_searches(built: Path) -> None:
    assert [hyper["proposal"] for hyper in read(built / "search.json")["further"]] == ["rerouted"]


def test_the_root_and_its_records_name_the_panel(built: Path, tmp_path: Path) -> None:
    made = read(built / CHEAP.version / "challenger.json")
    assert made["panel"] == "steady (seeds 0-1)"
    record = evaluate(open_data(built), "adv", Drivers(), tmp_path, EvalSettings(protocols=("exact",)))
    (caveat,) = (caveat for caveat in record.run.caveats or () if caveat.kind == "panel")
    assert caveat.sentence.endswith("steady (seeds 0-1), which is not held out")


def test_each_adversary_has_a_conflict(built: Path) -> None:
    scenes = read(built / CHEAP.version / "conflicts.json")["scenes"]
    assert sorted(scenes) == sorted(read(built / "report.json")["written"])
    assert all(len(conflicts) == 1 and "on the recording" in conflicts[0]["sentence"] for conflicts in scenes.values())


def test_workers_and_a_second_run_change_no_byte(source: DataSet, built: Path, tmp_path: Path) -> None:
    before = contents(built)
    build_split(source, "adv", replace(SETTINGS, out=built))
    assert contents(built) == before
    other = tmp_path / "out"
    build_split(source, "adv", replace(SETTINGS, out=other, executor=LocalProcesses(2)))
    assert contents(other) == before


def test_a_frozen_split_remembers_the_panel_and_is_rebuilt_with_its_conflicts(
    source: DataSet, built: Path, tmp_path: Path
) -> None:
    frozen = read_frozen_split(str(built.parent / "frozen.json"))
    assert frozen.frozen.chosen.panel == PANEL.sentence()
    build_frozen(source, frozen, BuildSettings(out=tmp_path / "out", version=CHEAP.version))
    rebuilt = tmp_path / "out" / CHEAP.version
    assert read(rebuilt / "challenger.json")["panel"] == PANEL.sentence()
    found, again = (read(root / "conflicts.json")["scenes"] for root in (built / CHEAP.version, rebuilt))
    assert {name: each[0]["first_now"] for name, each in found.items()} == {
        name: each[0]["first_now"] for name, each in again.items()
    }
