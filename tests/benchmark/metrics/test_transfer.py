"""Transfer: counts, dashes, agreement beyond chance, and what may not be compared."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.geometry import Floats
from benchmark.metrics.rates import Estimate, find_interval, resample_totals
from benchmark.metrics.transfer import transfer
from benchmark.records.run import RunRecord
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, hand_made

Verdicts = dict[str, bool | None]
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


def test_scenes_without_a_verdict_and_of_one_planner_alone_are_in_no_denominator() -> None:
    first, second = (
        record("first", {"a": True, "b": True, "c": None}),
        record("second", {"a": True, "b": None, "c": True}),
    )
    matrix = transfer([first, second])
    assert (matrix.cells[0][1].numerator, matrix.cells[0][1].denominator) == (1.0, 1)
    assert matrix.undecided == (("c",), ("b",))
    assert [rate.denominator for rate in matrix.base_rates] == [2, 2]
    matrix = transfer([record("first", {"a": True, "b": True}), record("second", {"a": False})])
    assert matrix.cells[0][1].denominator == 1 and matrix.undecided == ((), ("b",))


def test_records_of_other_scenes_are_refused() -> None:
    one, older = record("first", {"a": True}), hand_made("second", {"a": [HIT]}, data="f", versions={"exact": 0})
    unjudged = replace(one, run=one.run.model_copy(update={"protocols": {}}))
    of_older = r"second on adv of f was judged by version 0 of .* exact, now 2; .* rescore"
    for records, protocol, said in (
        ([one, record("second", {"a": True}, fingerprint="g")], "exact", "same scenes"),
        ([one, record("second", {"a": True}, split="val")], "exact", "same scenes"),
        ([one, one], "exact", "more than one record of first"),
        ([], "exact", "but none"),
        ([one], "vad", "not judged by protocol 'vad'"),
        ([one], "bogus", "unknown protocol 'bogus'"),
        ([unjudged], "exact", "not judged"),
        ([one, older], "exact", of_older),
        ([older], "exact", of_older),
    ):
        with pytest.raises(InputError, match=said):
            transfer(records, protocol=protocol)


@pytest.mark.parametrize("seed", range(3))
def test_order_changes_nothing_and_planners_agree_with_themselves(seed: int) -> None:
    rng, kinds, records = np.random.default_rng(seed), (True, False, None), []
    for name in ("first", "second"):
        verdicts = {f"s{place:02}": kinds[int(rng.choice(3, p=(0.4, 0.5, 0.1)))] for place in range(2, 12)}
        records.append(record(name, {**verdicts, "s00": True, "s01": False}))
    first, second = records
    planner = first.run.planner.model_copy(update={"name": "x"})
    same = replace(first, run=first.run.model_copy(update={"planner": planner}))
    matrix, backward = transfer([first, second, same]), transfer([same, second, first])
    shuffled = replace(first, rows=tuple(first.rows[index] for index in rng.permutation(len(first.rows))))
    assert transfer([shuffled, second, same]) == matrix
    assert backward.cells[2][1] == matrix.cells[0][1] and backward.cells[2][0] == matrix.cells[0][2]
    assert matrix.agreements[1].planners == ("first", "x") and matrix.agreements[1].phi.value == 1.0
    assert matrix.cells[0][2].value == 1.0 and matrix.agreements[0].phi == backward.agreements[2].phi


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


@pytest.mark.parametrize("seed", range(3))
def test_cells_and_agreements_are_those_that_each_pair_gives_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scenes = [f"scene-{number:02}" for number in range(14)]
    sources = {scene: f"recording-{number // 2}" for number, scene in enumerate(scenes)}
    kinds: list[bool | None] = [True, False, None]
    verdicts: list[Verdicts] = [
        {scene: kinds[int(rng.choice(3, p=(0.4, 0.5, 0.1)))] for scene in scenes[: int(rng.integers(6, 15))]}
        for _ in range(4)
    ]
    # Who fails all or none agrees with nobody beyond chance.
    verdicts += [dict.fromkeys(scenes, False), dict.fromkeys(scenes, True)]
    names = [f"planner-{number}" for number in range(len(verdicts))]
    matrix = transfer(
        [
            hand_made(
                name,
                {scene: [FLAGS[hit]] for scene, hit in found.items()},
                sources={each: sources[each] for each in found},
            )
            for name, found in zip(names, verdicts)
        ]
    )
    agreements = {agreement.planners: agreement for agreement in matrix.agreements}
    assert len(agreements) == 15
    for (row, surrogate), (column, victim) in product(enumerate(verdicts), repeat=2):
        units, counts = slow_counts(surrogate, victim, sources)
        failed, cell = counts[:, 0] + counts[:, 1], matrix.cells[row][column]
        assert (cell.numerator, cell.denominator) == (counts[:, 0].sum(), failed.sum())
        interval: tuple[float | None, float | None] = (None, None)
        if np.count_nonzero(failed) > 1:
            drawn = resample_totals(np.stack([counts[:, 0], failed], axis=1), units, seed=0)
            shares = [above / below if below > 0 else math.nan for above, below in drawn.tolist()]
            interval = find_interval(np.array(shares), (0.0, 1.0))
        assert (cell.low, cell.high) == interval
        if column <= row:
            continue
        found, phi, whole = agreements[names[row], names[column]], phi_of_counts(counts.sum(axis=0)), counts.sum(axis=0)
        assert (found.both, found.only_first, found.only_second, found.neither) == tuple(whole.tolist())
        share = (whole[0] + whole[2]) / whole.sum()
        assert found.lift == (pytest.approx(cell.value / share) if cell.value is not None and share else None)
        expected: Estimate = Estimate(None, None, None)
        if not math.isnan(phi):
            drawn = resample_totals(counts, units, seed=0)
            expected = Estimate(phi, *find_interval(np.array([phi_of_counts(one) for one in drawn]), (-1.0, 1.0)))
        assert found.phi == expected
