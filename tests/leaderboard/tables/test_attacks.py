"""Tables of attack success, severity, the ladder and realism: the numbers of the metrics, and what nobody can tell."""

from dataclasses import replace
from pathlib import Path

from benchmark.metrics.attacks import compute_attack_rates
from benchmark.records.run import RunRecord, load_record
from benchmark.report.table import Table
from leaderboard.build import build_leaderboard_files
from leaderboard.frame.results import read_results
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.attacks import attack_tables, success_table
from leaderboard.tables.collision import run_tables
from leaderboard.tables.contents import build_data_set_tables, missing_notes
from leaderboard.tables.scenario_assessment import assessment_tables
from tests.benchmark.metrics.made_attacks import attacked, with_realism
from tests.benchmark.records.hand_made_records import CLEAN, hand_made

SCENES = {"a": "f.r.", "b": "F...", "c": "f...", "d": "s!.."}
CAREFUL = {"a": True, "b": False, "c": None, "d": True}
GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "records"


def records() -> list[RunRecord]:
    calm = dict.fromkeys(SCENES, "....")
    return [attacked("bold", SCENES, CAREFUL), attacked("calm", calm, CAREFUL)]


def row_of(table: Table, name: str) -> dict[str, str]:
    (row,) = [row for row in table.rows if row[0].startswith(name)]
    return dict(zip(table.columns, row, strict=True))


def named(tables: list[Table]) -> dict[str, Table]:
    return {table.name: table for table in tables}


def test_attack_success_is_that_of_the_metric_with_its_counts() -> None:
    runs = records()
    table = named(attack_tables(DataSetRuns("d", runs)))["attack-success"]
    bold, calm = row_of(table, "bold"), row_of(table, "calm")
    rates = compute_attack_rates(runs[0])
    assert bold["attributable"] == f"{100 * (rates.samples['attributable'].value or 0):.1f}"
    # Nobody judged scene c, and the sample that failed in d might have shown anything.
    assert bold["attributable, scenes"] == "50.0" and bold["at fault, scenes"] == "66.7"
    assert bold["contact, scenes"] == "75.0" and bold["bystander, scenes"] == "25.0"
    assert (bold["judged"], bold["careful survives"], bold["scenes"]) == ("3", "2", "4")
    assert calm["contact, scenes"] == calm["attributable, scenes"] == "0.0"
    assert any("3 of 4 scenes were assessed: attributable covers only these" in note for note in table.notes)
    assert (bold["shared"], bold["unclear"]) == ("6.7", "0.0")
    older = named(attack_tables(DataSetRuns("d", [attacked("old", {**SCENES, "d": "?!.."}, CAREFUL)])))
    told = row_of(older["attack-success"], "old")
    assert (
        told["at fault, scenes"] == told["attributable"] == told["shared"] == "–" and told["contact, scenes"] == "75.0"
    )
    assert any("old on adv: the record does not say whose fault" in note for note in older["attack-success"].notes)
    assert row_of(older["severity-contacts"], "old")["at fault %"] == "–"


def test_without_judgements_attributable_is_a_dash_and_never_a_zero() -> None:
    table = success_table(DataSetRuns("d", [attacked("p", SCENES, dict.fromkeys(SCENES))]))
    assert table is not None
    row = row_of(table, "p")
    assert row["attributable"] == row["attributable, scenes"] == "–" and row["judged"] == "0"
    assert row["contact, scenes"] == "75.0"
    assert any("its scenes were not assessed: attributable is unknown" in note for note in table.notes)


def test_severity_tables_show_distributions() -> None:
    tables = named(attack_tables(DataSetRuns("d", records())))
    bold, calm = (row_of(tables["severity-contacts"], name) for name in ("bold", "calm"))
    assert bold["samples"] == "4" and bold["impact speed"] == "10.0" and bold["impact speed, worst tenth"] == "10.0"
    assert bold["at fault %"] == "50.0" and bold["P(fatal) most"] == f"{100 * (5 / 31.74) ** 4:.2f}"
    assert bold["samples, bystander"] == "1" and bold["at fault %, bystander"] == "100.0"
    assert bold["impact speed, bystander"] == "20.0" and bold["delta-v ego, bystander"] == "10.0"
    assert calm["samples"] == calm["samples, bystander"] == "0"
    assert calm["impact speed"] == calm["P(fatal) mean"] == calm["impact speed, bystander"] == "–"
    passes = row_of(tables["severity-near"], "calm")
    assert passes["samples"] == "16" and passes["TTC, worst tenth"] == "1.00" and passes["BTN >= 1, %"] == "50.0"


