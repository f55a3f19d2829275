"""Whom an adversary may endanger: the careful human of the search, and endings that touch nobody."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.constants import FRAME_HZ
from benchmark.dynamics.bicycle import SimulatedMotion
from benchmark.geometry import Floats, boxes_overlap
from benchmark.interactions.driver_outcomes import CollisionChecker
from benchmark.interactions.driver_simulation import DrivingSituation, ReferenceDriver, simulate_drivers
from benchmark.interactions.reaction import CAREFUL_TIME_S, HARDEST_BRAKING, REACTION_S, Driver
from benchmark.interactions.tracks import ContinuousTracks
from benchmark.scene import Scene
from generation.extensions.reactive_adversary.careful_driver import EVERY_FRAMES, CarefulDriverCheck, PathBodies
from generation.extensions.reactive_adversary.safe_endings import AIR_M, SurroundingTracks
from tests.generation.extensions.reactive_adversary.loops import road
from tests.hand_made import Car

FRAME = 24


def slowing(scene: Scene, gap_m: float, speed: float, braking: float) -> Floats:
    """(37, 3) a car in the ego's lane, so far ahead of it, that brakes."""
    seconds = np.arange(37) / 12
    time = np.minimum(seconds, speed / braking) if braking > 0 else seconds
    front = scene.ego.boxes[FRAME, 0] + 0.5 * 4.084
    x = front + gap_m + 0.5 * 4.6 + speed * time - 0.5 * braking * time**2
    return np.column_stack([x, np.full(37, 198.25), np.zeros(37)])


def motion_of(poses: Floats) -> SimulatedMotion:
    return SimulatedMotion(poses[None], np.zeros((1, 37, 6)), np.zeros((1, 36, 2)), np.ones(1, np.bool_))


def says(scene: Scene, poses: Floats) -> bool:
    careful = CarefulDriverCheck.of(scene, 0, FRAME, 8.0)
    return bool(careful.hit(motion_of(poses), scene.agents.size[0, :2])[0])


def ladder_says(scene: Scene, poses: Floats) -> bool:
    made = scene.with_adversary(0, slice(FRAME, FRAME + 37), poses).first_frames(FRAME + 37)
    tracks = ContinuousTracks.of_scene(made)
    situation = DrivingSituation(tracks, tracks.grid(float(made.seconds[FRAME])))
    (motion,) = simulate_drivers(situation, [ReferenceDriver(Driver.CC)])
    return not CollisionChecker.of(situation).find_outcome(motion).survives


@pytest.mark.parametrize(("speed", "braking"), [(2.0, 0.0), (2.0, 3.0), (5.0, 5.0), (8.0, 0.0), (8.0, 5.0)])
def test_it_agrees_with_the_ladder_where_that_is_clear(speed: float, braking: float) -> None:
    scene = road(Car(90.0, 198.25, 8.0), seconds=8.0)
    verdicts = {
        gap: (says(scene, slowing(scene, gap, speed, braking)), ladder_says(scene, slowing(scene, gap, speed, braking)))
        for gap in (0.5, 1.0, 2.0, 14.0, 25.0)
    }
    # Far away is safe, right ahead of a slower car is not; in between the ladder decides of executed tracks.
    assert verdicts[25.0] == (False, False)
    # Whoever the ladder has hit within the horizon is not let through.
    assert all(ours for ours, theirs in verdicts.values() if theirs)


def test_who_is_beside_the_way_hits_nobody_and_who_follows_does() -> None:
    scene = road(Car(90.0, 198.25, 8.0), Car(46.4, 198.25, 8.0), seconds=8.0)
    alone = road(Car(90.0, 198.25, 8.0), seconds=8.0)
    braking = slowing(alone, 10.0, 4.0, 0.0)
    assert not says(alone, braking)
    assert says(scene, braking)
    assert not says(scene, slowing(scene, 14.0, 8.0, 0.0))
    aside = braking + np.array([0.0, 7.0, 0.0])
    assert not says(scene, aside)


@pytest.mark.parametrize(("gap", "aside"), [(2.0, 0.0), (5.0, 0.0), (12.0, 0.0), (2.0, 3.5)])
def test_who_follows_too_closely_to_stop_lacks_what_is_missing(gap: float, aside: float) -> None:
    """At the same speed a second of way is needed: that in which nothing is planned."""
    scene = road(Car(90.0, 198.25, 8.0), seconds=8.0)
    x = scene.ego.boxes[FRAME, 0] - 0.5 * 4.084 - 0.5 * 4.6 - gap + 8.0 * np.arange(37) / 12
    poses = np.column_stack([x, np.full(37, 198.25 + aside), np.zeros(37)])
    careful = CarefulDriverCheck.of(scene, 0, FRAME, 8.0)
    size = np.array([4.6, 1.9])
    found = careful.compute_missing_distance(careful.place(motion_of(poses), size))[0]
    assert found == pytest.approx(max(8.0 - gap, 0.0) if aside == 0.0 else 0.0, abs=0.1)


def hits_one_by_one(careful: CarefulDriverCheck, placed: PathBodies) -> list[bool]:
    """Each body by itself, each of the others by itself, step after step."""
    return [_hits_alone(careful, placed, row) for row in range(len(placed.rear))]


