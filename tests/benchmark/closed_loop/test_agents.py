"""Policies keep their contract; IDM keeps its distance."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest

from benchmark.closed_loop.agent_policy import AgentMotion, TrafficSnapshot, check_policy
from benchmark.closed_loop.idm_policy import IdmPolicy
from benchmark.closed_loop.simulation_config import build_log_replay, build_simulation_config
from benchmark.closed_loop.stepping import begin_simulation, step
from benchmark.closed_loop.track_replay import TrackReplay
from benchmark.closed_loop.world_state import WorldState
from tests.benchmark.closed_loop.made import course, driven, idm_of, straight, town_scene
from tests.hand_made import Car, scene_on_straight_road


def moving(worlds: list[WorldState], agent: int) -> tuple[Any, Any]:
    """x and y of an agent at all planning instants."""
    boxes = np.array([world.others.boxes[agent] for world in worlds])
    return boxes[:, 0], boxes[:, 1]


def test_both_policies_keep_the_contract() -> None:
    scene = town_scene(0)
    made = build_simulation_config(scene)
    for policy in (made.policy, idm_of(scene, made)):
        check_policy(policy, begin_simulation(made).others, steps=8)


def test_replayed_agents_are_where_their_tracks_are_and_gone_after_them() -> None:
    scene = scene_on_straight_road((Car(80.0, 198.25, 6.0),), seconds=4.0)
    made = build_simulation_config(scene, duration_s=6.0)
    worlds = driven(made, straight(2.0), 12)
    assert moving(worlds[:8], 0)[0] == pytest.approx(80.0 + 6.0 * 0.5 * np.arange(8), abs=1e-5)
    assert [bool(world.others.present[0]) for world in worlds] == [time < 3.92 for time in 0.5 * np.arange(13)]
    assert worlds[3].others.velocity[0] == pytest.approx([6.0, 0.0], abs=1e-5)


def test_an_idm_agent_alone_takes_up_its_free_speed() -> None:
    worlds = driven(course(Car(120.0, 194.75, 6.0), idm=True, seconds=20.0), np.zeros((6, 2)), 30)
    x, y = moving(worlds, 0)
    speeds = np.diff(x) / 0.5
    assert (np.diff(speeds) >= -1e-6).all() and 9.0 < speeds[-1] <= 10.0 and np.ptp(y) < 1e-6


def test_an_idm_agent_stops_behind_an_ego_that_stands_and_a_replayed_one_does_not() -> None:
    cars = (Car(10.0, 198.25, 8.0),)
    for idm in (True, False):
        made = course(*cars, idm=idm, seconds=12.0)
        made = replace(made, start=replace(made.start, speed=0.0))
        worlds = driven(made, np.zeros((6, 2)), 22)
        assert (worlds[-1].contact is None) is idm
        if idm:
            gap = worlds[-1].others.ego[0] - 4.084 / 2 - worlds[-1].others.boxes[0, 0] - 2.3
            assert 0.5 < gap < 4.0 and np.hypot(*worlds[-1].others.velocity[0]) < 0.3


def test_an_idm_agent_follows_a_slower_one() -> None:
    worlds = driven(course(Car(60.0, 194.75, 10.0), Car(80.0, 194.75, 4.0), idm=True, seconds=20.0), straight(1.0), 36)
    gap = worlds[-1].others.boxes[1, 0] - worlds[-1].others.boxes[0, 0] - 4.6
    assert 5.0 < gap < 30.0
    assert all(world.others.boxes[1, 0] - world.others.boxes[0, 0] > 4.6 for world in worlds)


def test_an_idm_agent_drives_on_where_its_recording_ends() -> None:
    made = course(Car(60.0, 194.75, 8.0), idm=True, seconds=4.0, duration_s=8.0)
    worlds = driven(made, straight(1.0), 14)
    x, y = moving(worlds, 0)
    assert (
        worlds[-1].others.present[0] and x[-1] > 60.0 + 8.0 * 6.5 and y == pytest.approx(np.full(15, 194.75), abs=0.3)
    )


def test_parked_cars_and_people_do_what_their_tracks_say() -> None:
    walker = Car(100.0, 190.0, 1.2, np.pi / 2, "human.pedestrian.adult", (0.7, 0.7, 1.7))
    made = course(Car(120.0, 194.75), walker, idm=True)
    assert isinstance(made.policy, IdmPolicy) and not len(made.policy.driving)
    worlds = driven(made, straight(1.0), 6)
    assert moving(worlds, 0)[0] == pytest.approx(np.full(7, 120.0))
    assert moving(worlds, 1)[1] == pytest.approx(190.0 + 0.6 * np.arange(7), abs=1e-5)


def test_who_comes_later_drives_from_where_it_comes() -> None:
    scene = scene_on_straight_road((Car(60.0, 194.75, 8.0),), seconds=8.0)
    valid = scene.agents.valid.copy()
    valid[:, :24] = False
    scene = replace(scene, agents=replace(scene.agents, valid=valid))
    made = build_simulation_config(scene)
    worlds = driven(replace(made, policy=idm_of(scene, made)), straight(1.0), 10)
    assert [bool(world.others.present[0]) for world in worlds] == [number >= 4 for number in range(11)]
    x, _ = moving(worlds, 0)
    assert x[4] == pytest.approx(76.0, abs=0.01) and x[8] > 76.0 + 15.0


def test_an_empty_road_is_a_road() -> None:
    for idm in (False, True):
        made = course(idm=idm)
        world = step(made, begin_simulation(made), straight(8.0))
        assert world.contact is None and world.others.boxes.shape == (0, 5)


@dataclass
class Hidden:
    """A policy whose memory is an attribute."""

    replay: TrackReplay
    calls: list[int] = field(default_factory=list)
    name: str = "hidden"
    draws: bool = False

    def init(self, time_us: int, key: int) -> tuple[None, AgentMotion]:
        return self.replay.init(time_us, key)

    def act(self, memory: None, moment: TrafficSnapshot, key: int) -> tuple[None, AgentMotion]:
        self.calls.append(key)
        _, moved = self.replay.act(memory, moment, key)
        return None, replace(moved, velocity=moved.velocity + len(self.calls))


class Meddling(Hidden):
    """A policy that changes what it is given."""

    def act(self, memory: None, moment: TrafficSnapshot, key: int) -> tuple[None, AgentMotion]:
        moment.boxes[:, 0] += 1.0
        return self.replay.act(memory, moment, key)


class Short(Hidden):
    """A policy that forgets one instant."""

    def act(self, memory: None, moment: TrafficSnapshot, key: int) -> tuple[None, AgentMotion]:
        _, moved = self.replay.act(memory, moment, key)
        return None, AgentMotion(moved.boxes[:1], moved.present[:1], moved.velocity)


@pytest.mark.parametrize(
    ("policy", "says"),
    [(Hidden, "memory"), (Meddling, "modifies its arguments; copy them first"), (Short, "2 instants")],
)
def test_a_policy_that_breaks_the_contract_is_told_how(policy: type[Hidden], says: str) -> None:
    scene = scene_on_straight_road()
    made = build_simulation_config(scene)
    replay = build_log_replay(scene, made.start_us, made.end_us)
    copied = replace(replay, boxes=replay.boxes.copy())
    with pytest.raises(ValueError, match=says):
        check_policy(policy(copied), begin_simulation(made).others)


def test_courses_are_named_by_what_is_measured() -> None:
    assert course().name == "default replay" and course(idm=True, latency_us=200_000).name == "default idm +200 ms"
