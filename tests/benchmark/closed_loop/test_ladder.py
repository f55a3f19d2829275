"""The ladder in closed loop: where nobody answers, it is the ladder of open loop."""

import numpy as np
import pytest

from benchmark.closed_loop.courses import course_of
from benchmark.closed_loop.ladder import climbed
from benchmark.interactions.driving import LADDER, Rung, Situation, drive
from benchmark.interactions.outcomes import Surroundings
from benchmark.interactions.tracks import Tracks
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
    tracks = Tracks.of_scene(scene)
    situation = Situation(tracks, tracks.grid(float(scene.seconds[keyframe])))
    surroundings = Surroundings.of(situation)
    expected = [surroundings.outcome(motion) for motion in drive(situation, [Rung(driver) for driver in LADDER])]
    found = climbed(scene, course_of(scene, keyframe=2), LADDER)
    assert list(found) == list(LADDER)
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
    course = course_of(scene, keyframe=2)
    together = climbed(scene, course, LADDER)
    alone = {driver: climbed(scene, course, [driver])[driver] for driver in LADDER}
    assert together == alone
