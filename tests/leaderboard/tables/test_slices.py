"""Tables by slice: every form, the numbers of the metric, what old records lack, and what shares no column."""

import json
from dataclasses import replace
from pathlib import Path

from benchmark.metrics.slices import ADVERSARY, KINDS, compute_driving_by, compute_rates_by
from benchmark.protocols import PROTOCOLS
from benchmark.records.run import RunRecord, load_record
from benchmark.records.run_schema import SceneFacts
from leaderboard.build import build_leaderboard_files
from leaderboard.frame.results import read_results
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.contents import build_data_set_tables, missing_notes
from leaderboard.tables.slices import run_slices, slice_tables
from tests.benchmark.metrics.made_attacks import attacked
from tests.benchmark.metrics.test_effect import ran
from tests.benchmark.metrics.test_slices import FACTS, PLACES, SPEED, made
from tests.benchmark.records.hand_made_records import CLEAN, HIT, hand_made
from tests.leaderboard.csv_rows import csv_rows

GOLDEN = Path(__file__).resolve().parents[2] / "golden" / "records"


def judged(planner: str, native: str | None, *protocols: str) -> RunRecord:
    """A planner that says where its samples are and how fast."""
    record = hand_made(planner, {"a": (HIT, CLEAN, CLEAN), "b": (CLEAN, HIT, HIT)}, protocols=protocols, native=native)
    rows = tuple(row.model_copy(update={"speed_m_s": SPEED[row.index]}) for row in record.rows)
    return placed(replace(record, rows=rows))


def placed(record: RunRecord) -> RunRecord:
    rows = tuple(row.model_copy(update={"place": PLACES[row.index]}) for row in record.rows)
    return replace(record, rows=rows)


def test_a_row_holds_the_rates_of_its_slice_with_interval_and_counts() -> None:
    record = made()
    (table,) = slice_tables("d", [record], ("exact",), ("place",))
    assert table.name == "slices-place-exact" and table.cells is not None
    assert [row[2] for row in table.rows] == ["roundabout", "junction", "straight"]
    for cells, part in zip(table.cells, compute_rates_by(record, "place", "exact"), strict=True):
        found = {name: cell for name, cell in zip(table.columns, cells) if cell is not None}
        rate, average, interval = part.columns["collision"]["avg"], found["any avg"], found["95 % of any avg"]
        assert average.value == 100 * (rate.value or 0.0) and average.n == part.samples
        assert interval.low == (None if rate.low is None else 100 * rate.low) and average.protocol == "exact"
        assert found["L2 2s"].value == part.columns["l2"]["2s"].value
        assert (found["samples"].value, found["samples"].n) == (part.samples, 16)
        assert (found["scenes"].value, found["scenes"].n) == (part.scenes, 4)


def test_contacts_with_the_adversary_stand_before_any_contact() -> None:
    adversarial, recorded = placed(ran({"a": "fF..", "b": "f.F."})), placed(ran({"a": "...F", "b": "F..."}, "val"))
    recorded = replace(recorded, run=recorded.run.model_copy(update={"scene_facts": {}}))
    (table,) = slice_tables("d", [recorded, adversarial], ("exact",), ("place",))
    heads = ("split", "place", "adversary 3s", "adversary avg", "any 3s", "samples")
    assert [head for head in table.columns if head in heads] == [*heads]
    shown = [tuple(row[table.columns.index(head)] for head in heads) for row in table.rows]
    assert [row for row in shown if row[0] == "adv"] == [
        ("adv", "roundabout", "0.00", "0.00", "0.00", "2"),
        ("adv", "junction", "0.00", "0.00", "50.00", "2"),
        # Number 0 and 2 of each scene: two of the adversary, from 1.3 s on, and one bystander.
        ("adv", "straight", "50.00", "33.33", "75.00", "4"),
    ]
    assert {row[2:4] for row in shown if row[0] == "val"} == {("–", "–")}
    assert {row[4] for row in shown if row[0] == "val"} == {"50.00", "0.00", "25.00"}
    assert ADVERSARY not in compute_rates_by(recorded, "place", "exact")[0].columns
    (alone,) = slice_tables("d", [recorded], ("exact",), ("place",))
    assert "col. avg" in alone.columns and "adversary avg" not in alone.columns


