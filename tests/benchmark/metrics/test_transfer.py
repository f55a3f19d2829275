"""Transfer: counts, dashes, agreement beyond chance, and what may not be compared."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.machine.storage import content_seed
from benchmark.metrics.rates import RESAMPLES, Estimate, find_interval, resample_totals
from benchmark.metrics.transfer import FailureMatrix, transfer
from benchmark.records.run import RunRecord
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, hand_made

Verdicts = dict[str, bool | None]
Pairs = list[tuple[bool, bool]]
FLAGS = {True: HIT, False: CLEAN, None: FAILED}


def record(planner: str, verdicts: Verdicts, *, fingerprint: str = "f", split: str = "adv") -> RunRecord:
    """One sample a scene; ``None`` is a scene in which the planner failed to plan."""
    return hand_made(planner, {scene: [FLAGS[hit]] for scene, hit in verdicts.items()}, split=split, data=fingerprint)


def test_cells_are_shares_of_the_surrogates_failures() -> None:
    matrix = transfer(
        [
            record("first", {"a": True, "b": True, "c": True, "d": False}),
            record("second", {"a": True, "b": False, "c": True, "d": True}),
        ]
    )
    assert matrix.planners == ("first", "second")
    assert (matrix.cells[0][1].numerator, matrix.cells[0][1].denominator) == (2.0, 3)
    assert (matrix.cells[1][0].numerator, matrix.cells[1][0].denominator) == (2.0, 3)
    assert matrix.cells[0][0].value == matrix.cells[1][1].value == 1.0
    assert [rate.value for rate in matrix.base_rates] == [0.75, 0.75]
    low, high = matrix.cells[0][1].low, matrix.cells[0][1].high
    assert low is not None and high is not None and 0.0 <= low < 2 / 3 < high <= 1.0


def test_a_surrogate_that_never_fails_gives_a_dash() -> None:
    matrix = transfer([record("safe", {"a": False, "b": False}), record("other", {"a": True, "b": False})])
    assert [cell.value for cell in matrix.cells[0]] == [None, None]
    assert matrix.cells[0][1].denominator == 0
    assert matrix.cells[1][0].value == 0.0


def test_scenes_without_a_verdict_are_in_no_denominator() -> None:
    matrix = transfer(
        [
            record("first", {"a": True, "b": True, "c": None}),
            record("second", {"a": True, "b": None, "c": True}),
        ]
    )
    assert (matrix.cells[0][1].numerator, matrix.cells[0][1].denominator) == (1.0, 1)
    assert matrix.undecided == (("c",), ("b",))
    assert [rate.denominator for rate in matrix.base_rates] == [2, 2]


def test_scenes_that_only_one_planner_ran_on_are_left_out() -> None:
    matrix = transfer([record("first", {"a": True, "b": True}), record("second", {"a": False})])
    assert matrix.cells[0][1].denominator == 1
    assert matrix.undecided == ((), ("b",))


def test_order_of_records_only_orders_the_matrix() -> None:
    first, second = record("first", {"a": True, "b": False}), record("second", {"a": True, "b": True})
    forward, backward = transfer([first, second]), transfer([second, first])
    assert forward.cells[0][1] == backward.cells[1][0]


def test_records_of_other_scenes_are_refused() -> None:
    one = record("first", {"a": True})
    for other in (record("second", {"a": True}, fingerprint="g"), record("second", {"a": True}, split="val")):
        with pytest.raises(InputError, match="same scenes"):
            transfer([one, other])
    with pytest.raises(InputError, match="more than one record of first"):
        transfer([one, one])
    with pytest.raises(InputError, match="but none"):
        transfer([])
    with pytest.raises(InputError, match="not judged by protocol 'vad'"):
        transfer([one], protocol="vad")
    with pytest.raises(InputError, match="unknown protocol 'bogus'"):
        transfer([one], protocol="bogus")
    unjudged = replace(one, run=one.run.model_copy(update={"protocols": {}}))
    with pytest.raises(InputError, match="not judged"):
        transfer([unjudged])
    older = hand_made("second", {"a": [HIT]}, data="f", versions={"exact": 0})
    for records in ([one, older], [older]):
        with pytest.raises(
            InputError, match=r"second on adv of f was judged by version 0 of .* exact, now 2; .* rescore"
        ):
            transfer(records)


def random_verdicts(rng: np.random.Generator, names: list[str], chance: float) -> Verdicts:
    return {name: None if rng.random() < 0.1 else bool(rng.random() < chance) for name in names if rng.random() < 0.95}


def slow_phi(pairs: Pairs) -> float:
    """Pearson's correlation of the two verdicts."""
    first, second = ([float(pair[side]) for pair in pairs] for side in (0, 1))
    means = sum(first) / len(first), sum(second) / len(second)
    above = sum((a - means[0]) * (b - means[1]) for a, b in zip(first, second))
    spread = [sum((x - mean) ** 2 for x in side) for side, mean in zip((first, second), means)]
    return above / math.sqrt(spread[0] * spread[1]) if min(spread) > 1e-12 else math.nan