def _hits_alone(careful: CarefulDriverCheck, placed: PathBodies, row: int) -> bool:
    own = [column[row] for column in (placed.rear, placed.front, placed.beside)]
    others = [list(body) for body in zip(careful.others.rear, careful.others.front, careful.others.beside, strict=True)]
    half, dt, station, speed = 0.5 * careful.way.length_m, EVERY_FRAMES / FRAME_HZ, careful.station, careful.speed
    waiting, braking, hit, lost = REACTION_S, 0.0, False, False
    for step in range(len(careful.steps)):
        unsafe = False
        for rear, front, beside in [own, *others]:
            gap, closing = rear[step] - station - half, speed - (rear[step + 1] - rear[step]) / dt
            near = gap <= 0.0 or (closing > 0.0 and gap <= CAREFUL_TIME_S * closing)
            unsafe |= bool(beside[step] <= 0.0 and front[step] > station and near)
        ready = unsafe and waiting <= 0.0
        waiting -= dt if unsafe else 0.0
        braking = min(braking + 12.65 * dt, HARDEST_BRAKING) if ready else braking
        after = max(speed - (braking if ready else 0.0) * dt, 0.0)
        station, speed = station + 0.5 * dt * (speed + after), after
        rear, front, beside = (column[step + 1] for column in own)
        hit |= bool(rear < station + half + 1.0 and front > station - half and beside <= 0.4 + 0.1 * (step + 1) * dt)
        for other in others:
            rear, front, beside = (column[step + 1] for column in other)
            lost |= bool(rear < station + half and front > station - half and beside <= 0.0)
    return hit or lost


def test_all_at_once_is_each_by_itself() -> None:
    scene = road(seconds=8.0)
    careful = CarefulDriverCheck.of(scene, 0, FRAME, 8.0)
    rng, instants = np.random.default_rng(5), len(careful.steps) + 1

    def bodies(count: int, along: tuple[float, float]) -> PathBodies:
        rear = (
            careful.station + rng.uniform(*along, (count, 1)) + rng.uniform(0.0, 1.6, (count, instants)).cumsum(axis=1)
        )
        return PathBodies(rear, rear + 4.6, rng.uniform(-0.4, 1.2, (count, instants)))

    outcomes = set()
    for others in (0, 1, 4):
        among = replace(careful, others=bodies(others, (15.0, 60.0)), lost=False)
        placed = bodies(60, (-20.0, 40.0))
        # What is looked at after the last instant is not part of this comparison.
        placed.beside[:, -1] = 2.0
        found = among.hits(placed).tolist()
        assert found == hits_one_by_one(among, placed)
        outcomes |= set(found)
    assert outcomes == {False, True}


AGENT, START_FRAME = 0, 24
ENDING_CARS = (
    Car(60.0, 194.75, 9.0), Car(40.0, 194.75, 9.5), Car(30.0, 198.25, 8.0), Car(110.0, 194.75, 0.0),
    Car(150.0, 201.75, 9.0, np.pi),
)  # fmt: skip
SCENE = road(*ENDING_CARS, seconds=10.0)


def asked_slowly(scene: Scene, around: SurroundingTracks, poses: Floats) -> float:
    """Everybody at every instant, one after the other."""
    boxes, present = ContinuousTracks.of_scene(scene).agents_at(around.seconds + float(scene.seconds[START_FRAME]))
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
    around = SurroundingTracks.of(SCENE, AGENT, START_FRAME, int(SCENE.timestamps_us[0]) + clock)
    seconds = around.frame_seconds[:count]
    way = np.column_stack([np.cos(yaw) * speed * seconds, np.sin(yaw) * speed * seconds, 0.0 * seconds])
    poses = way + [x, y, yaw]
    assert around.compute_clear_seconds(poses) == pytest.approx(asked_slowly(SCENE, around, poses))


def test_instants_are_those_of_the_drive_and_frames_to_the_last() -> None:
    around = SurroundingTracks.of(SCENE, AGENT, START_FRAME, int(SCENE.timestamps_us[START_FRAME]) - 20_000)
    assert around.seconds[0] == pytest.approx(0.03)
    assert around.seconds[-1] == around.frame_seconds[-1] == pytest.approx(float(np.ptp(SCENE.seconds[START_FRAME:])))
    assert np.isin(np.round(around.frame_seconds[1:], 9), np.round(around.seconds, 9)).all()
    assert np.diff(around.seconds).max() <= 0.05 + 1e-9


def test_who_would_be_run_into_from_behind_later_may_not_stop_there() -> None:
    """Stopping at once is safe for five seconds, and then somebody comes: another ending is found, or none."""
    scene = road(Car(60.0, 194.75, 9.0), Car(-20.0, 194.75, 10.0), seconds=12.0)
    around = SurroundingTracks.of(scene, AGENT, START_FRAME, int(scene.timestamps_us[START_FRAME]))
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
    around = SurroundingTracks.of(SCENE, AGENT, START_FRAME, int(SCENE.timestamps_us[START_FRAME]))
    seconds = around.frame_seconds[:37]
    into = np.column_stack([100.0 + 9.0 * seconds, np.full(37, 194.75), np.zeros(37)])
    assert around.compute_clear_seconds(into[:13]) < np.inf and around.ending(into, 12) is None
    endings = list(around.generate_endings(into, 12))
    lasting = around.compute_clear_seconds(around.find_longest(endings))
    assert lasting == max(map(around.compute_clear_seconds, endings)) < np.inf
