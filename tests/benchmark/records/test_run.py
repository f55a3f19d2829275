"""Records: what is written reads back, old ones load for ever, damaged ones say so."""

import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from benchmark.errors import InputError
from benchmark.protocols import PROTOCOLS, STANDARD
from benchmark.records.row_schema import CAUSES, DiagnosisRow, SampleRow
from benchmark.records.rows import find_scene_failures
from benchmark.records.run import RunRecord, find_records, load_record, resolve_protocol, summarise_rows
from benchmark.records.run_schema import SceneFacts

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "records"


def row(scene: str, index: int, *, collides: bool = False, counted: bool = True, status: str = "ok") -> SampleRow:
    l2 = [1.0] * 6 if counted else [1.0] * 5 + [None]
    verdict: dict[str, Any] = {"collision": [collides] * 6, "l2": l2, "counted": counted, "steps": {}, "facts": {}}
    if status == "failed":
        said: dict[str, Any] = {"plan": None, "error": "RuntimeError", "outcomes": {}}
    else:
        plan = {"frame": "ego", "waypoints": [[1.0, 0.0]] * 6}
        said = {"plan": plan, "error": None, "outcomes": {"exact": verdict}}
    sample = {"scene": scene, "sample_token": f"{scene}-{index}", "index": index, "timestamp_us": 500_000 * index}
    seen = {"command": 2, "ego_motion": "derived", "lidar_ahead_m": 0.94, "recorded_future": [[0.0, 1.0, 1.5]] * 6}
    return SampleRow.model_validate({**sample, **seen, **said, "status": status, "complete": counted})


@pytest.mark.parametrize("directory", sorted(GOLDEN.iterdir()), ids=lambda path: path.name)
def test_golden_records_load_for_ever_and_summarise_alike(directory: Path) -> None:
    record = load_record(directory)
    again = summarise_rows(record.rows, record.run.protocols, seed=record.run.seed, scene_facts=record.run.scene_facts)
    assert again.samples == record.summary.samples == len(record.rows)
    for name, summary in record.summary.protocols.items():
        if name not in record.stale_protocols:
            assert again.protocols[name].columns["collision"] == summary.columns["collision"]


def test_a_record_of_schema_1_has_unknowns_where_schema_2_has_facts() -> None:
    record = load_record(GOLDEN / "schema-1")
    assert record.planner == "failing" and not record.complete
    assert len(record.rows) == 32 and record.summary.failed == 2
    collision = record.summary.protocols["exact"].columns["collision"]["3s"]
    assert (collision.numerator, collision.denominator) == (8.0, 18)
    assert record.missing_protocols == STANDARD[1:]
    assert record.run.scene_facts == {} and record.run.rescored is None and not record.run.says_truth
    assert all(row.diagnosis is None and row.disagreements == {} for row in record.rows)


def test_records_of_schema_2_keep_forecasts_diagnosis_and_disagreements() -> None:
    record = load_record(GOLDEN / "schema-2")
    assert record.complete and not record.covers_split and len(record.rows) == 40
    assert record.run.scene_facts["scene-8006-342b7d08"].source == "scene-8006" and not record.run.says_truth
    assert record.run.scene_facts["scene-8006-342b7d08"].manoeuvre == "cut-in-right"
    assert record.native_protocol == "exact" and record.run.rescored is None
    causes = [row.diagnosis.cause for row in record.rows if row.diagnosis is not None]
    assert [causes.count(cause) for cause in CAUSES] == [0, 7, 2, 0]
    assert all(row.plan is not None and row.plan.forecasts is not None for row in record.rows)
    assert [set(row.disagreements) for row in record.rows if row.disagreements] == [{"uniad"}]
    partial = load_record(GOLDEN / "schema-2-partial")
    assert partial.run.status == "partial" and partial.summary.failed == 1 and partial.run.rescored is not None
    assert partial.native_protocol == "vad"
    assert find_scene_failures(partial.rows, "uniad") == {"scene-8006-342b7d08": True}
    assert {row.diagnosis.cause for row in partial.rows if row.diagnosis is not None} == {"not attributable"}


