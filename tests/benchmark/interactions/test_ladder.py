"""Encounters whose answer is known: who survives them, and until when they could be avoided."""

import numpy as np
import pytest
import shapely

from benchmark.constants import EGO_LENGTH_M
from benchmark.interactions.avoidability import BaselineEgo
from benchmark.interactions.contacts import ContactKind
from benchmark.interactions.driver_outcomes import CollisionChecker, DriverOutcome
from benchmark.interactions.driver_simulation import (
    REFERENCE_DRIVER_KINDS,
    DrivingSituation,
    ReferenceDriver,
    simulate_drivers,
)
from benchmark.interactions.reaction import Driver
from benchmark.interactions.solvability import SceneReferenceDrivers
from benchmark.interactions.tracks import ContinuousTracks
from tests.benchmark.interactions.made import CAR, along, boxes, ego, scene, shifting, turned

GAP_M = 0.5 * (EGO_LENGTH_M + CAR[0])
"""Between centres of the ego and a car that touches its bumper."""


def outcomes(tracks: ContinuousTracks, *rungs: ReferenceDriver) -> list[DriverOutcome]:
    situation = DrivingSituation.of(tracks, adversary=0)
    return [CollisionChecker.of(situation).find_outcome(motion) for motion in simulate_drivers(situation, rungs)]


def survivors(tracks: ContinuousTracks) -> set[Driver]:
    ladder = SceneReferenceDrivers.of(tracks, 0)
    return {driver for driver in REFERENCE_DRIVER_KINDS if ladder.survives(driver)}


HARD_STOP = scene(ego(25.0), along(GAP_M + 5.0, 0.0, 25.0, brakes=9.0))
CUT_IN_AHEAD = scene(ego(12.0), shifting(40.0 + GAP_M, 12.0, 3.5, 1.0, 1.2))


@pytest.mark.parametrize("place", [(0.0, (0.0, 0.0)), (2.5, (1000.0, -700.0))])
def test_nobody_survives_a_leader_that_stops_hard_close_ahead(place: tuple[float, tuple[float, float]]) -> None:
    tracks = turned(HARD_STOP, *place)
    assert survivors(tracks) == set()
    ladder = SceneReferenceDrivers.of(tracks, 0)
    assert ladder.first_visible == 0.0 and ladder.unsolvable
    assert {ladder.outcomes[driver].contact.kind for driver in REFERENCE_DRIVER_KINDS} <= {  # type: ignore[union-attr]
        ContactKind.FRONT,
        ContactKind.STOPPED_TRACK,
    }


def test_what_runs_into_a_standing_or_slow_car_from_behind_is_nobodys_to_avoid() -> None:
    tracks = scene(ego(6.0), along(-25.0, 0.3, 13.0))
    found = outcomes(tracks, *map(ReferenceDriver, REFERENCE_DRIVER_KINDS))
    assert all(outcome.contact and outcome.contact.kind is ContactKind.REAR for outcome in found)
    assert all(outcome.reacted is None for outcome in found)
    ladder = SceneReferenceDrivers.of(tracks, 0)
    assert ladder.last_chance.time is None and not ladder.last_chance.unsolvable and not ladder.unsolvable


def test_the_careful_human_reacts_two_seconds_from_contact_and_then_takes_0_8_s() -> None:
    """A car that stands 60 m ahead: at 10 m/s contact is 2 s away when 20 m are left."""
    standing = boxes(np.full(97, 60.0 + GAP_M), np.zeros(97), yaw=0.0)
    (careful,) = outcomes(scene(ego(10.0), standing), ReferenceDriver(Driver.CC))
    assert careful.survives and careful.reacted == pytest.approx(4.0)
    first = int(np.argmax(careful.unsafe))
    # 0.8 s of coasting at 0.4 m/s^2, then braking that rises from 1.665 m/s^2.
    assert careful.speed[first + 8] == pytest.approx(10.0 - 8 * 0.04)
    assert careful.speed[first + 9] == pytest.approx(10.0 - 8 * 0.04 - 0.1665)
    # It brakes in unsafe steps only: as slow as that, contact is two seconds away again.
    assert 0.0 < careful.speed[-1] < 1.0 and careful.station[-1] < 60.0


