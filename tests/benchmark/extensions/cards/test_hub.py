"""Results for hubs: what the client reads is what records say, and what must not be ranked is not written."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from benchmark.errors import InputError
from benchmark.extensions.cards.every_eval_ever import build_document, check_document
from benchmark.extensions.cards.hub_results import build_hub_files, check_entries
from benchmark.extensions.cards.hub_verification import GOLDEN
from benchmark.extensions.cards.records_card import write_records_card
from benchmark.extensions.cards.writing import CardSettings
from benchmark.protocols import PROTOCOLS
from benchmark.records.drives import DriveRecord, load_drives
from benchmark.records.run import RunRecord, write_record
from benchmark.records.run_schema import SceneFacts, TruthFacts
from tests.benchmark.cli.in_process import run_here
from tests.benchmark.records.hand_made_records import CLEAN, HIT, LATE, facts_of, hand_made

SHARED = Path(__file__).resolve().parents[5] / "shared" / "golden"
DRIVES = Path(__file__).resolve().parents[3] / "promise" / "kept" / "formats" / "drives-1"
TO_HUB = CardSettings(published="2026-11-28", hub="a-lab/mini-adv-3", url="https://example.org/x")
SCENES = {"s1": [HIT, CLEAN], "s2": [CLEAN, CLEAN], "s3": [LATE, CLEAN]}


def record(planner: str = "mine", **changes: Any) -> RunRecord:
    made = hand_made(planner, changes.pop("scenes", SCENES), **changes)
    truth = TruthFacts(annotations=5)
    facts = {name: SceneFacts(source=name, truth=truth) for name in made.run.scenes}
    return replace(made, run=made.run.model_copy(update={"scene_facts": facts, "frozen_split": "mini-adv-3"}))


def changed(made: RunRecord, **facts: Any) -> RunRecord:
    return replace(made, run=made.run.model_copy(update=facts))


def driven() -> DriveRecord:
    drive = load_drives(DRIVES)
    facts = {name: fact.model_copy(update={"truth": TruthFacts(annotations=1)}) for name, fact in
             drive.facts.scene_facts.items()}  # fmt: skip
    return replace(drive, facts=drive.facts.model_copy(update={"scene_facts": facts, "frozen_split": "mini-adv-3"}))


def written(*records: RunRecord | DriveRecord, settings: CardSettings = TO_HUB) -> dict[str, Any]:
    """Values of the files, by path."""
    runs = [each for each in records if isinstance(each, RunRecord)]
    drives = [each for each in records if isinstance(each, DriveRecord)]
    files = build_hub_files(runs, drives, settings, ()).files
    return {str(path): yaml.safe_load(data) for path, data in files.items()}


@pytest.mark.path
def test_the_hubs_client_reads_shares_without_contact() -> None:
    client = pytest.importorskip("huggingface_hub")
    made = record()
    files = written(made, driven())
    (entry,) = client.parse_eval_result_entries(files["mine/.eval_results/mini-adv-3.yaml"])
    rate = made.summary.protocols["exact"].columns["collision"]["avg"]
    assert rate.value == pytest.approx(4 / 18)
    assert entry.value == pytest.approx(100 * (1 - 4 / 18), abs=1e-4)
    assert (entry.dataset_id, entry.task_id, entry.date) == ("a-lab/mini-adv-3", "open_loop_exact", "2026-11-28")
    assert (entry.source_url, entry.source_org, entry.verify_token) == ("https://example.org/x", "a-lab", None)
    assert rate.high is not None and f"95 % [{100 * (1 - rate.high):.1f}, " in entry.notes
    assert f"exact v{PROTOCOLS['exact'].version}" in entry.notes and "over 3 recordings, 6 samples" in entry.notes
    (drive,) = client.parse_eval_result_entries(files["straight/.eval_results/mini-adv-3.yaml"])
    assert drive.value in (0.0, 100.0) and drive.task_id.startswith("closed_loop_default-replay-none-")
    tasks = files["eval.yaml"]["tasks"]
    assert [task["id"] for task in tasks] == sorted([entry.task_id, drive.task_id])
    assert [task["split"] for task in tasks] == ["val", "adv"] and "Higher is better" in files["eval.yaml"][
        "description"
    ]
    head = build_hub_files([made], [], TO_HUB, ()).files
    assert b"Not checked by the hub" in next(data for path, data in head.items() if str(path) == "eval.yaml")


def test_a_data_set_that_is_no_frozen_split_has_tasks_by_split() -> None:
    val, adv = (changed(record(split=split), frozen_split=None) for split in ("val", "adv"))
    files = written(val, adv, settings=replace(TO_HUB, hub="a-lab/d"))
    assert [task["id"] for task in files["eval.yaml"]["tasks"]] == ["open_loop_exact_adv", "open_loop_exact_val"]
    assert len(files["mine/.eval_results/d.yaml"]) == 2


@pytest.mark.parametrize(
    ("left", "says"),
    [
        (record("idm"), "is a baseline"),
        (record("other", privileged=True), "is a baseline"),
        (changed(record("small"), planner=record("small").run.planner.model_copy(update={"miniature": True})), "minia"),
        (record("part", scenes_in_split=9), "covers 3 of 9 scenes"),
        (record("falls", scenes={"s1": [None, CLEAN]}), "1 failed plan"),
        (record("old", versions={"exact": 0}), "run challenger-bench rescore"),
        (changed(record("blind"), scene_facts={}), "run challenger-bench rescore"),
        (record("other-judge", protocols=("vad",)), "has no number"),
    ],
)
def test_what_ranks_nothing_is_not_written_and_says_so(left: RunRecord, says: str) -> None:
    files = build_hub_files([record(), left], [], TO_HUB, ())
    assert {path.parts[0] for path in files.files} == {"mine", "eval.yaml", "every_eval_ever"}
    assert len(files.left_out) == 1 and says in files.left_out[0]
    with pytest.raises(InputError, match="is a result for a hub"):
        build_hub_files([left], [], TO_HUB, ())


def test_two_results_for_one_task_are_refused_and_two_versions_are_two_planners() -> None:
    with pytest.raises(InputError, match="two results for open_loop_exact"):
        written(record(), record())
    other = record().run.data.model_copy(update={"fingerprint": "other"})
    with pytest.raises(InputError, match="different data sets"):
        written(record(), changed(record("yours"), data=other))
    both = written(record(weights="a" * 64), record(weights="b" * 64))
    assert sum(path.endswith("mini-adv-3.yaml") for path in both) == 2
    with pytest.raises(InputError, match=r"called 'mini-adv-4'; they are of mini-adv-3"):
        written(record(), settings=replace(TO_HUB, hub="a-lab/mini-adv-4"))


@pytest.mark.parametrize("name", ["../../up", "a/b", ".hidden", "a: b\n- c: !!python/x", "\u202eevil", "eval.yaml "])
def test_names_of_strangers_are_neither_paths_nor_yaml(name: str, tmp_path: Path) -> None:
    write_records_card([record(name)], [], tmp_path / "card", TO_HUB)
    assert [path.name for path in tmp_path.iterdir()] == ["card"]
    (file,) = (tmp_path / "card").glob("*/.eval_results/*.yaml")
    assert len(check_entries(yaml.safe_load(file.read_text()))) == 1
    for document in (tmp_path / "card").rglob("*-*.json"):
        check_document(json.loads(document.read_text()))


@pytest.mark.parametrize("name", ["README.md", "eval.yaml", "every_eval_ever", "", "x" * 256])
def test_a_name_that_cannot_be_a_folder_writes_nothing(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be a folder of results"):
        write_records_card([record(name)], [], tmp_path / "card", TO_HUB)
    assert not (tmp_path / "card").exists()


def test_files_of_others_are_not_written_over_and_ours_are(tmp_path: Path) -> None:
    write_records_card([record()], [], tmp_path, TO_HUB)
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    write_records_card([record()], [], tmp_path, TO_HUB)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before
    (tmp_path / "eval.yaml").write_text("name: mine\n")
    with pytest.raises(InputError, match=r"eval\.yaml was not written by challenger-bench"):
        write_records_card([record("yours")], [], tmp_path, TO_HUB)
    assert not (tmp_path / "yours").exists() and (tmp_path / "eval.yaml").read_text() == "name: mine\n"


def test_documents_have_intervals_counts_and_every_protocol() -> None:
    made = record(protocols=("exact", "vad"))
    document = build_document(made, "mine", "a-lab", "mini-adv-3", "2026-11-28")
    check_document(document.content)
    results = document.content["evaluation_results"]
    exact = next(each for each in results if each["evaluation_name"].endswith("collision") and "exact" in str(each))
    rate = made.summary.protocols["exact"].columns["collision"]["avg"]
    assert rate.value is not None and rate.low is not None
    assert exact["score_details"]["score"] == 100 * rate.value and exact["metric_config"]["lower_is_better"] is True
    assert exact["score_details"]["uncertainty"]["confidence_interval"]["lower"] == 100 * rate.low
    assert exact["score_details"]["uncertainty"]["num_samples"] == 6 and "3s" in exact["score_details"]["details"]
    assert {"vad" in each["evaluation_name"] for each in results} == {True, False}
    assert document.content["retrieved_timestamp"] == "1795824000"
    assert (
        document.uuid[14] == "4"
        and document.uuid == build_document(made, "mine", "a-lab", "mini-adv-3", "2026-11-28").uuid
    )
    driving = build_document(driven(), "straight", "a-lab", "mini-adv-3", "2026-11-28").content["evaluation_results"]
    assert {"contact", "nuplan_score"} <= {each["metric_config"]["metric_id"] for each in driving}


def _without(name: str) -> Callable[[dict[str, Any]], Any]:
    return lambda entry: entry.pop(name)


@pytest.mark.parametrize(
    "spoil",
    [
        _without("dataset"),
        _without("value"),
        lambda entry: entry.update(value=float("inf")),
        lambda entry: entry.update(value=True),
        lambda entry: entry.update(notes="x" * 201),
        lambda entry: entry.update(notes="two\nlines"),
        lambda entry: entry.update(date="28.11.2026"),
        lambda entry: entry.update(source={"url": "ftp://x"}),
        lambda entry: entry["dataset"].update(revision="abc"),
        lambda entry: entry["dataset"].update(id="a/b/c"),
        lambda entry: entry["dataset"].update(task_id="a b"),
    ],
)
def test_entries_that_no_client_refuses_are_refused(spoil: Callable[[dict[str, Any]], Any]) -> None:
    entry = {"dataset": {"id": "a/b", "task_id": "t"}, "value": 1, "date": "2026-11-28", "notes": "fine"}
    assert check_entries([entry]) == [("a/b", "t", 1.0)]
    spoil(entry)
    with pytest.raises(ValueError, match=r"."):
        check_entries([entry])


@pytest.mark.skipif(not SHARED.is_dir(), reason="the golden files are not beside the repository")
@pytest.mark.parametrize(("kind", "files"), [("hub", 26 + 6), ("eee", 15)])
def test_golden_files(kind: str, files: int) -> None:
    checks = GOLDEN.verify(SHARED / kind)
    assert [check for check in checks if not check.ok] == [] and sum(check.count for check in checks) == files


def test_verify_tells_a_file_that_is_judged_otherwise_and_a_path_that_leads_out(tmp_path: Path) -> None:
    (tmp_path / "valid").mkdir()
    (tmp_path / "valid" / "a.yaml").write_text("- {dataset: {id: a/b, task_id: t}, value: high}\n")
    listed: dict[str, Any] = {"huggingface_hub": "2.4.0", "files": {"valid/a.yaml": {"values": ["high"]}}}
    (tmp_path / "expected.json").write_text(json.dumps(listed))
    refused = run_here("verify", "hub", "--golden", tmp_path)
    assert refused.code == 2 and "is damaged" in refused.err
    listed["files"]["valid/a.yaml"]["values"] = ["1"]
    (tmp_path / "expected.json").write_text(json.dumps(listed))
    assert run_here("verify", "hub", "--golden", tmp_path).code == 1
    listed["files"] = {"valid/../../a.yaml": {"values": []}}
    (tmp_path / "expected.json").write_text(json.dumps(listed))
    assert run_here("verify", "hub", "--golden", tmp_path).code == 2


@pytest.mark.path
def test_the_command_writes_them_and_a_damaged_record_writes_nothing(tmp_path: Path) -> None:
    for made in (record(), record("idm")):
        write_record(tmp_path / "runs" / made.planner, facts_of(made.run), made.rows, made.run.protocols, seed=0)
    asked = ("leaderboard", "card", "--records", tmp_path / "runs", "--to", tmp_path / "card", "--hub")
    done = run_here(*asked, "a-lab/mini-adv-3", "--licence", "cc-by-4.0", "--json")
    assert done.code == 0 and "not for the hub: idm on adv is a baseline" in done.err
    named = {Path(file).relative_to(tmp_path / "card").as_posix() for file in json.loads(done.out)["files"]}
    assert {"README.md", "eval.yaml", "mine/.eval_results/mini-adv-3.yaml"} <= named and len(named) == 6
    assert json.loads((tmp_path / "card" / "croissant.json").read_text())["datePublished"]
    assert run_here(*asked, "no-name").code == 2
    (tmp_path / "runs" / "mine" / "samples.jsonl").write_bytes(b"")
    refused = run_here(*asked[:-2], tmp_path / "other", "--hub", "a-lab/mini-adv-3")
    assert refused.code == 2 and len(refused.err.strip().splitlines()) == 1 and not (tmp_path / "other").exists()
