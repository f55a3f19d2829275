"""Drives: what ends them, how planners fail, who follows the route, and when a plan takes effect."""

import contextlib
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.planners.constant_velocity_on_path import ConstantVelocityOnPath
from adapters.planners.idm import IntelligentDriver
from adapters.planners.log_replay import LogReplay
from adapters.planners.stop import Stop
from benchmark.closed_loop.default_engine import PRIMING_STEPS, DefaultBackend
from benchmark.closed_loop.episodes import run_episode
from benchmark.closed_loop.planner_calls import FailureReason
from benchmark.closed_loop.route import Route
from benchmark.closed_loop.scoring import score_episode
from benchmark.closed_loop.simulation_state import SimulatorBackend
from benchmark.dynamics.lane_path import LanePath
from benchmark.errors import InputError
from benchmark.planning import CameraView, Observation, Plan
from benchmark.runs.plan_rows import BrokenImageError
from benchmark.scene import Scene
from tests.benchmark.closed_loop.made import town_scene
from tests.benchmark.closed_loop.staged import Watching, staged
from tests.hand_made import Car, scene_on_straight_road

MAKERS: list[SimulatorBackend] = [DefaultBackend()]
"""Engines of extensions are asked the same where their tests are."""


class Faulty(Watching):
    """Does something wrong at its fifth plan."""

    def __init__(self, fault: str) -> None:
        super().__init__()
        self._fault = fault

    def plan(self, observation: Observation) -> Any:
        plan = super().plan(observation)
        if len(self.seen) < 5:
            return plan
        match self._fault:
            case "raises":
                raise RuntimeError("no idea")
            case "exits":
                raise SystemExit(0)
            case "answers NaN":
                return replace(plan, waypoints=np.full((6, 2), np.nan))
            case "poisons":
                plan.waypoints[3, 1] = np.inf
            case "hangs":
                time.sleep(30.0)
            case "hangs and swallows":
                with contextlib.suppress(Exception):
                    time.sleep(30.0)
            case "answers nothing":
                return None
        return plan


FAULTS = [
    ("raises", FailureReason.RAISED, "no idea"),
    ("exits", FailureReason.RAISED, "SystemExit"),
    ("answers NaN", FailureReason.RAISED, "must be finite"),
    ("poisons", FailureReason.UNUSABLE, "NaN or infinity"),
    ("answers nothing", FailureReason.NO_PLAN, "NoneType"),
    ("hangs", FailureReason.TIMEOUT, "0.3 s"),
    ("hangs and swallows", FailureReason.TIMEOUT, "0.3 s"),
]


@pytest.mark.parametrize(("fault", "reason", "says"), FAULTS)
@pytest.mark.parametrize("maker", MAKERS)
def test_a_planner_that_fails_ends_the_drive_with_its_reason(
    maker: SimulatorBackend, fault: str, reason: FailureReason, says: str
) -> None:
    found = run_episode(staged(scene_on_straight_road((), seconds=5.0), maker, timeout_s=0.3), Faulty(fault))
    assert found.end == "failed" and found.failure is not None
    assert found.failure.reason is reason and says in found.failure.text
    assert len(found.plans) == 4 and found.touch is None and found.neuroncap is None


@pytest.mark.parametrize("maker", MAKERS)
def test_six_identical_points_are_a_plan_to_stand(maker: SimulatorBackend) -> None:
    found = run_episode(staged(scene_on_straight_road((), ego_speed=6.0, seconds=6.0), maker), Stop())
    assert found.end == "end" and found.failure is None
    assert abs(found.motion.ego[-1, 3]) < 0.5


@pytest.mark.parametrize("fails_in", ["reset", "reveal"])
def test_a_planner_that_cannot_begin_has_failed(fails_in: str) -> None:
    class Never(IntelligentDriver):
        pass

    def refuse(self: Any, scene: Any) -> None:
        raise ValueError("not today")

    setattr(Never, fails_in, refuse)
    found = run_episode(staged(scene_on_straight_road((), seconds=4.0)), Never())
    assert found.failure is not None and "not today" in found.failure.text and found.plans == ()


def test_a_picture_that_cannot_be_had_is_not_the_planners_failure() -> None:
    scene = scene_on_straight_road((), seconds=4.0)

    def load() -> Any:
        raise InputError("the picture is gone")

    class Broken:
        name = "broken"
        facts: dict[str, Any] = {}  # noqa: RUF012 - as the Protocol has it
        cameras = scene.cameras

        def look(self, scene: Scene) -> "Broken":
            return self

        def views(self, driven: Scene) -> Any:
            return {"CAM_FRONT": CameraView(scene.cameras[0], Path("gone"), 0, np.eye(4), load)}

    class Looking(Watching):
        def plan(self, observation: Observation) -> Plan:
            observation.views["CAM_FRONT"].load()
            return super().plan(observation)

    with pytest.raises(BrokenImageError, match="gone"):
        run_episode(replace(staged(scene), sensor=Broken()), Looking())


