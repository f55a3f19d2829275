"""Transfer: counts, dashes, and what may not be compared."""

from dataclasses import replace
from pathlib import Path

import pytest

from benchmark.errors import InputError
from benchmark.records import DataFacts, PlannerFacts, RunFacts, RunRecord, summarise
from benchmark.transfer import transfer
from tests.benchmark.test_records import row


def record(planner: str, verdicts: dict[str, bool | None], *, fingerprint: str = "f", split: str = "adv") -> RunRecord:
    """One sample a scene; ``None`` is a scene in which the planner failed to plan."""
    rows = tuple(
        row(scene, 0, collides=bool(hit), status="failed" if hit is None else "ok") for scene, hit in verdicts.items()
    )
    run = RunFacts(
        schema=1,
        planner=PlannerFacts(name=planner, privileged=False),
        data=DataFacts(name="d", version="v", fingerprint=fingerprint),
        split=split,
        scenes=list(verdicts),
        scenes_in_split=len(verdicts),
        status="complete",
        protocols={"exact": 1},
        seed=0,
        config={},
        environment={},
        files={},
    )
    return RunRecord(Path(planner), run, rows, summarise(rows, {"exact": 1}, seed=0))


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
    with pytest.raises(InputError, match="there are none"):
        transfer([])
    with pytest.raises(InputError, match="not judged by protocol 'vad'"):
        transfer([one], protocol="vad")
    unjudged = replace(one, run=one.run.model_copy(update={"protocols": {}}))
    with pytest.raises(InputError, match="not judged"):
        transfer([unjudged])
