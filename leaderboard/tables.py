"""A table as data, and its Markdown, LaTeX and CSV text. Same table, same bytes."""

import csv
import io
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

UNDEFINED = "–"
"""Shown where a number does not exist; never a zero."""

_LATEX_SPECIAL = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "–": "--",
    "×": r"$\times$",
    "±": r"$\pm$",
    "†": r"$\dagger$",
    "‡": r"$\ddagger$",
    "−": "$-$",
    "→": r"$\to$",
    "∞": r"$\infty$",
    "φ": r"$\phi$",
    "…": r"\ldots{}",
    # After the end of a row these two would be taken for its options.
    "[": "{[}",
    "*": "{*}",
}


@dataclass(frozen=True, slots=True)
class Table:
    """Cells of text under named columns.

    Attributes:
        name: File stem, for example ``collision``.
        title: One line above the table.
        columns: Column heads.
        rows: Cells, one tuple a row, as many as there are columns.
        notes: Sentences below the table.
        text_columns: How many leading columns are text (left-aligned); the others are numbers.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    text_columns: int = 1

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.name}: a row has {len(row)} cells for {len(self.columns)} columns")

    def markdown(self) -> str:
        """The table as GitHub Markdown, with its title and notes."""
        rule = ["---"] * self.text_columns + ["---:"] * (len(self.columns) - self.text_columns)
        lines = [f"### {escape_markdown(self.title)}", ""]
        lines += [_markdown_row([escape_markdown(head) for head in self.columns]), _markdown_row(rule)]
        lines += [_markdown_row([escape_markdown(cell) for cell in row]) for row in self.rows]
        lines += ["", *(f"- {escape_markdown(note)}" for note in self.notes)] if self.notes else []
        return "\n".join(lines) + "\n"

    def plain(self) -> str:
        """The table as aligned text for a terminal, with its title and notes."""
        lines = [self.columns, *self.rows]
        widths = [max(len(line[column]) for line in lines) for column in range(len(self.columns))]
        texts = [self.title]
        for line in lines:
            cells = [
                cell.ljust(width) if column < self.text_columns else cell.rjust(width)
                for column, (cell, width) in enumerate(zip(line, widths))
            ]
            texts.append("  ".join(cells).rstrip())
        return "\n".join([*texts, *self.notes]) + "\n"

    def latex(self) -> str:
        """The table as a LaTeX ``table`` environment with booktabs rules."""
        alignment = "l" * self.text_columns + "r" * (len(self.columns) - self.text_columns)
        lines = [r"\begin{table}", r"  \centering", rf"  \begin{{tabular}}{{{alignment}}}", r"    \toprule"]
        lines += [f"    {_latex_row(self.columns)}", r"    \midrule"]
        lines += [f"    {_latex_row(row)}" for row in self.rows]
        lines += [r"    \bottomrule", r"  \end{tabular}"]
        label = re.sub("[^A-Za-z0-9-]", "-", self.name)
        caption = " ".join([f"{self.title}.", *self.notes])
        lines += [rf"  \caption{{{escape_latex(caption)}}}", rf"  \label{{tab:{label}}}", r"\end{table}"]
        return "\n".join(lines) + "\n"

    def csv(self) -> str:
        """The table as CSV, heads first."""
        stream = io.StringIO()
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(self.columns)
        writer.writerows([["" if cell == UNDEFINED else cell for cell in row] for row in self.rows])
        return stream.getvalue()


def escape_latex(text: str) -> str:
    """Text on one line in which nothing is LaTeX code."""
    return "".join(_LATEX_SPECIAL.get(character, character) for character in " ".join(text.split()))


def escape_markdown(text: str) -> str:
    """Text in which nothing is Markdown or HTML: names come from strangers' records."""
    safe = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace("\\", "\\\\")
    for character in "|`*":
        safe = safe.replace(character, f"\\{character}")
    safe = safe.replace("](", "\\](")
    return " ".join(safe.split())


def percent(fraction: float | None, digits: int = 2) -> str:
    """A fraction as a percentage without its sign, or a dash."""
    return UNDEFINED if fraction is None else f"{100 * fraction:.{digits}f}"


def interval(low: float | None, high: float | None, *, scale: float = 1.0, digits: int = 1) -> str:
    """An interval as ``[low, high]``, or a dash where there is none to speak of.

    Args:
        low: Lower end.
        high: Upper end; may be infinite.
        scale: What the ends are multiplied with, for example 100 for a percentage.
        digits: Decimals.

    Returns:
        The text. An interval without width is a dash too: where all scenes agree there is nothing to draw, and
        "[0.0, 0.0]" would look like certainty.
    """
    if low is None or high is None or low == high:
        return UNDEFINED
    return f"[{number(scale * low, digits)}, {number(scale * high, digits)}]"


def number(value: float | None, digits: int = 2, *, signed: bool = False) -> str:
    """A number, or a dash where it does not exist; never "-0.0"."""
    if value is None:
        return UNDEFINED
    if math.isinf(value):
        return "∞" if value > 0 else "-∞"
    text = f"{value:.{digits}f}"
    if float(text) == 0.0:
        return text.removeprefix("-")
    return f"+{text}" if signed and value > 0 else text


def metres(value: float | None, digits: int = 2) -> str:
    """A length in metres, or a dash."""
    return UNDEFINED if value is None else f"{value:.{digits}f}"


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _latex_row(cells: Sequence[str]) -> str:
    return " & ".join(escape_latex(cell) for cell in cells) + r" \\"
