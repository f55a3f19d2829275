"""Paired comparisons against loops that do the same slowly, and against what must be so."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import InputError
from benchmark.machine.storage import content_seed
from benchmark.metrics.rates import RESAMPLES
from benchmark.metrics.scores import map_scenes_to_sources, score_record
from benchmark.metrics.significance import PlannerComparison, SplitComparison, compare_planners, compare_splits
from benchmark.records.run import RunRecord
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, LATE, UNCOUNTED, hand_made

Scenes = dict[str, list[str | None]]
SIX = [f"s{index}" for index in range(6)]


def splits(baseline: RunRecord, other: RunRecord, protocol: str = "exact") -> SplitComparison:
    return compare_splits(score_record(baseline, protocol=protocol), score_record(other, protocol=protocol))


def planners(first: RunRecord, second: RunRecord, protocol: str = "exact") -> PlannerComparison:
    return compare_planners(score_record(first, protocol=protocol), score_record(second, protocol=protocol))


def random_scenes(rng: np.random.Generator, names: list[str], chance: float) -> Scenes:
    return {
        name: [str(rng.choice([HIT, LATE])) if rng.random() < chance else CLEAN for _ in range(rng.integers(2, 6))]
        for name in names
    }


def value_of(flags: str) -> float:
    """Average under ``exact`` of any contact up to 1, 2 and 3 s."""
    return sum("x" in flags[:steps] for steps in (2, 4, 6)) / 3


def slow_draws(names: list[str]) -> list[list[str]]:
    """The resamples as lists of names."""
    rng = np.random.default_rng(content_seed("scene bootstrap", names, 0))
    draws = rng.multinomial(len(names), np.full(len(names), 1 / len(names)), size=RESAMPLES)
    return [[name for name, times in zip(names, draw) for _ in range(times)] for draw in draws]


def slow_rate(scenes: Scenes, wanted: list[str]) -> float:
    values = [value_of(flags) for name in wanted for flags in scenes.get(name, []) if flags not in (FAILED, UNCOUNTED)]
    return sum(values) / len(values) if values else math.nan


def slow_ends(values: list[float], low: float, high: float) -> tuple[float, float]:
    below = sorted(low if math.isnan(value) else value for value in values)
    above = sorted(high if math.isnan(value) else value for value in values)
    return below[math.floor(0.025 * (len(values) - 1))], above[math.ceil(0.975 * (len(values) - 1))]


@pytest.mark.parametrize("seed", range(2))
def test_changes_between_splits_are_those_of_a_slow_bootstrap(seed: int) -> None:
    rng = np.random.default_rng(seed)
    val = random_scenes(rng, [*SIX, "only-val"], 0.3)
    # Two adversarial versions of some recordings, none of others, and one whose recording is not in val.
    versions = {f"{name}-{version}": name for name in SIX[:4] for version in range(2)} | {"lost-1": "lost-1"}
    adv = random_scenes(rng, list(versions), 0.6)
    found = splits(hand_made("p", val, split="val"), hand_made("p", adv))
    by_source: Scenes = {}
    for scene, source in versions.items():
        by_source.setdefault(source, []).extend(adv[scene])
    assert found.sources == tuple(SIX[:4])
    assert found.only_baseline == ("only-val", *SIX[4:])
    assert found.only_split == ("lost-1",)
    for comparison, names in (
        (found.paired["avg"], SIX[:4]),
        (found.everything["avg"], sorted([*SIX, "only-val", "lost-1"])),
    ):
        first, second = slow_rate(val, names), slow_rate(by_source, names)
        assert (comparison.first, comparison.second) == pytest.approx((first, second))
        pairs = [(slow_rate(val, draw), slow_rate(by_source, draw)) for draw in slow_draws(names)]
        assert comparison.difference.value == pytest.approx(second - first)
        ends = slow_ends([after - before for before, after in pairs], -1.0, 1.0)
        assert (comparison.difference.low, comparison.difference.high) == pytest.approx(ends)


def test_differences_between_planners_are_those_of_a_slow_bootstrap() -> None:
    rng = np.random.default_rng(5)
    first = random_scenes(rng, SIX, 0.3)
    second: Scenes = {name: [LATE if rng.random() < 0.5 else CLEAN for _ in flags] for name, flags in first.items()}
    found = planners(hand_made("a", first), hand_made("b", second)).by_horizon["avg"]
    drawn = [slow_rate(second, draw) - slow_rate(first, draw) for draw in slow_draws(SIX)]
    assert found.difference.value == pytest.approx(slow_rate(second, SIX) - slow_rate(first, SIX))
    assert (found.difference.low, found.difference.high) == pytest.approx(slow_ends(drawn, -1.0, 1.0))


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32), data=st.data())
def test_the_order_of_samples_and_scenes_changes_no_bit(seed: int, data: st.DataObject) -> None:
    rng = np.random.default_rng(seed)
    first, second = (hand_made(name, random_scenes(rng, SIX, 0.4)) for name in ("a", "b"))
    order = data.draw(st.permutations(range(len(first.rows))))
    shuffled = replace(first, rows=tuple(first.rows[index] for index in order))
    shuffled = replace(shuffled, run=shuffled.run.model_copy(update={"scenes": first.run.scenes[::-1]}))
    assert planners(shuffled, second) == planners(first, second)
    baseline = replace(second, run=second.run.model_copy(update={"split": "val", "planner": first.run.planner}))
    assert splits(baseline, shuffled) == splits(baseline, first)


def test_a_planner_does_not_differ_from_itself() -> None:
    scenes = random_scenes(np.random.default_rng(6), SIX, 0.5)
    for protocol in ("exact", "vad"):
        first, second = (hand_made(name, scenes, protocols=(protocol,)) for name in ("a", "b"))
        found = [one.difference for one in planners(first, second, protocol).by_horizon.values()]
        assert {(each.value, each.low, each.high) for each in found} == {(0.0, 0.0, 0.0)}


def test_what_both_splits_share_is_not_taken_for_chance() -> None:
    """Half of the recordings are hard in both; the adversary adds one contact to every scene of four samples."""
    hard = {f"s{index:02}": HIT if index % 2 else CLEAN for index in range(20)}
    val: Scenes = {name: [flags, flags, flags, CLEAN] for name, flags in hard.items()}
    adv: Scenes = {f"{name}-1": [flags, flags, flags, HIT] for name, flags in hard.items()}
    paired = splits(hand_made("p", val, split="val"), hand_made("p", adv)).paired["avg"]
    assert paired.difference.value == pytest.approx(0.25)
    assert (paired.difference.low, paired.difference.high) == pytest.approx((0.25, 0.25))


def test_ten_versions_of_a_recording_are_not_ten_observations() -> None:
    rng = np.random.default_rng(1)
    names = [f"s{index:02}" for index in range(12)]
    val = random_scenes(rng, names, 0.3)
    adv = random_scenes(rng, names, 0.6)
    once = {f"{name}-0": flags for name, flags in adv.items()}
    often = {f"{name}-{version}": flags for name, flags in adv.items() for version in range(10)}
    baseline = hand_made("p", val, split="val")
    one, ten = splits(baseline, hand_made("p", once)), splits(baseline, hand_made("p", often))
    few, many = one.paired["avg"].difference, ten.paired["avg"].difference
    assert (many.low, many.high) == pytest.approx((few.low, few.high))


def test_a_sample_that_either_failed_on_is_in_neither_rate_and_scenes_of_one_alone_are_named() -> None:
    first = hand_made("a", {"s0": [HIT, CLEAN, FAILED, CLEAN], "s1": [CLEAN, UNCOUNTED]})
    second = hand_made("b", {"s0": [CLEAN, CLEAN, HIT, FAILED], "s1": [CLEAN, UNCOUNTED]})
    found = planners(first, second)
    assert (found.samples, found.failed, found.unshared) == (3, 2, ())
    average = found.by_horizon["avg"]
    assert (average.first, average.second) == pytest.approx((1 / 3, 0.0))
    nothing = planners(hand_made("a", {"s0": [FAILED]}), hand_made("b", {"s0": [HIT]})).by_horizon["avg"]
    assert nothing.first is None and nothing.second is None and nothing.difference.value is None
    found = planners(hand_made("a", {"s0": [HIT], "s1": [HIT]}), hand_made("b", {"s1": [CLEAN], "s2": [HIT]}))
    assert found.unshared == ("s0", "s2") and found.samples == 1 and found.failed == 0
    difference = found.by_horizon["avg"].difference
    assert difference.value == -1.0 and difference.low is None


def test_where_a_scene_comes_from_is_taken_from_the_record_and_else_from_its_name() -> None:
    val = hand_made("p", {"scene-1": [CLEAN], "scene-1-b": [CLEAN], "scene-12": [CLEAN]}, split="val")
    adv = {"scene-1-b-77": [HIT], "scene-1-c": [HIT], "scene-12": [HIT], "scene-123": [HIT], "other": [HIT]}
    by_name = splits(val, hand_made("p", adv))
    assert by_name.sources == ("scene-1", "scene-1-b", "scene-12")
    assert by_name.only_split == ("other", "scene-123") and by_name.only_baseline == ()
    told = hand_made("p", adv, sources={"other": "scene-12", "scene-1-b-77": "scene-1"})
    assert map_scenes_to_sources(told)["other"] == "scene-12"
    found = splits(val, told)
    assert found.sources == ("scene-1", "scene-12")
    assert found.only_baseline == ("scene-1-b",) and found.only_split == ("scene-123",)
    rendered = hand_made("p", {"r1": [CLEAN]}, split="val-r", sources={"r1": "scene-12"})
    assert splits(rendered, told).sources == ("scene-12",)


def test_native_compares_under_each_planners_own_protocol() -> None:
    both = ("exact", "sparsedrive", "vad")
    val = hand_made("p", {"s0": [LATE], "s1": [CLEAN]}, split="val", protocols=both, native="sparsedrive")
    adv = hand_made("p", {"s0": [HIT], "s1": [LATE]}, protocols=both, native="sparsedrive")
    found = splits(val, adv, "native")
    assert found.protocol == "sparsedrive"
    assert found.everything["3s"].first == pytest.approx(1 / 12)
    other = hand_made("q", {"s0": [HIT], "s1": [LATE]}, protocols=both, native="vad")
    with pytest.raises(InputError, match="same data, split and protocol"):
        planners(adv, other, "native")


def test_what_does_not_compare_is_refused() -> None:
    scenes: Scenes = {"s0": [CLEAN], "s1": [HIT]}
    val, adv = hand_made("p", scenes, split="val"), hand_made("p", scenes)
    unknown = replace(adv, run=adv.run.model_copy(update={"protocols": {"gone": 1}}))
    for record, protocol, said in (
        (hand_made("p", scenes, versions={"exact": 0}), "exact", r"p on adv of d was judged by version 0 .* rescore"),
        (adv, "vad", "was not judged by protocol 'vad'; run challenger-bench rescore"),
        (unknown, "gone", "which is not installed"),
    ):
        with pytest.raises(InputError, match=said):
            score_record(record, protocol=protocol)
    with pytest.raises(InputError, match="in planner"):
        splits(val, hand_made("q", scenes))
    with pytest.raises(InputError, match="different weights"):
        splits(val, hand_made("p", scenes, weights="1" * 64))
    with pytest.raises(InputError, match="same data, split and protocol"):
        planners(val, hand_made("q", scenes))


def test_golden_numbers() -> None:
    rng = np.random.default_rng(9)
    names = [f"s{index:02}" for index in range(25)]
    val, adv = random_scenes(rng, names, 0.05), random_scenes(rng, [f"{name}-1" for name in names], 0.3)
    found = splits(hand_made("p", val, split="val"), hand_made("p", adv)).everything["avg"]
    difference = found.difference
    assert (difference.value, difference.low, difference.high) == pytest.approx(
        (0.09528214616096206, 0.02303016132803367, 0.17043212113889894), rel=1e-12
    )
