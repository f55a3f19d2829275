"""Severity of plans: the fast kernel against the definition, and plans that one can work out by hand."""

from typing import Any

import numpy as np
import pytest

from benchmark.fairness.plan_severity import measure_plan_severities
from benchmark.geometry import Bools, Floats, ego_footprints
from benchmark.protocols.exact import ExactProtocol
from benchmark.truth import SampleTruth
from tests.benchmark.fairness.slow_plans import encounters, first_contact
from tests.benchmark.protocols.protocol_cases import made_truth

STEPS = 0.5 * np.arange(7)
CAR = (4.6, 1.9)
NOSE_M = 0.5 + 0.5 * 4.084
"""From the lidar's origin to the ego's front."""
AHEAD = np.pi / 2
STANDING = ego_footprints(np.array([0.0, 0.0, AHEAD]))


def car(x: float, y: float, vx: float, vy: float, yaw: float = AHEAD, size: tuple[float, float] = CAR) -> Floats:
    """(7, 5) a body that keeps its velocity; x right, y forward."""
    return np.column_stack([x + vx * STEPS, y + vy * STEPS, np.tile([*size, yaw], (7, 1))])


def truth(*others: Floats, adversaries: tuple[int, ...] = (0,), **changes: Any) -> SampleTruth:
    """A sample around which others move."""
    named = frozenset(f"i-{row}" for row in adversaries)
    place = np.array([100.0, 50.0, 0.0])
    boxes = np.array(others).reshape(-1, 7, 5)
    return made_truth(boxes, np.zeros((6, 3)), name="i", lidar_pose=place, adversaries=named, **changes)


def straight(speed: float) -> Floats:
    return np.column_stack([np.zeros(6), speed * STEPS[1:]])


def one(sample: SampleTruth, plan: Floats, lanes: Any = None) -> Any:
    return measure_plan_severities([sample], plan[None], lanes)[0]


def test_running_into_a_standing_car() -> None:
    """10 m/s, 12.3 m free: contact at 1.3 s, the first tenth of a second after 1.23 s; the masses share 10 m/s."""
    free = 12.3
    found = one(truth(car(0.0, NOSE_M + free + 2.3, 0.0, 0.0)), straight(10.0))
    assert found.near is None
    contact = found.contact
    assert contact.time_s == 1.3 and contact.agent == "i-0" and contact.adversary
    assert contact.kind == "stopped_track" and contact.at_fault is True
    assert contact.impact_speed_m_s == pytest.approx(10.0)
    assert contact.delta_v_ego_m_s == pytest.approx(10.0 * 1800 / 3400)
    assert contact.delta_v_other_m_s == pytest.approx(10.0 * 1600 / 3400)
    assert contact.fatal_probability == pytest.approx((10.0 * 1800 / 3400 / 31.74) ** 4, abs=1e-6)


def test_being_run_into_from_behind_is_nobodys_fault_here() -> None:
    found = one(truth(car(0.0, -15.0, 0.0, 14.0)), straight(4.0))
    assert found.contact.kind == "rear" and found.contact.at_fault is False


def test_who_stands_is_not_to_blame() -> None:
    found = one(truth(car(0.0, 15.0, 0.0, -9.0, yaw=-AHEAD)), straight(0.0))
    assert found.contact.kind == "stopped_ego" and found.contact.at_fault is False
    assert found.contact.impact_speed_m_s == pytest.approx(9.0)


