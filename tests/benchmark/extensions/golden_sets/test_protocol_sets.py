"""`verify protocols`: sets are what slow versions say, a changed protocol is noticed, and notes say what is missing."""

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from numpy.typing import NDArray

from benchmark import geometry
from benchmark.extensions.golden_sets.protocols import BUILT_IN, GOLDEN
from benchmark.extensions.golden_sets.protocols.official import draw_rasters
from benchmark.geometry import Bools, Floats, box_corners
from benchmark.protocols import (
    PROTOCOLS,
    ProtocolOutcomes,
    bev_planner,
    fine_grid,
    omnidrive,
    raster,
    safemvdrive,
    sparsedrive,
    stp3,
    uniad,
    vad,
)
from benchmark.protocols.stacked_truths import StackedTruths, stack
from tests.benchmark.extensions.golden_sets.altered import altered, load, put
from tests.benchmark.extensions.golden_sets.golden_protocols import CASES, files_of
from tests.benchmark.protocols import slow_protocols as slow
from tests.benchmark.protocols.protocol_cases import Traits, plan_of, sample_of, traits
from tests.benchmark.verification.damaged import said


def failures(folder: Path) -> set[str]:
    return {check.quantity for check in GOLDEN.verify(folder) if not check.ok}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[] if "ghost" in name else pytest.mark.slow) for name in CASES]
)
def test_the_built_in_set_is_what_its_program_makes(name: str) -> None:
    for file, made in files_of(name, CASES[name]()).items():
        stored = load(BUILT_IN / file)
        assert stored.keys() == made.keys()
        for array, values in made.items():
            near = values.dtype.kind == "f"
            assert stored[array] == pytest.approx(values, abs=1e-5) if near else (stored[array] == values).all(), array


def test_the_built_in_set_has_the_cases_that_matter() -> None:
    official = {name: load(BUILT_IN / f"{name}_official.npz") for name in CASES}
    ghost, crossing = official["gtcol-ghost"], official["scene-crossing"]
    joined = {key: np.concatenate([part[key].ravel() for part in official.values()]) for key in ghost}
    for array in ("uniad_obj_box_col", "uniad_obj_col", "vad_step_obj_box_col", "vad_step_obj_col", "sd_obj_box_col"):
        assert 0 < joined[array].sum() < joined[array].size / 2, array
    assert (joined["vad_obj_box_col"] != joined["vad23_obj_box_col"]).any() and 0 < joined["sample_valid"].mean() < 1
    for prefix in ("uniad", "vad", "sd"):
        masked = ghost[f"{prefix}_raw_box"] & ghost[f"{prefix}_gt_box"][:, None]
        assert masked[ghost["sample_valid"]].sum() >= 10
    assert np.abs(load(BUILT_IN / "scene-crossing.npz")["plans"]).max() > 50
    grid = np.unpackbits(crossing["uniad_seg_bits"], axis=-1).reshape(-1, 200, 200)
    inside = crossing["uniad_seg_bits"].reshape(len(grid), -1).min(axis=1) < 255
    assert grid[inside][:, :, [0, 199]].any() or grid[inside][:, [0, 199]].any()


def test_a_set_of_the_slow_versions_agrees_also_beside_the_other_form(scenes: dict[str, Path], tmp_path: Path) -> None:
    official = load(scenes["further"] / "scene-crossing_official.npz")
    for name in ("stp3_raw_box", "bevp_raw_box", "bevp_raw_boundary", "omni_raw_box", "omni_raw_out", "od_all_raw_box"):
        assert 0.0 < official[name].mean() < 1.0, name
    checks = GOLDEN.verify(scenes["further"])
    assert all(check.ok and check.count > 0 for check in checks) and len(checks) > 60
    for folder in ("further", "gtcol-ghost"):
        shutil.copytree(scenes[folder], tmp_path / "both", dirs_exist_ok=True)
    quantities = {check.quantity for check in GOLDEN.verify(tmp_path / "both") if check.ok}
    assert {"uniad obj_box_col", "exact collision", "stp3 obj_box_col", "omnidrive off the road"} <= quantities


SPARSEDRIVE = sparsedrive.SparseDriveProtocol
KEPT = {kind: kind.evaluate for kind in (uniad.UniADProtocol, vad.VADProtocol, SPARSEDRIVE)}


def unmasked(self: Any, truths: Any, plans: Floats) -> ProtocolOutcomes:
    found = next(KEPT[kind] for kind in type(self).__mro__ if kind in KEPT)(self, truths, plans)
    return ProtocolOutcomes(found.step("before_mask"), found.l2, found.valid, found.counted, found.steps, found.facts)


