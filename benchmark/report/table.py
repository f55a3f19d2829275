"""A table as data, and its text for a terminal, as Markdown, LaTeX and CSV. Same table, same bytes."""

import csv
import functools
import io
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from benchmark.report.cells import RANKS_NOTHING, UNDEFINED, CellSource, TableCell
from benchmark.report.terminal import align_columns, find_terminal_width, wrap_text
from benchmark.report.words import pluralise

Groups = tuple[tuple[str, int], ...]
"""Labels over neighbouring columns, each with how many it stands over; an empty label is no label."""

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
    "§": r"\S{}",
    "¶": r"\P{}",
    "−": "$-$",
    "→": r"$\to$",
    "∞": r"$\infty$",
    "φ": r"$\phi$",
    "…": r"\ldots{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': "{''}",
    # After the end of a row these two would be read as its options.
    "[": "{[}",
    "*": "{*}",
}


_LATEX_LETTERS = "äöüßÄÖÜáàâãåçéèêëíìîïñóòôõøúùûæÁÀÂÅÇÉÈÊÍÑÓÔØÚÆ"


@dataclass(frozen=True, slots=True)
class LatexForm:
    """Layout of a table in LaTeX, if not as all others.

    ``alignment`` is of the columns, with rules between them. Columns in ``once`` say the same in all rows between two
    rules, and are shown in the middle one alone. With ``fit`` it is made as wide as the text.
    """

    alignment: str
    rules_after: tuple[int, ...] = ()
    bold_rows: tuple[int, ...] = ()
    once: tuple[int, ...] = ()
    fit: bool = False


@dataclass(frozen=True, slots=True)
class TableExcerpt:
    """Part of a table that a terminal shows unless all is asked for; its columns by place, those of text first.

    ``notes`` are those that its rows need; what columns mean stands in the table's own.
    """

    title: str
    columns: tuple[int, ...]
    notes: tuple[str, ...]
    text_columns: int


