"""VAD against the numbers of the published code, and `verify model` on damaged sets."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.extensions.golden_sets.models import verify_model
from adapters.extensions.golden_sets.parity_set import ParityManifest, ParitySet, compare_frame
from adapters.extensions.golden_sets.tensors import OUTLIERS, Quantity, Tolerance
from adapters.extensions.golden_sets.vad import EXACT
from benchmark.errors import InputError
from benchmark.verification.checks import Check, Comparison, format_report
from benchmark.verification.golden_sets import GoldenArrays

PARITY = Path(__file__).resolve().parents[5] / "shared" / "golden" / "parity"
needs_parity = pytest.mark.skipif(not PARITY.is_dir(), reason="no shared material beside the repository")


def copy(model: str, folder: Path, frames: int) -> Path:
    """A set with the first frames only."""
    (folder / "dev").mkdir(parents=True)
    shutil.copy(PARITY / model / "keys.json", folder)
    names = ["manifest.json", "inputs.npz", *(f"outputs_frame{frame}.npz" for frame in range(frames))]
    for name in names:
        shutil.copy(PARITY / model / "dev" / name, folder / "dev")
        (folder / "dev" / name).chmod(0o644)
    return folder


def change_arrays(path: Path, change: Callable[[dict[str, Any]], Any]) -> None:
    with np.load(path) as stored:
        arrays = {name: stored[name].copy() for name in stored.files}
    change(arrays)
    np.savez(path, **arrays)


@pytest.mark.slow
@needs_parity
def test_two_frames_of_the_tiny_network(tmp_path: Path) -> None:
    """The second frame sees the first; all four frames, and the base network, are for `verify model`."""
    golden = copy("vad_tiny", tmp_path, frames=2)

    def spoil(arrays: dict[str, Any]) -> None:
        arrays["plan"][3, 1] += 0.002
        arrays["all_traj_cls_scores_last"][0, 7, 2] += 0.1
        arrays["not_ours"] = np.zeros(3)
        tied = int(np.argmin(-np.diff(arrays["dec_scores_3d"])))
        for name in ("dec_boxes_3d", "dec_scores_3d", "dec_labels_3d", "dec_trajs_3d"):
            arrays[name][[tied, tied + 1]] = arrays[name][[tied + 1, tied]]

    change_arrays(golden / "dev" / "outputs_frame1.npz", spoil)
    checks = {check.quantity: check for check in verify_model("vad-tiny", golden)}
    failed = {name for name, check in checks.items() if not check.ok}
    assert failed == {"plan", OUTLIERS}, format_report(list(checks.values()))
    assert checks["plan"].error == pytest.approx(0.002, abs=1e-4)
    assert "not_ours" in checks["backbone0 (of its spread)"].note
    assert "dev, frame 1" in checks["plan"].note


def _hand_made(tmp_path: Path, **arrays: Any) -> ParitySet:
    np.savez(tmp_path / "outputs_frame0.npz", **arrays)
    stored = GoldenArrays.read(tmp_path / "outputs_frame0.npz")
    tensors = {"table": {"shape": [1, 4, 3], "stride": 5}, "list": {"shape": [4]}}
    image = {"shape": [1, 3, 32, 32], "valid_rows": 32}
    manifest = ParityManifest.model_validate({"salt": "", "image": image, "scene_tokens": ["a"], "tensors": tensors})
    return ParitySet(tmp_path, manifest, {}, stored, [stored])


def _compared(golden: ParitySet, **ours: Quantity) -> list[Check]:
    comparison = Comparison()
    compare_frame(comparison.at("frame 0"), golden, 0, ours)
    return comparison.checks()


def test_samples_and_statistics_are_both_compared(tmp_path: Path) -> None:
    table = np.arange(12.0).reshape(4, 3)
    statistics = np.array([table.mean(), table.std(), 11.0])
    golden = _hand_made(tmp_path, table__sub=table.reshape(-1)[::5], table__stats=statistics)
    exact = Tolerance(1e-3, of_spread=False)
    assert [check.ok for check in _compared(golden, table=Quantity(table, exact))] == [True]
    between = table.copy()
    between[0, 1] += 1.0
    (check,) = _compared(golden, table=Quantity(between, exact))
    assert not check.ok and check.error == pytest.approx(abs(float(between.std() - table.std())))
    for wrong in (np.full((4, 3), np.nan), np.zeros((4, 3))):
        assert not any(check.ok for check in _compared(golden, table=Quantity(wrong, exact)))
        some = _compared(golden, table=Quantity(wrong, Tolerance(1e-3, share=0.5)))
        assert not any(check.ok for check in some)
    assert [check.ok for check in _compared(golden, table=Quantity(table.T, exact))] == [False]
    with pytest.raises(LookupError):
        _compared(golden, other=Quantity(table, exact))


def test_only_what_is_undecided_and_wrong_is_left_out_and_lists_have_their_length(tmp_path: Path) -> None:
    table = np.arange(12.0).reshape(4, 3)
    golden = _hand_made(tmp_path, table=table[None], list=np.arange(4.0))
    flipped, undecided = table + [[0], [0], [5], [0]], np.array([False, False, True, True])
    lost = np.where(flipped > table, np.nan, table)
    for values, unsure, ok in ((flipped, undecided, True), (flipped, ~undecided, False), (lost, undecided, False)):
        (check,) = _compared(golden, table=Quantity(values, EXACT, unsure))
        assert check.ok is ok
        assert not ok or (check.count == 9 and check.note.startswith("3 too close to call left out in frame 0"))
    for length in (3, 4):
        (check,) = _compared(golden, list=Quantity(np.arange(float(length)), EXACT, listed=True))
        assert check.ok is (length == 4) and ("another length" in check.note) is (length == 3)


@needs_parity
def test_another_network_is_not_filled(tmp_path: Path) -> None:
    checks = verify_model("vad-base", copy("vad_tiny", tmp_path, frames=1))
    assert len(checks) == 1 and not checks[0].ok and "first: " in checks[0].note


def test_unknown_models_and_absent_sets(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="choose one of vad-tiny"):
        verify_model("vad", tmp_path)
    for folder in (tmp_path, tmp_path / "absent"):
        with pytest.raises(InputError, match="golden set"):
            verify_model("vad-tiny", folder)


def changed_manifest(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], Any]:
    def damage(golden: Path) -> None:
        path = golden / "dev" / "manifest.json"
        manifest = json.loads(path.read_text())
        change(manifest)
        path.write_text(json.dumps(manifest))

    return damage


def changed_inputs(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], Any]:
    return lambda golden: change_arrays(golden / "dev" / "inputs.npz", change)


DAMAGES: dict[str, Callable[[Path], Any]] = {
    "scene_tokens": changed_manifest(lambda m: m.pop("scene_tokens")),
    "IndexError": changed_manifest(lambda m: m.update(scene_tokens=[])),
    "SHA-256": changed_manifest(lambda m: m["image"].update(valid_rows=20)),
    "ValueError": changed_manifest(lambda m: m["image"].update(shape=[6, 3, 190, 320])),
    "6 cameras": changed_manifest(lambda m: m["image"].update(shape=[5, 3, 192, 320], sha256=[])),
    "complete npz file": lambda golden: (golden / "dev" / "outputs_frame0.npz").write_bytes(b"PK" * 50),
    "no array can_bus": changed_inputs(lambda a: a.pop("can_bus")),
    "NaN or infinity": changed_inputs(lambda a: a["lidar2img"].__setitem__(0, np.nan)),
    "out of bounds": changed_inputs(lambda a: a.update(can_bus=a["can_bus"][:0])),
    "keys.json": lambda golden: (golden / "keys.json").unlink(),
    "TypeError": lambda golden: (golden / "keys.json").write_text("[1, 2]"),
}


@needs_parity
@pytest.mark.parametrize("message", DAMAGES)
def test_damaged_sets_are_refused(message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    golden = copy("vad_tiny", tmp_path, frames=1)
    DAMAGES[message](golden)
    # What is damaged here is found before weights matter.
    monkeypatch.setattr("adapters.extensions.golden_sets.parity_set.fill_network", lambda *_: None)
    with pytest.raises(InputError, match=message):
        verify_model("vad-tiny", golden)
