"""`verify`: golden numbers are met, one that is changed is found, and broken sets are refused in a sentence."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.extensions.golden_sets import drivers, pdm, protocols, realism, severity
from benchmark.extensions.golden_sets.pdm.golden_set import PdmGoldenScene
from benchmark.verification.golden_sets import GoldenArrays, GoldenSet
from generation.extensions.golden_sets.built_in import BUILT_IN
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.golden_sets.altered import Change, altered, filled, load, put, shifted, turned
from tests.benchmark.extensions.golden_sets.golden_judgement import SHARED, made_driver_scenes, made_realism
from tests.benchmark.extensions.golden_sets.golden_pdm import golden_arrays
from tests.benchmark.pdm.cases import slow_objects
from tests.benchmark.pdm.slow_motion import slow_motion
from tests.benchmark.pdm.slow_pdm import SlowSample, slow_states_verdict
from tests.benchmark.verification.damaged import notices, refuses, said

JUDGED: dict[str, tuple[GoldenSet, Path]] = {
    "drivers": (drivers.GOLDEN, drivers.BUILT_IN),
    "severity": (severity.GOLDEN, severity.BUILT_IN),
    "realism": (realism.GOLDEN, realism.BUILT_IN),
}
FAMILIES = {name: golden for name, (golden, _) in JUDGED.items()} | {
    "pdm": pdm.GOLDEN, "ghost": protocols.GOLDEN, "further": protocols.GOLDEN,
}  # fmt: skip
GHOST, CROSSING = "gtcol-ghost_official.npz", "scene-crossing_official.npz"
COUNTED = ("samples that count", "L2 (m)")
beside_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="the golden numbers are not beside this checkout")


@pytest.fixture
def sets(scenes: dict[str, Path]) -> dict[str, Path]:
    """A set of each family; of the protocols' set one scene, and beside it one of the form that has roads."""
    whole = {name: built_in for name, (_, built_in) in JUDGED.items()} | {"pdm": pdm.BUILT_IN}
    return whole | {"ghost": scenes["gtcol-ghost"], "further": scenes["further"]}


def failed(kind: str, folder: Path | None) -> set[str]:
    return {check.quantity for check in FAMILIES[kind].verify(folder) if not check.ok}


@pytest.mark.path
@pytest.mark.parametrize("kind", ["protocols", "pdm"])
def test_the_command_agrees_with_the_built_in_set(kind: str) -> None:
    done = run_here("verify", kind)
    lines = done.out.splitlines()
    agree = sum(line.startswith("ok ") for line in lines)
    assert done.code == 0 and agree > 3 and lines[-1] == f"{agree} of {agree} quantities agree"


@pytest.mark.parametrize("kind", [*JUDGED, "physics", "scoring", "results"])
def test_the_other_built_in_sets_agree(kind: str) -> None:
    done = run_here("verify", kind)
    assert done.code == 0 and "FAIL" not in done.out and done.out.count("\nok ") > 3


def test_wrong_numbers_are_exit_code_1_with_the_lines_that_are_wrong(tmp_path: Path) -> None:
    def change(arrays: Any) -> None:
        arrays["center_pose"][2, 10, 0] += 1.0

    folder = altered(BUILT_IN / "physics", tmp_path / "physics", [("physics.npz", change)])
    done = run_here("verify", "physics", "--golden", folder)
    (line,) = [line for line in done.out.splitlines() if line.startswith("FAIL")]
    assert done.code == 1 and "centre position (m)" in line
    as_json = run_here("verify", "physics", "--golden", folder, "--json")
    assert as_json.code == 1
    assert [each["quantity"] for each in json.loads(as_json.out) if not each["ok"]] == ["centre position (m)"]


def test_what_is_no_golden_set_is_one_sentence(tmp_path: Path) -> None:
    absent = tmp_path / "absent"
    for kind in ("physics", "scoring", "denoiser", "protocols", "pdm", *JUDGED):
        for folder in (tmp_path, absent):
            sentence = refusal("verify", kind, "--golden", folder)
            assert str(folder) in sentence and "\n" not in sentence
    of_models = (
        ("chemistry",), ("model",), ("model", "--model", "vad-tiny"), ("physics", "--model", "vad-tiny"),
        *(("model", "--model", name, "--golden", tmp_path) for name in ("no-such-model", "vad-tiny")),
    )  # fmt: skip
    assert all("\n" not in refusal("verify", *arguments) for arguments in of_models)
    assert f"did you mean {protocols.BUILT_IN}" in said(protocols.GOLDEN.verify, protocols.BUILT_IN.parent)