def everything(self: Any, truths: StackedTruths) -> Bools:
    """Objects count with lidar points and without."""
    return truths.annotated[:, 1:]


def floor_polygons(boxes: Floats) -> NDArray[np.int32]:
    return np.asarray(np.floor((50.0 + box_corners(boxes)) / 0.5), np.int32)


def forgetful(columns: Any, *others: Any, kept: Any = safemvdrive._latch_outcomes) -> Any:
    found = kept(columns, *others)
    found.collision[:] = columns["at_step"] & found.counted[:, None]
    return found


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
        ("scene-crossing", SPARSEDRIVE, "counted_objects", everything, "sparsedrive before the mask"),
        ("gtcol-ghost", uniad.UniADProtocol, "evaluate", unmasked, "uniad obj_box_col"),
        ("gtcol-ghost", vad.VADProtocol, "evaluate", unmasked, "vad obj_box_col at 1, 2, 3 s"),
        ("gtcol-ghost", SPARSEDRIVE, "evaluate", unmasked, "sparsedrive rates, ghost scenes: collision"),
        ("scene-crossing", geometry, "EGO_BOX_FROM_LIDAR_M", 0.4, "exact contact every 0.1 s, all"),
        ("scene-crossing", geometry, "EGO_WIDTH_M", 1.9, "exact collision"),
        ("scene-crossing", PROTOCOLS["vad-23"], "categories", vad.COUNTED_32, "vad-23 obj_box_col at 1, 2, 3 s"),
        ("further", stp3.STP3Protocol, "counted_objects", everything, "stp3 raster cells"),
        ("further", stp3, "KEYFRAMES_BEFORE", 1, "stp3 samples that count"),
        ("further", bev_planner, "MOVING_M", 0.0, "bev-planner before the mask"),
        ("further", bev_planner, "VEHICLES", frozenset({"vehicle.truck"}), "bev-planner rasters"),
        ("further", bev_planner, "FIRST_CELL_M", -50.0, "bev-planner kerb rasters"),
        ("further", fine_grid, "FOOTPRINT", fine_grid.FOOTPRINT + [0, 4], "omnidrive before the mask"),
        ("further", omnidrive, "KERB_LENGTH_M", 4.9, "omnidrive off the road"),
        ("further", omnidrive, "round_to_text", lambda path: path, "omnidrive plan as text"),
        ("further", safemvdrive, "_latch_outcomes", forgetful, "safemvdrive latched"),
    ],
)  # fmt: skip
def test_a_changed_protocol_is_noticed(
    scene: str,
    where: Any,
    name: str,
    value: Any,
    noticed: str,
    scenes: dict[str, Path],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(where, name, value)
    assert noticed in failures(scenes[scene])


def test_notes_say_what_is_absent_and_what_differs_from_the_manifest(scenes: dict[str, Path], tmp_path: Path) -> None:
    folder = altered(scenes["gtcol-ghost"], tmp_path / "set", [("gtcol-ghost.npz", put(keyframe=np.arange(11) + 1))])
    shutil.copy(BUILT_IN / "manifest.json", folder)
    note = GOLDEN.verify(folder)[0].note
    assert note == "1 file; 6 more listed in manifest.json are missing; different from manifest.json: gtcol-ghost.npz"
    (folder / "manifest.json").unlink()
    (folder / "gtcol-ghost_exact.npz").unlink()
    checks = GOLDEN.verify(folder)
    assert all(check.ok for check in checks) and not any(check.quantity.startswith("exact") for check in checks)
    assert checks[0].note == "1 file; no exact verdicts for gtcol-ghost; no manifest.json"


@pytest.mark.parametrize("absent", ["gtcol-ghost.npz", "gtcol-ghost_official.npz"])
def test_half_a_scene_is_one_sentence(absent: str, scenes: dict[str, Path], tmp_path: Path) -> None:
    folder = Path(shutil.copytree(scenes["gtcol-ghost"], tmp_path / "set"))
    for path in list(folder.iterdir()):
        shutil.copy(path, folder / f"scene-{path.name}")
    (folder / f"scene-{absent}").unlink()
    assert f"it has no scene-{absent}" in said(GOLDEN.verify, folder)


@settings(max_examples=20, deadline=None)
@given(traits(coarse=True))
def test_rasters_are_those_of_whole_pictures(kind: Traits) -> None:
    sample = sample_of(kind)
    here = sample.ego_future_valid
    for name, judge in (("uniad", slow.slow_uniad), ("vad", slow.slow_vad)):
        expected = judge(sample, plan_of(kind)).rasters
        assert expected is not None
        assert (draw_rasters(name, stack([sample]))[0][here] == expected[here]).all()
