"""Attack success and severity of records: what counts, what is unknown, and that unknown is never a zero."""

from dataclasses import replace

import numpy as np
import pytest

from benchmark.metrics.attacks import (
    attack_rates_to_json,
    collect_scene_attacks,
    compute_attack_rates,
    has_adversaries,
    has_severity,
)
from benchmark.metrics.rates import compute_ratios_over_scenes
from benchmark.metrics.split_reference_drivers import (
    collect_split_reference_drivers,
    compute_spread,
    summarise_contacts,
    summarise_near_passes,
)
from tests.benchmark.metrics.made_attacks import attacked
from tests.benchmark.records.hand_made_records import CLEAN, hand_made

CAREFUL = {"a": True, "b": False, "c": None, "d": True}


def test_three_readings_of_samples_and_of_scenes() -> None:
    record = attacked("p", {"a": "f.r.", "b": "F...", "c": "f...", "d": "r..."}, CAREFUL)
    found = compute_attack_rates(record)
    assert {name: (rate.numerator, rate.denominator) for name, rate in found.samples.items()} == {
        # The contact in scene b is with another than the adversary.
        "contact": (4, 16),
        "at_fault": (2, 16),
        # Scene c was not judged: none of its samples says anything, not even those without contact.
        "attributable": (1, 12),
    }
    assert {name: (rate.numerator, rate.denominator) for name, rate in found.scenes.items()} == {
        "contact": (3, 4),
        "at_fault": (2, 4),
        "attributable": (1, 3),
    }
    assert (found.bystander_samples.numerator, found.bystander_samples.denominator) == (1, 16)
    assert (found.bystander_scenes.numerator, found.bystander_scenes.denominator) == (1, 4)
    assert (found.judged, found.spared, found.unknown_fault) == (3, 2, 0)


def test_shared_and_unclear_fault_are_nobody_s_attack() -> None:
    found = compute_attack_rates(attacked("p", {"a": "su..", "b": "sf.r"}, {"a": True, "b": True}))
    assert (found.shared.numerator, found.unclear.numerator, found.shared.denominator) == (2, 1, 8)
    assert (found.samples["contact"].numerator, found.samples["at_fault"].numerator) == (5, 1)
    assert found.scenes["at_fault"].value == found.scenes["attributable"].value == 0.5


def test_what_is_unknown_in_a_scene_makes_it_unknown_unless_something_is_found() -> None:
    record = attacked("p", {"a": "?...", "b": "?f..", "c": "!...", "d": "!f.."}, dict.fromkeys("abcd", True))
    verdicts = {scene: tuple(attack.verdicts.values()) for scene, attack in collect_scene_attacks(record).items()}
    assert list(collect_scene_attacks(record)["a"].verdicts) == ["contact", "at_fault", "attributable"]
    unknown, found_there = (None, None, None), (True, True, True)
    assert verdicts == {"a": (True, None, None), "b": found_there, "c": unknown, "d": found_there}
    found = compute_attack_rates(record)
    # A record that does not say of all its contacts whose fault they are has no rate of it.
    assert found.unknown_fault == 2 and found.samples["contact"].denominator == 14
    told = (*found.samples.values(), *found.scenes.values(), found.shared, found.unclear)
    assert [rate.value is None for rate in told] == [False, True, True, False, True, True, True, True]


def test_where_the_careful_human_fares_no_better_nothing_is_attributed() -> None:
    record = attacked("p", {"a": "?...", "b": "!f..", "c": "!!!!"}, dict.fromkeys("abc", False))
    verdicts = [attack.verdicts["attributable"] for attack in collect_scene_attacks(record).values()]
    assert verdicts == [False, False, None]


def test_samples_whose_recording_ends_early_are_in_no_rate() -> None:
    record = attacked("p", {"a": "--f.", "b": "----"}, {"a": True, "b": True})
    found = compute_attack_rates(record)
    assert found.samples["contact"].denominator == 2
    assert found.scenes["contact"].denominator == 1


def test_intervals_draw_recorded_scenes() -> None:
    scenes = {"a1": "f...", "a2": "ff..", "b1": "....", "c1": "f..."}
    sources = {"a1": "a", "a2": "a", "b1": "b", "c1": "c"}
    found = compute_attack_rates(attacked("p", scenes, dict.fromkeys(scenes, True), sources=sources)).scenes["contact"]
    values = [[1.0], [1.0], [0.0], [1.0]]
    (expected,) = compute_ratios_over_scenes(np.array(values), np.ones((4, 1)), list(sources.values()), seed=0)
    assert found == expected and found.low is not None and found.low < 0.75


