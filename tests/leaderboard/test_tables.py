import csv
import io
import math

import pytest

from leaderboard.tables import UNDEFINED, Table, escape_latex, interval, metres, number, percent

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


def test_what_does_not_exist_is_a_dash() -> None:
    assert percent(None) == metres(None) == number(None) == UNDEFINED
    assert percent(0.0) == "0.00"
    assert interval(None, None) == interval(0.1, None) == UNDEFINED


def test_intervals_and_signed_numbers() -> None:
    assert interval(0.0123, 0.5, scale=100.0) == "[1.2, 50.0]"
    assert interval(-0.04, math.inf) == "[0.0, ∞]"
    assert interval(0.2, 0.2) == UNDEFINED, "without width it would look like certainty"
    assert [number(value, 1, signed=True) for value in (1.24, -1.26, -0.01, 0.0)] == ["+1.2", "-1.3", "0.0", "0.0"]
    assert escape_latex("φ → ∞ ‡") == r"$\phi$ $\to$ $\infty$ $\ddagger$"


def test_a_row_of_the_wrong_width_is_refused() -> None:
    with pytest.raises(ValueError, match="2 columns"):
        Table("x", "x", ("a", "b"), (("1",),))
