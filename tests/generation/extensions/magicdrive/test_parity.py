"""`verify model --model magicdrive`: the golden set in the repository, the whole one where it is, and damaged ones."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from benchmark.cli.app import app
from benchmark.errors import InputError
from benchmark.verification.checks import format_report
from generation.extensions.magicdrive.verification.comparison import PUBLISHED, verify_magicdrive

GOLDEN = Path(__file__).resolve().parents[3] / "golden" / "parity" / "magicdrive"
WHOLE = Path(__file__).resolve().parents[5] / "shared" / "golden" / "parity" / "magicdrive"


def copied(folder: Path, *kept: str) -> Path:
    """The golden set with a few outputs only, for speed."""
    shutil.copytree(GOLDEN, folder / "set")
    if kept:
        change_arrays(folder / "set" / "outputs.npz", lambda arrays: [arrays.pop(n) for n in {*arrays} - {*kept}])
    return folder / "set"


def change_arrays(path: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    with np.load(path) as stored:
        arrays = {name: stored[name].copy() for name in stored.files}
    change(arrays)
    np.savez(path, **arrays)


def change_manifest(golden: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    manifest = json.loads((golden / "manifest.json").read_text())
    change(manifest)
    (golden / "manifest.json").write_text(json.dumps(manifest))


def test_the_set_of_the_repository_agrees() -> None:
    checks = verify_magicdrive(GOLDEN)
    assert all(check.ok for check in checks), format_report(checks)
    assert len(checks) == 33 and not any("not compared" in check.note for check in checks)
    errors = {check.quantity: check.error for check in checks}
    assert errors["A.forward"] < 3e-5 and errors["A.sample_slice_cfg2_4steps"] < 1e-4


@pytest.mark.skipif(not WHOLE.is_dir(), reason="no shared material beside the repository")
def test_the_published_size_and_every_block_agree(tmp_path: Path) -> None:
    golden = copied(tmp_path, "A.forward")
    shutil.copy(WHOLE / "keys.json", golden)
    shutil.copy(WHOLE / "dev" / "taps.npz", golden)
    checks = {check.quantity: check for check in verify_magicdrive(golden)}
    assert all(check.ok for check in checks.values()), format_report([*checks.values()])
    assert checks[PUBLISHED].count == 1768 and "2,037,971,481 numbers" in checks[PUBLISHED].note
    assert len([name for name in checks if "blocks_" in name]) == 14


def test_wrong_numbers_are_found(tmp_path: Path) -> None:
    golden = copied(tmp_path, "A.enc.text", "A.enc.camera", "C.forward", "A.sample_timesteps")

    def spoil(arrays: dict[str, Any]) -> None:
        arrays["A.enc.text"][0, 3, 5] += 3e-4
        arrays["C.forward"] = np.roll(arrays["C.forward"], 1, axis=1)
        arrays["not_ours"] = np.zeros(3)

    change_arrays(golden / "outputs.npz", spoil)
    checks = {check.quantity: check for check in verify_magicdrive(golden)}
    assert {name for name, check in checks.items() if not check.ok} == {"A.enc.text", "C.forward"}
    assert checks["A.enc.text"].error == pytest.approx(3e-4, rel=0.05)
    assert "not compared: not_ours" in checks["names and shapes of tensors"].note


def test_another_network_is_not_filled(tmp_path: Path) -> None:
    golden = copied(tmp_path, "A.enc.text")
    keys = json.loads((golden / "keys_reduced.json").read_text())
    keys[0][1] = [95]
    (golden / "keys_reduced.json").write_text(json.dumps(keys))
    (check,) = [check for check in verify_magicdrive(golden) if "timesteps" not in check.quantity]
    assert not check.ok and check.error == 1 and "first: base_token" in check.note


DAMAGES: dict[str, Callable[[Path], Any]] = {
    "has no inputs.npz": lambda golden: (golden / "inputs.npz").unlink(),
    "complete npz file": lambda golden: (golden / "outputs.npz").write_bytes(b"PK"),
    "keys_reduced.json": lambda golden: (golden / "keys_reduced.json").unlink(),
    "overrides": lambda golden: change_manifest(golden, lambda m: m.pop("overrides")),
    "of MagicDriveDiT or": lambda golden: change_manifest(golden, lambda m: m["reduced_config"].update(num_heads=5)),
    "less than or equal": lambda golden: change_manifest(golden, lambda m: m["reduced_config"].update(depth=10**6)),
    "Schedule": lambda golden: (golden / "timesteps_30.json").write_text("[{}]"),
    "no array A.in.y": lambda golden: change_arrays(golden / "inputs.npz", lambda a: a.pop("A.in.y")),
    "wrong type": lambda golden: change_arrays(golden / "inputs.npz", lambda a: a.update({"A.in.cams": a["A.in.z"]})),
    "NaN or infinity": lambda golden: change_arrays(golden / "inputs.npz", lambda a: a["A.in.z"].fill(np.nan)),
    "stores no quantity": lambda golden: np.savez(golden / "outputs.npz", other=np.zeros(2)),
}


@pytest.mark.parametrize("message", DAMAGES)
def test_damaged_sets_are_refused(message: str, tmp_path: Path) -> None:
    golden = copied(tmp_path, "A.enc.text")
    DAMAGES[message](golden)
    with pytest.raises(InputError, match=message):
        verify_magicdrive(golden)


def test_the_command_says_which_and_how_closely(tmp_path: Path) -> None:
    arguments = ["verify", "model", "--model", "magicdrive", "--golden", str(copied(tmp_path, "A.enc.text"))]
    found = CliRunner().invoke(app, [*arguments, "--json"])
    assert found.exit_code == 0 and "A.enc.text" in found.stdout
    change_arrays(tmp_path / "set" / "outputs.npz", lambda arrays: arrays["A.enc.text"].fill(0.0))
    assert CliRunner().invoke(app, arguments).exit_code == 1