def test_records_of_schema_3_have_driving_scores_and_do_not_say_where_their_samples_are() -> None:
    record = load_record(GOLDEN / "schema-3-adv")
    assert record.summary.driving is not None and record.run.frozen_split == "mini-adv-2"
    assert {(row.place, row.speed_m_s) for row in record.rows} == {(None, None)}
    facts = record.run.scene_facts["scene-8009-a101e81e"]
    assert facts.light is None and facts.manoeuvre == "squeezing-left" and facts.adversaries == 1


@pytest.mark.parametrize(
    ("word", "reason", "cause"),
    [
        ("misforecasting", "plan clear of forecast", "misforecast"),
        ("misplanning", "plan hits forecast", "misplanned"),
        ("misplanning", "no forecast near", "unseen"),
    ],
)
def test_the_two_causes_of_old_records_are_read_as_three(word: str, reason: str, cause: str) -> None:
    stored = {"cause": word, "reason": reason, "hit": "a", "first_contact_s": 1.0}
    assert DiagnosisRow.model_validate(stored).cause == cause


@pytest.fixture
def directory(sound: RunRecord, tmp_path: Path) -> Path:
    return Path(shutil.copytree(sound.directory, tmp_path / "runs" / "town" / "one"))


def test_a_scene_fails_if_any_counted_sample_collides() -> None:
    hit: dict[str, Any] = {"collides": True}
    fails, short = {"status": "failed"}, {"counted": False}
    cases: dict[str, tuple[bool | None, tuple[dict[str, Any], ...]]] = {
        "clean": (False, ({},)),
        "hit": (True, (hit, {})),
        "uncounted hit": (False, (hit | short, {})),
        "unknown": (None, ({}, fails)),
        "hit anyway": (True, (fails, hit)),
        "failed where it does not count": (False, ({}, fails | short)),
        "never counted": (None, (short,)),
    }
    rows = [row(name, at, **how) for name, (_, samples) in cases.items() for at, how in enumerate(samples)]
    assert find_scene_failures(rows, "exact") == {name: fails for name, (fails, _) in cases.items()}
    assert find_scene_failures(rows[::-1], "exact") == find_scene_failures(rows, "exact")


def test_where_short_recordings_count_a_failure_on_them_leaves_the_scene_undecided() -> None:
    rows = [row("a", 0), row("a", 1, status="failed", counted=False)]
    assert find_scene_failures(rows, "exact") == {"a": False}
    assert PROTOCOLS["uniad"].counts_incomplete
    assert find_scene_failures([judged_by(r, "uniad") for r in rows], "uniad") == {"a": None}
    # Nothing is recorded after the last sample of a scene: no plan could have collided there.
    last = [rows[0], rows[1].model_copy(update={"recorded_future": [None] * 6})]
    assert find_scene_failures([judged_by(r, "uniad") for r in last], "uniad") == {"a": False}


def test_scenes_without_verdicts_of_a_protocol_are_one_sentence() -> None:
    with pytest.raises(InputError, match="not judged by protocol 'uniad'; run challenger-bench rescore"):
        find_scene_failures([row("a", 0)], "uniad")
    with pytest.raises(InputError, match="unknown protocol 'nonsense'"):
        find_scene_failures([row("a", 0)], "nonsense")


def test_steps_that_the_mask_removes_are_those_that_would_count() -> None:
    hits, clear = [True] * 6, [False] * 6
    mask = {"before_mask": hits, "recorded": [True, True, False, False, False, True], "obj_col": clear}
    rows = [
        judged_by(row("a", 0), "uniad", steps=mask),
        judged_by(row("a", 1, counted=False), "uniad", steps=mask, counted=True),
        judged_by(row("a", 2), "uniad", steps=mask, counted=False),
        judged_by(row("a", 3), "uniad", steps={**mask, "before_mask": clear}),
        row("a", 4, status="failed"),
    ]
    assert summarise_rows(rows, {"uniad": 1}, seed=0).protocols["uniad"].mask_removed_steps == 3 + 2
    assert summarise_rows([row("a", 0)], {"exact": 1}, seed=0).protocols["exact"].mask_removed_steps is None


