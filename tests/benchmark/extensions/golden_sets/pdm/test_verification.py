"""`challenger-bench verify pdm`: official answers are met, one changed verdict is found, broken sets are refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.golden_sets.pdm import BUILT_IN, GOLDEN
from tests.benchmark.extensions.golden_sets.golden_pdm import golden_arrays
from tests.benchmark.verification.damaged import refuses

OFFICIAL = Path(__file__).resolve().parents[6] / "shared" / "golden" / "pdm"


def stored() -> dict[str, Any]:
    with np.load(BUILT_IN / "crossing.npz") as arrays:
        return {name: arrays[name] for name in arrays.files}


def verified(folder: Path, **changed: Any) -> list[str]:
    """Quantities that fail on the built-in set with some arrays replaced; ``None`` leaves one out."""
    arrays = {name: value for name, value in {**stored(), **changed}.items() if value is not None}
    np.savez(folder / "changed.npz", **arrays)
    return [check.quantity for check in GOLDEN.verify(folder) if not check.ok]


def test_the_built_in_set_agrees_and_is_what_the_slow_version_says() -> None:
    assert all(check.ok for check in GOLDEN.verify())
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
    checks = GOLDEN.verify(OFFICIAL)
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


def test_a_damaged_set_is_one_sentence(tmp_path: Path) -> None:
    """A set may have any number of scenes, but must have one."""
    (tmp_path / "set").mkdir()
    verified(tmp_path / "set")
    refuses(GOLDEN.verify, tmp_path / "set", "changed.npz", "lqr_states", tmp_path / "work")


@pytest.mark.parametrize(
    "changed",
    [
        {"vehicle": np.ones(6)},
        {"poly_layer": np.full(18, 9)},
        {"obj_offset": np.array([0, 20, 14])},
        {"plan_names": np.array(["other"] * 10)},
        {"pair": np.arange(2)},
    ],
)
def test_arrays_that_do_not_fit_are_one_sentence(tmp_path: Path, changed: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=str(tmp_path)):
        verified(tmp_path, **changed)
