"""Checks, their report, and how errors are gathered."""

import json

import numpy as np
import pytest

from benchmark.verification.checks import Check, Comparison, format_report


def test_nan_and_nothing_compared_are_no_success() -> None:
    assert Check("a", 1e-7, 1e-6, 3).ok
    assert Check("a", 0.0, 0.0, 3).ok
    for bad in (Check("a", 2e-6, 1e-6, 3), Check("a", float("nan"), 1e-6, 3), Check("a", 0.0, 1.0, 0)):
        assert not bad.ok


def test_report_has_a_line_for_each_and_counts() -> None:
    text = format_report([Check("speed (m/s)", 1e-9, 1e-6, 1200), Check("hits", 2, 0, 7, "worst in a.npz")])
    head, first, second, note, last = text.splitlines()
    assert head.split() == ["quantity", "largest", "error", "allowed", "values"]
    assert first.startswith("ok ") and first.endswith("1,200")
    assert second.startswith("FAIL") and note == "hits: worst in a.npz."
    assert last == "1 of 2 quantities agree"


def test_json_has_no_nan() -> None:
    values = Check("a", float("nan"), 1e-6, 3).as_json()
    assert json.loads(json.dumps(values, allow_nan=False))["error"] is None
    assert values["ok"] is False


def test_the_largest_error_of_all_files_counts_and_is_placed() -> None:
    comparison = Comparison()
    for where, error in (("one", 1.0), ("two", 3.0), ("three", 2.0)):
        comparison.numbers("x", np.array([5.0, 5.0 + error]), np.array([5.0, 5.0]), 0.5, where=where)
    (check,) = comparison.checks()
    assert (check.error, check.count, check.note) == (3.0, 6, "worst in two")


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_never_forgotten(bad: float) -> None:
    comparison = Comparison()
    for ours in (1.0, bad, 1.0):
        comparison.numbers("x", np.array([ours]), np.array([1.0]), 0.5)
        comparison.numbers("angle", np.array([ours]), np.array([1.0]), 0.5, angle=True)
    assert not any(check.ok for check in comparison.checks())


def test_angles_count_modulo_a_turn() -> None:
    comparison = Comparison()
    comparison.numbers("x", np.array([np.pi - 1e-9]), np.array([-np.pi]), 1e-8, angle=True)
    assert comparison.checks()[0].ok


def test_wrong_verdicts_add_up() -> None:
    comparison = Comparison()
    comparison.verdicts("hits", np.array([True, False]), where="one")
    comparison.verdicts("hits", np.array([True, True]), where="two")
    comparison.note("hits", "three files")
    (check,) = comparison.checks()
    assert (check.error, check.tolerance, check.count) == (3, 0, 4)
    assert check.note == "worst in two; three files"


def test_shapes_that_differ_are_a_defect_and_not_an_error_of_zero() -> None:
    with pytest.raises(ValueError, match="shapes"):
        Comparison().numbers("x", np.zeros((2, 1)), np.zeros(2), 1.0)