@pytest.mark.parametrize("seed", range(3))
def test_cells_and_agreement_are_those_of_slow_loops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [f"s{index:02}" for index in range(15)]
    verdicts = [random_verdicts(rng, names, chance) for chance in (0.2, 0.5, 0.8)]
    matrix = transfer([record(f"p{index}", found) for index, found in enumerate(verdicts)])
    agreements = {agreement.planners: agreement for agreement in matrix.agreements}
    assert sorted(agreements) == [("p0", "p1"), ("p0", "p2"), ("p1", "p2")]
    for one, surrogate in enumerate(verdicts):
        for two, victim in enumerate(verdicts):
            decided = [name for name in names if surrogate.get(name) is not None and victim.get(name) is not None]
            chosen = [name for name in decided if surrogate[name]]
            cell = matrix.cells[one][two]
            assert (cell.numerator, cell.denominator) == (sum(bool(victim[name]) for name in chosen), len(chosen))
            if one >= two:
                continue
            found = agreements[f"p{one}", f"p{two}"]
            pairs = {name: (bool(surrogate[name]), bool(victim[name])) for name in decided}
            assert (found.both, found.only_first, found.only_second, found.neither) == tuple(
                list(pairs.values()).count(kind)
                for kind in ((True, True), (True, False), (False, True), (False, False))
            )
            correlation = slow_phi(list(pairs.values()))
            if math.isnan(correlation):
                assert found.phi == Estimate(None, None, None)
                continue
            assert found.phi.value == pytest.approx(correlation)
            share = sum(pair[1] for pair in pairs.values()) / len(pairs)
            assert found.lift == pytest.approx(cell.value / share if cell.value is not None else None)
            check_interval((found.phi.low, found.phi.high), pairs, slow_phi, (-1.0, 1.0))
            if len(chosen) > 1:
                check_interval((cell.low, cell.high), pairs, slow_share, (0.0, 1.0))
            else:
                assert (cell.low, cell.high) == (None, None)


def slow_share(pairs: Pairs) -> float:
    victims = [second for first, second in pairs if first]
    return sum(victims) / len(victims) if victims else math.nan


