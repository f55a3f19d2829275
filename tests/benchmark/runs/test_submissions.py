"""Submissions: what was made honestly is fit; whatever was changed afterwards is found and said in one sentence."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from adapters.baselines.log_replay import LogReplay
from benchmark.errors import InputError
from benchmark.evaluation import EvalSettings, evaluate
from benchmark.machine.storage import file_sha256
from benchmark.protocols import PROTOCOLS
from benchmark.protocols.exact import Exact
from benchmark.runs.submissions import Finding, Level, check_submission
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.planners import Failing, Straight

DATA = town_of_two(slow_leader=True)


@pytest.fixture(scope="module")
def honest(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("submission")
    evaluate(DATA, "val", Straight(), root)
    return root


@pytest.fixture
def folder(honest: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(honest, tmp_path / "submitted"))


def checked(folder: Path) -> tuple[int, list[Finding]]:
    sound, findings = check_submission(folder, DATA.name, lambda split: DATA)
    return len(sound), [finding for finding in findings if finding.level is Level.ERROR]


def edited(folder: Path, change: Callable[[dict[str, Any], list[Any], dict[str, Any]], None]) -> None:
    """Change a record as a forger would: with hashes that agree again."""
    run_file = next(folder.rglob("run.json"))
    rows_file, summary_file = run_file.with_name("samples.jsonl"), run_file.with_name("summary.json")
    run, summary = json.loads(run_file.read_text()), json.loads(summary_file.read_text())
    rows = [json.loads(line) for line in rows_file.read_text().splitlines()]
    change(run, rows, summary)
    rows_file.write_text("".join(json.dumps(row) + "\n" for row in rows))
    summary_file.write_text(json.dumps(summary))
    run["files"] = {path.name: file_sha256(path) for path in (rows_file, summary_file)}
    run_file.write_text(json.dumps(run))


def test_what_eval_writes_is_fit(folder: Path) -> None:
    assert checked(folder) == (1, [])


def test_a_record_from_before_adversaries_were_counted_apart_is_fit_and_a_wrong_count_is_found(folder: Path) -> None:
    def older(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        for row in rows:
            for outcome in row["outcomes"].values():
                outcome["steps"].pop("recorded_adversary", None)
        for found in summary["protocols"].values():
            del found["mask_removed_for_adversary"]

    edited(folder, older)
    assert checked(folder) == (1, [])

    def claim(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        summary["protocols"]["uniad"]["mask_removed_for_adversary"] = 3
        rows[0]["outcomes"]["vad"]["steps"]["recorded_adversary"] = [True] * 6

    edited(folder, claim)
    assert {error.sentence.split(" under")[0].split(" on ")[0] for error in checked(folder)[1]} == {
        "says other verdicts than its plans have",
        "claims other counts or intervals",
    }


def test_a_flattering_rate_is_found(folder: Path) -> None:
    def lower(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        summary["protocols"]["exact"]["columns"]["collision"]["3s"]["value"] = 0.0

    edited(folder, lower)
    sound, (error,) = checked(folder)
    assert sound == 0
    assert "claims collision 3s = 0.0 under exact, and its plans give" in error.sentence


def test_a_verdict_that_the_plan_does_not_have_is_found(folder: Path) -> None:
    def acquit(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        row = next(row for row in rows if any(row["outcomes"]["exact"]["collision"]))
        row["outcomes"]["exact"]["collision"] = [False] * len(row["outcomes"]["exact"]["collision"])

    edited(folder, acquit)
    assert "other verdicts than its plans have on 1 of" in checked(folder)[1][0].sentence


def test_driving_scores_that_the_plans_do_not_have_are_found(folder: Path) -> None:
    def better(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        next(row for row in rows if row["driving"] is not None)["driving"]["ep"] = 0.123

    edited(folder, better)
    _, (error,) = checked(folder)
    assert "claims other driving scores than its plans give, first on sample" in error.sentence


def test_flattering_and_left_out_driving_scores_are_found(folder: Path, tmp_path: Path) -> None:
    def flatter(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        summary["driving"]["columns"]["score"]["mean"]["value"] = 1.0

    def leave_out(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        summary["driving"] = None

    def of_another_version(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        summary["driving"]["version"] = 0

    for number, (change, says) in enumerate(
        (
            (flatter, "claims other driving scores than its plans give; run"),
            (leave_out, "has no driving scores"),
            (of_another_version, "another version of nuscenes-pdm"),
        )
    ):
        changed = Path(shutil.copytree(folder, tmp_path / f"changed-{number}"))
        edited(changed, change)
        _, (error,) = checked(changed)
        assert says in error.sentence


def test_a_moved_plan_is_found_by_its_verdicts(folder: Path) -> None:
    def move(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        rows[0]["plan"]["waypoints"] = [[x + 30.0, y] for x, y in rows[0]["plan"]["waypoints"]]

    edited(folder, move)
    assert checked(folder)[1]


def test_left_out_samples_and_other_data_are_found(folder: Path, tmp_path: Path) -> None:
    edited(folder, lambda run, rows, summary: rows.pop())
    assert "does not hold the samples" in checked(folder)[1][0].sentence
    edited(folder, lambda run, rows, summary: run["data"].update(fingerprint="0" * 64))
    assert "other content" in checked(folder)[1][0].sentence
    edited(folder, lambda run, rows, summary: run["data"].update(name="elsewhere"))
    assert "is of the data set elsewhere" in checked(folder)[1][0].sentence


def test_hashes_that_do_not_agree_and_truncated_files_are_found(folder: Path) -> None:
    rows_file = next(folder.rglob("samples.jsonl"))
    rows_file.write_bytes(rows_file.read_bytes()[:-40])
    assert len(checked(folder)[1]) == 1
    rows_file.unlink()
    assert len(checked(folder)[1]) == 1


def test_one_bad_record_does_not_hide_a_good_one(folder: Path) -> None:
    shutil.copytree(folder / DATA.name, folder / "copy")
    (next((folder / "copy").rglob("run.json"))).write_text("{")
    sound, errors = checked(folder)
    assert sound == 1 and len(errors) == 1 and "copy" in str(errors[0].directory)


def test_the_same_record_twice_is_said(folder: Path) -> None:
    shutil.copytree(folder / DATA.name, folder / "copy")
    assert "is the same planner on the same split" in checked(folder)[1][0].sentence


def test_partial_runs_and_parts_of_a_split_are_refused(tmp_path: Path) -> None:
    evaluate(DATA, "val", Failing(), tmp_path / "failed")
    assert "has no plan for" in checked(tmp_path / "failed")[1][0].sentence
    evaluate(DATA, "val", Straight(), tmp_path / "part", EvalSettings(limit=1))
    assert "ran on 1 of 2 scenes" in checked(tmp_path / "part")[1][0].sentence


def test_old_and_missing_protocols_are_said(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Stricter(Exact):
        version = 99

    def forget(run: dict[str, Any], rows: list[Any], summary: dict[str, Any]) -> None:
        del run["protocols"]["vad"]
        run["config"]["protocols"].remove("vad")

    edited(folder, forget)
    assert "is not judged by vad" in checked(folder)[1][0].sentence
    monkeypatch.setitem(PROTOCOLS, "exact", Stricter())
    assert any("other versions of exact" in error.sentence for error in checked(folder)[1])


def test_plans_that_are_the_recording_are_noted(tmp_path: Path) -> None:
    def notes() -> list[str]:
        found = check_submission(tmp_path, DATA.name, lambda split: DATA)[1]
        return [finding.sentence for finding in found if finding.level is Level.NOTE]

    record = evaluate(DATA, "val", LogReplay(), tmp_path)
    assert record.run.planner.privileged and any("is privileged" in sentence for sentence in notes())
    edited(tmp_path, lambda run, rows, summary: run["planner"].update(privileged=False))
    assert any("the recorded future itself" in sentence for sentence in notes())


def test_nothing_to_check_is_said(tmp_path: Path) -> None:
    assert "holds no run record" in checked(tmp_path)[1][0].sentence
    with pytest.raises(InputError, match="there is no folder"):
        checked(tmp_path / "absent")
