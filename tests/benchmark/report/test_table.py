import csv
import io
import json
import math
import re
from dataclasses import replace
from typing import Any

import pytest

from benchmark.report.cells import UNDEFINED, CellSource, ValueSource, format_interval, format_number
from benchmark.report.table import Table, build_table, escape_latex

TABLE = Table(
    name="rates",
    title="Rates of <b>anyone</b>",
    columns=("planner", "rate"),
    rows=(("idm|x", "1.25"), ("a_b & 50%", UNDEFINED)),
    notes=("Note with a * star.",),
)


def test_names_from_strangers_stay_text_in_markdown() -> None:
    text = TABLE.markdown()
    assert "<b>" not in text
    assert "idm\\|x" in text
    assert all(line.count("|") - line.count("\\|") == 3 for line in text.splitlines() if line.startswith("|"))


def test_a_link_in_a_name_is_no_link_and_an_interval_stays_as_it_is() -> None:
    text = Table("x", "x", ("a", "b"), (("[me](javascript:x)", "[0.1, 9.4]"),)).markdown()
    assert "| [me\\](javascript:x) | [0.1, 9.4] |" in text


def test_names_from_strangers_stay_text_in_latex() -> None:
    assert escape_latex("a_b & 50% {x} \\input") == r"a\_b \& 50\% \{x\} \textbackslash{}input"
    assert r"a\_b \& 50\% & -- \\" in TABLE.latex()


def test_csv_reads_back_and_a_missing_number_is_empty_not_zero() -> None:
    rows = list(csv.reader(io.StringIO(TABLE.csv())))
    assert rows == [["planner", "rate"], ["idm|x", "1.25"], ["a_b & 50%", ""]]


def test_plain_columns_line_up() -> None:
    lines = TABLE.plain().splitlines()
    assert lines[2].index("1.25") + 4 == len(lines[2]) == len(lines[3])


NAMES = ("diffusiondrive-mini ‡", "constant-velocity-on-path †", "pdm-v2-20251129", "idm †")


@pytest.mark.parametrize("width", [60, 80, 100])
def test_names_in_a_narrow_matrix_break_at_hyphens_alone(width: int) -> None:
    rows = [(name, "scene-8000-9ed13f26", *["69 [33, 100] (11/16)"] * len(NAMES)) for name in NAMES]
    lines = build_table("x", "", ("planner", "scene", *NAMES), rows, text_columns=2).plain(width=width).splitlines()
    assert max(map(len, lines)) <= width
    whole = {part for name in (*NAMES, rows[0][1]) for part in re.findall(r"\w+-?", name)}
    words = {word for line in lines for word in re.findall(r"(?<!\w)[a-z]\w*-?", line)}
    assert words - {"planner", "scene"} <= whole, "no part of a name is broken"
    assert {word for word in words if word.endswith("-")} >= ({"diffusiondrive-"} if width == 60 else set())
    # Nothing is lost: the numbers of all planners stand in each row.
    assert sum(line.count("(11/16)") for line in lines) == len(NAMES) ** 2


def test_a_name_without_a_hyphen_breaks_where_numbers_have_no_room_else() -> None:
    table = build_table("x", "", ("planner", "rate"), [("x" * 70, "69 [33, 100] (11/16)")])
    lines = table.plain(width=80).splitlines()
    assert max(map(len, lines)) == 80 and "".join(lines).count("x") == 70
    assert build_table("x", "", ("planner", "rate"), [("x" * 70, "1.5")]).plain(width=80).count("\n") == 2


def test_what_does_not_exist_is_a_dash() -> None:
    nothing = ValueSource("exact").cell(None, "%", 0, scale=100.0)
    assert format_number(None) == nothing.shown(2, after="×").text == nothing.interval().text == UNDEFINED
    assert ValueSource().cell(0.0, "%", 4).shown(2).text == "0.00"
    assert format_interval(None, None) == format_interval(0.1, None) == UNDEFINED