@pytest.mark.parametrize("maker", MAKERS)
def test_the_first_contact_ends_the_drive(maker: SimulatorBackend) -> None:
    scene = scene_on_straight_road((Car(90.0, 198.25, 0.0),), ego_speed=8.0, seconds=10.0)
    found = run_episode(staged(scene, maker), Watching(speed=8.0))
    assert found.end == "contact" and found.touch is not None and found.touch.agent == 0
    # From 50 m at 8 m/s to a bumper at 90 - 2.3 m, the front being 3.432 m ahead of the axle.
    assert (found.touch.time_us - scene.timestamps_us[0]) * 1e-6 == pytest.approx(4.28, abs=0.25)
    assert found.touch.ego_speed == pytest.approx(8.0, abs=0.1)
    assert (found.neuroncap is None) == isinstance(maker, DefaultBackend)


@pytest.mark.parametrize("maker", MAKERS)
def test_scenes_that_are_too_short_are_refused_before_anybody_plans(maker: SimulatorBackend) -> None:
    planner = Watching()
    with pytest.raises(InputError, match="scene-9901"):
        run_episode(staged(scene_on_straight_road((), seconds=1.5), maker), planner)
    assert planner.resets == []


def test_the_recorded_ego_drives_as_recorded_and_catches_up() -> None:
    """It follows its route, and is not shown the scene."""

    class Told(LogReplay):
        def reveal(self, scene: Scene) -> None:
            raise AssertionError("the future was revealed")

    scene = town_scene(0).first_frames(121)
    found = run_episode(staged(scene), Told())
    ticks = found.motion.ticks
    recorded = scene.ego.pose[scene.keyframes[: len(ticks)], :2]
    assert found.failure is None and np.hypot(*(found.motion.ego[ticks, :2] - recorded).T).max() < 1.0
    # The same planner, put behind: it wants to be where the recording is, and not to follow it from there.
    behind, scene = Watching(speed=2.0), scene_on_straight_road((), ego_speed=8.0, seconds=6.0)
    run_episode(staged(scene), behind)
    planner, observation, route = LogReplay(), behind.seen[-1], Route.of(scene)
    planner.follow(route)
    gap = route.recorded_at(np.array([route.seconds_of(observation.timestamp_us)]))[0, 0] - observation.ego.pose[0]
    assert gap > 5.0 and planner.plan(observation).waypoints[0, 0] == pytest.approx(gap + 4.0, abs=0.05)


def test_constant_velocity_on_the_path_stays_on_it_at_its_own_speed() -> None:
    scene = town_scene(1)
    found = run_episode(staged(scene), ConstantVelocityOnPath())
    path = scene.ego.pose[:, :2]
    away = [np.hypot(*(path - place).T).min() for place in found.motion.ego[found.motion.ticks, :2]]
    within = np.array(found.stations) < np.hypot(*np.diff(path, axis=0).T).sum() - 1.0
    assert np.array(away)[: len(within)][within].max() < 1.5
    speed = found.motion.ego[found.motion.ticks[PRIMING_STEPS:], 3]
    assert speed.std() < 0.6


def test_idm_brakes_for_what_drives_in_the_world_as_driven() -> None:
    scene = scene_on_straight_road((Car(95.0, 198.25, 0.0),), ego_speed=8.0, seconds=12.0)
    found = run_episode(staged(scene), IntelligentDriver())
    assert found.end == "end" and found.motion.ego[-1, 3] < 1.0
    assert found.motion.ego[-1, 0] < 95.0 - 2.3 - 3.4


def test_idm_alone_on_an_empty_road_never_leaves_its_lane() -> None:
    scene = without_others(town_scene(0))
    found = run_episode(staged(scene), IntelligentDriver())
    assert found.end == "end" and found.motion.seconds[-1] > 19.4
    scores = score_episode(scene, found).nuplan
    assert scores is not None and scores.dac == 1.0 and scores.c == 1.0
    lines = np.concatenate([LanePath.through(lane.centerline).points for lane in scene.road_map.lanes.values()])
    places = found.motion.ego[int(found.motion.ticks[PRIMING_STEPS]) :: 5, :2]
    assert max(np.hypot(*(lines - place).T).min() for place in places) < 1.0


def without_others(scene: Scene) -> Scene:
    agents, known = scene.agents, scene.annotations
    nobody = replace(agents, valid=np.zeros_like(agents.valid))
    return replace(scene, agents=nobody, annotations=replace(known, valid=np.zeros_like(known.valid)))


def test_a_plan_takes_effect_so_much_later() -> None:
    scene = scene_on_straight_road((), ego_speed=8.0, seconds=8.0)
    at_once, late = (run_episode(staged(scene, DefaultBackend(latency_us=us)), Stop()) for us in (0, 400_000))
    start = at_once.motion.ticks[PRIMING_STEPS]
    # For 0.4 s the late one drives on as it did.
    assert late.motion.ego[start + 4, 3] == pytest.approx(8.0, abs=0.05)
    assert at_once.motion.ego[start + 4, 3] < 7.5
    assert late.motion.ego[-1, 0] > at_once.motion.ego[-1, 0] + 2.0


def test_the_same_drive_is_the_same_to_the_last_bit() -> None:
    scene = town_scene(2).first_frames(97)
    first, second = (run_episode(staged(scene, DefaultBackend("idm")), IntelligentDriver()) for _ in range(2))
    for name in ("ego", "position", "yaw", "present", "times_us"):
        assert getattr(first.motion, name).tobytes() == getattr(second.motion, name).tobytes()
