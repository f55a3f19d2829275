"""The main path: same bytes whatever the workers and interruptions, and failures that stay failures."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import benchmark.evaluation
from adapters.plan_file import WAYPOINT_COLUMNS, plan_file_factory
from adapters.planners.log_replay import LogReplay
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.planning import CameraView, Observation, SceneInfo
from benchmark.protocols import STANDARD
from benchmark.records.run import find_records, load_record
from benchmark.records.run_schema import PlannerFacts
from benchmark.runs.planner_facts import build_planner_facts
from benchmark.scene import Camera
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.planners import Factory, Failing, LooksAtImages, Remembering, Straight
from tests.hand_made import Car, scene_on_straight_road

ROOT = Path(__file__).resolve().parents[2]


EXACT = EvalSettings(protocols=("exact",))


def contents(folder: Path) -> dict[str, bytes]:
    """Every file."""
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }


def town_of_six() -> FakeData:
    return FakeData(
        {f"v{i % 2}/scene-{9910 + i}": scene_on_straight_road(name=f"v{i % 2}/scene-{9910 + i}") for i in range(6)}
    )


def test_constant_speed_hits_a_slow_leader_and_the_numbers_are_those_of_the_rows(tmp_path: Path) -> None:
    record = evaluate(town_of_two(slow_leader=True), "val", Straight(), tmp_path, EXACT)
    collision = record.summary.protocols["exact"].columns["collision"]["3s"]
    counted = [row.outcomes["exact"] for row in record.rows if row.outcomes["exact"].counted]
    assert collision.denominator == len(counted) == 20
    assert collision.numerator == sum(any(outcome.collision or ()) for outcome in counted) > 0
    assert {row.scene for row in record.rows if any(row.outcomes["exact"].collision or ())} == {"scene-9902"}
    assert record.complete and record.covers_split
    assert load_record(record.directory).rows == record.rows


def test_the_recorded_ego_has_no_displacement_and_no_collision(tmp_path: Path) -> None:
    record = evaluate(town_of_two(), "val", LogReplay(), tmp_path, EXACT)
    columns = record.summary.protocols["exact"].columns
    assert columns["collision"]["avg"].value == 0.0
    assert columns["l2"]["avg"].value == pytest.approx(0.0, abs=1e-9)
    assert record.run.planner.privileged


def test_one_and_two_workers_give_the_same_bytes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(benchmark.evaluation, "PROCESSES_PAY_AFTER_S", 0.0)
    factory = Factory(Remembering)
    one = evaluate(town_of_six(), "val", factory, tmp_path / "one", EvalSettings(workers=1))
    two = evaluate(town_of_six(), "val", factory, tmp_path / "two", EvalSettings(workers=2), reopen=town_of_six)
    assert contents(one.directory) == contents(two.directory)
    assert len({row.plan.waypoints[5][0] for row in one.rows if row.plan}) > 6


def test_a_network_waits_for_no_first_scene_where_workers_are_at_hand(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    facts = PlannerFacts(name="made", privileged=False, weights_sha256="0" * 64)
    factory = Factory(Remembering, facts=facts)
    one = evaluate(town_of_six(), "val", factory, tmp_path / "one", EXACT)
    here: list[str] = []
    monkeypatch.setattr(benchmark.evaluation, "evaluate_scene", lambda runs, data, planners, scene: here.append(scene))
    monkeypatch.setattr(benchmark.evaluation, "has_forkserver", lambda: True)
    two = evaluate(town_of_six(), "val", factory, tmp_path / "two", replace(EXACT, workers=2), reopen=town_of_six)
    assert not here and contents(one.directory) == contents(two.directory)


def test_running_again_asks_the_planner_nothing_and_changes_no_byte(tmp_path: Path) -> None:
    first = evaluate(town_of_two(), "val", Straight(), tmp_path, EXACT)
    before, planner = contents(first.directory), Straight()
    evaluate(town_of_two(), "val", planner, tmp_path, EXACT)
    assert planner.calls == 0 and contents(first.directory) == before
    evaluate(town_of_two(), "val", planner, tmp_path, replace(EXACT, fresh=True))
    assert planner.calls == 32 and contents(first.directory) == before


def test_other_data_or_another_planner_is_planned_anew(tmp_path: Path) -> None:
    evaluate(town_of_two(), "val", Straight(), tmp_path, EXACT)
    planner = Straight()
    record = evaluate(town_of_two(slow_leader=True), "val", planner, tmp_path, EXACT)
    assert planner.calls == 32
    tuned = Straight()
    tuned.settings = {"gain": 2}  # type: ignore[attr-defined]
    again = evaluate(town_of_two(slow_leader=True), "val", tuned, tmp_path, EXACT)
    assert tuned.calls == 32 and again.directory == record.directory
    assert len(find_records(tmp_path)) == 1


def test_damaged_rows_are_planned_again(tmp_path: Path) -> None:
    record = evaluate(town_of_two(), "val", Straight(), tmp_path, EXACT)
    before = contents(record.directory)
    rows = record.directory / "rows" / "scene-9901.json"
    for damage in (b"", rows.read_bytes()[:-400], b"[]\n", rows.read_bytes().rsplit(b"\n", 2)[0] + b"\n"):
        rows.write_bytes(damage)
        planner = Straight()
        evaluate(town_of_two(), "val", planner, tmp_path, EXACT)
        assert planner.calls == 16 and contents(record.directory) == before


def test_records_hold_every_protocol_and_the_facts_of_their_scenes(tmp_path: Path) -> None:
    record = evaluate(town_of_two(), "val", Straight(), tmp_path, EvalSettings(limit=1))
    assert set(record.run.protocols) == set(STANDARD) == set(record.summary.protocols) == set(record.rows[0].outcomes)
    assert {name: facts.source for name, facts in record.run.scene_facts.items()} == {"scene-9901": "scene-9901"}
    assert record.missing_protocols == record.stale_protocols == ()


def test_what_tables_say_of_a_planner_changes_neither_directory_nor_kept_plans(tmp_path: Path) -> None:
    plain = evaluate(town_of_two(), "val", Factory(), tmp_path)
    rows = contents(plain.directory / "rows")
    said = {"native_protocol": "vad", "published_as": "VAD", "miniature": True}
    named = replace(Factory(), facts=plain.run.planner.model_copy(update=said))
    record = evaluate(town_of_two(), "val", replace(named, made=Failing), tmp_path)
    assert record.directory == plain.directory and contents(plain.directory / "rows") == rows
    assert record.complete and load_record(record.directory).native_protocol == "vad"


def test_a_planner_names_its_native_protocol_itself() -> None:
    planner = Straight()
    assert build_planner_facts(planner).native_protocol is None
    planner.native_protocol = "sparsedrive"  # type: ignore[attr-defined]
    assert build_planner_facts(planner).native_protocol == "sparsedrive"
    for wrong in ("nuplan", 3, ["vad"]):
        planner.native_protocol = wrong  # type: ignore[attr-defined]
        with pytest.raises(InputError, match=r"planner 'straight' has the unknown native protocol .*choose from exact"):
            build_planner_facts(planner)


def test_plans_of_a_file_have_the_native_protocol_that_is_given(tmp_path: Path) -> None:
    data, path = town_of_two(), tmp_path / "mine.csv"
    names = [truth.sample_token for scene in data.scene_names() for truth in data.truth(scene)]
    points = ",".join(f"0.0,{4.0 * step}" for step in range(1, 7))
    rows = [f"{name},lidar,{points}" for name in names]
    path.write_text("\n".join([",".join(("sample_token", "frame", *WAYPOINT_COLUMNS)), *rows]) + "\n")
    record = evaluate(data, "val", plan_file_factory(path, data, "val", native="uniad"), tmp_path / "out")
    assert record.native_protocol == "uniad"
    plain = evaluate(data, "val", plan_file_factory(path, data, "val"), tmp_path / "out")
    assert plain.directory == record.directory and plain.native_protocol == "exact"
    with pytest.raises(InputError, match=r"mine\.csv .* unknown native protocol 'UniAD'; choose from exact, uniad"):
        plan_file_factory(path, data, "val", native="UniAD")


def test_a_failed_sample_is_never_a_zero(tmp_path: Path) -> None:
    record = evaluate(town_of_two(), "val", Failing(), tmp_path, EXACT)
    failed = [row for row in record.rows if row.status == "failed"]
    assert [row.index for row in failed] == [3, 3]
    assert all(row.plan is None and row.outcomes == {} for row in failed)
    assert record.run.status == "partial" and record.summary.failed == 2
    assert record.summary.coverage == pytest.approx(30 / 32)
    assert record.summary.protocols["exact"].columns["collision"]["3s"].denominator == 18
    assert record.summary.protocols["exact"].scenes_decided == 0
    error = failed[0].error or ""
    assert "RuntimeError: no idea <object object at 0x...>" in error
    assert str(ROOT) not in error and 'File "planners.py"' in error


class Broken(Straight):
    name = "broken"

    def reset(self, scene: SceneInfo) -> None:
        raise ValueError("no weights")


class Wrong(Straight):
    name = "wrong"

    def plan(self, observation: Observation) -> Any:
        return np.zeros((6, 2))


@pytest.mark.parametrize(("planner", "says"), [(Broken, "ValueError: no weights"), (Wrong, "returned ndarray")])
def test_a_planner_that_fails_at_reset_or_gives_no_plan_fails_its_scenes(
    tmp_path: Path, planner: type[Straight], says: str
) -> None:
    record = evaluate(town_of_two(), "val", planner(), tmp_path, EXACT)
    assert record.summary.failed == 32 and record.summary.coverage == 0.0
    assert all(says in (row.error or "") for row in record.rows)
    assert record.summary.protocols["exact"].columns["collision"]["avg"].value is None


def test_a_broken_image_is_the_datas_fault(tmp_path: Path) -> None:
    def load() -> NDArray[np.uint8]:
        raise InputError("cannot read front.jpg")

    camera = Camera("CAM_FRONT", np.zeros(3), np.array([1.0, 0, 0, 0]), np.eye(3), 8, 8)
    data = town_of_two()
    data.views["CAM_FRONT"] = CameraView(camera, Path("front.jpg"), 0, np.eye(4), load)
    with pytest.raises(InputError, match=r"front\.jpg"):
        evaluate(data, "val", LooksAtImages(), tmp_path)


def test_parts_of_a_split_have_their_own_record(tmp_path: Path) -> None:
    whole = evaluate(town_of_two(), "val", Straight(), tmp_path, EXACT)
    part = evaluate(town_of_two(), "val", Straight(), tmp_path, replace(EXACT, limit=1))
    assert part.directory != whole.directory
    assert part.run.scenes == ["scene-9901"] and not part.covers_split and whole.covers_split


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (EvalSettings(scenes=("scene-1", "scene-9901")), "no scene scene-1"),
        (EvalSettings(limit=0), "--limit"),
        (EvalSettings(scenes=()), "no scenes to evaluate"),
        (EvalSettings(protocols=("nonsense",)), "unknown protocol 'nonsense'"),
        (EvalSettings(workers=0), "--workers"),
    ],
)
def test_bad_settings_are_one_sentence(wrong: EvalSettings, says: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=says):
        evaluate(town_of_two(), "val", Factory(), tmp_path, wrong)


KILLED = """
from pathlib import Path
from benchmark.evaluation import evaluate
from tests.benchmark.planners import Factory, Straight
from tests.benchmark.test_evaluation import EXACT, town_of_six
evaluate(town_of_six(), "val", Factory(Straight, ({pause},)), Path({out!r}), EXACT)
"""


def test_killed_and_started_again_gives_the_bytes_of_an_undisturbed_run(tmp_path: Path) -> None:
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    script = KILLED.format(pause=0.02, out=str(tmp_path / "killed"))
    running = subprocess.Popen([sys.executable, "-c", script], cwd=ROOT, env=environment)
    deadline = time.monotonic() + 60
    while len(list((tmp_path / "killed").rglob("rows/*.json"))) < 2 and time.monotonic() < deadline:
        time.sleep(0.01)
    running.send_signal(signal.SIGKILL)
    running.wait()
    left = list((tmp_path / "killed").rglob("rows/*.json"))
    assert left and not list((tmp_path / "killed").rglob("run.json"))
    (left[0].parent / ".scene.json.1.part").write_bytes(b"half a row")
    timed = replace(EXACT, timings=tmp_path / "timings")
    again = evaluate(town_of_six(), "val", Factory(), tmp_path / "killed", timed)
    undisturbed = evaluate(town_of_six(), "val", Factory(), tmp_path / "undisturbed", EXACT)
    assert contents(again.directory) == contents(undisturbed.directory)
    (noted,) = (tmp_path / "timings").rglob("*.timing.json")
    timing = json.loads(noted.read_text())
    assert 0 < len(timing["scenes"]) < 6


def test_a_disk_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(InputError, match="cannot write"):
        evaluate(town_of_two(), "val", Straight(), tmp_path / "file")


def test_an_empty_road_is_no_truth_and_a_short_one_has_no_rate(tmp_path: Path) -> None:
    data = FakeData({"scene-9901": scene_on_straight_road(())})
    with pytest.raises(InputError, match="cannot be scored: it has no annotation"):
        evaluate(data, "val", Straight(), tmp_path)
    short = FakeData({"scene-9901": scene_on_straight_road((Car(80.0, 198.25),), seconds=1.0)})
    record = evaluate(short, "val", LogReplay(), tmp_path, EXACT)
    assert record.summary.protocols["exact"].columns["collision"]["avg"].value is None