def test_closing_in_on_a_slower_adversary_without_contact() -> None:
    """5 m/s faster and 20 m away: after 3 s 5 m are left, time to contact 1 s, and BTN = 25 / (2 * 5 * 7.593)."""
    found = one(truth(car(0.0, NOSE_M + 20.0 + 2.3, 0.0, 5.0)), straight(10.0))
    near = found.near
    assert found.contact is None
    assert near.least_gap_m == pytest.approx(5.0) and near.least_ttc_s == pytest.approx(1.0)
    # Below 1.5 s at 2.6, ... 3.0 s, by 0.1, ... 0.5 s; at 2.5 s exactly 1.5 s are left.
    assert near.tet_s in (pytest.approx(0.5), pytest.approx(0.6)) and near.tit_s2 == pytest.approx(0.15)
    assert near.max_btn == pytest.approx(25.0 / (2 * 5.0) / (0.774 * 9.81))
    # The leader's rear leaves a place about 2 s before the ego's front gets there, at 10 m/s.
    assert near.pet_s == pytest.approx(1.0, abs=0.11)


def test_near_is_about_adversaries_and_contact_about_anybody() -> None:
    by_the_way = car(6.0, 10.0, 0.0, 8.0)
    other = car(0.0, 14.0, 0.0, 0.0)
    found = one(truth(by_the_way, other), straight(8.0))
    assert found.contact.agent == "i-1" and not found.contact.adversary and found.near is None
    passing = one(truth(by_the_way, other, adversaries=()), straight(1.0))
    assert passing.contact is None and passing.near is None
    assert one(truth(by_the_way, other), straight(1.0)).near is not None
    assert one(truth(adversaries=()), straight(8.0)).contact is None


def test_of_several_adversaries_each_number_is_that_of_the_worst() -> None:
    first, second = car(0.0, 40.0, 0.0, 5.0), car(3.0, 5.0, 0.0, 8.0)
    alone = [one(truth(each), straight(8.0)).near for each in (first, second)]
    both = one(truth(first, second, adversaries=(0, 1)), straight(8.0)).near
    assert both.least_gap_m == min(each.least_gap_m for each in alone) == alone[1].least_gap_m
    assert both.least_ttc_s == alone[0].least_ttc_s and alone[1].least_ttc_s is None
    assert both.max_btn == max(each.max_btn for each in alone)


def test_who_touches_the_ego_in_the_present_never_counts() -> None:
    """`exact` counts it; nobody can plan a way out of it."""
    found = one(truth(car(0.0, 3.0, 0.0, 0.0)), straight(8.0))
    assert found.contact is None and found.near is None


def test_who_is_to_blame_for_a_contact_at_the_side_only_a_map_tells() -> None:
    class Map:
        def __init__(self, unsure: bool) -> None:
            self.verdict, self.asked = unsure, np.zeros((0, 5))

        def unsure(self, boxes: Floats) -> Bools:
            self.asked = boxes
            return np.full(len(boxes), self.verdict)

    # It comes from the right into the ego's flank.
    sample = truth(car(5.0, -1.0, -2.0, 8.0))
    assert one(sample, straight(8.0)).contact.kind == "lateral"
    assert one(sample, straight(8.0)).contact.at_fault is None
    for verdict in (True, False):
        road = Map(verdict)
        assert one(sample, straight(8.0), road).contact.at_fault is verdict
        # The ego drives east from 100, 50: what is forward for the lidar is x there.
        found = one(sample, straight(8.0), road).contact
        assert road.asked[0] == pytest.approx([100.0 + 8.0 * found.time_s + 0.5, 50.0, 4.084, 1.85, 0.0], abs=1e-6)
    known = Map(True)
    one(truth(car(0.0, 20.0, 0.0, 0.0)), straight(10.0), known)
    assert not len(known.asked)


