"""`verify` on the built-in sets and those beside the repository: wrong numbers, damaged sets."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from numpy.typing import NDArray

from benchmark.geometry import Floats
from benchmark.verification.checks import format_report
from generation.diffusion.denoiser import TrajectoryDenoiser
from generation.extensions.golden_sets.built_in import BUILT_IN
from generation.extensions.golden_sets.denoiser import GOLDEN as DENOISER
from generation.extensions.golden_sets.physics import GOLDEN as PHYSICS
from generation.extensions.golden_sets.scoring import GOLDEN as SCORING
from tests.benchmark.verification.damaged import refuses, said
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


WRONG: tuple[tuple[str, dict[str, Any], set[str], str], ...] = (
    ("physics/physics.npz",
     {"center_pose": shifted(2e-6, 2, 40, 0), "commands": shifted(-1e-5, 3, 7, 1),
      "curvature_profile": shifted(1e-3, 4, 9), "reference_local": shifted(1e-5, 6, 30, 1)},
     {"centre position (m)", "commanded steering rate (rad/frame)", "curvature profile (rad/m)",
      "reference position (m)"}, ""),
    ("scoring/crossing.npz",
     {"paper_center_violation": flipped(3, 4), "paper_dac": shifted(2e-9, 1), "paper_collision_half": flipped(5, 6),
      "paper_final_geometry": shifted(1e-8, 7)},
     {"centre off the road", "drivable area term", "collision, half", "final score, geometry",
      "final score with its random start, geometry"}, "worst in crossing.npz"),
    ("scoring/crossing.npz",
     {"ref_col": flipped(4, 5), "ref_dac": shifted(1e-4, 6), "ref_ac": shifted(1e-3, 7),
      "ref_n_polygon_tests": lambda count: count + 1},
     {"reference: collision", "reference: drivable area term", "reference: challenge",
      "reference: how many boxes are intersected"}, ""),
)  # fmt: skip


@pytest.mark.parametrize(("file", "changes", "wrong", "note"), WRONG)
def test_wrong_numbers_fail_where_they_are_wrong(
    file: str, changes: dict[str, Any], wrong: set[str], note: str, tmp_path: Path
) -> None:
    kind = file.partition("/")[0]
    copied(kind, tmp_path)
    change(tmp_path / file, **changes)
    checks = {check.quantity: check for check in VERIFY[kind](tmp_path / kind)}
    assert {name for name, check in checks.items() if not check.ok} == wrong
    assert any(note in check.note for check in checks.values())
    if kind == "physics":
        assert checks["centre position (m)"].error == pytest.approx(2e-6, rel=1e-3)


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


ARRAY = {
    "physics": ("physics.npz", "center_pose"),
    "scoring": ("crossing.npz", "paper_dist"),
    "denoiser": ("parity.npz", "noise"),
}


@pytest.mark.parametrize("kind", ["physics", "denoiser"])
def test_damaged_sets_are_one_sentence(kind: str, tmp_path: Path) -> None:
    refuses(VERIFY[kind], BUILT_IN / kind, *ARRAY[kind], tmp_path)


def test_a_damaged_frame_of_scores_is_one_sentence(tmp_path: Path) -> None:
    """A set may have any number of frames, but must have one."""
    (tmp_path / "scoring").mkdir()
    save(tmp_path / "scoring" / "crossing.npz", load(BUILT_IN / "scoring" / "crossing.npz"))
    refuses(VERIFY["scoring"], tmp_path / "scoring", *ARRAY["scoring"], tmp_path / "work")


@pytest.mark.parametrize("kind", VERIFY)
def test_a_folder_of_sets_says_which_is_meant(kind: str) -> None:
    assert f"did you mean {BUILT_IN / kind}" in said(VERIFY[kind], BUILT_IN)


@pytest.mark.parametrize(
    ("file", "name", "value"),
    [
        ("physics/physics.npz", "group", np.full(8, 99)),
        ("physics/physics.npz", "group_columns", np.array(["center_x"])),
        ("physics/physics.npz", "groups", np.zeros((8, 14))),
        ("physics/physics.npz", "groups", np.zeros((8, 3))),
        ("scoring/crossing.npz", "raster", np.zeros((200, 199), np.bool_)),
        ("scoring/crossing.npz", "raster_affine_global_to_index", np.ones((2, 3))),
        ("scoring/crossing.npz", "ego_index", np.array(70)),
        ("scoring/crossing.npz", "candidates", np.zeros((48, 5, 3))),
        ("scoring/crossing.npz", "valid", np.zeros((13, 6))),
    ],
)
def test_inputs_that_do_not_fit_are_one_sentence(file: str, name: str, value: NDArray[Any], tmp_path: Path) -> None:
    kind, _, rest = file.partition("/")
    path = copied(kind, tmp_path) / rest
    save(path, load(path) | {name: value})
    said(VERIFY[kind], path.parent)


@pytest.fixture
def slim(tmp_path: Path) -> Path:
    """The built-in denoiser set with one trajectory and few processes, because a call of the network takes time."""
    folder = Path(shutil.copytree(BUILT_IN / "denoiser", tmp_path / "slim"))
    arrays = load(folder / "parity.npz")
    dropped = ("trunc50", "trunc5", "trunc4", "clip_active", "stoch_t50", "stoch_t4")
    kept = {name: value for name, value in arrays.items() if not name.startswith(dropped)}
    save(folder / "parity.npz", {n: v if n.startswith("aug") or not v.shape else v[:1] for n, v in kept.items()})
    return folder


def test_wrong_denoiser_outputs_fail_where_they_are_wrong(slim: Path) -> None:
    change(
        slim / "parity.npz",
        denoise_t25=shifted(1e-4, 0, 5),
        trunc3_eta0_actions=shifted(1e-4, 0, 5),
        stoch_t10=shifted(1e-4, 0, 5),
        full_eta0_after_t50=shifted(1e-4, 0, 5),
        aug_out=shifted(1.0, 3, 5),
    )
    change(slim / "schedule.npz", betas=shifted(1e-5, 50), timesteps=shifted(1, 3))
    checks = DENOISER.verify(slim)
    assert failures(checks) == {
        "predicted noise", "truncated reverse processes", "stochastic steps", "full reverse process, on the way",
        "varied first batch (of the largest)", "schedule: betas", "schedule: timesteps",
    }  # fmt: skip
    assert "worst in timestep 25" in next(check.note for check in checks if check.quantity == "predicted noise")


def test_silent_zeros_fail(slim: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TrajectoryDenoiser, "forward", lambda self, noisy, timesteps: torch.zeros_like(noisy))
    assert {"predicted noise", "full reverse process", "stochastic steps"} <= failures(DENOISER.verify(slim))


def test_another_architecture_is_said_first_and_nothing_else(slim: Path) -> None:
    keys = json.loads((slim / "keys.json").read_text())
    keys["sigma_proj_layer.weight"]["shape"] = [256, 511]
    (slim / "keys.json").write_text(json.dumps(keys))
    (check,) = DENOISER.verify(slim)
    assert not check.ok and check.error == 1 and "sigma_proj_layer.weight" in check.note


def test_another_salt_and_other_rules_need_other_numbers(slim: Path) -> None:
    for manifest in ({"salt": "other", "std_rules": {}}, {"salt": "dev", "std_rules": {"decoder_mlp": 0.3}}):
        (slim / "manifest.json").write_text(json.dumps(manifest))
        assert "predicted noise" in failures(DENOISER.verify(slim))


@pytest.mark.path
def test_a_set_of_another_size_agrees_and_every_array_is_compared_or_named(slim: Path) -> None:
    arrays = load(slim / "parity.npz")
    save(slim / "parity.npz", arrays | {"something_new": np.zeros(3)})
    checks = DENOISER.verify(slim)
    assert not failures(checks), format_report(checks)
    notes = " ".join(check.note for check in checks)
    assert "history_features_ignored (the reference discards it" in notes
    assert "something_new (unknown here)" in notes


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("manifest.json", "{"),
        ("manifest.json", '{"std_rules": {}}'),
        ("manifest.json", '{"salt": "dev", "std_rules": {"(": 1.0}}'),
        ("manifest.json", '{"salt": "dev", "kept_buffers": {"sigma_proj_layer.bias": [1.0]}}'),
        ("keys.json", "[1, 2]"),
        ("keys.json", '{"a": {"shape": "x"}}'),
    ],
)
def test_descriptions_that_are_wrong_are_one_sentence(slim: Path, name: str, text: str) -> None:
    (slim / name).write_text(text)
    said(DENOISER.verify, slim)
