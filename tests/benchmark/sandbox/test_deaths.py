"""The table of deaths: what a planner does at one sample, which samples fail, with what reason, and which do not."""

import os
import re
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from benchmark.records.run_schema import PlannerFacts
from benchmark.runs.plan_rows import plan_scene
from benchmark.sandbox.limits import SandboxLimits
from benchmark.sandbox.planner import PlannerIdentity, PlannerSpec, SandboxedPlanner, make_sandboxed_planner
from benchmark.untrusted.files import GIB
from tests.benchmark.fake_data import FakeData
from tests.benchmark.sandbox.dying import AT, WAYS
from tests.hand_made import scene_on_straight_road

SAMPLES = 5
LIMIT_S = 10.0
SHORT_S = 1.0
SILENCE_S = 1.0
REST = "not planned: at sample 2 of the scene "
LATE = "no plan within 1 s; its process was ended"
DIED = "the planner's process died (signal "
LEFT = "the planner's process ended by itself with exit status "
BROKE = "the planner's process broke the connection: "
LOST = {
    "spins": LATE,
    "deaf": LATE,
    "segmentation-fault": f"{DIED}SIGSEGV)",
    "leaves": f"{LEFT}0",
    "leaves-with-3": f"{LEFT}3",
    "kills-itself": f"{DIED}SIGKILL, as happens where memory runs out)",
    "closes-everything": f"{LEFT}1",
    "talks-nonsense": f"{BROKE}it answered another question",
    "answers-before": f"{BROKE}it answered another question",
    "leaves-a-process": f"{LEFT}1",
}
RAISED = {
    "raises": "ValueError: no idea",
    "exits": "SystemExit: 0",
    "interrupts": "KeyboardInterrupt",
    "own-base-exception": "tests.benchmark.sandbox.dying.Own: mine",
    "wordless": "tests.benchmark.sandbox.dying.Wordless: <exception str() failed>",
    "wordy": "long",
    "takes-memory": "MemoryError",
    "recursion": "RecursionError: maximum recursion depth exceeded",
    "returns-none": "TypeError: dying returned NoneType; a planner must return benchmark.planning.Plan",
    "too-much": "UnencodableValueError: the answer cannot be sent: it holds more than 67108864 bytes",
    "no-numbers": "UnencodableValueError: the answer cannot be sent: it holds an array of object",
}
HARMLESS = ("prints", "closes-streams", "forks", "leaves-a-copy", "starts-a-process")


def maker(kind: str, **given: Any) -> tuple[PlannerSpec, PlannerIdentity]:
    name = {"Dying": "dying", "Silent": "dying", "Drawing": "drawing", "LoadsElsewhere": "loads-elsewhere"}[kind]
    reference = "tests.benchmark.sandbox.dying:made"
    return PlannerSpec(name, reference, {"kind": kind, **given}), PlannerIdentity(
        PlannerFacts(name=name, privileged=False)
    )


def roads(*names: str) -> FakeData:
    road = scene_on_straight_road(seconds=0.5 * SAMPLES)
    return FakeData({name: replace(road, name=name) for name in names})


def planned(planner: SandboxedPlanner, data: FakeData, name: str, folder: Path) -> list[dict[str, Any]]:
    return plan_scene(planner, data, name, folder / f"{name}.jsonl", "key", fresh=False).rows


def processes(notes: Path, kind: str) -> list[int]:
    return [int(each.name.rpartition("-")[2]) for each in notes.glob(f"{kind}-*")]


def gone(process: int) -> bool:
    try:
        return "Z" in Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return True


def wait_until_gone(found: list[int]) -> None:
    until = time.monotonic() + 20.0
    while not all(map(gone, found)):
        assert time.monotonic() < until, [each for each in found if not gone(each)]
        time.sleep(0.05)