def _random(rng: np.random.Generator, count: int) -> tuple[list[SampleTruth], Floats]:
    truths, plans = [], []
    for _ in range(count):
        others, there = [], []
        for _ in range(int(rng.integers(1, 5))):
            place, speed, turn = rng.uniform(-25, 25, 2), rng.uniform(0, 12), rng.uniform(-np.pi, np.pi)
            size = (rng.uniform(0.6, 9.0), rng.uniform(0.5, 2.6))
            track = car(place[0], place[1], 0.0, 0.0, turn, size)
            heading = turn + np.cumsum(rng.uniform(-0.3, 0.3, 7))
            track[:, 0] += np.cumsum(speed * 0.5 * np.cos(heading))
            track[:, 1] += np.cumsum(speed * 0.5 * np.sin(heading))
            track[:, 4] = heading
            others.append(track)
            there.append(rng.random(7) < rng.choice([0.5, 1.0]))
        moving = ["vehicle.car", "vehicle.truck", "human.pedestrian.adult"]
        choices = [moving, moving, [*moving, "movable_object.barrier"], ["static_object.bicycle_rack"]]
        categories = tuple(str(rng.choice(names)) for names, _ in zip(choices, others))
        truths.append(truth(*others, adversaries=(0, 1), categories=categories, annotated=np.array(there)))
        speed, bend = rng.uniform(0, 14), rng.uniform(-0.4, 0.4)
        heading = np.pi / 2 + np.cumsum(np.full(6, bend))
        step = speed * 0.5 * rng.uniform(0.4, 1.2, 6)
        plans.append(np.cumsum(np.column_stack([step * np.cos(heading), step * np.sin(heading)]), axis=0))
    return truths, np.array(plans)


def test_all_plans_at_once_are_what_each_is_alone_by_the_definition() -> None:
    truths, plans = _random(np.random.default_rng(26), 120)
    found = measure_plan_severities(truths, plans)
    kinds, nears = set(), 0
    for sample, plan, severity in zip(truths, plans, found, strict=True):
        expected = first_contact(sample, plan)
        contact = severity.contact
        if expected is None or contact is None:
            assert contact is None and expected is None
        else:
            kinds.add(contact.kind)
            assert [contact.agent, contact.kind] == list(expected[1:3])
            assert contact.time_s == pytest.approx(expected[0])
            assert contact.impact_speed_m_s == pytest.approx(expected[3], abs=2e-6)
            continue
        slow = encounters(sample, plan)
        assert (severity.near is None) == (not slow)
        if severity.near is not None:
            nears += 1
            near = severity.near
            assert near.least_gap_m == pytest.approx(min(each.min_gap or 0.0 for each in slow), abs=2e-6)
            ttcs = [each.min_ttc for each in slow if each.min_ttc is not None]
            assert near.least_ttc_s == (pytest.approx(min(ttcs), abs=2e-6) if ttcs else None)
            assert near.tet_s == pytest.approx(max(each.tet for each in slow))
            assert near.tit_s2 == pytest.approx(max(each.tit for each in slow), abs=2e-6)
            pets = [each.pet for each in slow if each.pet is not None]
            assert near.pet_s == (pytest.approx(min(pets)) if pets else None)
            assert near.max_btn == pytest.approx(max(each.max_btn or 0.0 for each in slow), abs=2e-6)
    assert nears > 20 and kinds >= {"front", "lateral", "stopped_track"}


def test_a_plan_is_measured_alike_in_any_company(monkeypatch: pytest.MonkeyPatch) -> None:
    truths, plans = _random(np.random.default_rng(27), 12)
    monkeypatch.setattr("benchmark.fairness.plan_severity._SAMPLES_AT_ONCE", 5)
    together = measure_plan_severities(truths, plans)
    assert [one(sample, plan) for sample, plan in zip(truths, plans)] == together
    assert measure_plan_severities([], np.zeros((0, 6, 2))) == []


def test_contact_is_that_of_exact_but_for_the_present() -> None:
    truths, plans = _random(np.random.default_rng(28), 60)
    exact = ExactProtocol().evaluate(truths, plans)
    differs = 0
    for sample, severity, time, hit in zip(
        truths, measure_plan_severities(truths, plans), exact.facts["first_contact_s"], exact.facts["hit"], strict=True
    ):
        mine = (None, None) if severity.contact is None else (severity.contact.time_s, severity.contact.agent)
        if mine != (time, hit):
            differs += 1
            assert first_contact(sample, np.zeros((6, 2))) is not None or hit is not None
    assert differs < 8
