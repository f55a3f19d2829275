"""Drives side by side: faster, and the same bytes as one after the other."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.registry import planner_factory
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.episodes import run_episode, run_episodes
from benchmark.closed_loop.simulation_state import SimulatorBackend
from benchmark.errors import InputError
from benchmark.machine.workers import LocalProcesses
from benchmark.planning import Observation, Plan, Planner
from benchmark.records.drives import DriveRecord
from benchmark.records.run_schema import PlannerFacts
from benchmark.runs.driving import DriveSettings, drive_planners, drive_split
from tests.benchmark.cli.cli_runs import bytes_below
from tests.benchmark.closed_loop.staged import Watching, staged
from tests.benchmark.fake_data import FakeData
from tests.benchmark.planners import Factory, Failing, Straight
from tests.benchmark.runs.test_driving import Reading, town
from tests.hand_made import Car, scene_on_straight_road

REPLAY = DriveSettings("default", DefaultBackend())
WORLDS = {
    "replay": REPLAY,
    "idm": replace(REPLAY, agents="idm", maker=DefaultBackend("idm")),
    "late": replace(REPLAY, latency_ms=300, maker=DefaultBackend(latency_us=300_000)),
}
"""Those of extensions are asked the same where their tests are."""
PLANNERS = [planner_factory(name) for name in ("stop", "idm")]
FAILING: Any = Factory(Failing, facts=PlannerFacts(name="failing", privileged=False))


def driven(out: Path, settings: DriveSettings, planners: Any = PLANNERS, data: Any = None) -> list[DriveRecord]:
    return drive_planners(data or town(), "val", planners, out, settings, reopen=town)


@pytest.mark.parametrize("settings", WORLDS.values(), ids=WORLDS)
def test_the_grouping_changes_no_byte(settings: DriveSettings, tmp_path: Path) -> None:
    for planner in [*PLANNERS, FAILING]:
        drive_split(town(), "val", planner, tmp_path / "alone", settings, reopen=town)
    alone = bytes_below(tmp_path / "alone")
    assert len(list((tmp_path / "alone").rglob("drives.jsonl"))) == 3
    # Two scenes of three planners: in fours across scenes, and all at once.
    for together in (4, 6) if settings is REPLAY else (4,):
        records = driven(tmp_path / str(together), replace(settings, together=together), [*PLANNERS, FAILING])
        assert [record.planner for record in records] == [*(each.name for each in PLANNERS), "failing"]
        assert bytes_below(tmp_path / str(together)) == alone


def test_one_process_and_two_give_the_same_bytes(tmp_path: Path) -> None:
    for workers in (1, 2):
        settings = replace(REPLAY, together=8, executor=LocalProcesses(workers))
        driven(tmp_path / str(workers), settings)
    assert bytes_below(tmp_path / "1") == bytes_below(tmp_path / "2")


class Dying(Straight):
    """The user interrupts in its second scene."""

    def plan(self, observation: Observation) -> Plan:
        if observation.scene == "scene-9902" and observation.index == 4:
            raise KeyboardInterrupt
        return super().plan(observation)


def test_what_was_finished_before_an_interruption_is_not_driven_again(tmp_path: Path) -> None:
    facts = PlannerFacts(name="made", privileged=False)
    whole = driven(tmp_path / "whole", REPLAY, [PLANNERS[0], Factory(Straight, facts=facts)])
    settings = replace(REPLAY, together=2)
    with pytest.raises(KeyboardInterrupt):
        driven(tmp_path / "cut", settings, [PLANNERS[0], Factory(Dying, facts=facts)])
    assert not list((tmp_path / "cut").rglob("drive.json"))
    data = Reading(town().scenes)
    resumed = driven(tmp_path / "cut", settings, [PLANNERS[0], Factory(Straight, facts=facts)], data)
    assert resumed[0].rows == whole[0].rows and resumed[1].rows == whole[1].rows
    assert bytes_below(tmp_path / "cut") == bytes_below(tmp_path / "whole")
    # Once, for what the record says of it.
    assert data.read.count("scene-9901") == 1


def test_a_scene_that_cannot_be_driven_costs_the_others_nothing(tmp_path: Path) -> None:
    short = replace(scene_on_straight_road((), seconds=1.5), name="scene-9900")
    data = FakeData({"scene-9900": short, **town().scenes})
    with pytest.raises(InputError, match="scene-9900 has 3 keyframes"):
        driven(tmp_path, replace(REPLAY, together=20), PLANNERS[:2], data)
    kept = sorted(path.name for path in tmp_path.rglob("*-0.json"))
    assert kept == ["scene-9901-0.json"] * 2 + ["scene-9902-0.json"] * 2


class Faulty(Watching):
    """Raises, or answers what nobody can drive, at its fifth plan."""

    def __init__(self, fault: str = "") -> None:
        super().__init__()
        self._find_failure = fault

    def plan(self, observation: Observation) -> Plan:
        plan = super().plan(observation)
        if len(self.seen) == 5 and self._find_failure == "raises":
            raise RuntimeError("no idea")
        if len(self.seen) == 5 and self._find_failure == "far away":
            return replace(plan, waypoints=np.full((6, 2), 1e5))
        return plan


@pytest.mark.parametrize("maker", [DefaultBackend(), DefaultBackend("idm", 200_000)])
def test_a_planner_that_fails_takes_nobody_with_it(maker: SimulatorBackend) -> None:
    scene = scene_on_straight_road((Car(120.0, 198.25, 3.0),), seconds=8.0)
    planners: list[Planner] = [Faulty(), Faulty("raises"), Faulty(), Faulty("far away")]
    found = dict(run_episodes([staged(scene, maker) for _ in planners], planners))
    assert sorted(found) == [0, 1, 2, 3]
    assert [found[place].failure is None for place in range(4)] == [True, False, True, False]
    alone = run_episode(staged(scene, maker), Faulty())
    for place in (0, 2):
        assert found[place].motion.ego.tobytes() == alone.motion.ego.tobytes() and found[place].end == alone.end


def test_one_planner_never_drives_two_scenes_at_once(tmp_path: Path) -> None:
    record = drive_split(town(), "val", Straight(), tmp_path, replace(REPLAY, together=9))
    assert len(record.rows) == 2
    with pytest.raises(InputError, match="at least 1"):
        driven(tmp_path, replace(REPLAY, together=0))