def test_where_a_record_does_not_say_whom_contacts_are_with_there_are_dashes() -> None:
    scenes = {"a": "fF..", "b": "f.F."}
    old = placed(attacked("p", scenes, dict.fromkeys(scenes, True)))
    (table,) = slice_tables("d", [old], ("exact",), ("place",))
    at = table.columns.index("adversary avg")
    assert {row[at] for row in table.rows} == {"–"} and {row[at + 2] for row in table.rows} != {"–"}
    assert any("older records lack the objects touched; challenger-bench rescore" in one for one in table.notes)


def test_every_form_has_the_same_rows() -> None:
    record = made()
    tables = slice_tables("d", [record], ("exact",), KINDS)
    assert [table.name for table in tables] == [f"slices-{kind}-exact" for kind in KINDS]
    for table in tables:
        stored = json.loads(json.dumps(table.as_json()))
        assert [row[2] for row in stored["rows"]] == [row[2] for row in table.rows]
        assert len(csv_rows(table.csv())) == len(table.rows)
        for row in table.rows:
            assert row[2] in table.markdown() and row[2] in table.latex() and row[2] in table.plain().replace("\n", " ")
    # Manoeuvres are of adversarial splits alone.
    recorded = {name: SceneFacts(source=name, light=[]) for name in FACTS}
    plain = replace(record, run=record.run.model_copy(update={"scene_facts": recorded}))
    assert slice_tables("d", [plain], ("exact",), ("manoeuvre",)) == []


def test_under_their_own_protocols_stand_planners_that_have_one_and_no_maxima() -> None:
    records = [judged("p", "vad", "exact", "vad"), judged("q", None, "exact"), judged("m", "omnidrive", "omnidrive")]
    (table,) = slice_tables("d", records, ("native",), ("speed",))
    assert {(row[0], row[3]) for row in table.rows} == {("p", "vad")}
    (omnidrive,) = slice_tables("d", records, ("omnidrive",), ("speed",))
    assert {row[0] for row in omnidrive.rows} == {"m"} and "off road avg" in omnidrive.columns
    said = " ".join(omnidrive.notes)
    assert "p on adv of d was not judged by protocol 'omnidrive'" in said
    assert [table.name for table in run_slices("d", records, ("speed",))] == [
        "slices-speed-exact",
        "slices-speed-native",
    ]


def test_an_old_record_is_said_to_lack_it_and_nothing_is_guessed() -> None:
    old = load_record(GOLDEN / "schema-3-adv")
    # Its verdicts are those of the present version, which only its rows are too old for.
    protocols = old.run.protocols | {"exact": PROTOCOLS["exact"].version}
    old = replace(old, run=old.run.model_copy(update={"protocols": protocols}))
    lacking = {table.name: table for table in slice_tables("mini", [old], ("exact",), KINDS)}
    for kind, words in {"place": "the places", "light": "the light", "speed": "the speed"}.items():
        table = lacking[f"slices-{kind}-exact"]
        assert not table.rows and words in table.notes[-1] and "rescore" in table.notes[-1]
    # What it always said, it is sorted by.
    assert lacking["slices-command-exact"].rows and lacking["slices-manoeuvre-exact"].rows[0][2] == "squeezing-left"
    frame = DataSetRuns("mini", [old])
    found = build_data_set_tables(frame)
    assert {table.name.split("-")[1] for table in found.slices} == {"command", "manoeuvre"}
    assert any("does not say where its samples are" in note for note in missing_notes(frame))
    assert compute_driving_by(old, "command") and compute_driving_by(old, "place") == []


def test_a_leaderboard_names_their_file_which_has_all_of_them() -> None:
    files = build_leaderboard_files(read_results([made()]))
    assert b"`tables/slices.csv`" in files["README.md"]
    stacked = {row["from table"] for row in csv_rows(files["tables/slices.csv"].decode())}
    assert {f"slices-{kind}-{judge}" for kind in KINDS for judge in ("exact", "vad")} <= stacked


def test_the_whole_is_in_the_slices() -> None:
    record = made()
    counted = record.summary.protocols["exact"].counted
    for kind, table in zip(KINDS, slice_tables("d", [record], ("exact",), KINDS), strict=True):
        samples = [int(row[table.columns.index("samples")]) for row in table.rows]
        # A scene of two lights is in two slices.
        assert sum(samples) == counted + (3 if kind == "light" else 0), kind
