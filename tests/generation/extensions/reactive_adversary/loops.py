"""Adversaries in the loop on hand-made roads, with a stand-in for the diffusion model."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmark.closed_loop.adversary import AdversaryTrack
from benchmark.closed_loop.agent_policy import TrafficSnapshot
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.closed_loop.plan_tracking import SUBSTEP_US
from benchmark.closed_loop.simulation_config import build_log_replay
from benchmark.geometry import Bools, Floats
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.adversary_maker import ReactiveAdversaryMaker
from generation.extensions.reactive_adversary.policy import ReactiveAdversary
from generation.extensions.reactive_adversary.settings import AdversarySettings, EgoPrediction, build_reactive_settings
from tests.generation.search.driving_prior import DrivingPrior, unchanged
from tests.hand_made import Car, scene_on_straight_road

HYPER = replace(build_reactive_settings(), candidates=24, rounds=2)
SETTINGS = AdversarySettings(hyper=HYPER)
CARS = (Car(62.0, 194.75, 9.0), Car(90.0, 198.25, 8.0), Car(120.0, 201.75, 9.0, np.pi))
MAKER = ReactiveAdversaryMaker(SETTINGS, DrivingPrior, DrivingPrior.fingerprint)


def road(*cars: Car, seconds: float = 9.0, ego_speed: float = 8.0) -> Scene:
    return scene_on_straight_road(cars or CARS, seconds=seconds, ego_speed=ego_speed)


def policy_of(
    scene: Scene, settings: AdversarySettings = SETTINGS, agent: int = 0, start: int = 12, run: int = 0
) -> ReactiveAdversary:
    start_us, end_us = int(scene.timestamps_us[scene.keyframes[2]]), int(scene.timestamps_us[scene.keyframes[-1]])
    others = build_log_replay(scene, start_us, end_us)
    return ReactiveAdversary(scene, agent, start, run, settings, others, DrivingPrior(), unchanged)


def rides(settings: AdversarySettings = SETTINGS) -> DefaultBackend:
    return DefaultBackend("adversary", 0, replace(MAKER, settings=settings))


def loop(
    scene: Scene, policy: ReactiveAdversary, ego_at: Callable[[float], Floats] | None = None
) -> tuple[AdversaryTrack, Floats, Bools]:
    """Its track, and (R, N, 5) boxes and (R, N) presence of everybody every 0.05 s while an ego drives.

    The ego is the recorded one, or where it says it is, (5,), at seconds of the scene.
    """
    tracks = ContinuousTracks.of_scene(scene)
    where = ego_at or (lambda seconds: tracks.ego_at(np.array([seconds]))[0])
    time = int(scene.timestamps_us[scene.keyframes[2]])
    memory, moved = policy.init(time, 0)
    boxes, present = [], []
    while time < scene.timestamps_us[scene.keyframes[-1]]:
        seconds = (time - int(scene.timestamps_us[0])) / 1e6
        now, before = where(seconds), where(seconds - 0.1)
        speed = float(np.hypot(*(now - before)[:2])) / 0.1
        moment = TrafficSnapshot(time, now, speed, moved.boxes[-1], moved.present[-1], moved.velocity)
        memory, moved = policy.act(memory, moment, 0)
        boxes += [*moved.boxes]
        present += [*moved.present]
        time += SUBSTEP_US
    return policy.adversary(memory), np.stack(boxes), np.stack(present)


def knowing(knows: EgoPrediction) -> AdversarySettings:
    return replace(SETTINGS, knows=knows)
