"""`challenger-bench verify protocols`: agrees with honest sets, notices changed protocols, refuses damaged files."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmark import geometry
from benchmark.extensions.golden_sets.protocols import BUILT_IN, GOLDEN
from benchmark.geometry import Floats, box_corners
from benchmark.protocols import PROTOCOLS, ProtocolOutcomes, raster, sparsedrive, uniad, vad
from benchmark.protocols.stacked_truths import StackedTruths
from benchmark.verification.checks import Check

SHARED = Path(__file__).resolve().parents[6] / "shared" / "golden" / "protocols"
Arrays = dict[str, NDArray[Any]]


def load(path: Path) -> Arrays:
    with np.load(path) as stored:
        return {name: stored[name] for name in stored.files}


def change(path: Path, **changes: NDArray[Any] | None) -> None:
    arrays = {name: array for name, array in (load(path) | changes).items() if array is not None}
    np.savez_compressed(path, **arrays)


def failures(checks: list[Check]) -> set[str]:
    return {check.quantity for check in checks if not check.ok}


def copied_scene(name: str, tmp_path: Path) -> Path:
    """A copy of one scene of the built-in set."""
    folder = tmp_path / "protocols"
    folder.mkdir()
    for path in BUILT_IN.glob(f"{name}*.npz"):
        shutil.copy(path, folder)
    return folder


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    return copied_scene("gtcol-ghost", tmp_path)


@pytest.mark.skipif(not SHARED.is_dir(), reason="the golden sets are not beside this checkout")
def test_the_official_verdicts_agree() -> None:
    checks = {check.quantity: check for check in GOLDEN.verify(SHARED)}
    assert not failures(list(checks.values()))
    assert all(
        check.error == 0 for quantity, check in checks.items() if "rates" not in quantity and check.tolerance == 0
    )
    assert checks["uniad obj_box_col"].count >= 12_390


def unmasked(self: Any, truths: Any, plans: Floats) -> ProtocolOutcomes:
    outcomes = next(KEPT[kind] for kind in type(self).__mro__ if kind in KEPT)(self, truths, plans)
    return ProtocolOutcomes(
        outcomes.step("before_mask"), outcomes.l2, outcomes.valid, outcomes.counted, outcomes.steps, outcomes.facts
    )


KEPT = {kind: kind.evaluate for kind in (uniad.UniADProtocol, vad.VADProtocol, sparsedrive.SparseDriveProtocol)}


def without_points(self: Any, truths: StackedTruths) -> NDArray[np.bool_]:
    return truths.annotated[:, 1:]


def floor_polygons(boxes: Floats) -> NDArray[np.int32]:
    return np.asarray(np.floor((50.0 + box_corners(boxes)) / 0.5), np.int32)


@pytest.mark.parametrize(
    ("scene", "where", "name", "value", "noticed"),
    [
        ("scene-crossing", uniad, "VEHICLES", uniad.VEHICLES - {"vehicle.bicycle"}, "uniad raster cells"),
        ("scene-crossing", uniad, "VEHICLES", uniad.VEHICLES | {"vehicle.emergency.police"}, "uniad raster cells"),
        ("scene-crossing", uniad, "round_polygons", floor_polygons, "uniad obj_box_col"),
        ("scene-crossing", vad, "SIDE_M", 20.0, "vad raster cells"),
        ("scene-crossing", vad, "AHEAD_M", 60.0, "vad raster cells"),
        ("gtcol-ghost", raster, "EGO_BLOCK", raster.EGO_BLOCK + 1, "vad obj_box_col"),
        ("scene-crossing", raster, "EGO_BLOCK", raster.EGO_BLOCK[:-4], "uniad obj_box_col"),
        ("scene-standing", sparsedrive, "STANDING_M", 0.05, "sparsedrive before the mask"),
        ("scene-standing", geometry, "EGO_BOX_FROM_LIDAR_M", 0.0, "diffusiondrive obj_box_col"),
        (
            "scene-crossing",
            sparsedrive.SparseDriveProtocol,
            "counted_objects",
            without_points,
            "sparsedrive before the mask",
        ),
        ("gtcol-ghost", uniad.UniADProtocol, "evaluate", unmasked, "uniad obj_box_col"),
        ("gtcol-ghost", vad.VADProtocol, "evaluate", unmasked, "vad obj_box_col at 1, 2, 3 s"),
        (
            "gtcol-ghost",
            sparsedrive.SparseDriveProtocol,
            "evaluate",
            unmasked,
            "sparsedrive rates, ghost scenes: collision",
        ),
        ("scene-crossing", geometry, "EGO_BOX_FROM_LIDAR_M", 0.4, "exact contact every 0.1 s, all"),
        ("scene-crossing", geometry, "EGO_WIDTH_M", 1.9, "exact collision"),
    ],
)
def test_a_changed_protocol_is_noticed(
    scene: str, where: Any, name: str, value: Any, noticed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(where, name, value)
    assert noticed in failures(GOLDEN.verify(copied_scene(scene, tmp_path)))


def test_swapped_category_tables_are_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PROTOCOLS["vad-23"], "categories", vad.COUNTED_32)
    assert "vad-23 obj_box_col at 1, 2, 3 s" in failures(GOLDEN.verify())


@pytest.mark.parametrize(
    ("file", "array", "noticed"),
    [
        (
            "gtcol-ghost_official.npz",
            "uniad_obj_box_col",
            {"uniad obj_box_col", "uniad rates, ghost scenes: collision"},
        ),
        ("gtcol-ghost_official.npz", "vad_step_obj_box_col", {"vad obj_box_col"}),
        ("gtcol-ghost_official.npz", "sd_raw_box", {"sparsedrive before the mask", "diffusiondrive before the mask"}),
        ("gtcol-ghost_official.npz", "uniad_seg_bits", {"uniad raster cells"}),
        ("gtcol-ghost_official.npz", "sample_valid", {"samples that count"}),
        ("gtcol-ghost_exact.npz", "cont_sd", {"exact contact every 0.1 s, sd"}),
        ("gtcol-ghost_exact.npz", "gt_way_vad", {"exact contact of the recorded ego, vad"}),
    ],
)
def test_one_wrong_golden_verdict_is_found(file: str, array: str, noticed: set[str], copied: Path) -> None:
    values = load(copied / file)[array]
    flat = values.reshape(-1)
    flat[1] = ~flat[1] if values.dtype == np.bool_ else flat[1] ^ 1 if values.dtype == np.uint8 else 1 - flat[1]
    change(copied / file, **{array: values})
    checks = GOLDEN.verify(copied)
    assert failures(checks) == noticed
    wrong = [check for check in checks if check.quantity in noticed and check.tolerance == 0]
    assert all(check.error == 1 and "gtcol-ghost" in check.note for check in wrong)


def test_displacements_off_by_more_than_single_precision_are_found(copied: Path) -> None:
    path = copied / "gtcol-ghost_official.npz"
    displacement = load(path)["uniad_L2"]
    displacement[0, 0, 1] += 1e-4
    change(path, uniad_L2=displacement)
    assert failures(GOLDEN.verify(copied)) == {"uniad L2 (m)", "uniad rates, ghost scenes: l2 (m)"}


def test_a_set_without_exact_verdicts_says_so(copied: Path) -> None:
    (copied / "gtcol-ghost_exact.npz").unlink()
    checks = GOLDEN.verify(copied)
    assert not failures(checks) and not any(check.quantity.startswith("exact") for check in checks)
    assert checks[0].note == "1 file; no exact verdicts for gtcol-ghost; no manifest.json"


def test_the_manifest_tells_what_is_absent_and_what_changed(copied: Path) -> None:
    shutil.copy(BUILT_IN / "manifest.json", copied)
    assert GOLDEN.verify(copied)[0].note == "1 file; 6 more listed in manifest.json are missing"
    change(copied / "gtcol-ghost.npz", keyframe=np.arange(11) + 1)
    note = GOLDEN.verify(copied)[0].note
    assert note.endswith("different from manifest.json: gtcol-ghost.npz")
