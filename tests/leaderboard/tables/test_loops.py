"""Tables of both loops side by side: from records alone, scenes by name."""

from pathlib import Path

from leaderboard.tables.drives import loop_tables
from tests.benchmark.metrics.test_loops import drives, hit, run
from tests.benchmark.records.test_drives import failed, row


def test_rates_ranks_and_scenes(tmp_path: Path) -> None:
    driven = [
        drives(tmp_path / "a", hit("s1"), row("s2"), row("s3"), row("s4"), name="a"),
        drives(tmp_path / "b", hit("s1"), hit("s2", at_fault=False), row("s3"), failed("s4"), name="b"),
        drives(tmp_path / "c", *(hit(each) for each in ("s1", "s2", "s3", "s4")), name="c"),
        drives(tmp_path / "x", *(row(each) for each in ("s1", "s2", "s3", "s4")), name="never ran"),
    ]
    runs = [run("a", ("s1",)), run("b", ("s1", "s3")), run("c", ("s1", "s2", "s3", "s4"))]
    rates, scenes = loop_tables(driven, runs)
    assert rates.name == "loops-adv-default-replay" and "beside open loop" in rates.title
    first, second, third = (dict(zip(rates.columns, each)) for each in rates.rows)
    shown = (first["open loop %"], first["contact %"], first["agree %"], first["scenes"])
    assert shown == ("25.0", "25.0", "100.0", "4")
    assert (second["open loop %"], second["contact %"], second["at fault %"]) == ("66.7", "66.7", "33.3")
    assert (second["only open"], second["only closed"], second["scenes"]) == ("1", "1", "3")
    assert third["contact %"] == "100.0"
    notes = " ".join(rates.notes)
    assert "contact 1.00, at fault 0.82 (over 3 planners on the 3 scenes" in notes
    assert "b: 1 scene left out" in notes and "same planner and scenes: never ran." in notes
    assert [(each[0], each[1], each[3], each[5]) for each in scenes.rows] == [
        ("b", "s2", "only closed", "no"),
        ("b", "s3", "only open", "–"),
    ]
    for table in (rates, scenes):
        assert table.markdown() and table.plain() and table.latex() and table.csv() and table.as_json()


def test_worlds_are_never_mixed_and_without_runs_there_is_no_table(tmp_path: Path) -> None:
    idm = {"engine": "default", "agents": "idm", "sensor": "none"}
    driven = [drives(tmp_path / "a", hit("s1")), drives(tmp_path / "b", row("s1"), measured=idm)]
    found = loop_tables(driven, [run(hits=("s1",))])
    assert [table.name for table in found] == [
        "loops-adv-default-idm-part",
        "loops-adv-default-replay-part",
        "loops-scenes-adv-default-idm-part",
    ]
    assert [dict(zip(table.columns, table.rows[0]))["contact %"] for table in found[:2]] == ["0.0", "100.0"]
    assert loop_tables(driven, []) == [] and loop_tables([], [run()]) == []
    # NeuroNCAP's own scenarios stand beside no open loop.
    own = {"engine": "neuroncap@paper", "agents": "replay", "sensor": "none", "scenarios": "own"}
    assert loop_tables([drives(tmp_path, hit("s1"), measured=own)], [run(hits=("s1",))]) == []