@dataclass(frozen=True, slots=True)
class Table:
    """Cells of text under named columns, with the facts behind them.

    Attributes:
        name: File stem, for example ``collision``.
        title: Heading, with the name of the data set.
        columns: Heads.
        rows: Text of each cell, as it is shown.
        notes: Sentences below the table.
        text_columns: How many leading columns are text (left-aligned); the others are numbers.
        groups: Labels over columns that cover all of them, or none. Where numbers rest on verdicts the label names the
            protocol.
        cells: The facts behind each cell of ``rows``, ``None`` where it is text alone; ``None`` if none has any.
        sources: Where quoted numbers come from.
        miniatures: Of each row whether it is about a miniature, whose numbers show the pipeline and rank nothing; none
            if no row is. CSV has a column more then.
        brief: What a terminal shows without being asked for more; ``None`` for everything.
    """

    name: str
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()
    text_columns: int = 1
    groups: Groups = ()
    cells: tuple[tuple[CellSource | None, ...], ...] | None = None
    sources: tuple[str, ...] = ()
    miniatures: tuple[bool, ...] = ()
    brief: TableExcerpt | None = None
    latex_form: LatexForm | None = None

    def __post_init__(self) -> None:
        width = len(self.columns)
        for row in self.rows:
            if len(row) != width:
                raise ValueError(f"table {self.name}: a row has {len(row)} cells for {width} columns")
        if self.groups and sum(span for _, span in self.groups) != width:
            raise ValueError(f"table {self.name}: groups do not cover {width} columns")
        if self.cells is not None and [len(row) for row in self.cells] != [width] * len(self.rows):
            raise ValueError(f"table {self.name}: cells do not match {len(self.rows)} rows of {width}")
        if self.miniatures and len(self.miniatures) != len(self.rows):
            raise ValueError(f"table {self.name}: {len(self.miniatures)} miniature flags for {len(self.rows)} rows")

    @property
    def heads(self) -> tuple[str, ...]:
        """Column heads that say everything: ``head | group`` where there is a group."""
        labels = [label for label, span in self.groups for _ in range(span)] or [""] * len(self.columns)
        return tuple(f"{head} | {label}" if label else head for head, label in zip(self.columns, labels))

    @property
    def remarks(self) -> tuple[str, ...]:
        """Notes and sources as the sentences below the table."""
        return (*self.notes, *(f"Source of quoted numbers: {source}." for source in self.sources))

    def markdown(self) -> str:
        """The table as GitHub Markdown, with its title and notes."""
        rule = ["---"] * self.text_columns + ["---:"] * (len(self.columns) - self.text_columns)
        lines = [f"### {escape_markdown(self.title)}", ""]
        lines += [_markdown_row([escape_markdown(head) for head in self.columns]), _markdown_row(rule)]
        lines += [_markdown_row([escape_markdown(cell) for cell in row]) for row in self.rows]
        lines += ["", *(f"- {escape_markdown(note)}" for note in self.remarks)] if self.remarks else []
        return "\n".join(lines) + "\n"

    def plain(
        self, *, wide: bool = False, width: int | None = None, indent: str = "", least: Sequence[int] = ()
    ) -> str:
        """The table as aligned text for a terminal, with its title, if it has one, and notes.

        ``wide`` shows every column, as wide as they are; notes are wrapped all the same. The terminal's ``width`` is
        asked for by default, ``indent`` is not before the title, and each column has at least ``least`` characters.
        """
        width, brief = width or find_terminal_width(), None if wide else self.brief
        notes = list(self.remarks if brief is None else brief.notes)
        if brief is not None and len(brief.columns) < len(self.columns):
            notes.append(f"--wide shows {pluralise(len(self.columns) - len(brief.columns), 'column')} more.")
        below = [
            line for note in notes for line in wrap_text(note, width, indent=indent, hanging="  ", whole_words=False)
        ]
        return "\n".join([*self.lines(wide=wide, width=width, indent=indent, least=least), *below]) + "\n"

    def lines(self, *, wide: bool, width: int, indent: str = "", least: Sequence[int] = ()) -> list[str]:
        """Title and rows of `plain`."""
        brief = None if wide else self.brief
        places = range(len(self.columns)) if brief is None else brief.columns
        lines = align_columns(
            [self.columns[place] for place in places],
            [[row[place] for place in places] for row in self.rows],
            text_columns=self.text_columns if brief is None else brief.text_columns,
            width=None if wide else width - len(indent),
            least=least,
        )
        full_title = self.title if brief is None else brief.title
        title = wrap_text(full_title, width, whole_words=False) if full_title else []
        return [*title, *(f"{indent}{line}" if line else "" for line in lines)]

    def latex(self) -> str:
        """The table as a LaTeX ``table`` environment with booktabs rules, groups over their columns."""
        form = self.latex_form or LatexForm("l" * self.text_columns + "r" * (len(self.columns) - self.text_columns))
        lines = [r"\begin{table}", r"  \centering", *([r"  \resizebox{\textwidth}{!}{%"] if form.fit else [])]
        lines += [rf"  \begin{{tabular}}{{{form.alignment}}}", r"    \toprule"]
        lines += [f"    {line}" for line in _latex_groups(self.groups)]
        lines += [f"    {_latex_row(self.columns)}", r"    \midrule"]
        for place, row in enumerate(_shown_once(self.rows, form)):
            lines += [r"    \midrule"] if place in form.rules_after else []
            lines.append(f"    {_latex_row(row, bold=place in form.bold_rows)}")
        lines += [r"    \bottomrule", r"  \end{tabular}" + ("}" if form.fit else "")]
        label = re.sub("[^A-Za-z0-9-]", "-", self.name)
        caption = " ".join([f"{self.title}.", *self.remarks])
        lines += [rf"  \caption{{{escape_latex(caption)}}}", rf"  \label{{tab:{label}}}", r"\end{table}"]
        return "\n".join(lines) + "\n"

    def csv(self) -> str:
        """The table as CSV, heads with their groups first, and a column on miniatures last."""
        return _format_csv([self._csv_heads, *self._csv_rows()])

    @property
    def _csv_heads(self) -> tuple[str, ...]:
        return (*self.heads, *(("miniature",) if self.miniatures else ()))

    def _csv_rows(self) -> Iterator[list[str]]:
        for place, row in enumerate(self.rows):
            note = [RANKS_NOTHING if self.miniatures[place] else ""] if self.miniatures else []
            yield ["" if cell == UNDEFINED else cell for cell in row] + note

    def as_json(self) -> dict[str, Any]:
        """The table and the facts behind its cells as JSON values."""
        cells = None
        if self.cells is not None:
            cells = [[None if cell is None else cell.as_json() for cell in row] for row in self.cells]
        return {
            "name": self.name,
            "title": self.title,
            "columns": list(self.columns),
            "groups": [list(group) for group in self.groups],
            "text_columns": self.text_columns,
            "miniatures": list(self.miniatures),
            "rows": [list(row) for row in self.rows],
            "cells": cells,
            "notes": list(self.notes),
            "sources": list(self.sources),
        }


def stack_csv(tables: Iterable[tuple[str, Table]]) -> str:
    """Tables, each with the name of its data set, below each other as CSV, with a column for every head of any of them.

    Two columns before these say which table a row is from. Heads name the protocol, so that two protocols never share
    a column.
    """
    stacked = [(name, table, _number_heads(table._csv_heads)) for name, table in tables]
    columns = list(dict.fromkeys(head for _, _, heads in stacked for head in heads))
    lines = [("from data set", "from table", *(head for head, _ in columns))]
    for name, table, heads in stacked:
        for row in table._csv_rows():
            values = dict(zip(heads, row, strict=True))
            lines.append((name, table.name, *(values.get(column, "") for column in columns)))
    return _format_csv(lines)