def test_the_terminal_shows_the_three_readings_shortly() -> None:
    (table,) = [table for table in run_tables("d", records(), allow_partial=True) if table.name == "attack-success"]
    text = table.plain(width=100)
    assert "attributable" in text and "50.0" in text and "95 %" not in text
    assert len([line for line in text.splitlines() if line.startswith(("bold  ", "calm  "))]) == 2
    assert all(table.name != "attack-success" for table in run_tables("d", records(), ["exact"], allow_partial=True))
    recorded = [hand_made("p", {"a": [CLEAN]}, split="val")]
    assert all(table.name != "attack-success" for table in run_tables("d", recorded))


def test_the_ladder_stands_once_for_a_split() -> None:
    runs = records()
    tables = named(assessment_tables(DataSetRuns("d", runs)))
    assert list(tables) == ["ladder", "validity"]
    # Nobody counted adversaries: of the three scenes that were judged one has an adversary off the road.
    assert ("adv", "off road", "1", "3", "33.3") in tables["validity"].rows
    (row,) = tables["ladder"].rows
    shown = dict(zip(tables["ladder"].columns, row, strict=True))
    assert shown["recorded"] == "100.0" and shown["careful human"] == "66.7" and shown["unsolvable"] == "0"
    assert shown["margin, s"] == "1.2" and shown["judged"] == "3" and shown["no fault"] == "66.7"
    assert any("3 of 4 scenes were assessed" in note for note in tables["ladder"].notes)
    assert not any("earlier definition" in note for note in tables["ladder"].notes)
    assert assessment_tables(DataSetRuns("d", [attacked("p", SCENES, dict.fromkeys(SCENES))])) == []


def test_the_ladder_says_which_scenes_were_judged_from_their_first_frame() -> None:
    record = records()[0]
    facts = {
        name: each.model_copy(
            update={"judgement": each.judgement and each.judgement.model_copy(update={"definition": 1})}
        )
        for name, each in record.run.scene_facts.items()
    }
    old = replace(record, run=record.run.model_copy(update={"scene_facts": facts}))
    notes = named(assessment_tables(DataSetRuns("d", [old])))["ladder"].notes
    assert any("3 scenes assessed by an earlier definition" in note for note in notes)


def test_realism_is_shown_by_its_worst_feature_and_beside_the_halves() -> None:
    tables = named(assessment_tables(DataSetRuns("d", [with_realism(run, 0.8) for run in records()])))
    assert list(tables) == ["ladder", "validity", "realism", "realism-adv"]
    (row,) = tables["realism"].rows
    shown = dict(zip(tables["realism"].columns, row, strict=True))
    assert shown["worst feature"] == "jerk along" and shown["realism"] == "0.800" and shown["halves"] == "0.940"
    assert shown["ctg-realism@code"] == "0.0500" and shown["ctg, relative"] == "–"
    assert any("version ctg, normalised by scene, mask current_speed" in note for note in tables["realism"].notes)
    assert [row[0] for row in tables["realism-adv"].rows] == ["speed", "jerk along (worst)"]
    assert not any("mean" in head for head in tables["realism-adv"].columns)


def test_our_own_town_has_validity_alone_and_says_why() -> None:
    tables = named(assessment_tables(DataSetRuns("d", [with_realism(run, None) for run in records()])))
    assert list(tables) == ["ladder", "validity"]
    off_road, teleport = tables["validity"].rows
    assert off_road[1:] == ("off road", "1", "4", "25.0") and teleport[3:] == ("0", "–")
    said = "not compared with recordings: the recordings are our own town"
    assert any(said in note for note in tables["validity"].notes)
    assert any("adv: teleport: the generated 12 Hz track" in note for note in tables["validity"].notes)


def test_old_records_are_named_and_in_no_table() -> None:
    frame = DataSetRuns("mini", [load_record(GOLDEN / "schema-3-adv")])
    tables = build_data_set_tables(frame)
    assert not [table for table in tables.tables if table.name.startswith(("attack", "severity", "ladder"))]
    assert any("does not say how severe its plans are" in note and "rescore" in note for note in missing_notes(frame))


def test_a_leaderboard_has_the_tables_and_the_figure_or_says_why_not() -> None:
    for run in (with_realism(records()[0], None), attacked("p", SCENES, dict.fromkeys(SCENES))):
        files, judged = build_leaderboard_files(read_results([run]), figures=True), run.planner == "bold"
        for kind in ("attack", "severity", *(("ladder", "validity") if judged else ())):
            assert f"tables/{kind}.csv" in files
        assert ("figures/d/attack-realism.png" in files) == judged
        said = "No figure of attack success against realism: the avoidability of no scene was assessed"
        assert (said in files["README.md"].decode()) != judged and b"attack success" in files["README.md"]