@pytest.fixture(scope="module")
def notes(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("notes")


@pytest.fixture(scope="module")
def rows(notes: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[dict[str, Any]]]:
    """All deaths one after the other: that each scene begins well is what the one before must not prevent."""
    names = (*LOST, *RAISED, *HARMLESS, "dies-in-reset", "ordinary")
    kept, data = tmp_path_factory.mktemp("rows"), roads(*names)
    made, identity = maker("Dying", notes=notes)
    found: dict[str, list[dict[str, Any]]] = {}
    # Those whose limit is waited for wait for a short one; the others never do.
    for limit_s, late in ((SHORT_S, True), (LIMIT_S, False)):
        planner = make_sandboxed_planner(made, identity, SandboxLimits(limit_s, memory_bytes=GIB, loading_s=60.0))
        chosen = [name for name in names if (LOST.get(name) == LATE) == late]
        found |= {name: planned(planner, data, name, kept) for name in chosen}
        planner.close()
    assert {path.stem for path in kept.glob("*.jsonl")} == {*names} - {*LOST, "dies-in-reset"}
    return found


def test_the_table_is_whole() -> None:
    assert {*LOST, *RAISED, *HARMLESS} == {*WAYS}


@pytest.mark.parametrize("way", LOST)
def test_who_is_lost_fails_at_the_rest_of_the_scene(rows: dict[str, list[dict[str, Any]]], way: str) -> None:
    found = rows[way]
    assert [row["status"] for row in found] == ["ok"] * AT + ["failed"] * (SAMPLES - AT)
    assert [row["error"] for row in found[AT:]] == [LOST[way], *[REST + LOST[way]] * (SAMPLES - AT - 1)]


@pytest.mark.parametrize("way", RAISED)
def test_who_raises_fails_at_that_sample(rows: dict[str, list[dict[str, Any]]], way: str) -> None:
    found = rows[way]
    assert [row["status"] for row in found] == ["failed" if index == AT else "ok" for index in range(SAMPLES)]
    assert RAISED[way] in found[AT]["error"] and len(found[AT]["error"]) < 30_000
    assert not re.search(r"/(work|tmp|home)/|0x[0-9a-f]{6}", found[AT]["error"])


@pytest.mark.parametrize("way", [*HARMLESS, "ordinary"])
def test_what_is_harmless_is_no_failure(rows: dict[str, list[dict[str, Any]]], way: str) -> None:
    assert [row["status"] for row in rows[way]] == ["ok"] * SAMPLES


def test_who_dies_in_reset_fails_at_every_sample(rows: dict[str, list[dict[str, Any]]]) -> None:
    assert {row["error"] for row in rows["dies-in-reset"]} == {f"{LEFT}7"}
    assert {row["status"] for row in rows["dies-in-reset"]} == {"failed"}


def test_no_answer_is_taken_for_that_of_another_sample(rows: dict[str, list[dict[str, Any]]]) -> None:
    for found in rows.values():
        for row in found:
            assert row["plan"] is None or row["plan"]["waypoints"][0] == [float(row["index"]), 0.0]


def test_nothing_is_left_of_any_of_them(rows: dict[str, list[dict[str, Any]]], notes: Path) -> None:
    """Nor of what they started, also where it was meant to outlive them."""
    assert len(processes(notes, "planner")) >= len(LOST) and len(processes(notes, "outliving")) == 2
    assert len(processes(notes, "copy")) == 1
    wait_until_gone([process for kind in ("planner", "outliving", "copy") for process in processes(notes, kind)])
    assert not [each for each in Path(f"/proc/{os.getpid()}/task").glob("*/children") if "reaper" in each.read_text()]


@pytest.mark.parametrize("way", ["holds-the-lock", "is-stopped"])
def test_who_gives_no_sign_of_life_is_not_waited_for(tmp_path: Path, way: str) -> None:
    made, identity = maker("Silent", notes=tmp_path)
    planner = make_sandboxed_planner(made, identity, SandboxLimits(600.0, loading_s=60.0, silence_s=SILENCE_S))
    begun = time.monotonic()
    found = planned(planner, roads(way), way, tmp_path)
    assert found[AT]["error"] == f"no plan, and its process gave no sign of life for {SILENCE_S:g} s; it was ended"
    assert found[-1]["error"].startswith(REST) and time.monotonic() - begun < 120.0
    planner.close()
    wait_until_gone(processes(tmp_path, "planner"))
