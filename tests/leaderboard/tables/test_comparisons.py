"""Tables of several protocols, splits and planners: whose numbers they are, what is left out and why."""

from dataclasses import replace

from benchmark.metrics.transfer import transfer
from benchmark.published import INCREASE, TABLE_1
from benchmark.records.run import RunRecord
from benchmark.report.cells import UNDEFINED
from benchmark.report.table import Table
from leaderboard.figures.contents import matrix_figures
from leaderboard.frame.rows import FEW_NOTE
from leaderboard.frame.runs import DataSetRuns
from leaderboard.paper.document import compute_increase
from leaderboard.tables.collision import collision_table
from leaderboard.tables.comparisons import planner_table, split_table
from leaderboard.tables.contents import build_data_set_tables, missing_notes
from leaderboard.tables.transfer import agreement_table, transfer_table
from tests.benchmark.metrics.made_attacks import attacked, told
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, LATE, hand_made

ALL = ("exact", "uniad", "vad")
VAL = {"s0": [HIT, CLEAN], "s1": [CLEAN, CLEAN], "s2": [LATE, CLEAN]}
ADV = {"s0-1": [HIT, HIT], "s0-2": [HIT, CLEAN], "s1-1": [LATE, CLEAN], "lost-1": [HIT, HIT]}


def column(table: Table, head: str) -> list[str]:
    return [row[table.columns.index(head)] for row in table.rows]


def cells(table: Table, **wanted: str) -> dict[str, str]:
    (row,) = [
        row for row in table.rows if all(row[table.columns.index(head)] == value for head, value in wanted.items())
    ]
    return dict(zip(table.columns, row))


def pair(planner: str = "p", native: str | None = None) -> list[RunRecord]:
    return [
        hand_made(planner, VAL, split="val", protocols=ALL, native=native),
        hand_made(planner, ADV, protocols=ALL, native=native),
    ]


def test_the_printed_increases_follow_from_the_printed_averages() -> None:
    for model, increase in INCREASE.items():
        average = {rate.data_set: float(rate.percent[3]) for rate in TABLE_1 if rate.model == model}
        found = compute_increase(average["nuScenes-val"], average["Adv-nuSc"])
        assert found is not None and f"{found:.1f}" == increase


def test_every_planner_under_its_own_protocol_and_the_others_apart() -> None:
    records = [*pair("a", "vad"), *pair("b", "uniad"), *pair("c"), *pair("d", "sparsedrive")]
    table = collision_table(DataSetRuns("d", records), "native")
    assert column(table, "protocol") == ["vad", "vad", "uniad", "uniad", "exact", "exact"]
    assert column(table, "planner") == ["a", "a", "b", "b", "c", "c"]
    # Late contact: all of UniAD's value at 3 s, a sixth of VAD's mean over the steps.
    assert cells(table, planner="a", split="val")["col. 3s"] == f"{100 * (1 + 1 / 6) / 6:.2f}"
    assert cells(table, planner="b", split="val")["col. 3s"] == f"{100 * 2 / 6:.2f}"
    assert cells(table, planner="c", split="adv")["avg before mask"] == UNDEFINED
    assert cells(table, planner="b", split="adv")["steps masked"] == "0"
    assert any(
        "d on val: no verdicts under protocol sparsedrive; run challenger-bench rescore." in note
        for note in table.notes
    )


def masked(record: RunRecord, steps: int | None, for_adversary: int | None) -> RunRecord:
    counted = {"mask_removed_steps": steps, "mask_removed_for_adversary": for_adversary}
    protocols = {
        name: found if name == "exact" else found.model_copy(update=counted)
        for name, found in record.summary.protocols.items()
    }
    return replace(record, summary=record.summary.model_copy(update={"protocols": protocols}))


