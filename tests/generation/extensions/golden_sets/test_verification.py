"""`verify` on the built-in sets and on those beside the repository; wrong numbers fail where they are wrong."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmark.geometry import Floats
from benchmark.verification.checks import format_report
from generation.extensions.golden_sets.built_in import BUILT_IN
from generation.extensions.golden_sets.physics import GOLDEN as PHYSICS
from generation.extensions.golden_sets.scoring import GOLDEN as SCORING
from tests.generation.extensions.golden_sets import golden_scoring
from tests.generation.extensions.golden_sets.golden_copies import (
    VERIFY,
    change,
    copied,
    failures,
    flipped,
    load,
    save,
    shifted,
)

PATH = pytest.mark.path
SHARED = Path(__file__).resolve().parents[5] / "shared" / "golden"


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("kind", [pytest.param("physics", marks=PATH), pytest.param("scoring", marks=PATH), "denoiser"])
def test_built_in_sets_agree_and_are_small(kind: str) -> None:
    checks = VERIFY[kind](None)
    assert not failures(checks), format_report(checks)
    assert len(checks) > 15
    assert sum(path.stat().st_size for path in (BUILT_IN / kind).iterdir()) < 150_000


@pytest.mark.skipif(not SHARED.is_dir(), reason="no shared material beside the repository")
@pytest.mark.parametrize("kind", VERIFY)
def test_sets_beside_the_repository_agree(kind: str) -> None:
    checks = VERIFY[kind](SHARED / kind)
    assert not failures(checks), format_report(checks)


def test_built_in_scoring_set_is_what_the_obvious_loops_make() -> None:
    assert {path.stem for path in (BUILT_IN / "scoring").glob("*.npz")} == set(golden_scoring.CASES)
    for name, make in golden_scoring.CASES.items():
        stored, made = load(BUILT_IN / "scoring" / f"{name}.npz"), make()
        assert stored.keys() == made.keys()
        for key, value in made.items():
            np.testing.assert_allclose(stored[key], value, rtol=0.0, atol=1e-10, err_msg=f"{name} {key}")


def test_wrong_physics_fails_where_it_is_wrong(tmp_path: Path) -> None:
    folder = copied("physics", tmp_path)
    change(
        folder / "physics.npz",
        center_pose=shifted(2e-6, 2, 40, 0),
        commands=shifted(-1e-5, 3, 7, 1),
        curvature_profile=shifted(1e-3, 4, 9),
        reference_local=shifted(1e-5, 6, 30, 1),
    )
    checks = PHYSICS.verify(folder)
    assert failures(checks) == {
        "centre position (m)", "commanded steering rate (rad/frame)", "curvature profile (rad/m)",
        "reference position (m)",
    }  # fmt: skip
    assert next(check.error for check in checks if check.quantity == "centre position (m)") == pytest.approx(
        2e-6, rel=1e-3
    )


def test_headings_count_modulo_a_turn_and_ill_conditioned_candidates_loosely(tmp_path: Path) -> None:
    folder = copied("physics", tmp_path)
    good = load(folder / "physics.npz")["well_conditioned"]
    turned = shifted(2 * np.pi, 2, 40, 2)
    for change_of_other, wrong in ((5e-4, set()), (2e-3, {"centre position of others, first 13 frames (m)"})):
        shutil.copy(BUILT_IN / "physics" / "physics.npz", folder / "physics.npz")
        change(folder / "physics.npz", center_pose=turned, reference_local=turned)
        soon = int(np.flatnonzero(~good & (load(folder / "physics.npz")["sensitivity_13_steps_m"] < 1e-3))[0])
        change(folder / "physics.npz", center_pose=shifted(change_of_other, soon, 5, 0))
        assert failures(PHYSICS.verify(folder)) == wrong


def test_degenerate_candidates_are_optional_and_checked_where_they_are_steady(tmp_path: Path) -> None:
    folder = copied("physics", tmp_path)
    change(folder / "physics_degenerate.npz", **{"all_behind/center_pose": shifted(3.0, 60, 0)})
    assert not failures(PHYSICS.verify(folder))
    change(folder / "physics_degenerate.npz", **{"sideways/center_pose": shifted(3e-6, 60, 0)})
    assert failures(PHYSICS.verify(folder)) == {"degenerate candidates: centre position (m)"}
    (folder / "physics_degenerate.npz").unlink()
    assert not any("degenerate" in check.quantity for check in PHYSICS.verify(folder))


def test_any_number_of_candidates_and_groups(tmp_path: Path) -> None:
    folder = copied("physics", tmp_path)
    arrays = load(folder / "physics.npz")
    chosen = np.array([6, 2, 2, 0, 5])
    per_candidate = {n: v[chosen] for n, v in arrays.items() if v.shape[:1] == (8,) and n != "groups"}
    save(folder / "physics.npz", arrays | per_candidate)
    checks = PHYSICS.verify(folder)
    assert not failures(checks)
    assert "4 of 5" in checks[0].note


def test_wrong_scores_fail_where_they_are_wrong(tmp_path: Path) -> None:
    folder = copied("scoring", tmp_path)
    change(
        folder / "crossing.npz",
        paper_center_violation=flipped(3, 4),
        paper_dac=shifted(2e-9, 1),
        paper_collision_half=flipped(5, 6),
        paper_final_geometry=shifted(1e-8, 7),
    )
    checks = SCORING.verify(folder)
    assert failures(checks) == {
        "centre off the road", "drivable area term", "collision, half", "final score, geometry",
        "final score with its random start, geometry",
    }  # fmt: skip
    assert "worst in crossing.npz" in checks[0].note


def test_wrong_scores_of_the_reference_fail_where_they_are_wrong(tmp_path: Path) -> None:
    folder = copied("scoring", tmp_path)
    change(
        folder / "crossing.npz",
        ref_col=flipped(4, 5),
        ref_dac=shifted(1e-4, 6),
        ref_ac=shifted(1e-3, 7),
        ref_n_polygon_tests=lambda count: count + 1,
    )
    assert failures(SCORING.verify(folder)) == {
        "reference: collision", "reference: drivable area term", "reference: challenge",
        "reference: how many boxes are intersected",
    }  # fmt: skip


def test_sets_without_numbers_of_the_reference_are_sets(tmp_path: Path) -> None:
    folder = copied("scoring", tmp_path)
    for path in folder.glob("*.npz"):
        save(path, {name: array for name, array in load(path).items() if not name.startswith("ref_")})
    checks = SCORING.verify(folder)
    assert not failures(checks) and not any("reference" in check.quantity for check in checks)


def test_a_verdict_that_hangs_on_single_precision_is_counted(tmp_path: Path) -> None:
    """A corner that lies on the border of a cell; the same difference elsewhere is an error."""
    folder = copied("scoring", tmp_path)
    checks = SCORING.verify(folder)
    noted = {check.quantity: check.note for check in checks}
    assert "hang on single precision, in 3 files" in noted["reference: corners off the road"]
    change(folder / "parked_row.npz", ref_corners_out_count=shifted(1, 3, 6))
    assert "reference: corners off the road" in failures(SCORING.verify(folder))


def test_another_ranking_fails(tmp_path: Path) -> None:
    folder = copied("scoring", tmp_path)
    best, worst = (int(pick(load(folder / "parked_row.npz")["paper_final_half"])) for pick in (np.argmin, np.argmax))

    def swapped(final: Floats) -> Floats:
        final[[best, worst]] = final[[worst, best]]
        return final

    change(folder / "parked_row.npz", paper_final_half=swapped)
    assert "ranking, half" in failures(SCORING.verify(folder))


def test_a_verdict_on_a_tie_may_differ_and_is_counted(tmp_path: Path) -> None:
    folder = copied("scoring", tmp_path)
    change(folder / "standing.npz", paper_collision_geometry=flipped(0, 3))
    checks = SCORING.verify(folder)
    assert not failures(checks)
    assert "1 within 1e-9 of a tie" in next(c.note for c in checks if c.quantity == "collision, geometry")


def test_one_file_of_an_indexed_set_is_enough(tmp_path: Path) -> None:
    folder = copied("scoring", tmp_path)
    (folder / "standing.npz").unlink()
    (folder / "index.json").write_text(json.dumps({"dev/standing.npz": {}, "dev/crossing.npz": {}}))
    checks = SCORING.verify(folder)
    assert not failures(checks)
    assert checks[0].note == "2 files; 1 more in index.json is missing"
