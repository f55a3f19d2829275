"""Behind every number of every table stand the facts: value, count, interval, protocol, record or source."""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmark.records.planner_versions import label_versions
from benchmark.records.row_schema import CAUSES, DiagnosisRow, SampleRow
from benchmark.records.run import RunRecord
from benchmark.records.run_schema import SceneFacts
from benchmark.report.cells import UNDEFINED, CellSource, format_number
from benchmark.report.table import Table
from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.ablation import ablation_tables
from leaderboard.tables.contents import build_data_set_tables, generation_tables
from leaderboard.tables.published import published_comparison_tables, published_tables
from tests.benchmark.metrics.made_attacks import contact, judged, near, with_realism
from tests.benchmark.records.hand_made_records import CLEAN, FAILED, HIT, LATE, hand_made
from tests.leaderboard.made_up import study, workspace_sheets

PROTOCOLS = ("exact", "uniad", "vad")
SPLITS: dict[str, dict[str, list[str | None]]] = {
    "val": {"s0": [HIT, CLEAN], "s1": [CLEAN, CLEAN], "s2": [LATE, CLEAN]},
    "val-r": {"s0": [HIT, CLEAN], "s1": [HIT, CLEAN], "s2": [LATE, CLEAN]},
    "adv": {"s0-1": [HIT, HIT], "s0-2": [HIT, CLEAN], "s1-1": [LATE, CLEAN], "lost-1": [FAILED, HIT]},
}


def explained(record: RunRecord) -> RunRecord:
    """Its collisions are diagnosed, its scenes have sources and manoeuvres."""
    rows: list[SampleRow] = []
    turn = 0
    for row in record.rows:
        if row.status == "ok":
            touches = any(row.outcomes["exact"].collision or ())
            facts: dict[str, object] = {"severity": contact("fFrs"[len(rows) % 4]) if touches else near(row.index)}
            if touches:
                said = {"cause": CAUSES[turn % len(CAUSES)], "reason": "plan hits forecast", "hit": "a"}
                facts["diagnosis"], turn = DiagnosisRow.model_validate({**said, "first_contact_s": 1.0}), turn + 1
            row = row.model_copy(update=facts)
        rows.append(row)
    scene_facts = {
        name: SceneFacts(
            source=name.partition("-")[0],
            manoeuvre="cut-in-left" if "0" in name else "tailgating",
            adversaries=1,
            judgement=judged({"s0-1": True, "s0-2": False}.get(name)),
        )
        for name in record.run.scenes
    }
    adversarial = record.run.split == "adv"
    run = record.run.model_copy(update={"scene_facts": scene_facts if adversarial else {}})
    whole = replace(record, run=run, rows=tuple(rows))
    return with_realism(whole, 0.8) if adversarial else whole


def records() -> list[RunRecord]:
    """A published model, a miniature, a privileged one and one with two seeds, on three splits."""
    found = []
    for split, scenes in SPLITS.items():
        for name, native in (("UniAD", "uniad"), ("vad-mini", "vad"), ("plain", None)):
            found.append(hand_made(name, scenes, split=split, protocols=PROTOCOLS, native=native))
        found.append(hand_made("seer", scenes, split=split, protocols=PROTOCOLS, privileged=True))
    calm = hand_made(
        "plain", {name: [CLEAN] * len(samples) for name, samples in SPLITS["adv"].items()}, protocols=PROTOCOLS
    )
    planner = calm.run.planner.model_copy(update={"seed": 1})
    found.append(replace(calm, run=calm.run.model_copy(update={"planner": planner})))
    return label_versions([explained(record) for record in found])


def every_table(runs: Sequence[RunRecord]) -> list[Table]:
    """Those of extensions are tested where they lie."""
    generated = generation_tables(workspace_sheets(), [study(), study("q")])
    others = [table for tables in generated.values() for table in tables]
    return [
        *build_data_set_tables(DataSetRuns("d", runs)).tables,
        *others,
        *published_tables(),
        *published_comparison_tables(runs),
    ]


@pytest.fixture(scope="module")
def tables() -> list[Table]:
    return every_table(records())


def numbers_of(table: Table) -> Iterator[tuple[str, CellSource | None]]:
    """Text and facts of everything to the right of the text columns."""
    assert table.cells is not None, table.name
    for row, cells in zip(table.rows, table.cells, strict=True):
        assert not any(cells[: table.text_columns]), table.name
        yield from list(zip(row, cells, strict=True))[table.text_columns :]


def decimals(text: str) -> int:
    return len(text.partition(".")[2])