def test_masked_steps_are_those_of_adversaries_and_others_in_every_form() -> None:
    new, old = masked(hand_made("new", ADV, protocols=ALL), 9, 7), masked(hand_made("old", ADV, protocols=ALL), 9, None)
    table = collision_table(DataSetRuns("d", [new, old, masked(hand_made("clean", ADV, protocols=ALL), 0, 0)]), "uniad")
    heads = ("steps masked", "masked for adversaries", "masked for others")
    assert [cells(table, planner="new")[head] for head in heads] == ["9", "7", "2"]
    assert [cells(table, planner="old")[head] for head in heads] == ["9", UNDEFINED, UNDEFINED]
    assert [cells(table, planner="clean")[head] for head in heads] == ["0", "0", "0"]
    for text in (table.markdown(), table.latex(), table.csv()):
        assert all(head in text for head in heads)
    facts = table.as_json()["cells"][[row[0] for row in table.rows].index("new")]
    assert [facts[table.columns.index(head)]["value"] for head in heads] == [9.0, 7.0, 2.0]
    assert table.brief is not None
    assert any("masked" in note for note in table.notes) and not any("masked" in note for note in table.brief.notes)
    exact = collision_table(DataSetRuns("d", [new, old]), "exact")
    assert not set(heads) & set(exact.columns) and exact.brief is not None
    assert not any("masked" in note for note in exact.brief.notes)


def test_numbers_of_an_earlier_version_are_marked() -> None:
    old = hand_made("p", VAL, split="val", versions={"exact": 0})
    table = collision_table(DataSetRuns("d", [old, hand_made("p", ADV)]), "exact")
    assert column(table, "planner") == ["p ‡", "p"]
    assert any("‡ p on val: scored by version 0 of protocol exact, now" in note for note in table.notes)
    changes = split_table(DataSetRuns("d", [old, hand_made("p", ADV)]), "exact")
    assert changes is not None and changes.rows == ()
    assert any("Left out: p on val of d was judged by version 0" in note for note in changes.notes)


def test_records_that_lack_a_protocol_are_named_and_in_no_matrix() -> None:
    records = [*pair("a"), *pair("b"), hand_made("c", ADV, protocols=("exact",))]
    frame = DataSetRuns("d", records)
    assert any(note.startswith("c on adv: not scored by uniad, vad,") for note in missing_notes(frame))
    found = build_data_set_tables(frame)
    by_name = {table.name: table for table in found.tables}
    assert "c" in by_name["transfer-adv-exact"].columns and "c" not in by_name["transfer-adv-vad"].columns
    assert any(
        "Left out: c on adv of d was not judged by protocol 'vad'" in n for n in by_name["transfer-adv-vad"].notes
    )


def test_exact_and_native_come_first_and_others_have_tables_of_their_own() -> None:
    frame = DataSetRuns("d", [*pair("a", "vad"), *pair("b", "uniad")])
    found = build_data_set_tables(frame)
    names = [table.name for table in found.front]
    assert names[:5] == ["effect", "collision-exact", "collision-native", "changes-exact", "changes-native"]
    assert "planners-adv-exact" in names and "planners-adv-native" not in names
    assert list(found.others) == ["uniad", "vad"]
    assert [tables[0].name for tables in found.others.values()] == ["collision-uniad", "collision-vad"]
    assert sorted(figure.name for figure in matrix_figures(frame)) == [
        *("lift-adv-exact", "lift-val-exact"),
        *(f"transfer-{split}-{name}" for split in ("adv", "val") for name in ("exact", "native")),
    ]
    every = [table.name for table in found.tables]
    assert len(every) == len(set(every))


def test_where_adversaries_are_known_the_picture_of_lift_is_of_contacts_with_them() -> None:
    scenes, known = {"A-1": "f...", "B-1": "F..f", "C-1": "...."}, dict.fromkeys(("A-1", "B-1", "C-1"), True)
    frame = DataSetRuns(
        "d", [told(attacked("a", scenes, known)), told(attacked("b", {**scenes, "C-1": "F..."}, known))]
    )
    drawn = {figure.name: figure.title for figure in matrix_figures(frame)}
    names = [name for name in drawn if name.endswith(("exact", "adversary"))]
    assert names == ["transfer-adv-exact", "transfer-adv-adversary", "lift-adv-adversary"]
    assert "by contacts with the adversary" in drawn["lift-adv-adversary"]
    assert drawn.items() <= {table.name: table.title for table in build_data_set_tables(frame).front}.items()


