"""The effect of the adversary: paired by recording and key frame, every recording weighs once."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.metrics.effect import AdversaryEffect, compute_effect
from benchmark.metrics.rates import (
    FEWEST_DIFFERING_OF_TEN,
    FEWEST_RECORDINGS,
    PairedDifference,
    compute_paired_difference,
)
from benchmark.metrics.unchanged_records import find_unchanged_record
from benchmark.records.run import RunRecord
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.effect import effect_table
from tests.benchmark.metrics.made_attacks import attacked, told

ADVERSARIAL = {"A-1": "f...", "A-2": "ff..", "B-1": "F..f"}
UNCHANGED = {"A": "....", "B": "F..."}
"""f: touches the adversary, F: a bystander, .: nothing; worked by hand."""


def ran(scenes: Mapping[str, str], split: str = "adv") -> RunRecord:
    sources = {scene: scene.partition("-")[0] for scene in scenes}
    return told(attacked("p", scenes, dict.fromkeys(scenes, True), split=split, sources=sources))


def effect(adversarial: Mapping[str, str], unchanged: Mapping[str, str]) -> AdversaryEffect:
    found = compute_effect(ran(adversarial), ran(unchanged, "val"))
    assert found is not None and found.paired is not None
    return found


def test_the_worked_example() -> None:
    found = effect(ADVERSARIAL, UNCHANGED)
    assert found.touched is not None and found.paired is not None and found.at_fault == found.touched
    # Samples of A weigh one half each, those of B one: (3 x 0.5 + 1) / (8 x 0.5 + 4).
    assert found.touched[2] == pytest.approx(2.5 / 8)
    assert found.paired.adversarial == pytest.approx(3.5 / 8)
    assert found.paired.unchanged == pytest.approx(1 / 8)
    assert found.paired.difference.value == pytest.approx(2.5 / 8)
    assert found.paired.ratio == pytest.approx(3.5)
    assert (found.paired.new_others, found.paired.lost_others) == (0.0, 0.0)
    assert (found.paired.pairs, found.paired.unpaired, found.recordings) == (12, 0, 2)


def test_who_evades_into_a_bystander_has_a_new_contact_and_who_is_spared_one_has_lost_it() -> None:
    found = effect({"A-1": "F...", "B-1": "f..."}, {"A": "....", "B": "F.F."}).paired
    assert found is not None
    assert found.new_others == pytest.approx(1 / 8) and found.lost_others == pytest.approx(2 / 8)


def test_what_has_no_pair_is_counted_and_named_and_a_ratio_over_zero_does_not_exist() -> None:
    found = effect({"A-1": "f...", "C-1": "f..."}, {"A": "..", "B": "...."}).paired
    assert found is not None
    assert (found.pairs, found.unpaired, found.unpaired_scenes) == (2, 6, ("C-1",))
    found = effect({"A-1": "f..."}, {"A": "...."}).paired
    assert found is not None and found.ratio is None and found.difference.value == pytest.approx(0.25)


def test_a_record_that_does_not_say_whom_contacts_are_with_has_dashes_and_no_zeros() -> None:
    old = attacked("p", ADVERSARIAL, dict.fromkeys(ADVERSARIAL, True))
    assert compute_effect(old, None) is None
    table = effect_table(DataSetRuns("d", [old]))
    assert table is not None and set(table.rows[0][2:]) == {"–"}
    assert any("older records lack the objects touched" in note for note in table.notes)


letters = st.text("fF.", min_size=4, max_size=4)


@settings(max_examples=6, deadline=None)
@given(st.lists(st.tuples(letters, letters, letters), min_size=5, max_size=8))
def test_a_second_variant_that_is_the_same_changes_no_number_and_no_interval(
    recordings: list[tuple[str, str, str]],
) -> None:
    unchanged = {f"R{place}": known for place, (known, _, _) in enumerate(recordings)}
    once = {f"R{place}-{v}": text for place, (_, *own) in enumerate(recordings) for v, text in enumerate(own)}
    twice = {f"{name}{copy}": text for name, text in once.items() for copy in "xy"}
    one, two = effect(once, unchanged), effect(twice, unchanged)
    assert one.paired is not None and two.paired is not None
    assert two.touched == pytest.approx(one.touched)
    for name in ("value", "low", "high"):
        known = getattr(one.paired.difference, name)
        assert getattr(two.paired.difference, name) == (None if known is None else pytest.approx(known))


def test_too_few_recordings_that_differ_give_no_interval_and_say_how_many_would() -> None:
    weights = np.full(10, 34.0)
    few = compute_paired_difference(np.array([3.0, 2.0, *[0.0] * 8]), weights)
    assert (few.low, few.high, few.differing) == (None, None, 2) and few.value == pytest.approx(5 / 340)
    assert few.enough == FEWEST_DIFFERING_OF_TEN * 5
    assert compute_paired_difference(np.zeros(10), weights).enough is None
    assert compute_paired_difference(np.full(3, 2.0), weights[:3]).enough == FEWEST_RECORDINGS
    assert compute_paired_difference(np.zeros(0), np.zeros(0)).value is None


@pytest.mark.parametrize(
    ("recordings", "differing", "enough"),
    [(5, 4, None), (5, 3, 7), (7, 4, None), (7, 3, 12), (9, 4, None), (10, 4, 13), (10, 5, None), (30, 4, 38)],
)
def test_four_of_fewer_than_ten_recordings_must_differ_and_five_of_more(
    recordings: int, differing: int, enough: int | None
) -> None:
    def found(count: int, unlike: int) -> PairedDifference:
        sums = np.array([*np.linspace(1.0, 4.0, unlike), *[0.0] * (count - unlike)])
        return compute_paired_difference(sums, np.full(count, 30.0))

    told = found(recordings, differing)
    assert (told.low is None, told.enough) == (enough is not None, enough)
    if enough is not None:
        # What is named does, and one fewer does not.
        fewer, named = (found(number, number * differing // recordings) for number in (enough - 1, enough))
        assert fewer.low is None and named.low is not None


def test_the_table_says_in_words_how_many_recordings_differ() -> None:
    many = {f"{name}-1": "f..." if name in "AB" else "...." for name in "ABCDEFG"}
    for adversarial, said in (
        ({"A-1": "f..."}, "only 1 of 1 recordings differs, too few"),
        (many, "only 2 of 7 recordings differ, too"),
    ):
        unchanged = ran({scene[0]: "...." for scene in adversarial}, "val")
        table = effect_table(DataSetRuns("d", [ran(adversarial), unchanged]))
        assert table is not None and sum(said in note for note in table.notes) == 1


def test_the_interval_is_that_of_t_over_recordings_of_equal_length() -> None:
    sums, weights = np.array([2.0, 0.0, 5.0, 1.0, 3.0, 0.0]), np.full(6, 30.0)
    found, means = compute_paired_difference(sums, weights), sums / 30.0
    reach = 2.5705818 * means.std(ddof=1) / np.sqrt(6)
    assert (found.low, found.high) == pytest.approx((means.mean() - reach, means.mean() + reach), rel=1e-6)


def test_the_partner_is_of_the_same_planner_and_has_most_of_the_recordings() -> None:
    def of(record: RunRecord, **facts: object) -> RunRecord:
        planner = record.run.planner.model_copy(update=facts)
        return replace(record, run=record.run.model_copy(update={"planner": planner}))

    adversarial, val = ran(ADVERSARIAL), ran(UNCHANGED, "val")
    part, rendered = ran({"A": "...."}, "val"), ran(UNCHANGED, "val-r")
    assert find_unchanged_record(adversarial, [part, val, adversarial]) is val
    assert find_unchanged_record(adversarial, [val, rendered]) is val
    seeing = [of(each, miniature=True) for each in (adversarial, val, rendered)]
    assert find_unchanged_record(seeing[0], [seeing[2], seeing[1]]) is seeing[2]
    assert find_unchanged_record(adversarial, [of(val, weights_sha256="0" * 64)]) is None


def test_an_ego_that_reacts_is_paired_with_the_same_driver_undisturbed_and_with_nobody_else() -> None:
    driven, undisturbed = ran(ADVERSARIAL, "adv-ego-careful"), ran(UNCHANGED, "val-r-ego-careful")
    others = [ran(UNCHANGED, split) for split in ("val", "val-r", "val-r-ego-idm")]
    assert find_unchanged_record(driven, [*others, undisturbed]) is undisturbed
    assert find_unchanged_record(driven, others) is None
    assert find_unchanged_record(ran(ADVERSARIAL), [undisturbed]) is None
