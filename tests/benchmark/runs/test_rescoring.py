"""Rescoring: the bytes that a new run would give, nothing where nothing changes, and no half record whenever killed."""

import json
import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine.storage import lock_folder
from benchmark.protocols import PROTOCOLS, STANDARD
from benchmark.protocols.exact import ExactProtocol
from benchmark.records.run import RunRecord, load_record
from benchmark.records.run_schema import SCHEMA
from benchmark.records.store import finish_replacement, replace_files
from benchmark.runs.rescoring import rescore, rescore_all
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.planners import Failing, Straight
from tests.benchmark.records.test_run import GOLDEN
from tests.benchmark.test_evaluation import contents

ALL = tuple(PROTOCOLS)
TWO = ("exact", "uniad")
"""Enough where it does not matter who judges."""
DATA = town_of_two(slow_leader=True)


class Killed(BaseException):
    """What the test raises where a process would have ended."""


@pytest.fixture(scope="module")
def judged_by_exact(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of a planner that fails once a scene, judged by one protocol only."""
    out = tmp_path_factory.mktemp("runs")
    return evaluate(DATA, "val", Failing(), out, EvalSettings(protocols=("exact",))).directory


@pytest.fixture(scope="module")
def undisturbed(judged_by_exact: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """What rescoring that nobody kills leaves."""
    directory = Path(shutil.copytree(judged_by_exact, tmp_path_factory.mktemp("undisturbed") / "failing"))
    rescore(directory, DATA, protocols=TWO)
    return contents(directory)


@pytest.fixture
def directory(judged_by_exact: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(judged_by_exact, tmp_path / "runs" / "fake" / "val" / "failing"))


def without(run: Any, *names: str) -> Any:
    return {name: value for name, value in run.items() if name not in names}


def run_json(directory: Path) -> Any:
    return json.loads((directory / "run.json").read_text())


def all_of(root: Path, data: FakeData = DATA) -> dict[str, tuple[str, bool]]:
    return {
        result.directory.relative_to(root).as_posix(): (result.sentence, result.failed)
        for result in rescore_all(root, lambda split: data, data.name, TWO)
    }


def test_rescoring_gives_the_record_that_a_run_with_all_protocols_gives(directory: Path, tmp_path: Path) -> None:
    assert load_record(directory).missing_protocols == STANDARD[1:]
    rescored = rescore(directory, DATA, protocols=ALL)
    new = evaluate(DATA, "val", Failing(), tmp_path / "new", EvalSettings(protocols=ALL))
    assert rescored.rows == new.rows and rescored.summary == new.summary
    for name in ("samples.jsonl", "summary.json"):
        assert (directory / name).read_bytes() == (new.directory / name).read_bytes()
    assert without(run_json(directory), "rescored") == without(run_json(new.directory), "rescored")
    assert rescored.run.rescored == new.run.environment and new.run.rescored is None
    assert load_record(directory) == rescored
    assert rescored.missing_protocols == () and rescored.stale_protocols == ()


def test_plans_errors_planner_and_its_environment_stay(directory: Path) -> None:
    facts = run_json(directory)
    facts["environment"] = {"hardware": {"cpu": "another machine"}}
    facts["planner"]["native_protocol"] = "vad"
    (directory / "run.json").write_text(json.dumps(facts))
    before, after = load_record(directory), rescore(directory, DATA, protocols=TWO)
    assert after.run.environment == before.run.environment != after.run.rescored
    assert after.run.planner == before.run.planner and after.native_protocol == "vad"
    assert [(row.plan, row.error, row.status) for row in after.rows] == [
        (row.plan, row.error, row.status) for row in before.rows
    ]
    assert [row.outcomes == {} for row in after.rows] == [row.status == "failed" for row in after.rows]
    assert not after.complete


def test_doing_it_again_writes_nothing(directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    rescore(directory, DATA, protocols=TWO)
    before, times = contents(directory), {path: path.stat().st_mtime_ns for path in directory.rglob("*")}
    monkeypatch.setattr("benchmark.runs.rescoring.environment_facts", lambda: {"hardware": {"cpu": "another machine"}})
    rescore(directory, DATA, protocols=(*TWO, TWO[0]))
    assert contents(directory) == before
    assert {path: path.stat().st_mtime_ns for path in directory.rglob("*")} == times


def test_rescoring_brings_the_further_protocols_to_a_run_without_its_planner(tmp_path: Path) -> None:
    record = evaluate(DATA, "val", Straight(), tmp_path)
    assert tuple(record.run.protocols) == STANDARD and record.missing_protocols == ()
    after = rescore(record.directory, DATA)
    assert tuple(after.run.protocols) == ALL and set(ALL) > set(STANDARD)
    assert [row.plan for row in after.rows] == [row.plan for row in record.rows]
    for name in STANDARD:
        assert after.summary.protocols[name] == record.summary.protocols[name]
    for name in set(ALL) - set(STANDARD):
        assert after.summary.protocols[name].columns["collision"]["3s"].value is not None
    # The made-up data set has no map: the kerb is in no denominator.
    off_road = after.summary.protocols["omnidrive"].columns["off_road"]["3s"]
    assert (off_road.value, off_road.denominator) == (None, 0)


def test_a_changed_protocol_makes_records_stale_until_they_are_rescored(
    directory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stricter(ExactProtocol):
        version = 99

    monkeypatch.setitem(PROTOCOLS, "exact", Stricter())
    assert load_record(directory).stale_protocols == ("exact",)
    record = rescore(directory, DATA, protocols=TWO)
    assert record.stale_protocols == () and record.summary.protocols["exact"].version == 99


def test_fewer_protocols_leave_no_verdict_of_the_others(directory: Path) -> None:
    record = rescore(directory, DATA, protocols=("uniad",))
    assert record.run.protocols == {"uniad": PROTOCOLS["uniad"].version}
    assert all(set(row.outcomes) <= {"uniad"} and row.diagnosis is None for row in record.rows)


def test_records_of_schema_1_are_rescored(tmp_path: Path) -> None:
    directory = Path(shutil.copytree(GOLDEN / "schema-1", tmp_path / "old"))
    old = load_record(directory)
    assert old.missing_protocols == STANDARD[1:] and old.stale_protocols == ("exact",)
    assert old.summary.protocols["exact"].mask_removed_steps is None and old.run.scene_facts == {}
    new = rescore(directory, DATA, protocols=ALL)
    assert run_json(directory)["schema"] == SCHEMA and set(new.run.scene_facts) == set(new.run.scenes)
    # Version 2 says the same of samples at 2 Hz.
    assert new.summary.protocols["exact"] == old.summary.protocols["exact"].model_copy(update={"version": 2})
    assert any(row.diagnosis for row in new.rows)
    assert {(row.place, row.speed_m_s) for row in old.rows} == {(None, None)}
    assert {row.severity for row in old.rows} == {None}
    assert all((row.severity is not None) == (row.status == "ok") for row in new.rows)
    assert {row.place for row in new.rows} == {"straight"} and all(row.speed_m_s == 8.0 for row in new.rows)
    assert {tuple(facts.light or ()) for facts in new.run.scene_facts.values()} == {("day",)}
    assert rescore(directory, DATA, protocols=ALL) == new


@pytest.mark.parametrize("killed_at", range(1, 7))
def test_killed_anywhere_the_old_record_loads_or_rescoring_again_finishes(
    directory: Path, undisturbed: dict[str, bytes], killed_at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = load_record(directory)
    with monkeypatch.context() as patch, pytest.raises(Killed):
        kill_at(patch, killed_at)
        rescore(directory, DATA, protocols=TWO)
    try:
        assert load_record(directory) == old
    except InputError as error:
        assert killed_at > 4 and "run challenger-bench rescore again" in str(error)
    assert all_of(directory.parent) == {"failing": ("current" if killed_at > 3 else "rescored", False)}
    assert contents(directory) == undisturbed


@pytest.mark.parametrize("killed_at", [1, 3, 5, 6])
def test_killed_while_it_replaces_a_record_eval_can_be_started_again(
    directory: Path, tmp_path: Path, killed_at: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, settings = tmp_path / "runs", EvalSettings(protocols=TWO)
    with monkeypatch.context() as patch, pytest.raises(Killed):
        kill_at(patch, killed_at, ".pending")
        evaluate(DATA, "val", Failing(), out, settings)
    again = evaluate(DATA, "val", Failing(), out, settings)
    assert again.directory == directory
    assert contents(directory) == contents(
        evaluate(DATA, "val", Failing(), tmp_path / "undisturbed", settings).directory
    )


def kill_at(patch: pytest.MonkeyPatch, count: int, ending: str = "") -> None:
    """End the process when a file of a record gets its name for the nth time, be it new or a replacement."""
    replace_path, link, calls = Path.replace, os.link, iter(range(1, 1000))

    def named(*names: str) -> None:
        if any(name.endswith(ending) for name in names) and next(calls) == count:
            raise Killed

    def replace(path: Path, target: Path) -> Path:
        named(path.name, target.name)
        return replace_path(path, target)

    def linked(source: Path, target: Path, **options: Any) -> None:
        # What is only called so until it replaces another file gets its name when it does.
        if not target.name.endswith(".part"):
            named(target.name)
        link(source, target, **options)

    patch.setattr(Path, "replace", replace)
    patch.setattr(os, "link", linked)


def test_leftovers_that_belong_to_nothing_are_dropped(directory: Path) -> None:
    before = contents(directory)
    for name, text in {
        ".run.json.pending": '{"files": {"samples.jsonl": "0", "summary.json": "0"}}',
        ".samples.jsonl.pending": "half a ro",
        ".summary.json.pending.77.part": "",
    }.items():
        (directory / name).write_text(text)
        assert load_record(directory).planner == "failing"
    finish_replacement(directory)
    assert contents(directory) == before
    for nonsense in ("", "[]", "{}", '{"files": []}', '{"files": {}}'):
        (directory / ".run.json.pending").write_text(nonsense)
        finish_replacement(directory)
        assert contents(directory) == before


def test_other_data_is_one_sentence(directory: Path) -> None:
    before = contents(directory)
    with pytest.raises(InputError, match="used other data of fake than"):
        rescore(directory, town_of_two(), protocols=ALL)
    with pytest.raises(InputError, match="unknown protocol 'nonsense'"):
        rescore(directory, DATA, protocols=("nonsense",))
    with pytest.raises(InputError, match="no run record"):
        rescore(directory / "nowhere", DATA, protocols=ALL)
    assert contents(directory) == before and not (directory / "nowhere").exists()


def test_a_record_that_another_command_writes_is_left_alone(directory: Path) -> None:
    with lock_folder(directory), pytest.raises(InputError, match="another command is writing"):
        rescore(directory, DATA, protocols=ALL)


def test_one_damaged_record_does_not_stop_the_others(directory: Path, tmp_path: Path) -> None:
    root = tmp_path / "runs"
    for name in ("current", "foreign", "moved", "truncated"):
        shutil.copytree(directory, root / name)
    rescore(root / "current", DATA, protocols=TWO)
    change(root / "foreign", data={**run_json(directory)["data"], "name": "another"})
    change(root / "moved", data={**run_json(directory)["data"], "fingerprint": "0" * 64})
    (root / "truncated" / "samples.jsonl").write_bytes((directory / "samples.jsonl").read_bytes()[:-9])
    found = all_of(root)
    assert list(found) == ["current", "fake/val/failing", "foreign", "moved", "truncated"]
    assert [failed for _, failed in found.values()] == [False, False, False, True, True]
    assert found["current"][0] == "current" and found["fake/val/failing"][0] == "rescored"
    assert "it belongs to data set another" in found["foreign"][0] and "fingerprints differ" in found["moved"][0]
    assert load_record(root / "foreign").missing_protocols == STANDARD[1:]
    with pytest.raises(InputError, match="nowhere does not exist"):
        all_of(root / "nowhere")


def test_a_split_that_cannot_be_opened_fails_its_records_only(directory: Path, tmp_path: Path) -> None:
    shutil.copytree(directory, tmp_path / "runs" / "other")
    change(tmp_path / "runs" / "other", split="adv")
    asked: list[str] = []

    def open_split(split: str) -> FakeData:
        asked.append(split)
        if split == "adv":
            raise InputError("split 'adv' has not been generated")
        return DATA

    found = list(rescore_all(tmp_path / "runs", open_split, "fake", TWO))
    assert [result.failed for result in found] == [False, True] and asked == ["val", "adv"]


def test_rows_of_other_samples_are_refused(directory: Path) -> None:
    record = load_record(directory)
    shorter = replaced_rows(record, [row.model_dump(mode="json") for row in record.rows[1:]])
    with pytest.raises(InputError, match="does not hold the samples of scene-9901"):
        rescore(shorter, DATA, protocols=ALL)


def replaced_rows(record: RunRecord, rows: list[Any]) -> Path:
    run = run_json(record.directory)
    summary = json.loads((record.directory / "summary.json").read_text())
    replace_files(record.directory, lambda files: {**run, "files": files}, rows, summary)
    return record.directory


def change(directory: Path, **values: Any) -> None:
    (directory / "run.json").write_text(json.dumps({**run_json(directory), **values}))
