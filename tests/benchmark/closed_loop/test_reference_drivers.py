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
    scene = scene_on_straight_road(SCENES[which], seconds=9.0)
    keyframe = int(scene.keyframes[2])
    tracks = ContinuousTracks.of_scene(scene)
    situation = DrivingSituation(tracks, tracks.grid(float(scene.seconds[keyframe])))
    surroundings = CollisionChecker.of(situation)
    expected = [
        surroundings.find_outcome(motion)
        for motion in simulate_drivers(situation, [ReferenceDriver(driver) for driver in REFERENCE_DRIVER_KINDS])
    ]
    found = simulate_reference_drivers(scene, build_simulation_config(scene, keyframe=2), REFERENCE_DRIVER_KINDS)
    assert list(found) == list(REFERENCE_DRIVER_KINDS)
    last = float(scene.seconds[scene.keyframes[-1]])
    for ours, theirs in zip(found.values(), expected, strict=True):
        contact = theirs.contact
        if contact is None or contact.time > last:
            assert ours.survives, ours
            continue
        assert ours.seconds == pytest.approx(contact.time - float(scene.seconds[keyframe]), abs=0.051)
        assert (ours.agent, ours.kind) == (scene.agents.ids[contact.agent], contact.kind.value)


def test_a_driver_is_answered_by_a_world_of_its_own() -> None:
    scene = scene_on_straight_road(SCENES["all parked"], seconds=9.0)
    course = build_simulation_config(scene, keyframe=2)
    together = simulate_reference_drivers(scene, course, REFERENCE_DRIVER_KINDS)
    alone = {driver: simulate_reference_drivers(scene, course, [driver])[driver] for driver in REFERENCE_DRIVER_KINDS}
    assert together == alone