def test_changes_show_both_rates_and_the_paired_difference() -> None:
    rendered = hand_made("p", VAL, split="val-r", protocols=ALL, sources={name: name for name in VAL})
    table = split_table(DataSetRuns("d", [*pair(), rendered]), "exact")
    assert table is not None
    assert column(table, "splits") == ["val → adv", "val-r → adv", "val → val-r"]
    row = cells(table, splits="val → adv")
    val, adv = (1 + 1 / 3) / 6, (1 + 1 + 1 + 1 / 3 + 1 + 1) / 8
    assert row["from (%)"] == f"{100 * val:.2f}" and row["to (%)"] == f"{100 * adv:.2f}"
    paired = (3 + 1 / 3) / 6 - 1 / 4
    assert row["paired difference (points)"] == f"+{100 * paired:.2f}"
    assert (row["scenes paired"], row["not paired"]) == ("2", "2")
    assert {"val → adv: 1 scene only in val (s2).", "val → adv: 1 scene only in adv (lost-1)."} <= set(table.notes)
    same = cells(table, splits="val → val-r")
    assert same["from (%)"] == same["to (%)"] and same["paired difference (points)"] == "0.00"


def test_runs_of_a_part_are_in_no_comparison_and_named() -> None:
    part = hand_made("p", ADV, scenes_in_split=9)
    assert split_table(DataSetRuns("d", [pair()[0], part]), "exact") is None
    table = planner_table(DataSetRuns("d", [*pair("a"), *pair("b"), part]), "exact", "adv")
    assert table is not None and column(table, "first") == ["a"] and column(table, "second") == ["b"]
    assert any("p on adv: 4 of 9 scenes of the split." in note for note in table.notes)
    # Planners that are the same differ by nothing.
    assert column(table, "second − first (points)") == ["0.00"]
    agreement = agreement_table("d", transfer([pair("a")[0], pair("b")[0]], protocol="vad"))
    assert (column(agreement, "φ"), column(agreement, "lift")) == (["1.00"], ["1.50"])


def test_coverage_below_100_is_said() -> None:
    failing = hand_made("p", {"s0": [HIT, FAILED], "s1": [CLEAN, CLEAN]})
    table = collision_table(DataSetRuns("d", [failing]), "exact")
    assert column(table, "coverage") == ["75.0"]
    assert any("p on adv: 1 sample failed. The rates cover 75.0 % of 4 samples." in note for note in table.notes)
    other = hand_made("q", {"s0": [HIT, HIT], "s1": [CLEAN, CLEAN]})
    compared = planner_table(DataSetRuns("d", [failing, other]), "exact", "adv")
    assert compared is not None
    assert (column(compared, "samples"), column(compared, "failed samples")) == (["3"], ["1"])


def test_native_transfer_says_whose_verdicts_they_are() -> None:
    matrix = transfer([pair("a", "vad")[1], pair("b", "uniad")[1]], protocol="native")
    table = transfer_table("d", matrix)
    assert column(table, "surrogate") == ["a (vad)", "b (uniad)", "all scenes"]
    assert column(table, "a (vad)")[0] == UNDEFINED
    assert table.title == "d, split adv: transfer of failures (%), each planner under its own protocol"


def test_few_recordings_are_few_however_many_versions_they_have() -> None:
    versions = {f"s{index:02}": "one" if index else "two" for index in range(30)}
    records = [hand_made(planner, {name: [HIT] for name in versions}, sources=versions) for planner in ("a", "b")]
    tables = [
        collision_table(DataSetRuns("d", records), "exact"),
        planner_table(DataSetRuns("d", records), "exact", "adv"),
        transfer_table("d", transfer(records)),
        agreement_table("d", transfer(records)),
    ]
    assert all(table is not None and FEW_NOTE in table.notes for table in tables)


def test_where_records_lie_is_in_no_table() -> None:
    records = [*pair("a", "vad"), *pair("b"), hand_made("c", VAL, split="val", versions={"exact": 0})]
    moved = [replace(record, directory=record.directory / "elsewhere") for record in records]
    made, again = (build_data_set_tables(DataSetRuns("d", each)).tables for each in (records, moved))
    assert [table.as_json() for table in made] == [table.as_json() for table in again]
    for form in (Table.markdown, Table.latex, Table.csv, Table.plain):
        assert [form(table) for table in made] == [form(table) for table in again]
