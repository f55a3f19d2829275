"""What an adversary may drive: endings to the last frame, and who is ever touched, against asking everybody always."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.geometry import Floats, boxes_overlap
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.safe_endings import AIR_M, SurroundingTracks
from tests.generation.extensions.reactive_adversary.loops import road
from tests.hand_made import Car

AGENT, FRAME = 0, 24
CARS = (
    Car(60.0, 194.75, 9.0), Car(40.0, 194.75, 9.5), Car(30.0, 198.25, 8.0), Car(110.0, 194.75, 0.0),
    Car(150.0, 201.75, 9.0, np.pi),
)  # fmt: skip
SCENE = road(*CARS, seconds=10.0)


def asked_slowly(scene: Scene, around: SurroundingTracks, poses: Floats) -> float:
    """Everybody at every instant, one after the other."""
    boxes, present = ContinuousTracks.of_scene(scene).agents_at(around.seconds + float(scene.seconds[FRAME]))
    last = 0.0
    for row, second in enumerate(around.seconds):
        if second > around.frame_seconds[len(poses) - 1] + 1e-9:
            break
        place = [np.interp(second, around.frame_seconds[: len(poses)], poses[:, axis]) for axis in range(3)]
        own = np.array([[*place[:2], *(scene.agents.size[AGENT, :2] + 2 * AIR_M), place[2]]])
        for other in range(len(boxes)):
            if other != AGENT and present[other, row] and boxes_overlap(own, boxes[other, row][None])[0]:
                return last
        last = float(second)
    return float(np.inf)


@settings(max_examples=30, deadline=None)
@given(
    st.floats(30.0, 120.0), st.floats(193.0, 203.0), st.floats(-0.2, 0.2), st.floats(0.0, 14.0), st.integers(2, 97),
    st.integers(0, 99_999),
)  # fmt: skip
def test_who_is_touched_is_who_anybody_would_find(
    x: float, y: float, yaw: float, speed: float, count: int, clock: int
) -> None:
    around = SurroundingTracks.of(SCENE, AGENT, FRAME, int(SCENE.timestamps_us[0]) + clock)
    seconds = around.frame_seconds[:count]
    way = np.column_stack([np.cos(yaw) * speed * seconds, np.sin(yaw) * speed * seconds, 0.0 * seconds])
    poses = way + [x, y, yaw]
    assert around.compute_clear_seconds(poses) == pytest.approx(asked_slowly(SCENE, around, poses))


def test_instants_are_those_of_the_drive_and_frames_to_the_last() -> None:
    around = SurroundingTracks.of(SCENE, AGENT, FRAME, int(SCENE.timestamps_us[FRAME]) - 20_000)
    assert around.seconds[0] == pytest.approx(0.03)
    assert around.seconds[-1] == around.frame_seconds[-1] == pytest.approx(float(np.ptp(SCENE.seconds[FRAME:])))
    assert np.isin(np.round(around.frame_seconds[1:], 9), np.round(around.seconds, 9)).all()
    assert np.diff(around.seconds).max() <= 0.05 + 1e-9


def test_who_would_be_run_into_from_behind_later_may_not_stop_there() -> None:
    """Stopping at once is safe for five seconds, and then somebody comes: another ending is found, or none."""
    scene = road(Car(60.0, 194.75, 9.0), Car(-20.0, 194.75, 10.0), seconds=12.0)
    around = SurroundingTracks.of(scene, AGENT, FRAME, int(scene.timestamps_us[FRAME]))
    seconds = around.frame_seconds
    stopping = np.column_stack(
        [78.0 + np.minimum(9.0 * seconds - seconds**2, 20.25), np.full_like(seconds, 194.75), 0.0 * seconds]
    )
    assert 5.0 < around.compute_clear_seconds(stopping) < np.inf
    # Who stands has nowhere to go; who is known to drive on drives on.
    assert around.ending(np.repeat(stopping[60:61], 37, axis=0), 12) is None
    driving = np.column_stack([78.0 + 9.0 * seconds[:37], np.full(37, 194.75), np.zeros(37)])
    found = around.ending(driving, 12)
    assert found is not None and len(found) == len(seconds) and around.compute_clear_seconds(found) == np.inf
    np.testing.assert_allclose(found[:13], driving[:13])


def test_what_touches_somebody_in_what_is_driven_has_no_ending() -> None:
    around = SurroundingTracks.of(SCENE, AGENT, FRAME, int(SCENE.timestamps_us[FRAME]))
    seconds = around.frame_seconds[:37]
    into = np.column_stack([100.0 + 9.0 * seconds, np.full(37, 194.75), np.zeros(37)])
    assert around.compute_clear_seconds(into[:13]) < np.inf and around.ending(into, 12) is None
    endings = list(around.generate_endings(into, 12))
    lasting = around.compute_clear_seconds(around.find_longest(endings))
    assert lasting == max(map(around.compute_clear_seconds, endings)) < np.inf