@beside_shared
@pytest.mark.parametrize("kind", [*JUDGED, "pdm"])
def test_every_golden_number_is_met(kind: str) -> None:
    checks = FAMILIES[kind].verify(SHARED / kind)
    assert [check.quantity for check in checks if not check.ok] == [] and sum(check.count for check in checks) > 10_000
    if kind == "pdm":
        by_name = {check.quantity: check for check in checks}
        assert by_name["lqr: NC"].count == by_name["direct: TTC"].count == 1190
        assert by_name["states (11 columns)"].tolerance == 1e-9 and by_name["lqr: HC extremes"].tolerance == 2e-8


@beside_shared
@pytest.mark.parametrize(
    ("folder", "counts"),
    [
        ("protocols", {"uniad obj_box_col": 12_390}),
        ("protocols_more", {"stp3 raster cells": 56_640_000, "omnidrive off the road": 12_390}),
    ],
)
def test_the_official_verdicts_of_protocols_agree(folder: str, counts: dict[str, int]) -> None:
    checks = {check.quantity: check for check in protocols.GOLDEN.verify(SHARED / folder)}
    assert [name for name, check in checks.items() if not check.ok] == []
    assert all(checks[name].count >= count for name, count in counts.items())
    exact = [check for name, check in checks.items() if "rates" not in name and check.tolerance == 0]
    assert any("rates" in name for name in checks)
    assert folder != "protocols" or all(check.error == 0 for check in exact)


@beside_shared
def test_the_slow_version_of_pdm_says_what_the_official_code_says() -> None:
    scene = PdmGoldenScene(GoldenArrays.read(SHARED / "pdm" / "scene-0553.npz"))
    for sample in (0, 3):
        things = slow_objects(scene.key_frames, sample)
        around = SlowSample(scene.now[sample], scene.history[sample], things, scene.road(sample), scene.route)
        for plan in range(0, scene.count, 3):
            states = slow_motion(scene.plans[sample, plan], scene.now[sample])
            assert np.abs(states - scene.by_plan("lqr_states", 31, 11)[sample, plan]).max() < 1e-6
            for mode in ("lqr", "direct"):
                verdict = slow_states_verdict(scene.by_plan(f"{mode}_states", 31, 11)[sample, plan], around)
                for name in ("nc", "dac", "ddc", "ttc", "lk", "hc"):
                    assert getattr(verdict, name) == scene.by_plan(f"{mode}_{name}")[sample, plan], (mode, name, plan)


def test_what_is_made_up_in_the_sets_is_what_the_program_makes_up() -> None:
    arrays, facts = made_driver_scenes()
    stored = json.loads((drivers.BUILT_IN / "scenes.json").read_text())
    assert [each["scene"] for each in stored] == [each["scene"] for each in facts]
    require_same(load(drivers.BUILT_IN / "scenes.npz"), arrays, 2e-6)
    for name, again in made_realism()[0].items():
        assert set(load(realism.BUILT_IN / f"{name}.npz")) == set(again), name
    hits = [driver for each in stored for driver, facts in each["drivers"].items() if facts["contact"]]
    assert "recorded" in hits and len(hits) < sum(len(each["drivers"]) for each in stored)


def test_the_set_of_pdm_is_what_the_slow_version_says_and_has_every_verdict() -> None:
    arrays = load(pdm.BUILT_IN / "crossing.npz")
    # Motions are those of least squares: processors differ in their last digits.
    require_same(arrays, golden_arrays(), 1e-7)
    for name, values in {"nc": {0, 0.5, 1}, "ddc": {0, 0.5, 1}, "dac": {0, 1}, "ttc": {0, 1}, "lk": {0, 1}}.items():
        assert set(arrays[f"lqr_{name}"].ravel().tolist()) == values
    assert set(arrays["lqr_ec"].ravel().tolist()) == set(arrays["lqr_hc"].ravel().tolist()) == {0.0, 1.0}
    assert len(np.unique(arrays["lqr_ep"])) > 3 and arrays["obj_removed"].any()


def require_same(stored: dict[str, Any], again: dict[str, Any], tolerance: float) -> None:
    assert set(stored) == set(again)
    for name, values in stored.items():
        near = values.dtype.kind == "f"
        assert again[name] == pytest.approx(values, abs=tolerance) if near else (again[name] == values).all(), name


def reacts(facts: Any) -> None:
    facts[0]["drivers"]["cc"].update(reacted=1.0)


def misses(name: str) -> Change:
    return lambda arrays: arrays.update({name: arrays[name][1:]})


def invents(name: str, row: list[int]) -> Change:
    return lambda arrays: arrays.update({name: np.concatenate([arrays[name], [row]])})


