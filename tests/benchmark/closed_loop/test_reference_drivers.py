"""The ladder in closed loop: where nobody answers, it is the ladder of open loop."""

import numpy as np
import pytest

from benchmark.closed_loop.reference_drivers import simulate_reference_drivers
from benchmark.closed_loop.simulation_config import build_simulation_config
from benchmark.interactions.driver_outcomes import CollisionChecker
from benchmark.interactions.driver_simulation import (
    REFERENCE_DRIVER_KINDS,
    DrivingSituation,
    ReferenceDriver,
    simulate_drivers,
)
from benchmark.interactions.tracks import ContinuousTracks
from tests.hand_made import Car, scene_on_straight_road

SCENES = {
    "leader brakes": (Car(75.0, 198.25, 3.0),),
    "all parked": (Car(90.0, 198.25, 0.0), Car(60.0, 194.75, 10.0)),
    "crossing": (Car(95.0, 185.0, 4.0, np.pi / 2),),
    "oncoming": (Car(130.0, 198.6, 6.0, np.pi),),
    "free": (Car(60.0, 205.25, 9.0),),
}


@pytest.mark.parametrize("which", SCENES)
def test_replayed_agents_give_the_outcomes_of_open_loop(which: str) -> None:
    scene = scene_on_straight_road(SCENES[which], seconds=7.0)
    start = float(scene.seconds[scene.keyframes[2]])
    tracks = ContinuousTracks.of_scene(scene)
    situation = DrivingSituation(tracks, tracks.grid(start))
    motions = simulate_drivers(situation, [ReferenceDriver(driver) for driver in REFERENCE_DRIVER_KINDS])
    expected = [CollisionChecker.of(situation).find_outcome(motion).contact for motion in motions]
    found = simulate_reference_drivers(scene, build_simulation_config(scene, keyframe=2), REFERENCE_DRIVER_KINDS)
    assert list(found) == list(REFERENCE_DRIVER_KINDS)
    for ours, contact in zip(found.values(), expected, strict=True):
        if contact is None or contact.time > float(scene.seconds[scene.keyframes[-1]]):
            assert ours.survives, ours
            continue
        assert ours.seconds == pytest.approx(contact.time - start, abs=0.051)
        assert (ours.agent, ours.kind) == (scene.agents.ids[contact.agent], contact.kind.value)


def test_a_driver_is_answered_by_a_world_of_its_own() -> None:
    scene = scene_on_straight_road(SCENES["all parked"], seconds=5.0)
    course, some = build_simulation_config(scene, keyframe=2), REFERENCE_DRIVER_KINDS[:3]
    together = simulate_reference_drivers(scene, course, some)
    assert together == {driver: simulate_reference_drivers(scene, course, [driver])[driver] for driver in some}
