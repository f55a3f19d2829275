"""The golden set of the protocols in the package: what its program makes, and with the cases that matter."""

from pathlib import Path

import numpy as np
import pytest

from benchmark.extensions.golden_sets.protocols import BUILT_IN, verify_protocols
from benchmark.machine.storage import read_json
from tests.benchmark.extensions.golden_sets import golden_protocols
from tests.benchmark.extensions.golden_sets.golden_protocols import CASES, files_of, write
from tests.benchmark.extensions.golden_sets.protocols.test_verification import failures, load


def test_the_built_in_set_agrees() -> None:
    checks = verify_protocols(None)
    assert not failures(checks)
    assert len(checks) == 69
    assert checks[0].note == "3 files"


@pytest.mark.parametrize("name", CASES)
def test_the_built_in_set_is_what_its_program_makes(name: str) -> None:
    for file, made in files_of(name, CASES[name]()).items():
        stored = load(BUILT_IN / file)
        assert stored.keys() == made.keys()
        for array, values in made.items():
            if values.dtype.kind == "f":
                assert stored[array] == pytest.approx(values, abs=1e-5), array
            else:
                assert (stored[array] == values).all(), array


def test_the_built_in_set_has_the_cases_that_matter() -> None:
    official = {name: load(BUILT_IN / f"{name}_official.npz") for name in CASES}
    inputs = {name: load(BUILT_IN / f"{name}.npz") for name in CASES}
    joined = {key: np.concatenate([part[key].ravel() for part in official.values()]) for key in official["gtcol-ghost"]}
    for array in ("uniad_obj_box_col", "uniad_obj_col", "vad_step_obj_box_col", "vad_step_obj_col", "sd_obj_box_col"):
        assert 0 < joined[array].sum() < joined[array].size / 2, array
    assert (joined["vad_obj_box_col"] != joined["vad23_obj_box_col"]).any()
    ghost = official["gtcol-ghost"]
    for prefix in ("uniad", "vad", "sd"):
        masked = ghost[f"{prefix}_raw_box"] & ghost[f"{prefix}_gt_box"][:, None]
        assert masked[ghost["sample_valid"]].sum() >= 10
    assert 0 < joined["sample_valid"].mean() < 1
    assert np.abs(inputs["scene-crossing"]["plans"]).max() > 50
    grid = np.unpackbits(official["scene-crossing"]["uniad_seg_bits"], axis=-1).reshape(-1, 200, 200)
    inside = official["scene-crossing"]["uniad_seg_bits"].reshape(len(grid), -1).min(axis=1) < 255
    assert grid[inside][:, :, [0, 199]].any() or grid[inside][:, [0, 199]].any()


def test_the_program_writes_files_that_are_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    parts = {"inputs": "", "official": "_official", "exact": "_exact"}
    arrays = {
        f"{part}/{name}": array
        for part, ending in parts.items()
        for name, array in load(BUILT_IN / f"gtcol-ghost{ending}.npz").items()
    }
    monkeypatch.setattr(golden_protocols, "CASES", {"gtcol-ghost": lambda: arrays})
    write(tmp_path)
    checks = verify_protocols(tmp_path)
    assert not failures(checks) and checks[0].note == "1 file"
    assert set(read_json(tmp_path / "manifest.json")["files"]) == {path.name for path in tmp_path.glob("*.npz")}