def test_older_records_do_not_say_how_severe_plans_are_and_others_may_judge_nothing() -> None:
    old = hand_made("p", {"a": [CLEAN]})
    assert not has_severity(old) and has_adversaries(old)
    assert has_severity(attacked("p", {"a": ".!"}, {"a": True}))
    assert not has_adversaries(hand_made("p", {"a": [CLEAN]}, split="val"))
    found = compute_attack_rates(attacked("p", {"a": "f.", "b": ".."}, {"a": None, "b": None}))
    assert found.samples["attributable"].value is None and found.scenes["attributable"].denominator == 0
    assert found.scenes["at_fault"].value == 0.5 and found.judged == 0


def test_distributions_over_contacts_and_near_passes() -> None:
    record = attacked("p", {"a": "fFr.", "b": "..-s", "c": "!..."}, dict.fromkeys("abc", True))
    found = summarise_contacts(record)
    assert (found.samples, found.faults) == (3, {"ego": 1, "other": 1, "shared": 1})
    assert found.kinds == {"front": 1, "rear": 1, "lateral": 1}
    assert found.impact_speed.median == 4.0 and found.impact_speed.worst_tenth == 10.0
    assert found.most_fatal == pytest.approx((5.0 / 31.74) ** 4)
    others = summarise_contacts(record, bystanders=True)
    assert (others.samples, others.faults, others.kinds) == (1, {"ego": 1}, {"front": 1})
    assert others.impact_speed.median == 20.0 and others.most_fatal == pytest.approx((10.0 / 31.74) ** 4)
    passes = summarise_near_passes(record)
    assert passes.samples == 6 and passes.ttc.samples == 5 and passes.ttc.worst_tenth == 1.0
    assert passes.gap.worst_tenth == 2.0 and passes.btn.worst_tenth == 1.5 and passes.critical == 3


def test_a_spread_is_made_of_values_that_are_there() -> None:
    values = [float(each) for each in range(1, 22)]
    assert compute_spread(values).median == 11.0 and compute_spread(values).worst_tenth == 19.0
    assert compute_spread(values, less_is_worse=True).worst_tenth == 3.0
    assert compute_spread([1.0, 2.0]).median == 2.0 and compute_spread([1.0, 2.0], less_is_worse=True).median == 1.0
    assert compute_spread([]) == compute_spread([], less_is_worse=True) and compute_spread([]).median is None


def test_the_ladder_of_a_split_is_that_of_the_record_that_says_most() -> None:
    scenes = {"a": "..", "b": "..", "c": ".."}
    poor = attacked("p", scenes, {"a": True, "b": None, "c": None})
    rich = attacked("q", scenes, {"a": True, "b": False, "c": True})
    ladder = collect_split_reference_drivers([poor, rich])["adv"]
    assert ladder.record is rich and ladder.scenes == 3
    assert ladder.survives["recorded"].value == 1.0 and ladder.survives["cc"].value == pytest.approx(2 / 3)
    assert ladder.margin.samples == 1 and ladder.margin.median == 1.25 and ladder.too_late == 0
    assert ladder.without_fault.value == pytest.approx(2 / 3) and ladder.unsolvable == 0
    assert ladder.gap.median == 2.0 and ladder.ttc.median == 3.0
    assert collect_split_reference_drivers([attacked("p", scenes, dict.fromkeys(scenes))]) == {}


def test_a_driver_that_a_record_does_not_name_is_unknown() -> None:
    record = attacked("p", {"a": "f...", "b": "f..."}, {"a": True, "b": True})
    facts = record.run.scene_facts
    assert facts["a"].judgement is not None
    some = facts["a"].judgement.model_copy(update={"survives": {"recorded": True}})
    changed = {**facts, "a": facts["a"].model_copy(update={"judgement": some})}
    poor = replace(record, run=record.run.model_copy(update={"scene_facts": changed}))
    assert collect_scene_attacks(poor)["a"].verdicts["attributable"] is None and compute_attack_rates(poor).judged == 1
    ladder = collect_split_reference_drivers([poor])["adv"]
    assert ladder.survives["cc"].denominator == 1 and ladder.survives["recorded"].denominator == 2


def test_machines_read_the_readings_of_splits_with_adversaries() -> None:
    said = attack_rates_to_json(attacked("p", {"a": "f...", "b": "...."}, {"a": True, "b": None}))["attack_success"]
    assert said["samples"]["contact"]["value"] == 0.125 and said["scenes"]["attributable"]["denominator"] == 1
    for split in ("val", "adv"):
        assert attack_rates_to_json(hand_made("p", {"a": [CLEAN]}, split=split)) == {}
