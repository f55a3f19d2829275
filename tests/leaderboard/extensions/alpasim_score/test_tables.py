"""AlpaSim's score in the tables of drives: under the names of its rules, marked without a map, km per incident."""

from pathlib import Path
from typing import Any

import pytest

from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import DriveRecord, load_drives
from benchmark.records.run_schema import SceneFacts
from benchmark.report.table import Table
from leaderboard.extensions.alpasim_score.tables import RULE_SETS, alpasim_tables, compute_alpasim_results
from leaderboard.tables.contents import closed_loop_tables
from leaderboard.tables.drives import drive_tables
from tests.benchmark.records.test_drives import failed, row, scores, written

JULY, SEPTEMBER = RULE_SETS


def parts(score: float = 1.0, **changes: float | None) -> dict[str, float | None]:
    none = dict.fromkeys(("front", "rear", "lateral", "off_road", "corridor"), 0.0)
    return {"score": score, "progress": 0.8, "km": 0.1, **none, **changes}


def drive(scene: str, july: dict[str, float | None], september: dict[str, float | None], **changes: Any) -> EpisodeRow:
    return row(scene, scores=scores(further={JULY: july, SEPTEMBER: september}), **changes)


def clean(scene: str, score: float = 1.0, **changes: float | None) -> EpisodeRow:
    return drive(scene, parts(score, **changes), parts(score, **changes))


def cells(table: Table, place: int) -> dict[str, str]:
    return dict(zip(table.columns, table.rows[place], strict=True))


@pytest.mark.path
def test_scores_stand_under_the_names_of_their_rules_with_their_parts(tmp_path: Path) -> None:
    hit, aside = parts(0.0, front=1.0, km=0.05), parts(0.0, corridor=1.0, km=0.3)
    record = written(tmp_path, drive("scene-1", hit, hit), drive("scene-2", parts(0.5, corridor=1.0, km=0.3), aside))
    (table,) = drive_tables([record])
    shown = cells(table, 0)
    assert (shown[JULY], shown[SEPTEMBER]) == ("0.25", "0.00")
    (own,) = alpasim_tables([record])
    july, september = cells(own, 0), cells(own, 1)
    assert own.name == "alpasim-adv-default-replay" and (july["rules"], september["rules"]) == RULE_SETS
    assert (july["score"], september["score"]) == ("0.25", "0.00") and july["progress %"] == "80.0"
    assert july["at fault %"] == "50.0" and july["rear %"] == "0.0" and july["off road %"] == "0.0"
    # July's rules have no such part.
    assert (july["left corridor %"], september["left corridor %"]) == ("–", "50.0")
    assert july["km per incident"] == july["km per incident at fault"] == "0.350" and july["drives"] == "2"
    assert own in closed_loop_tables("fake", [record], [])


def test_kilometres_count_hits_from_behind_only_among_all_incidents(tmp_path: Path) -> None:
    record = written(tmp_path, clean("scene-1", rear=1.0), clean("scene-2"))
    (own,) = alpasim_tables([record])
    assert cells(own, 0)["km per incident"] == "0.200" and cells(own, 0)["km per incident at fault"] == "–"
    both = written(tmp_path / "b", clean("scene-1", front=1.0, lateral=1.0, off_road=1.0), clean("scene-2"))
    assert cells(alpasim_tables([both])[0], 0)["km per incident"] == "0.200"


def test_without_a_map_off_road_is_empty_and_the_row_is_marked(tmp_path: Path) -> None:
    record = written(tmp_path / "a", clean("scene-1", off_road=None), clean("scene-2", off_road=None))
    (own,) = alpasim_tables([record])
    assert cells(own, 0)["off road %"] == "–" and cells(own, 0)["planner"] == "made ¶"
    assert any(note.startswith("¶ made: 2 of 2 drives without a map: only collisions") for note in own.notes)
    some = written(tmp_path / "b", clean("scene-1", off_road=None), clean("scene-2", off_road=1.0))
    (own,) = alpasim_tables([some])
    assert cells(own, 0)["off road %"] == "100.0" and cells(own, 0)["planner"] == "made ¶"
    mapped = written(tmp_path / "c", clean("scene-1"), clean("scene-2"))
    assert cells(alpasim_tables([mapped])[0], 0)["planner"] == "made"


def test_older_failed_and_unlabelled_drives_are_in_no_number(tmp_path: Path) -> None:
    older = written(tmp_path / "a")
    assert alpasim_tables([older]) == [] and JULY not in drive_tables([older])[0].columns
    others = (failed("scene-2"), clean("scene-3", score=0.0).model_copy(update={"unlabelled": True}), row("scene-4"))
    names = [f"scene-{number}" for number in range(1, 5)]
    record = written(tmp_path / "b", clean("scene-1"), *others, scenes=names, scenes_in_split=4)
    found = compute_alpasim_results(record, JULY)
    assert found is not None and found.drives == 1 and found.rates["score"].value == 1.0
    # Beside a record with scores, one without has a dash.
    beside = written(tmp_path / "c", planner={"name": "older", "privileged": False}, scenes=names, scenes_in_split=4)
    shown = {each["planner"]: each[JULY] for each in (cells(drive_tables([record, beside])[0], at) for at in range(2))}
    assert shown == {"made": "1.00", "older": "–"} and len(alpasim_tables([record, beside])[0].rows) == 2


def test_recordings_are_drawn_together_and_a_record_reads_back(tmp_path: Path) -> None:
    facts: dict[str, Any] = {f"scene-{number}": SceneFacts(source=f"scene-{number % 2}") for number in range(4)}
    rows = [clean(name, score=float(place % 2)) for place, name in enumerate(facts)]
    described = {"scene_facts": facts, "scenes": [*facts], "scenes_in_split": 4}
    record = written(tmp_path, *rows, **described)
    found = compute_alpasim_results(record, SEPTEMBER)
    assert found is not None and (found.rates["score"].low, found.rates["score"].high) == (0.0, 1.0)
    assert load_drives(tmp_path) == record


def test_parts_that_are_missing_from_a_record_are_dashes(tmp_path: Path) -> None:
    record: DriveRecord = written(tmp_path, drive("scene-1", {}, {"score": 0.5}), clean("scene-2"))
    (own,) = alpasim_tables([record])
    assert cells(own, 0)["score"] == "1.00" and cells(own, 1)["score"] == "0.75" and drive_tables([record])