CHANGES: dict[str, list[tuple[str, Change, set[str]]]] = {
    "drivers": [
        ("straight.npz", shifted("speed"), {"straight, cc: speed (m/s)"}),
        ("straight.npz", shifted("crash_step"), {"straight, cc: crash_step"}),
        ("functions.npz", shifted("pfs"), {"function pfs"}),
        ("tables_following.npz", shifted("impact"), {"tables of following: impact (m/s)"}),
        ("encounters.npz", shifted("cut_in/cc/station"), {"encounters: station"}),
        ("encounters.json", reacts, {"encounters: first unsafe step"}),
        ("scenes.json", lambda f: f[0].update(first_visible=3.0), {"scenes: first visible"}),
        ("scenes.json", lambda f: f[0]["drivers"]["recorded"].update(contact=None), {"scenes: survives"}),
    ],
    "severity": [
        ("encounters.npz", shifted("cut_in/gap"), {"encounters: gap"}),
        ("manoeuvres.npz", shifted("cut_in/4/0"), {"manoeuvres: states"}),
        ("contacts.json", lambda f: f["cases"][0]["expected"].update(type="rear"), {"contacts: type"}),
        ("contacts.json", lambda f: f["cases"][0]["official_nuplan"].update(delta_v=9.0), {"official: delta_v (m/s)"}),
        ("encounters.json", lambda f: f[0]["last_chance"]["evaluated"].update({"0": 4}), {"last chance: evaluations"}),
        ("encounters.json", lambda f: f[0]["severity"].update(pet=1.0), {"encounters: pet"}),
    ],
    "realism": [
        ("ctg_histograms.npz", shifted("ctg/scene/None/recorded/velocity"), {"ctg: histograms of agents"}),
        ("plain_features.npz", shifted("recorded/scene-made-0/0/0/yaw_rate"), {"features: yaw_rate"}),
        ("plain_divergences.json", lambda f: f["arrays"][0].update(w1=9.0), {"arrays: w1"}),
        (
            "plain_divergences.json",
            lambda f: f["halves"]["ttc"].update(jsd=0.9),
            {"divergences of stored features: jsd"},
        ),
        (
            "ctg_deviations.json",
            lambda f: f["old/scene/None"]["rotated"].update(mean_real_dev=1),
            {"ctg: agents' means"},
        ),
    ],
    "pdm": [
        ("crossing.npz", shifted("lqr_nc"), {"lqr: NC", "from plans: NC"}),
        ("crossing.npz", shifted("direct_lk"), {"direct: LK"}),
        ("crossing.npz", shifted("lqr_ttc_step"), {"lqr: TTC step", "from plans: TTC step"}),
        ("crossing.npz", shifted("lqr_ec"), {"lqr: EC", "from plans: EC"}),
        ("crossing.npz", shifted("lqr_score"), {"lqr: score", "from plans: score"}),
        ("crossing.npz", shifted("human_dac"), {"recorded driver"}),
        ("crossing.npz", shifted("filtered_score"), {"filtered score"}),
        ("crossing.npz", shifted("obj_removed"), {"objects removed"}),
        ("crossing.npz", misses("lqr_nc_events"), {"lqr: NC events", "from plans: NC events"}),
        ("crossing.npz", invents("direct_nc_events", [1, 0, 0, 0, 3, 0]), {"direct: NC events"}),
    ],
    "ghost": [
        (GHOST, turned("uniad_obj_box_col", column=1), {"uniad obj_box_col", "uniad rates, ghost scenes: collision"}),
        (GHOST, turned("vad_step_obj_box_col", column=1), {"vad obj_box_col"}),
        (GHOST, turned("sd_raw_box", column=1), {"sparsedrive before the mask", "diffusiondrive before the mask"}),
        (GHOST, turned("uniad_seg_bits", column=1), {"uniad raster cells"}),
        ("gtcol-ghost_exact.npz", turned("cont_sd", column=1), {"exact contact every 0.1 s, sd"}),
        ("gtcol-ghost_exact.npz", turned("gt_way_vad", column=1), {"exact contact of the recorded ego, vad"}),
        # More than single precision.
        (GHOST, shifted("uniad_L2", 1e-4, at=1), {"uniad L2 (m)", "uniad rates, ghost scenes: l2 (m)"}),
    ],
    "ghost, counted": [(GHOST, turned("sample_valid", row=1), {"samples that count"})],
    # Late enough that the sample counts, early enough that its step was recorded.
    "further": [
        (CROSSING, turned("bevp_raw_boundary", row=3), {"bev-planner kerb before the mask"}),
        (CROSSING, turned("omni_text_raw_out", row=3), {"omnidrive off the road"}),
        (CROSSING, turned("stp3_seg_bits", row=3), {"stp3 raster cells"}),
        (CROSSING, turned("ad_uniad_raw_box", row=3), {"agent-driver before the mask"}),
        (CROSSING, turned("od_all_obj_col", row=3), {"opendrivevla-stp3 obj_col"}),
        # A sample that counts has a displacement too.
        (CROSSING, turned("smv_box_all_counted", row=3), {f"safemvdrive-box-all {each}" for each in COUNTED}),
    ],
}