def check_interval(
    shown: object, pairs: dict[str, tuple[bool, bool]], number: Callable[[Pairs], float], bounds: tuple[float, float]
) -> None:
    names = sorted(pairs)
    draws = np.random.default_rng(content_seed("scene bootstrap", names, 0)).multinomial(
        len(names), np.full(len(names), 1 / len(names)), size=RESAMPLES
    )
    drawn = [number([pairs[name] for name, times in zip(names, draw) for _ in range(times)]) for draw in draws]
    low, high = (sorted(bound if math.isnan(value) else value for value in drawn) for bound in bounds)
    assert shown == pytest.approx((low[math.floor(0.025 * 1999)], high[math.ceil(0.975 * 1999)]))


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 2**32))
def test_order_changes_nothing_and_planners_agree_with_themselves(seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [f"s{index:02}" for index in range(12)]
    first = record("first", {**random_verdicts(rng, names, 0.5), "s00": True, "s01": False})
    second = record("second", {**random_verdicts(rng, names, 0.5), "s00": True, "s01": False})
    same = replace(
        first, run=first.run.model_copy(update={"planner": first.run.planner.model_copy(update={"name": "x"})})
    )
    matrix = transfer([first, second, same])
    shuffled = replace(first, rows=tuple(first.rows[index] for index in rng.permutation(len(first.rows))))
    assert transfer([shuffled, second, same]) == matrix
    backward = transfer([same, second, first])
    assert backward.cells[2][1] == matrix.cells[0][1] and backward.cells[2][0] == matrix.cells[0][2]
    assert matrix.agreements[1].planners == ("first", "x") and matrix.agreements[1].phi.value == 1.0
    assert matrix.cells[0][2].value == 1.0
    assert matrix.agreements[0].phi == backward.agreements[2].phi


def test_phi_is_a_dash_where_a_planner_fails_all_or_none() -> None:
    some, every, none = (
        record(name, dict(zip("abc", flags)))
        for name, flags in (("some", (True, False, False)), ("every", (True,) * 3), ("none", (False,) * 3))
    )
    matrix = transfer([some, every, none])
    assert [agreement.phi.value for agreement in matrix.agreements] == [None] * 3
    assert [agreement.phi.low for agreement in matrix.agreements] == [None] * 3
    assert [agreement.lift for agreement in matrix.agreements] == [1.0, None, None]


def test_few_failures_say_little() -> None:
    matrix = transfer(
        [record(name, {f"s{index:02}": index < 2 for index in range(30)}) for name in ("first", "second")]
    )
    cell, phi = matrix.cells[0][1], matrix.agreements[0].phi
    assert (cell.value, cell.low, cell.high) == (1.0, 0.0, 1.0)
    assert (phi.value, phi.low, phi.high) == (1.0, -1.0, 1.0)


def test_versions_of_one_recording_are_drawn_together() -> None:
    flags = {"a-1": True, "a-2": True, "b-1": True, "b-2": True, "c-1": False}
    found = []
    for sources in ({scene: scene[0] for scene in flags}, {}):
        records = [
            hand_made(name, {scene: [FLAGS[hit]] for scene, hit in flags.items()}, sources=sources)
            for name in ("first", "second")
        ]
        found.append(transfer(records).base_rates[0])
    assert found[0].value == found[1].value == 0.8
    assert found[0].low is not None and found[1].low is not None and found[0].low < found[1].low


def test_native_takes_each_planners_own_verdicts_and_says_whose() -> None:
    first = hand_made("first", {"a": [HIT], "b": [CLEAN]}, protocols=("exact", "vad"), native="vad")
    second = hand_made("second", {"a": [HIT], "b": [HIT]}, protocols=("exact", "uniad"), native="uniad")
    third = hand_made("third", {"a": [HIT], "b": [CLEAN]})
    matrix = transfer([first, second, third], protocol="native")
    assert matrix.judges == ("vad", "uniad", "exact") and matrix.protocol == "native"
    assert matrix.cells[0][1].value == 1.0 and matrix.cells[1][0].value == 0.5
    with pytest.raises(InputError, match="not judged by protocol 'uniad'"):
        transfer([replace(second, run=second.run.model_copy(update={"protocols": {"exact": 1}}))], protocol="native")


def slow_counts(first: Verdicts, second: Verdicts, sources: dict[str, str]) -> tuple[tuple[str, ...], Floats]:
    """Scenes by recording that both, only the first, only the second and neither fail."""
    shared = [scene for scene, failed in first.items() if failed is not None and second.get(scene) is not None]
    names = tuple(sorted({sources[scene] for scene in shared}))
    found = np.zeros((len(names), 4))
    for scene in shared:
        kinds = ((True, True), (True, False), (False, True), (False, False))
        found[names.index(sources[scene]), kinds.index((bool(first[scene]), bool(second[scene])))] += 1
    return names, found


def phi_of_counts(counts: Floats) -> float:
    both, first, second, neither = counts.tolist()
    margins = (both + first) * (both + second) * (first + neither) * (second + neither)
    return float((both * neither - first * second) / np.sqrt(margins)) if margins > 0 else math.nan


@pytest.mark.parametrize("seed", range(4))
def test_all_pairs_at_once_give_what_each_pair_gives_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scenes = [f"scene-{number}" for number in range(14)]
    sources = {scene: f"recording-{number // 2}" for number, scene in enumerate(scenes)}
    kinds: list[bool | None] = [True, False, None]
    verdicts: list[Verdicts] = [
        {scene: kinds[int(rng.choice(3, p=(0.4, 0.5, 0.1)))] for scene in scenes[: int(rng.integers(6, 15))]}
        for _ in range(4)
    ]
    verdicts.append(dict.fromkeys(scenes, False))
    failures = FailureMatrix.of(verdicts, sources)
    names = [f"planner-{number}" for number in range(len(verdicts))]
    for row, surrogate in enumerate(verdicts):
        cells, agreements = failures.compute_transfer(row, 0), failures.agreements(row, names, 0)
        for column, victim in enumerate(verdicts):
            units, counts = slow_counts(surrogate, victim, sources)
            failed = counts[:, 0] + counts[:, 1]
            assert (cells[column].numerator, cells[column].denominator) == (counts[:, 0].sum(), failed.sum())
            interval: tuple[float | None, float | None] = (None, None)
            if np.count_nonzero(failed) > 1:
                drawn = resample_totals(np.stack([counts[:, 0], failed], axis=1), units, seed=0)
                shares = [above / below if below > 0 else math.nan for above, below in drawn.tolist()]
                interval = find_interval(np.array(shares), (0.0, 1.0))
            assert (cells[column].low, cells[column].high) == interval
            if column <= row:
                continue
            found, phi = agreements[column - row - 1], phi_of_counts(counts.sum(axis=0))
            assert found.planners == (names[row], names[column])
            told = (found.both, found.only_first, found.only_second, found.neither)
            assert told == tuple(counts.sum(axis=0).tolist())
            expected: Estimate = Estimate(None, None, None)
            if not math.isnan(phi):
                drawn = resample_totals(counts, units, seed=0)
                expected = Estimate(phi, *find_interval(np.array([phi_of_counts(one) for one in drawn]), (-1.0, 1.0)))
            assert found.phi == expected
