"""The one reader of golden sets and the one form in which they are declared."""

import gzip
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.verification.checks import Comparison
from benchmark.verification.golden_sets import GoldenFolder, GoldenSet, unpack_gzip
from tests.benchmark.verification.damaged import refuses, said


def _compare_speeds(comparison: Comparison, folder: GoldenFolder) -> None:
    stored = folder.arrays("numbers.npz")
    comparison.numbers("speed (m/s)", np.arange(3.0), stored.floats("speed", 3))
    comparison.same("hits", [True, False], stored.verdicts("hits", 2))
    if folder.has("facts.json"):
        comparison.numbers("facts: mass (kg)", 5.0, folder.facts("facts.json")["mass"])


FAMILY = GoldenSet("speeds", ("numbers.npz",), (_compare_speeds,), {"speed (m/s)": 0.1, "facts: *": 1e-3})


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    folder = tmp_path / "speeds"
    folder.mkdir()
    np.savez(folder / "numbers.npz", speed=np.array([0.0, 1.0, 2.05]), hits=np.array([True, False]))
    return folder


def test_what_is_declared_is_compared(whole: Path) -> None:
    (whole / "facts.json").write_text('{"mass": 5}')
    assert [(check.quantity, check.ok, check.tolerance) for check in FAMILY.verify(whole)] == [
        ("speed (m/s)", True, 0.1),
        ("hits", True, 0.0),
        ("facts: mass (kg)", True, 1e-3),
    ]


def test_a_damaged_set_is_one_sentence(whole: Path, tmp_path: Path) -> None:
    refuses(FAMILY.verify, whole, "numbers.npz", "speed", tmp_path / "work")
    assert f"did you mean {whole}" in said(FAMILY.verify, tmp_path)


@pytest.mark.parametrize("facts", ["", "{", "{}", "[]", "null", "[3]", '{"mass": NaN}', '{"mass": "x"}'])
def test_facts_of_another_form_are_one_sentence(whole: Path, facts: str) -> None:
    (whole / "facts.json").write_text(facts)
    said(FAMILY.verify, whole)


@pytest.mark.parametrize(
    "damage",
    [
        lambda data: data[: len(data) // 2],
        lambda data: data[:20] + bytes(len(data) - 40) + data[-20:],
        lambda data: b"not compressed",
        lambda data: gzip.compress(bytes(65 << 20)),
    ],
)
def test_a_damaged_compressed_file_is_one_sentence(tmp_path: Path, damage: Callable[[bytes], bytes]) -> None:
    path, data = tmp_path / "numbers.json.gz", gzip.compress(np.random.default_rng(0).bytes(4096))
    path.write_bytes(data)
    assert len(unpack_gzip(path)) == 4096
    path.write_bytes(damage(data))
    with pytest.raises(InputError, match="is damaged"):
        unpack_gzip(path)


def test_a_number_that_is_absent_never_agrees(whole: Path) -> None:
    (whole / "facts.json").write_text('{"mass": null}')
    assert [check.quantity for check in FAMILY.verify(whole) if not check.ok] == ["facts: mass (kg)"]


def test_without_a_set_in_the_package_one_must_be_given() -> None:
    with pytest.raises(InputError, match="verify speeds needs --golden"):
        FAMILY.verify()


def test_a_quantity_that_is_not_in_the_table_is_a_defect_of_ours(whole: Path) -> None:
    with pytest.raises(AssertionError, match="no speed"):
        GoldenSet("speeds", ("numbers.npz",), (_compare_speeds,)).verify(whole)


def test_equality_and_series_need_the_same_shape() -> None:
    comparison = Comparison({"*": 1.0})
    for ours, golden in (([1, 2], [1]), ([[1]], [1])):
        with pytest.raises(ValueError, match="shapes"):
            comparison.same("equal", ours, golden)
    assert not comparison.series("series", np.zeros(3), np.zeros(0))
    (check,) = comparison.checks()
    assert not check.ok and check.count == 1
