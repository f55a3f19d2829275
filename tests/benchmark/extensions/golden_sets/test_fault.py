"""`verify fault`: the cases are met, changed ones are found, and no turn, mirror or exchange of users matters."""

import json
import shutil
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.extensions.golden_sets.fault import BUILT_IN, GOLDEN
from benchmark.extensions.golden_sets.fault.cases import EXCHANGED, FaultCase, read_cases
from benchmark.fairness.fault_definition import ContactTracks, RoadUser
from benchmark.verification.golden_sets import GoldenFolder
from tests.benchmark.cli.cli_runs import refusal
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.extensions.golden_sets.golden_judgement import SHARED


@cache
def cases() -> list[FaultCase]:
    return read_cases(GoldenFolder(BUILT_IN))


@pytest.mark.path
def test_the_command_agrees_with_the_built_in_set() -> None:
    done = run_here("verify", "fault")
    assert done.code == 0 and "8 of 8 quantities agree" in done.out


@pytest.mark.skipif(not (SHARED / "fault").is_dir(), reason="the golden cases are not beside this checkout")
def test_every_golden_case_is_met() -> None:
    checks = GOLDEN.verify(SHARED / "fault")
    assert all(check.ok and check.count >= 30 for check in checks)


def perturbed(case: FaultCase, user: RoadUser, amounts: tuple[float, float, float]) -> RoadUser:
    """A user a little beside and before its place, and faster or slower."""
    along, aside, faster = amounts
    cos, sin = np.cos(user.pose[:, 2]), np.sin(user.pose[:, 2])
    pose = user.pose.copy()
    pose[:, :2] = pose[-1, :2] + (pose[:, :2] - pose[-1, :2]) * faster
    pose[:, :2] += np.column_stack([along * cos - aside * sin, along * sin + aside * cos])
    return replace(user, pose=pose, speed=user.speed * faster)


amounts = st.tuples(st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.6, 1.4))


@settings(max_examples=60)
@given(
    number=st.integers(0, 29),
    ego=amounts,
    other=amounts,
    angle=st.floats(-3.1, 3.1),
    offset=st.tuples(st.floats(-2000, 2000), st.floats(-2000, 2000)),
)
def test_exchanging_turning_moving_and_mirroring_change_nothing(
    number: int, ego: Any, other: Any, angle: float, offset: tuple[float, float]
) -> None:
    case = cases()[number]
    tracks = case.tracks
    users = perturbed(case, tracks.ego, ego), perturbed(case, tracks.other, other)
    case = replace(case, tracks=ContactTracks(tracks.times_s, *users))
    ours = case.attribute()
    exchanged = case.exchanged().attribute()
    assert (exchanged.verdict, exchanged.reason) == (EXCHANGED.get(ours.verdict, ours.verdict), ours.reason)
    assert exchanged.ego == ours.other and exchanged.other == ours.ego
    for moved in (case.turned(angle, offset), case.mirrored()):
        found = moved.attribute()
        assert (found.verdict, found.reason) == (ours.verdict, ours.reason)


def changed(folder: Path, name: str, change: Any) -> Path:
    """A copy of the built-in set with one file changed."""
    shutil.copytree(BUILT_IN, folder)
    facts = json.loads((folder / name).read_text())
    change(facts)
    (folder / name).write_text(json.dumps(facts))
    return folder


def test_another_verdict_is_found(tmp_path: Path) -> None:
    folder = changed(tmp_path / "set", "stop-sign.json", lambda facts: facts["expected"].update(verdict="other"))
    changed_list = json.loads((folder / "manifest.json").read_text())
    next(case for case in changed_list["cases"] if case["name"] == "stop-sign")["verdict"] = "other"
    (folder / "manifest.json").write_text(json.dumps(changed_list))
    done = run_here("verify", "fault", "--golden", folder)
    assert done.code == 1 and "FAIL  verdict, as given" in done.out and "ok    reason, as given" in done.out


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("stop-sign.json", lambda facts: facts["users"]["ego"]["x_m"].pop()),
        ("stop-sign.json", lambda facts: facts["users"]["other"].update(times_s=[0.0])),
        ("stop-sign.json", lambda facts: facts["map"]["lanes"][0].update(centerline=[[0.0]])),
        ("stop-sign.json", lambda facts: facts["map"]["drivable_area"].append([[[0, 0], [1, 1]]])),
        ("stop-sign.json", lambda facts: facts.update(handedness="both")),
        ("stop-sign.json", lambda facts: facts["expected"].update(reason="luck")),
        ("stop-sign.json", lambda facts: facts["expected"].update(verdict="shared")),
        ("stop-sign.json", lambda facts: facts.pop("users")),
        ("manifest.json", lambda facts: facts.update(format="fault-2")),
        (
            "manifest.json",
            lambda facts: facts["cases"].append({"name": "absent", "verdict": "ego", "reason": "object"}),
        ),
    ],
)
def test_a_damaged_set_is_one_sentence(tmp_path: Path, name: str, change: Any) -> None:
    sentence = refusal("verify", "fault", "--golden", changed(tmp_path / "set", name, change))
    assert "set" in sentence and "\n" not in sentence
