"""`verify protocols` with sets that have roads and the past: honest ones agree, changed protocols are noticed."""

import shutil
from pathlib import Path
from typing import Any

import pytest

from benchmark.extensions.golden_sets.protocols import BUILT_IN, GOLDEN
from benchmark.geometry import Bools, Floats
from benchmark.protocols import bev_planner, fine_grid, omnidrive, safemvdrive, stp3
from benchmark.protocols.stacked_truths import StackedTruths
from tests.benchmark.extensions.golden_sets import golden_further
from tests.benchmark.extensions.golden_sets.protocols.test_verification import change, failures, load
from tests.benchmark.verification.damaged import notices, said

SHARED = Path(__file__).resolve().parents[6] / "shared" / "golden" / "protocols_more"


@pytest.mark.skipif(not SHARED.is_dir(), reason="the golden sets are not beside this checkout")
def test_the_official_verdicts_agree() -> None:
    checks = {check.quantity: check for check in GOLDEN.verify(SHARED)}
    assert not failures(list(checks.values()))
    assert checks["stp3 raster cells"].count >= 56_640_000 and checks["omnidrive off the road"].count >= 12_390
    assert any("rates" in quantity for quantity in checks)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return golden_further.write(tmp_path_factory.mktemp("further"))


@pytest.fixture
def copied(made: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(made, tmp_path / "set"))


def test_a_set_of_the_slow_versions_agrees(made: Path) -> None:
    checks = GOLDEN.verify(made)
    assert not failures(checks) and len(checks) > 60
    assert all(check.count > 0 for check in checks)
    official = load(made / "scene-crossing_official.npz")
    for name in ("stp3_raw_box", "bevp_raw_box", "bevp_raw_boundary", "omni_raw_box", "omni_raw_out", "od_all_raw_box"):
        assert 0.0 < official[name].mean() < 1.0, name


def test_both_forms_may_lie_in_one_folder(copied: Path) -> None:
    for path in BUILT_IN.glob("gtcol-ghost*.npz"):
        shutil.copy(path, copied)
    quantities = {check.quantity for check in GOLDEN.verify(copied) if check.ok}
    assert {"uniad obj_box_col", "exact collision", "stp3 obj_box_col", "omnidrive off the road"} <= quantities


def everything(self: Any, truths: StackedTruths) -> Bools:
    return truths.annotated[:, 1:]


def as_it_is(path: Floats) -> Floats:
    return path


@pytest.mark.parametrize(
    ("where", "name", "value", "noticed"),
    [
        (stp3.STP3Protocol, "counted_objects", everything, "stp3 raster cells"),
        (stp3, "KEYFRAMES_BEFORE", 1, "stp3 samples that count"),
        (bev_planner, "MOVING_M", 0.0, "bev-planner before the mask"),
        (bev_planner, "VEHICLES", frozenset({"vehicle.truck"}), "bev-planner rasters"),
        (bev_planner, "FIRST_CELL_M", -50.0, "bev-planner kerb rasters"),
        (fine_grid, "FOOTPRINT", fine_grid.FOOTPRINT + [0, 4], "omnidrive before the mask"),
        (omnidrive, "KERB_LENGTH_M", 4.9, "omnidrive off the road"),
        (omnidrive, "round_to_text", as_it_is, "omnidrive plan as text"),
        (safemvdrive, "_latch_outcomes", None, "safemvdrive latched"),
    ],
)
def test_a_changed_protocol_is_noticed(
    where: Any, name: str, value: Any, noticed: str, made: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if name == "_latch_outcomes":
        kept = safemvdrive._latch_outcomes

        def forgetful(columns: Any, *others: Any) -> Any:
            found = kept(columns, *others)
            found.collision[:] = columns["at_step"] & found.counted[:, None]
            return found

        value = forgetful
    monkeypatch.setattr(where, name, value)
    assert noticed in failures(GOLDEN.verify(made))


@pytest.mark.parametrize(
    ("array", "noticed"),
    [
        ("bevp_raw_boundary", "bev-planner kerb before the mask"),
        ("omni_text_raw_out", "omnidrive off the road"),
        ("stp3_seg_bits", "stp3 raster cells"),
        ("ad_uniad_raw_box", "agent-driver before the mask"),
        ("od_all_obj_col", "opendrivevla-stp3 obj_col"),
        ("smv_box_all_counted", "safemvdrive-box-all samples that count"),
    ],
)
def test_one_wrong_golden_verdict_is_found(array: str, noticed: str, copied: Path) -> None:
    path = copied / "scene-crossing_official.npz"
    values = load(path)[array]
    # Late enough that the sample counts, early enough that its step was recorded.
    place = (3, *(0 for _ in values.shape[1:]))
    values[place] = ~values[place] if values.dtype.kind in "bu" else 1 - values[place]
    change(path, **{array: values})
    found = failures(GOLDEN.verify(copied))
    # A sample that counts has a displacement too.
    assert found == {noticed} | ({"safemvdrive-box-all L2 (m)"} if array.endswith("counted") else set())


def test_damaged_roads_are_refused(copied: Path) -> None:
    path = copied / "scene-crossing.npz"
    offset = load(path)["boundary_offset"]
    change(path, boundary_offset=offset + 1)
    notices(GOLDEN.verify, copied)
    change(path, boundary_offset=None)
    assert "no array boundary_offset" in said(GOLDEN.verify, copied)


def test_an_aggregate_file_is_compared_where_it_counts_the_same_samples(copied: Path) -> None:
    (copied / "aggregate.json").write_text("{}")
    assert "aggregate.json" in said(GOLDEN.verify, copied)
