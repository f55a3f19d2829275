"""`verify neuroncap`: golden numbers are met, a changed one is found, broken sets are refused in a sentence."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.verification import BUILT_IN, GOLDEN
from tests.benchmark.extensions.golden_sets.altered import Change, altered, filled, load, put, shifted
from tests.benchmark.extensions.neuroncap.golden_neuroncap import SHARED, made_loops
from tests.benchmark.verification.damaged import notices, said

MADE = "loops/made.json"


def failed(folder: Path | None) -> set[str]:
    return {check.quantity for check in GOLDEN.verify(folder) if not check.ok}


@pytest.mark.path
def test_the_built_in_set_agrees() -> None:
    assert failed(None) == set()


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="the golden numbers are not here")
def test_every_golden_number_is_met() -> None:
    checks = GOLDEN.verify(SHARED)
    assert [check.quantity for check in checks if not check.ok] == []
    assert sum(check.count for check in checks) > 200_000


def test_what_is_made_up_in_the_set_is_what_the_program_makes_up() -> None:
    arrays, facts = made_loops()
    for name, expected in arrays.items():
        assert set(load(BUILT_IN / f"{name}.npz")) == set(expected), name
    stored, made = json.loads((BUILT_IN / MADE).read_text())["runs"], facts["loops/made"]["runs"]
    assert [run["n_infer_calls"] for run in stored] == [run["n_infer_calls"] for run in made]
    assert {run["collision"] is None for run in stored} == {True, False}


CHANGES: dict[str, list[tuple[str, Change, str]]] = {
    "numbers": [
        ("vehicle.npz", shifted("code_substep_state", 1e-5), "car as code: states of sub-steps"),
        ("vehicle.npz", shifted("float64_substep_command", 1e-8), "car in double precision: commands"),
        ("vehicle.npz", shifted("code_step_time"), "car as code: times"),
        ("contact.npz", shifted("hit"), "contact: who is touched"),
        ("contact.npz", shifted("hit_alt"), "contact with the other box: who is touched"),
        ("command.npz", shifted("command", -1), "command"),
        ("loops/made.npz", shifted("r001_state_time"), "loops: times"),
        ("loops/made.npz", shifted("r001_check"), "loops: instants and verdicts of checks"),
        ("loops/made.npz", shifted("r002_command", -1), "loops: commands"),
        ("loops/made_inputs.npz", shifted("canbus_at_frame", 1e-3), "loops: CAN rows at frames"),
    ],
    "facts": [
        ("scenarios.json", lambda f: f["synthetic"]["scenarios"][0]["runs"][0]["draws"].pop(), "scenarios: draws"),
        (
            "scenarios.json",
            lambda f: f["official"][0]["runs"][1]["actors"][0].update(uuid="other"),
            "scenarios: who is there, in order",
        ),
        ("aggregate.json", lambda f: f["cases"][0]["overall"].update(ncap_score=1.0), "aggregate: overall"),
        ("aggregate.json", lambda f: f["cases"][2].update(check_validity="passes"), "aggregate: is it complete"),
        (MADE, lambda f: f["runs"][1].update(nns_code=1.0), "loops: score, code"),
        (MADE, lambda f: f["runs"][1].update(collision=None), "loops: contact"),
        (MADE, lambda f: f["runs"][1]["metrics"].pop("any_collide@1.0s"), "loops: rates in the file"),
    ],
    "no number": [(MADE, lambda f: f["runs"][3].update(nns_code="nan"), "loops: score, code")],
}


@pytest.mark.parametrize("changes", CHANGES.values(), ids=CHANGES)
def test_each_change_is_found(changes: list[tuple[str, Change, str]], tmp_path: Path) -> None:
    folder = altered(BUILT_IN, tmp_path / "set", [(file, change) for file, change, _ in changes])
    assert {found for _, _, found in changes} <= failed(folder)


@pytest.mark.parametrize("file", [*GOLDEN.files, MADE, "loops/made.npz", "loops/made_inputs.npz"])
def test_a_missing_or_cut_file_is_one_sentence(file: str, tmp_path: Path) -> None:
    path = Path(shutil.copytree(BUILT_IN, tmp_path / "neuroncap")) / file
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    assert path.name in said(GOLDEN.verify, tmp_path / "neuroncap")
    path.unlink()
    assert path.name in said(GOLDEN.verify, tmp_path / "neuroncap")


@pytest.mark.parametrize(
    ("file", "change"),
    [
        ("vehicle.npz", put(plan=None)),
        ("vehicle.npz", filled("plan_waypoints", 9)),
        ("vehicle.npz", filled("step_case", 99)),
        ("vehicle.npz", filled("plan", np.nan)),
        ("vehicle.npz", filled("code_step_pose", np.nan)),
        ("contact.npz", filled("actor_case", 9999)),
        ("command.npz", lambda arrays: arrays.update(path=arrays["path"] + 99)),
        ("loops/made.npz", put(r001_plan=None)),
        ("loops/made.npz", lambda arrays: arrays.update(r001_substep_state=arrays["r001_substep_state"][1:])),
        ("loops/made_inputs.npz", filled("timestamps", 0)),
        ("loops/made_inputs.npz", filled("ann_instance", 99)),
    ],
)
def test_arrays_that_cannot_be_used_are_refused(file: str, change: Change, tmp_path: Path) -> None:
    notices(GOLDEN.verify, altered(BUILT_IN, tmp_path / "set", [(file, change)]))


@pytest.mark.parametrize(
    ("file", "change"),
    [
        ("scenarios.json", put(synthetic=None)),
        ("scenarios.json", lambda facts: facts["official"][0]["scenario"].pop("general")),
        ("scenarios.json", lambda facts: facts["official"][0]["runs"][0].pop("draws")),
        ("aggregate.json", lambda facts: facts["cases"][0]["runs"].update(side=3)),
        ("loops/index.json", lambda facts: facts[0].update(file="../made.json")),
        (MADE, lambda facts: facts["runs"][0].pop("n_infer_calls")),
        (MADE, put(scenario=3)),
    ],
)
def test_facts_that_cannot_be_used_are_refused(file: str, change: Change, tmp_path: Path) -> None:
    with pytest.raises(InputError) as error:
        GOLDEN.verify(altered(BUILT_IN, tmp_path / "set", [(file, change)]))
    assert "\n" not in str(error.value)