@pytest.mark.parametrize("family", CHANGES)
def test_each_change_is_found(family: str, sets: dict[str, Path], tmp_path: Path) -> None:
    kind, changes = family.partition(",")[0], CHANGES[family]
    folder = altered(sets[kind], tmp_path / "set", [(file, change) for file, change, _ in changes])
    wrong = {check.quantity: check for check in FAMILIES[kind].verify(folder) if not check.ok}
    expected = set.union(*(found for _, _, found in changes))
    assert expected <= set(wrong)
    # A driver that starts otherwise differs in much that follows.
    assert kind in JUDGED or set(wrong) == expected
    if kind == "ghost":
        assert all(check.error == 1 and "gtcol-ghost" in check.note for check in wrong.values() if not check.tolerance)


def test_a_fragile_outcome_is_left_out(tmp_path: Path) -> None:
    def fragile(facts: Any) -> None:
        reacts(facts)
        facts[0]["drivers"]["cc"].update(fragile=True)

    def fragile_pet(facts: Any) -> None:
        facts[0]["severity"].update(pet=1.0)
        facts[0]["fragile"] = ["pet"]

    for kind, change in (("drivers", fragile), ("severity", fragile_pet)):
        assert failed(kind, altered(JUDGED[kind][1], tmp_path / kind, [("encounters.json", change)])) == set()


@pytest.mark.parametrize(
    ("kind", "file", "array"),
    [
        ("drivers", "straight.npz", "ego_speed"),
        ("severity", "encounters.npz", "cut_in/ego"),
        ("realism", "plain_features.npz", "recorded/scene-made-0/0/0/yaw_rate"),
        ("pdm", "crossing.npz", "lqr_states"),
        ("ghost", "gtcol-ghost.npz", "obj_box"),
        ("ghost", GHOST, "vad_obj_box_col"),
    ],
)
def test_a_damaged_set_is_refused(kind: str, file: str, array: str, sets: dict[str, Path], tmp_path: Path) -> None:
    refuses(FAMILIES[kind].verify, sets[kind], file, array, tmp_path)


@pytest.mark.parametrize(
    ("kind", "file", "change"),
    [
        ("pdm", "crossing.npz", put(vehicle=np.ones(6))),
        ("pdm", "crossing.npz", put(poly_layer=np.full(18, 9))),
        ("pdm", "crossing.npz", put(obj_offset=np.array([0, 20, 14]))),
        ("pdm", "crossing.npz", put(plan_names=np.array(["other"] * 10))),
        ("pdm", "crossing.npz", put(pair=np.arange(2))),
        ("ghost", "gtcol-ghost.npz", filled("command", 5)),
        ("ghost", "gtcol-ghost.npz", put(ego_fut_valid=np.ones((11, 6)))),
        ("ghost", "gtcol-ghost.npz", put(plans=np.zeros((11, 0, 6, 2)))),
        ("ghost", "gtcol-ghost.npz", put(plan_names=np.arange(8))),
        ("ghost", GHOST, put(uniad_raw_box=np.zeros((11, 8, 5)))),
        ("ghost", GHOST, put(vad_seg_bits=np.zeros((11, 6, 200), np.uint8))),
        ("ghost", "gtcol-ghost_exact.npz", put(heading=None)),
        ("further", "scene-crossing.npz", put(boundary_offset=None)),
    ],
)
def test_arrays_that_do_not_fit_are_one_sentence(
    kind: str, file: str, change: Change, sets: dict[str, Path], tmp_path: Path
) -> None:
    said(FAMILIES[kind].verify, altered(sets[kind], tmp_path / "set", [(file, change)]))


def test_damaged_roads_are_noticed(sets: dict[str, Path], tmp_path: Path) -> None:
    def change(arrays: Any) -> None:
        arrays["boundary_offset"] += 1

    notices(protocols.GOLDEN.verify, altered(sets["further"], tmp_path / "set", [("scene-crossing.npz", change)]))


@pytest.mark.parametrize("kind", JUDGED)
@pytest.mark.parametrize("other", ["{}", '[{"name": 3}]'])
def test_json_of_another_form_is_refused(kind: str, other: str, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(JUDGED[kind][1], tmp_path / kind))
    for path in folder.glob("*.json"):
        path.write_text(other)
    said(FAMILIES[kind].verify, folder)


@pytest.mark.parametrize("text", ["{", "[1]", '{"made": "today"}'])
def test_files_beside_a_set_that_are_of_another_form_are_one_sentence(
    text: str, sets: dict[str, Path], tmp_path: Path
) -> None:
    for kind, file in (("ghost", "manifest.json"), ("further", "aggregate.json")):
        folder = Path(shutil.copytree(sets[kind], tmp_path / kind))
        (folder / file).write_text(text)
        said(FAMILIES[kind].verify, folder)
