"""The worst failures of a planner, from its record: who is hit, when, at whose fault, in which order."""

from pathlib import Path

import pytest

from benchmark.metrics.failures import find_failures
from benchmark.records.run import RunRecord
from leaderboard.tables.failures import describe_failures, failure_tables
from tests.benchmark.fake_data import FakeData
from tests.benchmark.metrics.made_attacks import attacked, told
from tests.benchmark.metrics.test_loops import drives
from tests.benchmark.records.test_drives import contact, failed, row
from tests.hand_made import Car, scene_on_straight_road

SCENES = {"A-1": "F.r.", "A-2": "..!?", "B-1": "f-..", "C-1": "...."}
"""f: touches the adversary at fault, ?: of unknown fault, r: is run into by it, F: touches a bystander, !: raised."""


def ran(scenes: dict[str, str] = SCENES) -> RunRecord:
    return told(attacked("p", scenes, dict.fromkeys(scenes, True)))


def test_contacts_with_the_adversary_come_first_then_fault_then_force() -> None:
    found = find_failures(ran())
    assert [(one.scene, one.index, one.adversary, one.at_fault) for one in found.worst] == [
        ("B-1", 0, True, True),
        ("A-2", 3, True, None),
        ("A-1", 2, True, False),
        ("A-1", 0, False, True),
    ]
    assert [(scene.scene, scene.counted, len(scene.failures)) for scene in found.scenes] == [
        ("B-1", 3, 1),
        ("A-2", 3, 1),
        ("A-1", 4, 2),
    ]
    first = found.worst[0]
    assert (first.hit, first.category, first.delta_v_m_s) == ("a", None, 5.0)
    # Half a second between samples; the made contacts are 1.3 s after theirs.
    assert found.worst[2].moment_s == 1.0 and found.worst[2].contact_s == pytest.approx(2.3)
    assert (found.counted, found.scenes_counted) == (14, 4)
    (crash,) = found.crashes
    assert (crash.scene, crash.index, crash.moment_s) == ("A-2", 2, 1.0)


def test_fault_is_the_one_that_the_effect_counts() -> None:
    record = ran()
    # The severity of a plan is about another object than the one that it touches first.
    rows = [
        row.model_copy(update={"severity": row.severity.model_copy(update={"contact": other})})
        if row.scene == "B-1" and row.severity is not None and (other := row.severity.contact) is not None
        and (other := other.model_copy(update={"agent": "c"}))
        else row
        for row in record.rows
    ]  # fmt: skip
    found = find_failures(RunRecord(record.directory, record.run, rows, record.summary))
    (failure,) = next(scene.failures for scene in found.scenes if scene.scene == "B-1")
    assert (failure.hit, failure.adversary, failure.at_fault, failure.delta_v_m_s) == ("a", True, None, None)


def test_a_record_that_does_not_say_whom_it_hits_says_so_and_recordings_have_no_adversary() -> None:
    old = find_failures(attacked("p", SCENES, dict.fromkeys(SCENES, True)))
    assert {(failure.hit, failure.contact_s, failure.adversary, failure.at_fault) for failure in old.worst} == {
        (None, None, None, None)
    }
    val = find_failures(told(attacked("p", {"A": "F..."}, {"A": True}, split="val")))
    assert [failure.adversary for failure in val.worst] == [False]


def test_the_data_set_says_of_which_category_an_object_is() -> None:
    scene = scene_on_straight_road((Car(75.0, 198.25, 2.0, category="vehicle.truck"),), name="A-1")
    record = told(attacked("p", {"A-1": "f..."}, {"A-1": True}))
    rows = []
    for one in record.rows:
        outcome = one.outcomes["exact"]
        facts = {**outcome.facts, "hit": outcome.facts["hit"] and scene.agents.ids[0]}
        rows.append(one.model_copy(update={"outcomes": {"exact": outcome.model_copy(update={"facts": facts})}}))
    record = RunRecord(record.directory, record.run, rows, record.summary)
    data = FakeData({"A-1": scene})
    assert [failure.category for failure in find_failures(record, data).worst] == ["vehicle.truck"]
    assert [failure.category for failure in find_failures(record, data, limit=0).worst] == [None]
    assert [failure.category for failure in find_failures(record, FakeData({})).worst] == [None]


def test_drives_have_the_contact_that_ended_them_or_the_first(tmp_path: Path) -> None:
    passed = {**contact(at_fault=False), "seconds": 0.1, "category": "human.pedestrian.adult", "adversary": False}
    record = drives(
        tmp_path,
        row("s1", end="contact", contact=contact(), passed=[passed]),
        row("s2", passed=[passed]),
        row("s3", unlabelled=True, end="contact", contact=contact()),
        failed("s4"),
    )
    found = find_failures(record)
    assert [(one.scene, one.category, one.at_fault, one.contact_s) for one in found.worst] == [
        ("s1", "vehicle.car", True, 0.3),
        ("s2", "human.pedestrian.adult", False, 0.1),
    ]
    assert (found.unit, found.counted, [crash.raised for crash in found.crashes]) == ("drive", 2, ["ValueError: no"])
    said = describe_failures(found)
    assert "p on d adv (default, agents replay, sensor none): 2 of 2 drives touch something" in said
    assert said.endswith("1 with the adversary, 1 at the planner's fault; 1 drive without a plan")
    assert [table.columns[1] for table in failure_tables(found, 10)] == ["worst run", "hits", "run"]


def test_tables_say_how_many_there_are_and_a_dash_where_nothing_is_known() -> None:
    found = find_failures(ran())
    assert describe_failures(found) == (
        "p on d adv (exact, 3 s): 4 of 14 samples fail, in 3 of 4 scenes; 3 with the adversary, 2 at the planner's "
        "fault; 1 sample without a plan"
    )
    scenes, samples, crashes = failure_tables(found, 2)
    assert [table.title for table in (scenes, samples, crashes)] == [
        "worst scenes (2 of 3)",
        "worst samples (2 of 4)",
        "samples without a plan (1)",
    ]
    assert scenes.rows == (("B-1", "0", "1/3", "1", "1"), ("A-2", "3", "1/3", "1", "0"))
    assert samples.rows[1] == ("A-2", "an object, the adversary", "–", "3", "1.5", "2.8", "1.0")
    assert crashes.rows == (("A-2", "2", "RuntimeError"),)
    assert all(len(line) <= 100 for table in (scenes, samples, crashes) for line in table.plain(width=100).splitlines())
    clean = find_failures(ran({"A-1": "...."}))
    assert describe_failures(clean).endswith(": no failure in 4 samples of 1 scene") and not failure_tables(clean, 9)