def test_masked_steps_of_adversaries_are_those_at_which_the_recorded_ego_touches_one() -> None:
    hits = [True] * 6
    mask = {
        "before_mask": hits,
        "recorded": [True, True, False, False, False, True],
        "recorded_adversary": [False, True, False, False, False, True],
        "obj_col": [False] * 6,
    }
    rows = [judged_by(row(scene, 0), "uniad", steps=mask) for scene in ("a", "b")]

    def removed(facts: dict[str, SceneFacts] | None) -> tuple[int | None, int | None]:
        found = summarise_rows(rows, {"uniad": 1}, seed=0, scene_facts=facts).protocols["uniad"]
        return found.mask_removed_steps, found.mask_removed_for_adversary

    known = {name: SceneFacts(source="s", adversaries=1) for name in "ab"}
    assert removed(known) == (6, 4)
    # Who is an adversary is not known of one scene, of all, or was not looked at when the record was written.
    assert removed({**known, "b": SceneFacts(source="s")}) == (6, None)
    assert removed(None) == (6, None)
    for each in rows:
        each.outcomes["uniad"].steps.pop("recorded_adversary", None)
    assert removed(known) == (6, None)


def judged_by(judged: SampleRow, name: str, **changes: Any) -> SampleRow:
    """The row with the verdict of ``exact`` as that of another protocol."""
    steps = {"before_mask": [False] * 6, "recorded": [False] * 6, "obj_col": [False] * 6}
    if judged.status == "failed":
        return judged
    found = judged.outcomes["exact"].model_copy(update={"steps": steps, **changes})
    return judged.model_copy(update={"outcomes": {name: found}})


def test_native_is_the_planners_own_protocol_or_exact(directory: Path) -> None:
    record = load_record(directory)
    assert record.native_protocol == "exact" and resolve_protocol(record, "native") == "exact"
    change(directory / "run.json", planner={**record.run.planner.model_dump(), "native_protocol": "vad"})
    record = load_record(directory)
    assert record.native_protocol == "vad" and resolve_protocol(record, "native") == "vad"
    assert resolve_protocol(record, "uniad") == "uniad"


def test_records_of_other_versions_load_and_say_so(directory: Path) -> None:
    versions = {**load_record(directory).run.protocols, "vad": 99, "of somebody else": 1}
    del versions["uniad"]
    change(directory / "run.json", protocols=versions, config={"protocols": list(versions)})
    record = load_record(directory)
    assert record.stale_protocols == ("vad",) and record.missing_protocols == ("uniad",)


def test_a_summary_leaves_failed_samples_out_of_both_sums() -> None:
    rows = [row("a", 0, collides=True), row("a", 1), row("a", 2, status="failed")]
    summary = summarise_rows(rows, {"exact": 1}, seed=0)
    rate = summary.protocols["exact"].columns["collision"]["3s"]
    assert (rate.numerator, rate.denominator, summary.failed) == (1.0, 2, 1)


def test_rows_have_no_nan() -> None:
    with pytest.raises(ValidationError):
        SampleRow.model_validate({**row("a", 0).model_dump(), "lidar_ahead_m": float("nan")})


def test_numbers_in_files_are_json(directory: Path) -> None:
    def refuse(name: str) -> None:
        raise AssertionError(name)

    for path in directory.glob("*.json"):
        json.loads(path.read_text(), parse_constant=refuse)
    for line in (directory / "samples.jsonl").read_text().splitlines():
        json.loads(line, parse_constant=refuse)


def test_rows_that_are_no_text_are_refused(directory: Path) -> None:
    (directory / "samples.jsonl").write_bytes(b"\xd0\x00\xff")
    with pytest.raises(InputError, match="is not text"):
        load_record(directory)


@pytest.mark.parametrize("name", ["samples.jsonl", "summary.json"])
def test_files_that_do_not_belong_together_are_refused(directory: Path, name: str) -> None:
    path = directory / name
    path.write_bytes(path.read_bytes().replace(b"0", b"1", 1))
    with pytest.raises(InputError, match=name):
        load_record(directory)
    path.unlink()
    with pytest.raises(InputError, match="cannot read"):
        load_record(directory)