def test_intervals_and_signed_numbers() -> None:
    assert ValueSource().cell(0.2, "%", 4, low=0.0123, high=0.5, scale=100.0).interval().text == "[1.2, 50.0]"
    assert format_interval(-0.04, math.inf) == "[0.0, ∞]"
    assert format_interval(0.2, 0.2) == UNDEFINED, "without width it would look like certainty"
    numbers = {1.24: "+1.2", -1.26: "-1.3", -0.01: "0.0", 0.0: "0.0"}
    assert all(format_number(value, 1, signed=True) == text for value, text in numbers.items())
    assert escape_latex("φ → ∞ ‡") == r"$\phi$ $\to$ $\infty$ $\ddagger$"


def test_a_row_of_the_wrong_width_is_refused() -> None:
    with pytest.raises(ValueError, match="2 columns"):
        Table("x", "x", ("a", "b"), (("1",),))


RATE = CellSource(1.25, "%", 8, "samples", 0.5, math.inf, "vad & co", "0123456789ab idm|x on adv", None)
GROUPED = build_table(
    "grouped", "Rates", ("planner", "avg", "95 %", "95 %"), [("idm|x", RATE.shown(2), RATE.interval(), UNDEFINED)],
    notes=("A note.",), groups=(("", 1), ("rate in %, vad & co", 2), ("nothing", 0), ("other", 1)),
    sources=("A paper",),
)  # fmt: skip


def test_groups_cover_the_columns_and_say_whose_they_are() -> None:
    assert GROUPED.groups == (("", 1), ("rate in %, vad & co", 2), ("other", 1))
    heads = next(csv.reader(io.StringIO(GROUPED.csv())))
    assert heads == ["planner", "avg | rate in %, vad & co", "95 % | rate in %, vad & co", "95 % | other"]
    assert len(set(heads)) == len(heads)
    assert "| planner | avg | 95 % | 95 % |" in GROUPED.markdown()
    lines = GROUPED.latex().splitlines()
    assert lines[4].strip() == (
        r"\multicolumn{1}{c}{} & \multicolumn{2}{c}{rate in \%, vad \& co} & \multicolumn{1}{c}{other} \\"
    )
    assert lines[5].strip() == r"\cmidrule(lr){2-3} \cmidrule(lr){4-4}"
    with pytest.raises(ValueError, match="groups do not cover 2 columns"):
        replace(TABLE, groups=(("", 1),))
    with pytest.raises(ValueError, match="cells do not match"):
        replace(TABLE, cells=((None, None),))


def test_the_source_of_quoted_numbers_stands_below_in_every_form() -> None:
    for text in (GROUPED.markdown(), GROUPED.plain(), GROUPED.latex()):
        assert "Source of quoted numbers: A paper." in text


def test_json_reads_back_with_the_facts_of_every_cell() -> None:
    read: dict[str, Any] = json.loads(json.dumps(GROUPED.as_json()))
    assert read == GROUPED.as_json()
    assert [tuple(group) for group in read["groups"]] == list(GROUPED.groups)
    assert [tuple(row) for row in read["rows"]] == list(GROUPED.rows)
    (cells,) = read["cells"]
    assert cells[0] is None and cells[3] is None and cells[1] == cells[2]
    assert cells[1] == {
        **{"value": 1.25, "unit": "%", "n": 8, "of": "samples", "low": 0.5, "high": "∞"},
        **{"protocol": "vad & co", "record": "0123456789ab idm|x on adv"},
    }
    assert json.loads(json.dumps(TABLE.as_json()))["cells"] is None


def test_the_last_bits_of_a_number_are_not_in_json() -> None:
    sums = [0.1 + 0.2, 0.3]
    assert sums[0] != sums[1]
    first, second = (ValueSource().cell(value, "m", 1).as_json() for value in sums)
    assert first == second
