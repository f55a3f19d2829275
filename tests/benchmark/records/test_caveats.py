"""Caveats are stored with a record, printed once, and mark its row in tables."""

from pathlib import Path

import pytest

from benchmark.cli.output import warn_of_caveats
from benchmark.records.caveats import Caveat, sort_caveats
from benchmark.records.rows import SampleRows
from benchmark.records.run import RunRecord, load_record, write_record
from benchmark.runs.caveats import list_run_caveats
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.collision import collision_table
from tests.benchmark.fake_data import town_of_two
from tests.benchmark.records.hand_made_records import facts_of

NO_MAP = Caveat(kind="map", sentence="no map, so that it drives without lanes")
AS_IS = Caveat(kind="as-is", sentence="its plans look mirrored and are taken as they stand (--as-is)")


def test_a_sound_run_has_none_and_says_how_many_boxes_each_scene_has(sound: RunRecord) -> None:
    assert sound.run.caveats == []
    data = town_of_two()
    counts = {name: int(data.scene(name).annotations.valid.sum()) for name in data.scene_names()}
    assert {name: facts.truth and facts.truth.annotations for name, facts in sound.run.scene_facts.items()} == counts


def test_they_are_stored_and_mark_the_row_with_a_note(sound: RunRecord, tmp_path: Path) -> None:
    facts = facts_of(sound.run) | {"caveats": [NO_MAP]}
    write_record(tmp_path / "again", facts, sound.rows, sound.run.protocols, seed=sound.run.seed)
    again = load_record(tmp_path / "again")
    assert again.run.caveats == [NO_MAP]
    table = collision_table(DataSetRuns("town", [again]), "exact")
    assert table.rows[0][0] == "straight ¶"
    assert "¶ straight on val: no map, so that it drives without lanes." in table.notes
    assert "¶" not in collision_table(DataSetRuns("town", [sound]), "exact").markdown()


def test_each_sentence_is_printed_once_with_the_planners_that_it_concerns(
    sound: RunRecord, capsys: pytest.CaptureFixture[str]
) -> None:
    one = sound.run.model_copy(update={"caveats": [NO_MAP, AS_IS]})
    other = one.model_copy(update={"caveats": [NO_MAP], "planner": one.planner.model_copy(update={"name": "other"})})
    warn_of_caveats([one, other])
    assert capsys.readouterr().err.splitlines() == [
        f"warning: straight, other: {NO_MAP.sentence}",
        f"warning: straight: {AS_IS.sentence}",
    ]


def test_what_only_the_door_knows_stays_when_plans_are_judged_anew(sound: RunRecord) -> None:
    found = list_run_caveats(sound.run.planner, sound.run.scene_facts, SampleRows.of(sound.rows), [AS_IS, NO_MAP])
    assert found == [AS_IS]
    assert sort_caveats([AS_IS, NO_MAP, AS_IS]) == [NO_MAP, AS_IS]
