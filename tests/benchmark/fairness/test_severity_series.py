"""Severities that one can work out by hand."""

import numpy as np
import pytest

from benchmark.fairness.attack import Attack, AttackSuccess, any_or_unknown, compute_attack_success
from benchmark.fairness.scene_assessment import compute_impact
from benchmark.fairness.severity_series import measure_severity
from benchmark.interactions.driver_outcomes import CollisionChecker
from benchmark.interactions.driver_simulation import DrivingSituation, ReferenceDriver, simulate_drivers
from benchmark.interactions.reaction import HARDEST_BRAKING, Driver
from benchmark.interactions.tracks import ContinuousTracks
from tests.benchmark.interactions.made import CAR, SECONDS, along, boxes, ego, scene

GAP_M = 0.5 * (4.084 + CAR[0])


def test_closing_in_on_a_slower_leader() -> None:
    """5 m/s faster and 30 m away: contact after 6 s, so that 1.5 s are left at 4.5 s."""
    found = measure_severity(scene(ego(10.0), along(GAP_M + 30.0, 0.0, 5.0)), 0)
    assert found.contact_s == pytest.approx(6.0, abs=0.11) and found.min_gap == 0.0
    assert found.ttc[0] == pytest.approx(6.0) and found.ttc[30] == pytest.approx(3.0)
    assert found.btn[20] == pytest.approx(25.0 / (2 * 20.0) / HARDEST_BRAKING)
    assert found.tet == pytest.approx(1.5, abs=0.11) and found.pet == 0.0 and found.first == "none"
    assert np.isnan(found.ttc[found.first_contact + 1 :]).all()


def test_following_at_the_same_speed_is_no_threat() -> None:
    found = measure_severity(scene(ego(10.0), along(GAP_M + 12.0, 0.0, 10.0)), 0)
    assert found.contact_s is None and found.min_gap == pytest.approx(12.0)
    assert found.tet == found.tit == 0.0
    assert found.max_btn == pytest.approx(0.0, abs=1e-9)
    # The leader's rear is left 1.2 s before the ego's front gets there.
    assert found.pet == pytest.approx(1.2, abs=0.11) and found.first == "other"


def test_crossing_paths() -> None:
    """The other crosses 10 m ahead while the ego is 4 s away from there."""
    seconds = SECONDS
    crossing = boxes(np.full(len(seconds), 20.0), -12.0 + 6.0 * seconds, yaw=np.pi / 2)
    found = measure_severity(scene(ego(4.0), crossing), 0)
    leaves = (12.0 + 0.865 + 2.3) / 6.0
    enters = (20.0 - 0.95 - 2.042) / 4.0
    assert found.first == "other" and found.pet == pytest.approx(enters - leaves, abs=0.2)
    passed = measure_severity(scene(ego(4.0), along(-30.0, 40.0, 3.0)), 0)
    assert passed.pet is None and passed.first is None and passed.min_ttc is None


def test_an_agent_that_is_never_there_has_no_severity() -> None:
    tracks = scene(ego(5.0), along(10.0, 0.0, 3.0))
    absent = ContinuousTracks(tracks.seconds, tracks.ego, tracks.agents, np.zeros_like(tracks.valid), tracks.categories)
    found = measure_severity(absent, 0)
    assert found.min_gap is None and found.min_ttc is None and found.max_btn is None and found.pet is None


def test_an_impact_in_numbers() -> None:
    tracks = scene(ego(10.0), boxes(np.full(97, 40.0), np.zeros(97), yaw=0.0), categories=("vehicle.truck",))
    situation = DrivingSituation.of(tracks)
    outcome = CollisionChecker.of(situation).find_outcome(
        simulate_drivers(situation, [ReferenceDriver(Driver.RECORDED)])[0]
    )
    assert outcome.contact is not None
    impact = compute_impact(outcome.contact, "vehicle.truck", True)
    assert impact.kind == "stopped_track" and impact.at_fault
    assert impact.impact_speed_m_s == pytest.approx(10.0) and impact.delta_v_ego_m_s == pytest.approx(
        10.0 * 12000 / 13600
    )
    assert 0.0 < impact.fatal_probability < 0.01


def test_attack_success_in_three_readings() -> None:
    attacks = [
        Attack.of(False, None, True), Attack.of(True, False, True), Attack.of(True, True, False),
        Attack.of(True, True, True),
    ]  # fmt: skip
    assert compute_attack_success(attacks) == AttackSuccess(4, 0.75, 0.5, 0.25)
    assert compute_attack_success([]) == AttackSuccess(0, None, None, None)


def test_what_nobody_can_tell_is_in_no_share() -> None:
    unjudged, side = Attack.of(True, True, None), Attack.of(True, None, True)
    assert (unjudged.at_fault, unjudged.attributable) == (True, None)
    assert (side.at_fault, side.attributable) == (None, None)
    # Nothing can be attributed to a planner in a scene in which the careful human fares no better.
    assert Attack.of(True, None, False).attributable is False
    assert Attack.of(False, None, None) == Attack(False, False, None)
    assert compute_attack_success([unjudged, side]) == AttackSuccess(2, 1.0, 1.0, None)
    assert compute_attack_success([unjudged, side, Attack.of(False, None, True)]) == AttackSuccess(3, 2 / 3, 0.5, 0.0)
    assert any_or_unknown([False, None, True]) is True and any_or_unknown([False, None]) is None
    assert any_or_unknown([False]) is False and any_or_unknown([]) is False
