"""Submissions: what was made honestly is fit; whatever was changed afterwards is found and said in one sentence."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from adapters.planner_listing import find_own_planner
from adapters.planners.log_replay import LogReplay
from adapters.registry import planner_factory
from benchmark.closed_loop.default_engine import DefaultBackend
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.extensions.submissions.checking import check_submission
from benchmark.extensions.submissions.recomputed import FindingLevel, SubmissionFinding
from benchmark.machine.storage import file_sha256
from benchmark.protocols import PROTOCOLS
from benchmark.protocols.exact import ExactProtocol
from benchmark.runs.driving import DriveSettings, drive_split
from benchmark.scene import Scene
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.cli.small_path import PLANNERS, SPLITS, done, judged_town, small_town
from tests.benchmark.fake_data import FakeData, town_of_two
from tests.benchmark.planners import Failing, Straight
from tests.hand_made import scene_on_straight_road

DATA = town_of_two(slow_leader=True)


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("submission")
    evaluate(DATA, "val", Straight(), root)
    return root


@pytest.fixture
def folder(honest: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(honest, tmp_path / "submitted"))


def checked(folder: Path) -> tuple[int, list[SubmissionFinding]]:
    sound, findings = check_submission(folder, DATA.name, lambda split: DATA)
    return len(sound), [finding for finding in findings if finding.level is FindingLevel.ERROR]


Forgery = Callable[[dict[str, Any], list[Any], dict[str, Any]], object]
"""Changes the head of a record, its rows and its summary."""


def edited(folder: Path, change: Forgery) -> None:
    """Change a record of plans or drives as a forger would: with hashes that agree again."""
    head = next(path for name in ("run.json", "drive.json") for path in folder.rglob(name))
    rows_file = head.with_name("samples.jsonl" if head.name == "run.json" else "drives.jsonl")
    summary_file = head.with_name("summary.json")
    run, summary = json.loads(head.read_text()), json.loads(summary_file.read_text())
    rows = [json.loads(line) for line in rows_file.read_text().splitlines()]
    change(run, rows, summary)
    rows_file.write_text("".join(json.dumps(row) + "\n" for row in rows))
    summary_file.write_text(json.dumps(summary))
    run["files"] = {path.name: file_sha256(path) for path in (rows_file, summary_file)}
    head.write_text(json.dumps(run))


@pytest.mark.path
@pytest.mark.parametrize("kind", ["honest", "driven"])
def test_what_eval_and_drive_write_is_fit(kind: str, request: pytest.FixtureRequest) -> None:
    assert checked(request.getfixturevalue(kind)) == (1, [])


def test_a_record_from_before_verdicts_said_whom_they_are_about_is_fit_and_a_wrong_count_is_found(folder: Path) -> None:
    def older(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        for row in rows:
            for outcome in row["outcomes"].values():
                outcome["steps"].pop("recorded_adversary", None)
            for name in ("hit", "first_contact_s", "hit_adversary", "adversary_contact_s") if row["driving"] else ():
                del row["driving"][name]
        for found in summary["protocols"].values():
            del found["mask_removed_for_adversary"]

    edited(folder, older)
    assert checked(folder) == (1, [])

    def claim(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        summary["protocols"]["uniad"]["mask_removed_for_adversary"] = 3
        rows[0]["outcomes"]["vad"]["steps"]["recorded_adversary"] = [True] * 6

    edited(folder, claim)
    assert {error.sentence.split(" = ")[0].split(" on ")[0] for error in checked(folder)[1]} == {
        "claims other verdicts than its plans",
        "claims mask_removed_for_adversary",
    }


def test_hashes_that_do_not_agree_and_truncated_files_are_found(folder: Path) -> None:
    rows_file = next(folder.rglob("samples.jsonl"))
    rows_file.write_bytes(rows_file.read_bytes()[:-40])
    assert len(checked(folder)[1]) == 1
    rows_file.unlink()
    assert len(checked(folder)[1]) == 1


def test_one_bad_record_does_not_hide_a_good_one_and_the_same_twice_is_said(folder: Path) -> None:
    shutil.copytree(folder / DATA.name, folder / "copy")
    assert "is the same planner on the same split" in checked(folder)[1][0].sentence
    (next((folder / "copy").rglob("run.json"))).write_text("{")
    sound, errors = checked(folder)
    assert sound == 1 and len(errors) == 1 and "copy" in str(errors[0].directory)


def test_partial_runs_and_parts_of_a_split_are_refused(tmp_path: Path) -> None:
    evaluate(DATA, "val", Failing(), tmp_path / "failed")
    assert "has no plan for" in checked(tmp_path / "failed")[1][0].sentence
    evaluate(DATA, "val", Straight(), tmp_path / "part", EvalSettings(limit=1))
    assert "ran on 1 of 2 scenes" in checked(tmp_path / "part")[1][0].sentence


def acquit(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
    row = next(row for row in rows if any(row["outcomes"]["exact"]["collision"]))
    row["outcomes"]["exact"]["collision"] = [False] * len(row["outcomes"]["exact"]["collision"])


def move(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
    rows[0]["plan"]["waypoints"] = [[x + 30.0, y] for x, y in rows[0]["plan"]["waypoints"]]


def forget(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
    del run["protocols"]["vad"]
    run["config"]["protocols"].remove("vad")


def exact(summary: dict[str, Any]) -> Any:
    return summary["protocols"]["exact"]["columns"]["collision"]["3s"]


FORGERIES: list[tuple[str, Forgery]] = [
    ("claims collision 3s = 0.0, but its plans give", lambda run, rows, summary: exact(summary).update(value=0.0)),
    ("under exact", lambda run, rows, summary: exact(summary).update(low=0.0, high=0.0)),
    ("claims other verdicts than its plans on 1 of", acquit),
    ("claims other verdicts than its plans", move),
    (
        "claims other driving scores than its plans give, first on sample",
        lambda run, rows, summary: next(row for row in rows if row["driving"])["driving"].update(ep=0.123),
    ),
    (
        "claims other driving scores than its plans give: score mean = 1.0, but its plans give",
        lambda run, rows, summary: summary["driving"]["columns"]["score"]["mean"].update(value=1.0),
    ),
    ("has no driving scores", lambda run, rows, summary: summary.update(driving=None)),
    ("another version of nuscenes-pdm", lambda run, rows, summary: summary["driving"].update(version=0)),
    ("does not hold the samples", lambda run, rows, summary: rows.pop()),
    ("used other data of", lambda run, rows, summary: run["data"].update(fingerprint="0" * 64)),
    ("was run on the data set elsewhere", lambda run, rows, summary: run["data"].update(name="elsewhere")),
    ("was not scored by vad", forget),
    ("claims coverage = 0.5", lambda run, rows, summary: summary.update(coverage=0.5)),
    ("claims samples = 1", lambda run, rows, summary: summary.update(samples=1)),
    ("claims failed = 1", lambda run, rows, summary: summary.update(failed=1)),
    ("claims counted = 1", lambda run, rows, summary: summary["protocols"]["vad"].update(counted=1)),
    ("counted = 1", lambda run, rows, summary: summary["driving"].update(counted=1)),
    (
        "has rates under kind",
        lambda run, rows, summary: summary["protocols"].update(kind=summary["protocols"]["exact"]),
    ),
    ("claims to be partial", lambda run, rows, summary: run.update(status="partial")),
    ("says that val has 7 scenes", lambda run, rows, summary: run.update(scenes_in_split=7)),
    ("frozen split", lambda run, rows, summary: run.update(frozen_split="mini-adv-1")),
    ("search", lambda run, rows, summary: run.update(generated={"seed": 3})),
    ("is not a SHA-256", lambda run, rows, summary: run["planner"].update(weights_sha256="f00")),
    ("is not a SHA-256", lambda run, rows, summary: run["planner"].update(code_sha256="x" * 64)),
    ("names the native protocol ", lambda run, rows, summary: run["planner"].update(native_protocol="lenient")),
    ("claims 'ok'", lambda run, rows, summary: rows[3].update(plan=None, error=None, outcomes={})),
    ("has no plan for 1 of", lambda run, rows, summary: rows[3].update(status="failed")),
]
OF_DRIVES: list[tuple[str, Forgery]] = [
    (
        "give another",
        lambda run, rows, summary: next(row for row in rows if row["contact"]).update(contact=None, end="end"),
    ),
    ("claims other scores", lambda run, rows, summary: rows[0]["scores"].update(progress_m=900.0)),
    ("claims at_fault = 0.0", lambda run, rows, summary: summary["columns"]["at_fault"].update(value=0.0)),
    ("scenes without a drive", lambda run, rows, summary: rows.pop()),
    ("has duplicate drives", lambda run, rows, summary: rows.append(rows[0])),
    ("give another", lambda run, rows, summary: rows[0]["ticks"]["ego"][-1].__setitem__(0, 3.0)),
    ("was driven on", lambda run, rows, summary: run["data"].update(fingerprint="0")),
]
KINDS = [("honest", *row) for row in FORGERIES] + [("driven", *row) for row in OF_DRIVES]


@pytest.mark.parametrize(("kind", "says", "change"), KINDS)
def test_whatever_is_edited_is_found(
    kind: str, says: str, change: Forgery, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    folder = Path(shutil.copytree(request.getfixturevalue(kind), tmp_path / "submitted"))
    edited(folder, change)
    sound, errors = checked(folder)
    assert sound == 0 and any(says in error.sentence for error in errors), [error.sentence for error in errors]


def test_old_protocols_are_said(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Stricter(ExactProtocol):
        version = 99

    monkeypatch.setitem(PROTOCOLS, "exact", Stricter())
    assert any("other versions of exact" in error.sentence for error in checked(folder)[1])


def test_completeness_is_not_believed(tmp_path: Path) -> None:
    evaluate(DATA, "val", Failing(), tmp_path)

    def claim(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        run.update(status="complete")
        summary.update(failed=0, coverage=1.0)

    edited(tmp_path, claim)
    said = [error.sentence for error in checked(tmp_path)[1]]
    assert any("has no plan for" in one for one in said) and any("claims to be complete" in one for one in said)


def test_what_our_planners_are_is_known_by_their_code(tmp_path: Path) -> None:
    evaluate(DATA, "val", planner_factory("constant-velocity-on-path"), tmp_path)

    def said(level: FindingLevel) -> list[str]:
        findings = check_submission(tmp_path, DATA.name, lambda split: DATA, find_own_planner)[1]
        return [finding.sentence for finding in findings if finding.level is level]

    assert said(FindingLevel.ERROR) == [] and not any("declares" in one for one in said(FindingLevel.NOTE))
    edited(tmp_path, lambda run, rows, summary: run["planner"].update(name="mine", privileged=False))
    assert any("has the code of constant-velocity-on-path" in one for one in said(FindingLevel.NOTE))
    assert any("says privileged: False" in one for one in said(FindingLevel.ERROR))
    edited(tmp_path, lambda run, rows, summary: run["planner"].update(code_sha256="0" * 64))
    assert said(FindingLevel.ERROR) == [] and any("declares privileged: no" in one for one in said(FindingLevel.NOTE))
    edited(tmp_path, lambda run, rows, summary: run["planner"].update(name="constant-velocity-on-path"))
    assert any(
        "is called constant-velocity-on-path but lacks this version's code" in one for one in said(FindingLevel.NOTE)
    )


def test_plans_that_know_the_future_are_suspicious_unless_they_say_so(tmp_path: Path) -> None:
    data = FakeData({f"scene-99{number:02d}": braking_scene(number) for number in range(6)})

    def suspicions() -> list[SubmissionFinding]:
        found = check_submission(tmp_path, data.name, lambda split: data)
        assert len(found[0]) == 1, found[1]
        return [finding for finding in found[1] if finding.level is FindingLevel.SUSPICIOUS]

    evaluate(data, "val", LogReplay(), tmp_path)
    assert suspicions() == []
    edited(tmp_path, lambda run, rows, summary: run["planner"].update(privileged=False))
    (said,) = suspicions()
    assert "are matched" in said.sentence and "This is no proof;" in said.sentence


def braking_scene(number: int) -> Scene:
    """A recording of 20 s whose car slows down and speeds up at moments of its own."""
    scene = scene_on_straight_road(name=f"scene-99{number:02d}", seconds=20.0)
    times = scene.seconds
    speed = 7.0 + 4.0 * np.sign(np.sin(times * (0.9 + 0.1 * number) + number))
    smooth = np.convolve(np.pad(speed, 6, mode="edge"), np.full(13, 1 / 13), mode="valid")
    position = scene.ego.position.copy()
    position[:, 0] = position[0, 0] + np.concatenate([[0.0], np.cumsum(smooth[:-1] * np.diff(times))])
    return replace(scene, ego=replace(scene.ego, position=position))


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("driven")
    drive_split(DATA, "val", Straight(), root, DriveSettings("default", DefaultBackend("replay"), agents="replay"))
    return root


def test_nothing_to_check_is_said(tmp_path: Path) -> None:
    assert "holds no run record" in checked(tmp_path)[1][0].sentence
    with pytest.raises(InputError, match="there is no folder"):
        checked(tmp_path / "absent")


def test_what_eval_writes_can_be_submitted_and_a_changed_number_cannot(tmp_path: Path) -> None:
    town, out, records = small_town(tmp_path / "small"), tmp_path / "out", len(SPLITS) * len(PLANNERS)
    judged_town(town, out)
    where = ("--data", town, "--out", out)
    run = done(run_here("leaderboard", "submit-check", out / "runs", *where))
    assert run.out.count("fit: ") == records
    shutil.copytree(out / "runs", tmp_path / "runs")
    summary = next((tmp_path / "runs").rglob("summary.json"))
    summary.write_text(summary.read_text().replace("0", "1", 1))
    refused = run_here("leaderboard", "submit-check", tmp_path / "runs", *where, "--json")
    assert refused.code == 1 and len(json.loads(refused.out)["sound"]) == records - 1
    absent = run_here("leaderboard", "submit-check", tmp_path / "absent", *where)
    assert absent.code == 2 and "there is no folder" in absent.err
