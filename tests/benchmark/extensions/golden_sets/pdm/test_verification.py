"""`challenger-bench verify pdm`: official answers are met, one changed verdict is found, broken sets are refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.golden_sets.pdm import BUILT_IN, verify_pdm
from tests.benchmark.extensions.golden_sets.golden_pdm import golden_arrays

OFFICIAL = Path(__file__).resolve().parents[6] / "shared" / "golden" / "pdm"


def stored() -> dict[str, Any]:
    with np.load(BUILT_IN / "crossing.npz") as arrays:
        return {name: arrays[name] for name in arrays.files}


def verified(folder: Path, **changed: Any) -> list[str]:
    """Quantities that fail on the built-in set with some arrays replaced; ``None`` leaves one out."""
    arrays = {name: value for name, value in {**stored(), **changed}.items() if value is not None}
    np.savez(folder / "changed.npz", **arrays)
    return [check.quantity for check in verify_pdm(folder) if not check.ok]


def test_the_built_in_set_agrees_and_is_what_the_slow_version_says() -> None:
    assert all(check.ok for check in verify_pdm())
    arrays, again = stored(), golden_arrays()
    assert set(arrays) == set(again)
    for name, values in arrays.items():
        if values.dtype.kind == "f":
            # Motions are those of least squares: processors differ in their last digits.
            assert again[name] == pytest.approx(values, abs=1e-7), name
        else:
            assert np.array_equal(again[name], values), name


def test_the_built_in_set_has_every_verdict() -> None:
    arrays = stored()
    for name, values in {"nc": {0, 0.5, 1}, "ddc": {0, 0.5, 1}, "dac": {0, 1}, "ttc": {0, 1}, "lk": {0, 1}}.items():
        assert set(arrays[f"lqr_{name}"].ravel().tolist()) == values
    assert set(arrays["lqr_ec"].ravel().tolist()) == set(arrays["lqr_hc"].ravel().tolist()) == {0.0, 1.0}
    assert len(np.unique(arrays["lqr_ep"])) > 3 and arrays["obj_removed"].any()


@pytest.mark.skipif(not OFFICIAL.is_dir(), reason="the official answers are not here")
def test_every_official_answer_is_met() -> None:
    checks = verify_pdm(OFFICIAL)
    assert len(checks) > 100 and [check.quantity for check in checks if not check.ok] == []
    by_name = {check.quantity: check for check in checks}
    assert by_name["lqr: NC"].count == by_name["direct: TTC"].count == 1190
    assert by_name["states (11 columns)"].tolerance == 1e-9 and by_name["lqr: HC extremes"].tolerance == 2e-8


@pytest.mark.parametrize(
    ("name", "quantities"),
    [
        ("lqr_nc", ["lqr: NC", "from plans: NC"]),
        ("direct_lk", ["direct: LK"]),
        ("lqr_ttc_step", ["lqr: TTC step", "from plans: TTC step"]),
        ("lqr_ec", ["lqr: EC", "from plans: EC"]),
        ("lqr_score", ["lqr: score", "from plans: score"]),
        ("human_dac", ["recorded driver"]),
        ("filtered_score", ["filtered score"]),
        ("obj_removed", ["objects removed"]),
    ],
)
def test_one_changed_answer_is_found(tmp_path: Path, name: str, quantities: list[str]) -> None:
    changed = stored()[name].copy()
    first = (0,) * changed.ndim
    changed[first] = ~changed[first] if changed.dtype == np.bool_ else changed[first] + 1
    assert verified(tmp_path, **{name: changed}) == quantities


def test_a_missing_and_an_invented_event_are_found(tmp_path: Path) -> None:
    events = stored()["lqr_nc_events"]
    assert verified(tmp_path, lqr_nc_events=events[1:]) == ["lqr: NC events", "from plans: NC events"]
    more = np.concatenate([events, [[1, 0, 0, 0, 3, 0]]])
    assert verified(tmp_path, lqr_nc_events=more) == ["lqr: NC events", "from plans: NC events"]


@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"plans": None}, "has no array plans"),
        ({"vehicle": np.ones(6)}, "is about a vehicle"),
        ({"lqr_states": np.zeros((2, 10, 31, 10))}, "has shape"),
        ({"poly_layer": np.full(18, 9)}, "do not fit together"),
        ({"obj_offset": np.array([0, 20, 14])}, "must rise"),
        ({"obj_key_valid": np.zeros((28, 7), np.bool_)}, "never annotated"),
        ({"plan_names": np.array(["other"] * 10)}, "names no plan recorded"),
        ({"pair": np.arange(2)}, "pairs"),
    ],
)
def test_sets_that_are_not_whole_are_refused(tmp_path: Path, changed: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        verified(tmp_path, **changed)


def test_a_folder_without_a_set_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="has no"):
        verify_pdm(tmp_path)
