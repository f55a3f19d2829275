"""Tables of pressure and of transfer in closed loop, from made-up records."""

from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmark.records.drive_schema import EpisodeRow
from benchmark.records.drives import AT_FAULT_NUPLAN, BYSTANDER, SHARED, UNCLEAR, DriveRecord, compute_columns
from leaderboard.tables.drives import drive_tables
from leaderboard.tables.pressure import group_by_pressure, pressure_tables
from tests.benchmark.records.test_drives import contact, row, written

FACTS = {"policy": 1, "knows": "motion", "every_s": 1.0, "others": "replay", "rounds": 5, "candidates": 256}
SURVIVED = {"cc": {"survives": True}}
HURT = {"cc": {"survives": False, "seconds": 2.0, "agent": "a", "kind": "front", "at_fault": True}}


def measured(**changes: Any) -> dict[str, Any]:
    facts = {**FACTS, "search": f"4-{len(str(changes))}", **changes}
    return {"engine": "default", "agents": "adversary", "sensor": "none", "agents_facts": facts}


def drives(*ladders: Any, adversary: bool = True) -> list[EpisodeRow]:
    """A contact at fault in the first scene alone, where the ladders are these."""
    hit = {**contact(), "adversary": adversary}
    both = (row("scene-1", end="contact", contact=hit), row("scene-2"))
    return [
        EpisodeRow.model_validate({**each.model_dump(mode="json"), "ladder": ladder})
        for each, ladder in zip(both, ladders, strict=True)
    ]


def records(folder: Path) -> list[DriveRecord]:
    weak = written(folder / "weak", *drives(HURT, SURVIVED), measured=measured(rounds=0, candidates=32))
    full = written(folder / "full", *drives(SURVIVED, SURVIVED), measured=measured())
    plan = written(folder / "plan", *drives(SURVIVED, SURVIVED), measured=measured(knows="plan"))
    return [full, weak, plan]


def test_budgets_of_one_adversary_stand_in_one_table_the_weakest_first(tmp_path: Path) -> None:
    made = records(tmp_path)
    (table,) = pressure_tables(made)
    assert [line[1:4] for line in table.rows] == [("1", "0", "32"), ("1", "5", "256")]
    cells = [dict(zip(table.columns, line)) for line in table.rows]
    # At fault both times, but fair to a careful human only once.
    assert [each["at fault %"] for each in cells] == ["50.0", "50.0"]
    assert [each["attributable %"] for each in cells] == ["0.0", "50.0"]
    assert [each["careful survives %"] for each in cells] == ["50.0", "100.0"]
    (found,) = group_by_pressure(made)
    assert [each.candidates for each in found[1]] == [32.0, 1536.0]
    assert not pressure_tables(made[:1])


def test_who_runs_into_a_bystander_fails_to_nobody_s_pressure(tmp_path: Path) -> None:
    weak = written(tmp_path / "weak", *drives(SURVIVED, SURVIVED), measured=measured(rounds=0, candidates=32))
    aside = drives(SURVIVED, SURVIVED, adversary=False)
    full = written(tmp_path / "full", *aside, measured=measured())
    (pressure,), of_weak, of_full = pressure_tables([weak, full]), drive_tables([weak]), drive_tables([full])
    lines = [(pressure, line) for line in pressure.rows] + [(table, table.rows[0]) for table in (*of_weak, *of_full)]
    shown = [dict(zip(table.columns, line)) for table, line in lines]
    found = [tuple(cells[head] for head in ("at fault %", "attributable %", "bystander %")) for cells in shown]
    assert found == [("50.0", "50.0", "0.0"), ("50.0", "0.0", "50.0")] * 2
    # What a planner fails to a bystander no track carries over.
    given = {"tracks_of": "made", "record": full.content_id, "others": "replay"}
    other = {"name": "other", "privileged": False}
    against = written(tmp_path / "given", *aside, planner=other, measured={**measured(), "agents_facts": given})
    transfer = pressure_tables([full, against])[-1]
    assert dict(zip(transfer.columns, transfer.rows[0]))["fails"] == "0"


def test_an_older_summary_counts_anew_whom_contacts_are_with(tmp_path: Path) -> None:
    made = written(tmp_path / "made", *drives(SURVIVED, SURVIVED, adversary=False), measured=measured())
    new = (BYSTANDER, SHARED, UNCLEAR, AT_FAULT_NUPLAN)
    columns = {name: rate for name, rate in made.summary.columns.items() if name not in new}
    columns["attributable"] = made.summary.columns["at_fault"]
    old = replace(made, summary=made.summary.model_copy(update={"columns": columns}))
    assert compute_columns(old) == made.summary.columns == compute_columns(made)


def test_what_an_adversary_knows_never_shares_a_table(tmp_path: Path) -> None:
    tables = drive_tables(records(tmp_path))
    assert len({table.title for table in tables}) == 3
    shown = [dict(zip(table.columns, table.rows[0])) for table in tables]
    assert {each["careful survives %"] for each in shown} == {"50.0", "100.0"}


def test_transfer_counts_what_the_source_failed(tmp_path: Path) -> None:
    source = written(tmp_path / "source", *drives(SURVIVED, SURVIVED), measured=measured())
    given = {"tracks_of": "made", "record": source.content_id, "others": "replay"}
    world = {**measured(), "agents_facts": given}
    other = {"name": "other", "privileged": False}
    safe = written(tmp_path / "safe", row("scene-1"), row("scene-2"), planner=other, measured=world)
    (table,) = pressure_tables([source, safe])
    cells = dict(zip(table.columns, table.rows[0]))
    assert cells == {"planned against": "made", "fails": "1", "made": "100.0", "other": "0.0"}
    hit = written(tmp_path / "hit", *drives(None, None), planner={**other, "name": "third"}, measured=world)
    (table,) = pressure_tables([source, safe, hit])
    assert dict(zip(table.columns, table.rows[0]))["third"] == "100.0"
    # Whose fault contacts are an older record does not say.
    rows = [each.model_dump(mode="json") for each in drives(SURVIVED, SURVIVED)]
    rows[0]["contact"]["fault"] = None
    older = written(tmp_path / "older", *map(EpisodeRow.model_validate, rows), measured=measured())
    against = {**measured(), "agents_facts": {**given, "record": older.content_id}}
    beside = written(tmp_path / "beside", row("scene-1"), row("scene-2"), planner=other, measured=against)
    (table,) = pressure_tables([older, beside])
    assert dict(zip(table.columns, table.rows[0])) == {
        "planned against": "made",
        **dict.fromkeys(("fails", "made", "other"), "–"),
    }
    # Tracks of a record that is not there say nothing.
    assert not pressure_tables([safe])
