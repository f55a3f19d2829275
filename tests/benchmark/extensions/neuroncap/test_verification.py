"""`verify neuroncap`: golden numbers are met, a changed one is found, broken sets are refused in a sentence."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmark.errors import InputError
from benchmark.extensions.neuroncap.verification import BUILT_IN, FILES, verify_neuroncap
from tests.benchmark.extensions.golden_sets.test_judgement_sets import change_arrays, change_facts
from tests.benchmark.extensions.neuroncap.golden_neuroncap import SHARED, made_loops


@pytest.fixture
def golden(tmp_path: Path) -> Path:
    return Path(shutil.copytree(BUILT_IN, tmp_path / "neuroncap"))


def failed(folder: Path | None) -> list[str]:
    return [check.quantity for check in verify_neuroncap(folder) if not check.ok]


def test_the_built_in_set_agrees() -> None:
    assert failed(None) == []


@pytest.mark.slow
@pytest.mark.skipif(not SHARED.is_dir(), reason="the golden numbers are not here")
def test_every_golden_number_is_met() -> None:
    checks = verify_neuroncap(SHARED)
    assert [check.quantity for check in checks if not check.ok] == []
    assert sum(check.count for check in checks) > 200_000


def test_what_is_made_up_in_the_set_is_what_the_program_makes_up() -> None:
    arrays, facts = made_loops()
    for name, expected in arrays.items():
        with np.load(BUILT_IN / f"{name}.npz") as held:
            assert set(held.files) == set(expected), name
    stored = json.loads((BUILT_IN / "loops/made.json").read_text())
    assert [run["n_infer_calls"] for run in stored["runs"]] == [
        run["n_infer_calls"] for run in facts["loops/made"]["runs"]
    ]
    assert {run["collision"] is None for run in stored["runs"]} == {True, False}


def first_changed(name: str, by: float) -> Callable[[dict[str, Any]], None]:
    def change(arrays: dict[str, Any]) -> None:
        flat = arrays[name].reshape(-1)
        flat[0] = ~flat[0] if flat.dtype == np.bool_ else flat[0] + by

    return change


@pytest.mark.parametrize(
    ("file", "array", "by", "found"),
    [
        ("vehicle.npz", "code_substep_state", 1e-5, "car as code: states of sub-steps"),
        ("vehicle.npz", "float64_substep_command", 1e-8, "car in double precision: commands"),
        ("vehicle.npz", "code_step_time", 1, "car as code: times"),
        ("contact.npz", "hit", 1, "contact: who is touched"),
        ("contact.npz", "hit_alt", 1, "contact with the other box: who is touched"),
        ("command.npz", "command", -1, "command"),
        ("loops/made.npz", "r001_state_time", 1, "loops: times"),
        ("loops/made.npz", "r001_check", 1, "loops: instants and verdicts of checks"),
        ("loops/made.npz", "r002_command", -1, "loops: commands"),
        ("loops/made_inputs.npz", "canbus_at_frame", 1e-3, "loops: CAN rows at frames"),
    ],
)
def test_a_changed_number_is_found(golden: Path, file: str, array: str, by: float, found: str) -> None:
    change_arrays(golden / file, first_changed(array, by))
    assert found in failed(golden)


@pytest.mark.parametrize(
    ("file", "change", "found"),
    [
        (
            "scenarios.json",
            lambda facts: facts["synthetic"]["scenarios"][0]["runs"][0]["draws"].pop(),
            "scenarios: draws",
        ),
        (
            "scenarios.json",
            lambda facts: facts["official"][0]["runs"][1]["actors"][0].update(uuid="other"),
            "scenarios: who is there, in order",
        ),
        ("aggregate.json", lambda facts: facts["cases"][0]["overall"].update(ncap_score=1.0), "aggregate: overall"),
        (
            "aggregate.json",
            lambda facts: facts["cases"][2].update(check_validity="passes"),
            "aggregate: is it complete",
        ),
        ("loops/made.json", lambda facts: facts["runs"][1].update(nns_code=1.0), "loops: score, code"),
        ("loops/made.json", lambda facts: facts["runs"][1].update(collision=None), "loops: contact"),
        ("loops/made.json", lambda facts: facts["runs"][3].update(nns_code="nan"), "loops: score, code"),
        (
            "loops/made.json",
            lambda facts: facts["runs"][1]["metrics"].pop("any_collide@1.0s"),
            "loops: rates in the file",
        ),
    ],
)
def test_a_changed_fact_is_found(golden: Path, file: str, change: Callable[[Any], None], found: str) -> None:
    change_facts(golden / file, change)
    assert found in failed(golden)


@pytest.mark.parametrize("file", [*FILES, "loops/made.json", "loops/made.npz", "loops/made_inputs.npz"])
def test_a_missing_or_cut_file_is_one_sentence(golden: Path, file: str) -> None:
    path = golden / file
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError) as damaged:
        verify_neuroncap(golden)
    path.unlink()
    with pytest.raises(InputError) as missing:
        verify_neuroncap(golden)
    for error in (damaged, missing):
        assert Path(file).name in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("file", "change"),
    [
        ("vehicle.npz", lambda arrays: arrays.pop("plan")),
        ("vehicle.npz", lambda arrays: arrays["plan_waypoints"].fill(9)),
        ("vehicle.npz", lambda arrays: arrays["step_case"].fill(99)),
        ("vehicle.npz", lambda arrays: arrays["plan"].fill(np.nan)),
        ("vehicle.npz", lambda arrays: arrays["code_step_pose"].fill(np.nan)),
        ("contact.npz", lambda arrays: arrays["actor_case"].fill(9999)),
        ("contact.npz", lambda arrays: arrays["pose_time"].fill(0)),
        ("command.npz", lambda arrays: arrays.update(path=arrays["path"] + 99)),
        ("loops/made.npz", lambda arrays: arrays.pop("r001_plan")),
        ("loops/made.npz", lambda arrays: arrays.update(r001_substep_state=arrays["r001_substep_state"][1:])),
        ("loops/made_inputs.npz", lambda arrays: arrays["timestamps"].fill(0)),
        ("loops/made_inputs.npz", lambda arrays: arrays["ann_instance"].fill(99)),
    ],
)
def test_arrays_that_cannot_be_used_are_refused(golden: Path, file: str, change: Callable[[Any], None]) -> None:
    change_arrays(golden / file, change)
    with pytest.raises(InputError, match=Path(file).name):
        verify_neuroncap(golden)


@pytest.mark.parametrize(
    ("file", "change"),
    [
        ("scenarios.json", lambda facts: facts.pop("synthetic")),
        ("scenarios.json", lambda facts: facts["official"][0]["scenario"].pop("general")),
        ("scenarios.json", lambda facts: facts["official"][0]["runs"][0].pop("draws")),
        ("aggregate.json", lambda facts: facts.update(cases=[])),
        ("aggregate.json", lambda facts: facts["cases"][0]["runs"].update(side=3)),
        ("loops/index.json", lambda facts: facts[0].update(file="../made.json")),
        ("loops/made.json", lambda facts: facts["runs"][0].pop("n_infer_calls")),
        ("loops/made.json", lambda facts: facts.update(scenario=3)),
    ],
)
def test_facts_that_cannot_be_used_are_refused(golden: Path, file: str, change: Callable[[Any], None]) -> None:
    change_facts(golden / file, change)
    with pytest.raises(InputError) as error:
        verify_neuroncap(golden)
    assert Path(file).stem in str(error.value) and "\n" not in str(error.value)