def test_constant_speed_does_not_brake_as_the_recording_did() -> None:
    seconds = np.arange(97) / 12.0
    own = ego(8.0)
    own[:, 0] = np.where(seconds < 2.0, 8.0 * seconds, 16.0 + 8.0 * (seconds - 2.0) - 1.0 * (seconds - 2.0) ** 2)
    own[seconds > 6.0, 0] = 32.0
    leader = boxes(np.full(97, 36.0 + GAP_M), np.zeros(97), yaw=0.0)
    recorded, constant = outcomes(
        scene(own, leader), ReferenceDriver(Driver.RECORDED), ReferenceDriver(Driver.CONSTANT)
    )
    assert recorded.survives and not recorded.beyond_end
    assert constant.contact is not None and constant.contact.kind is ContactKind.STOPPED_TRACK
    assert constant.contact.time == pytest.approx(4.5, abs=0.021) and constant.beyond_end


def test_what_nobody_sees_makes_nobody_react() -> None:
    """A standing car is hidden by a truck until the truck has left; without the truck it is seen at once."""
    hidden = boxes(np.full(97, 40.0), np.full(97, 0.0), yaw=0.0)
    truck = boxes(np.full(97, 20.0), np.full(97, 0.0), (8.0, 3.0), 0.0)
    both = scene(ego(8.0), hidden, truck, categories=("vehicle.car", "vehicle.truck"))
    alone = scene(ego(8.0), hidden)
    assert SceneReferenceDrivers.of(alone, 0).first_visible == 0.0
    ladder = SceneReferenceDrivers.of(both, 0)
    assert ladder.first_visible is None or ladder.first_visible > 1.0
    (only_adversary,) = outcomes(both, ReferenceDriver(Driver.CC, adversary_only=True))
    assert only_adversary.reacted is None and only_adversary.contact is not None and only_adversary.contact.agent == 1


def test_whom_the_ego_touches_at_the_start_is_ignored_for_good() -> None:
    inside = boxes(np.full(97, 2.0), np.full(97, 0.5), yaw=0.0)
    assert survivors(scene(ego(5.0), inside)) == set(REFERENCE_DRIVER_KINDS)


def test_all_drivers_together_do_what_each_does_alone() -> None:
    tracks = scene(ego(12.0), shifting(22.0, 7.0, 3.5, 1.0, 1.2), along(-30.0, -3.5, 14.0), along(60.0, 3.5, 5.0))
    together = outcomes(tracks, *map(ReferenceDriver, REFERENCE_DRIVER_KINDS))
    for driver, outcome in zip(REFERENCE_DRIVER_KINDS, together):
        (alone,) = outcomes(tracks, ReferenceDriver(driver))
        assert np.array_equal(alone.motion.speed, outcome.motion.speed)
        assert (alone.contact is None) == (outcome.contact is None)


def test_the_last_chance_is_found_by_bisection_as_by_looking_at_every_moment() -> None:
    base = BaselineEgo(DrivingSituation.of(scene(ego(12.0), shifting(22.0, 7.0, 3.5, 1.0, 1.2))))
    chance = base.last_chance()
    assert chance.contact is not None and chance.time is not None
    moments = 0.1 * np.arange(int(np.ceil(chance.contact.time / 0.1)))
    alive = [base.try_from(float(moment)).first >= 0 for moment in moments]
    assert chance.time == pytest.approx(float(moments[alive][-1]))


def test_a_narrow_road_leaves_less_time_than_an_open_field() -> None:
    situation = DrivingSituation.of(scene(ego(12.0), shifting(22.0, 7.0, 3.5, 1.0, 1.2)))
    lane = shapely.MultiPolygon([shapely.box(-50.0, -1.75, 400.0, 5.25)])
    field, road = BaselineEgo(situation).last_chance(), BaselineEgo(situation, drivable=lane).last_chance()
    assert field.time is not None and road.time is not None and road.time <= field.time
    wall = shapely.MultiPolygon([shapely.box(-50.0, -1.0, 400.0, 1.0)])
    swerving = BaselineEgo(situation, drivable=wall).try_from(1.0).succeeds
    # Only manoeuvres that stay on the path (every fifth) are left.
    assert not swerving.reshape(5, 5)[:, 1:].any()


def test_a_base_must_be_recorded_or_constant() -> None:
    with pytest.raises(ValueError, match="cc cannot be a base"):
        BaselineEgo(DrivingSituation.of(CUT_IN_AHEAD), Driver.CC)


def test_a_scene_without_anybody_is_survived_by_all() -> None:
    found = outcomes(scene(ego(9.0)), *map(ReferenceDriver, REFERENCE_DRIVER_KINDS))
    assert all(outcome.survives for outcome in found)