def test_a_truncated_or_foreign_run_file_is_refused(directory: Path) -> None:
    text = (directory / "run.json").read_text()
    (directory / "run.json").write_text(text[:100])
    with pytest.raises(InputError, match="not valid JSON"):
        load_record(directory)
    for foreign in ("[]", "{}", '{"schema": 1, "files": {}}', '{"schema": true}', '{"schema": 1, "files": []}'):
        (directory / "run.json").write_text(foreign)
        with pytest.raises(InputError):
            load_record(directory)


def test_names_that_no_file_can_have_are_refused_in_few_words(directory: Path) -> None:
    run = json.loads((directory / "run.json").read_text())
    change(directory / "run.json", data={**run["data"], "name": "x" * 100_000})
    with pytest.raises(InputError, match=r"data\.name") as refused:
        load_record(directory)
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"schema": 99}, "upgrade challenger-bench"),
        *(({"schema": never}, "never existed") for never in (0, -1)),
        *(
            ({"config": {"protocols": wrong}}, "must be those that judged")
            for wrong in (None, ["exact", None], "exact", ["exat"])
        ),
        *(({"scenes": wrong}, "scenes") for wrong in ([], ["a\0b"], ["../a"], ["twice", "twice"], ["another"])),
        ({"scene_facts": {"another": {"source": "another"}}}, "scene_facts must be of the scenes"),
        ({"files": {"../../secret": "0" * 64}}, r"run\.json"),
        ({"files": {}}, "does not belong"),
        # Texts and numbers say what the machine is; judging anew must not mend anything else.
        ({"environment": {"packages": {"torch": [1, "a", None]}}}, r"run\.json .*environment"),
    ],
)
def test_what_a_run_must_not_say_is_refused(directory: Path, changes: dict[str, Any], says: str) -> None:
    run = json.loads((directory / "run.json").read_text())
    inside = {name: {**run[name], **value} for name, value in changes.items() if name in ("config", "environment")}
    change(directory / "run.json", **{**changes, **inside})
    with pytest.raises(InputError, match=says):
        load_record(directory)


def test_records_are_found_by_path(directory: Path, tmp_path: Path) -> None:
    shutil.copytree(directory, tmp_path / "runs" / "another")
    assert [record.directory for record in find_records(tmp_path)] == sorted([directory, tmp_path / "runs" / "another"])
    with pytest.raises(InputError, match="nowhere does not exist"):
        find_records(tmp_path / "nowhere")


def test_one_damaged_record_among_others_is_named_with_what_to_do(directory: Path, tmp_path: Path) -> None:
    other = tmp_path / "runs" / "another"
    shutil.copytree(directory, other)
    change(other / "run.json", status="wonderful")
    todo = r"another/run\.json is not .*status.*; you can also delete or move .*/another to"
    with pytest.raises(InputError, match=todo):
        find_records(tmp_path)
    shutil.copyfile(directory / "run.json", other / "run.json")
    (other / "samples.jsonl").write_text("")
    with pytest.raises(InputError, match=r"another/samples\.jsonl .*; you can also delete or move"):
        find_records(tmp_path)


def test_a_record_is_known_by_its_content_wherever_it_lies(directory: Path, tmp_path: Path) -> None:
    known = load_record(directory)
    assert re.fullmatch("[0-9a-f]{12}", known.content_id)
    other = tmp_path / "elsewhere"
    shutil.copytree(directory, other)
    change(other / "run.json", environment={"processor": "another"})
    assert load_record(other).content_id == known.content_id
    change(other / "run.json", seed=99)
    assert load_record(other).content_id != known.content_id
    hostile = known.run.planner.model_copy(update={"settings": {"gap_m": float("nan")}})
    other_planner = replace(known, run=known.run.model_copy(update={"planner": hostile}))
    assert other_planner.content_id != known.content_id


def change(path: Path, **values: Any) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), **values}))