def says(text: str, cell: CellSource) -> bool:
    """Whether a text is the number, or the interval, of a cell."""
    if text.startswith("["):
        ends = text.strip("[]").split(", ")
        digits = max(decimals(end) for end in ends)
        return ends == [format_number(cell.low, digits), format_number(cell.high, digits)]
    found = re.match(r"[+-]?[\d,]+(\.\d+)?|∞", text)
    assert found, text
    shown = found[0].replace(",", "").removeprefix("+")
    return shown == format_number(cell.value, decimals(shown))


def check(table: Table) -> None:
    for text, cell in numbers_of(table):
        if text == UNDEFINED:
            continue
        assert cell is not None, (table.name, text)
        assert says(text, cell), (table.name, text, cell)
        assert (cell.record is None) != (cell.source is None), (table.name, text, cell)
        assert cell.source is not None or cell.n is not None, (table.name, text, cell)
        if of := re.search(r"/(\d+)", text):
            assert int(of[1]) == cell.n, (table.name, text, cell)
        assert cell.source is None or cell.source in table.sources


def test_every_number_is_that_of_its_cell(tables: list[Table]) -> None:
    names = [table.name for table in tables]
    assert len(set(names)) == len(names) > 40
    for expected in ("collision-native", "seeds-exact", "diagnosis-manoeuvres", "runtime-adv"):
        assert expected in names
    for table in tables:
        check(table)


def test_every_number_that_rests_on_verdicts_names_the_protocol(tables: list[Table]) -> None:
    kinds = ("collision", "changes", "planners", "seeds", "transfer")
    for table in (each for each in tables if each.name.startswith(kinds)):
        assert None not in {cell.protocol for _, cell in numbers_of(table) if cell is not None}, table.name
        for label, _ in table.groups:
            assert not label or any(name in label for name in (*PROTOCOLS, "own protocol")), (table.name, label)


def test_heads_differ_and_json_of_every_table_reads_back(tables: list[Table]) -> None:
    for table in tables:
        assert len(set(table.heads)) == len(table.columns), table.name
        assert table.groups or table.name.endswith("-published"), table.name
        read = json.loads(json.dumps(table.as_json()))
        assert read == table.as_json()
        assert [len(row) for row in read["cells"]] == [len(table.columns)] * len(table.rows)


def test_latex_is_balanced_and_every_line_has_all_columns(tables: list[Table]) -> None:
    for table in tables:
        text = table.latex()
        plain = re.sub(r"\\[\\{}%&$#_]", "", text)
        assert plain.count("{") == plain.count("}"), table.name
        begun, ended = re.findall(r"\\begin\{(\w+)\}", text), re.findall(r"\\end\{(\w+)\}", text)
        assert begun == ended[::-1] == ["table", "tabular"]
        body = text[text.index(r"\toprule") : text.index(r"\bottomrule")].splitlines()
        for line in (line for line in body if line.endswith(r"\\")):
            spans = [int(span) for span in re.findall(r"\\multicolumn\{(\d+)\}", line)]
            cells = re.sub(r"\\&", "", line).count("&") + 1
            assert cells - len(spans) + sum(spans) == len(table.columns), (table.name, line)
        rules = [int(end) for _, end in re.findall(r"\\cmidrule\(lr\)\{(\d+)-(\d+)\}", text)]
        assert rules == sorted(rules) and all(end <= len(table.columns) for end in rules)


def test_the_order_of_what_tables_are_made_from_does_not_matter(tables: list[Table]) -> None:
    assert [table.as_json() for table in tables] == [table.as_json() for table in every_table(records()[::-1])]
    studies = [study(), study("q"), study(seed=1)]
    assert ablation_tables(studies) == ablation_tables(studies[::-1])


FLAGS = st.lists(st.sampled_from([CLEAN, HIT, LATE, FAILED]), min_size=1, max_size=3)


@settings(max_examples=3, deadline=None)
@given(val=FLAGS, adv=FLAGS, other=FLAGS)
def test_whatever_the_verdicts(val: list[str | None], adv: list[str | None], other: list[str | None]) -> None:
    runs = [
        hand_made(name, {"s0": flags, "s1": [CLEAN]}, split=split, protocols=("exact", "vad"), native=native)
        for name, native, of_adv in (("vad-base", "vad", adv), ("another", None, other))
        for split, flags in (("val", val), ("adv", of_adv))
    ]
    for table in build_data_set_tables(DataSetRuns("d", [explained(record) for record in runs])).tables:
        check(table)