def _number_heads(heads: Sequence[str]) -> list[tuple[str, int]]:
    """Heads with how often each was there before: a table may have two of one name."""
    return [(head, heads[:place].count(head)) for place, head in enumerate(heads)]


def _format_csv(lines: Iterable[Sequence[str]]) -> str:
    stream = io.StringIO()
    csv.writer(stream, lineterminator="\n").writerows(lines)
    return stream.getvalue()


def format_tables(tables: Sequence[Table], *, wide: bool, verbose: bool, width: int | None = None) -> str:
    """Tables for a terminal, one below the other, and their notes once below all of them.

    ``wide`` is as in `Table.plain`; ``verbose`` gives every note, not only those that rows need.
    """
    width, briefs = width or find_terminal_width(), [table.brief for table in tables if table.brief]
    shown = [table.remarks if verbose or table.brief is None else table.brief.notes for table in tables]
    notes = list(dict.fromkeys(note for of_table in shown for note in of_table))
    hides = not wide and any(table.brief and len(table.brief.columns) < len(table.columns) for table in tables)
    more = ["--wide shows all columns"] if hides else []
    more += [f"-v explains {'them' if hides else 'the columns'}"] if briefs and not verbose else []
    notes += [f"{', '.join(more)}."] if more else []
    below = [line for note in notes for line in wrap_text(note, width, hanging="  ", whole_words=False)]
    blocks = [*(table.lines(wide=wide, width=width) for table in tables), *([below] if below else [])]
    return "\n\n".join("\n".join(lines) for lines in blocks)


def build_table(
    name: str,
    title: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str | TableCell]],
    *,
    notes: Sequence[str] = (),
    text_columns: int = 1,
    groups: Sequence[tuple[str, int]] = (),
    sources: Sequence[str] = (),
    brief: TableExcerpt | None = None,
    latex_form: LatexForm | None = None,
) -> Table:
    """A table of texts and of numbers that bring their facts; ``groups`` over no columns are left out."""
    cells = [[TableCell(cell) if isinstance(cell, str) else cell for cell in row] for row in rows]
    miniatures = tuple(any(cell.miniature for cell in row) for row in cells)
    return Table(
        name,
        title,
        tuple(columns),
        tuple(tuple(cell.text for cell in row) for row in cells),
        tuple(notes),
        text_columns,
        tuple((label, span) for label, span in groups if span),
        tuple(tuple(cell.cell for cell in row) for row in cells),
        tuple(sources),
        miniatures if any(miniatures) else (),
        brief,
        latex_form,
    )


@functools.lru_cache(maxsize=1 << 14)
def escape_latex(text: str) -> str:
    """Text on one line in which nothing is LaTeX code."""
    return "".join(map(_latex_character, " ".join(text.split())))


def _latex_character(character: str) -> str:
    """Form of a character that every LaTeX can set: ASCII, usual letters with accents, of anything else its number."""
    plain = character.isascii() or character in _LATEX_LETTERS
    return _LATEX_SPECIAL.get(character, character if plain else f"U+{ord(character):04X}")


def escape_markdown(text: str) -> str:
    """Text in which nothing is Markdown or HTML: names come from strangers' records."""
    safe = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;").replace("\\", "\\\\")
    for character in "|`*":
        safe = safe.replace(character, f"\\{character}")
    safe = safe.replace("](", "\\](")
    return " ".join(safe.split())


def _markdown_row(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _shown_once(rows: Sequence[Sequence[str]], form: LatexForm) -> list[list[str]]:
    """Rows in which the columns that are shown once are empty but in the middle of each block."""
    first, result_rows = 0, []
    for last in (*form.rules_after, len(rows)):
        for place in range(first, last):
            middle = place == first + (last - first - 1) // 2
            result_rows.append([cell if middle or at not in form.once else "" for at, cell in enumerate(rows[place])])
        first = last
    return result_rows


def _latex_row(cells: Sequence[str], *, bold: bool = False) -> str:
    texts = (escape_latex(cell) for cell in cells)
    return " & ".join(rf"\textbf{{{text}}}" if bold and text else text for text in texts) + r" \\"


def _latex_groups(groups: Groups) -> Iterator[str]:
    if not any(label for label, _ in groups):
        return
    cells, rules, first = [], [], 1
    for label, span in groups:
        cells.append(rf"\multicolumn{{{span}}}{{c}}{{{escape_latex(label)}}}")
        rules += [rf"\cmidrule(lr){{{first}-{first + span - 1}}}"] if label else []
        first += span
    yield " & ".join(cells) + r" \\"
    yield " ".join(rules)
