"""How tables, sentences and records look in a terminal (80 columns where there is none) or a notebook."""

import re
import shutil
import textwrap
from collections.abc import Iterable, Sequence
from html import escape
from typing import Final


def html_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table for ``_repr_html_``; what strangers wrote in its cells is escaped here."""

    def line(cells: Sequence[str], tag: str) -> str:
        return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"

    body = "".join(line(row, "td") for row in rows)
    return f"<table><caption>{escape(title)}</caption><thead>{line(columns, 'th')}</thead><tbody>{body}</tbody></table>"


def percent(value: float | None) -> str:
    """A share as tables have it."""
    return "–" if value is None else f"{100 * value:.2f} %"


WIDTH: Final = 80
"""Columns where there is no terminal."""
LEAST_WIDTH: Final = 40
"""A narrower terminal breaks lines itself; nothing sensible fits."""
_LEAST_TEXT: Final = 10
"""Characters that a column of text keeps, however many numbers stand beside it."""
_HYPHEN: Final = re.compile(r"(?<=\w-)(?=\w)")
"""Where a name may break."""
_GAP: Final = "  "
_BOUND: Final = "\u00a0"
"""Stands between a name and its mark, and a number and its unit, while lines are broken."""


def find_terminal_width() -> int:
    """Columns of the terminal, or of the variable ``COLUMNS``; 80 where there is neither."""
    return max(LEAST_WIDTH, shutil.get_terminal_size((WIDTH, 24)).columns)


def wrap_text(
    text: str, width: int | None = None, *, indent: str = "", hanging: str = "", whole_words: bool = True
) -> list[str]:
    """A sentence as lines, at least one, as wide as the terminal by default.

    ``hanging`` comes after the indent of each line but the first. With ``whole_words`` words that are longer than a
    line (paths) stay whole, so that they can be copied.
    """
    return textwrap.wrap(
        text,
        width or find_terminal_width(),
        initial_indent=indent,
        subsequent_indent=indent + hanging,
        break_long_words=not whole_words,
        break_on_hyphens=False,
    ) or [indent]


def align_columns(
    heads: Sequence[str],
    rows: Sequence[Sequence[str]],
    *,
    text_columns: int,
    width: int | None,
    least: Sequence[int] = (),
) -> list[str]:
    """Lines of a table; the first ``text_columns`` are text (left-aligned), the others numbers.

    Where it is wider than ``width``, heads break between words, then cells of text and heads break behind hyphens, too,
    then columns of numbers go on below, with the columns of text again before them. Only text that leaves no room for
    a column of numbers breaks elsewhere. Each column has at least ``least`` characters.
    """
    heads, rows = [_bound(head) for head in heads], [[_bound(cell) for cell in row] for row in rows]
    least = least or (0,) * len(heads)
    bodies = [max(few, 0, *(len(row[column]) for row in rows)) for column, few in enumerate(least)]
    full_widths = [max(body, len(head)) for body, head in zip(bodies, heads)]
    if width is None or _total(full_widths) <= width:
        return _lines(heads, rows, full_widths, text_columns)
    words = [max(body, _longest(head.split(" "))) for body, head in zip(bodies, heads)]
    if _total(words) <= width:
        return _lines(heads, rows, _shrunk(full_widths, words, width), text_columns)
    texts, numbers = words[:text_columns], words[text_columns:]
    columns = zip(*[heads, *rows]) if rows else ((head,) for head in heads)
    parts = [_longest(part for cell in cells for part in _split_name(cell)) for cells in columns]
    few_letters = [min(text, max(_LEAST_TEXT, part)) for text, part in zip(texts, parts)]
    shrunk_texts = _shrunk(texts, few_letters, width - _total(numbers) - len(_GAP))
    fits = _total([*shrunk_texts, *numbers]) <= width
    if not fits:
        shrunk_texts = _shrunk(texts, few_letters, width // 2)
        least_room = max(bodies[text_columns:], default=0) + len(_GAP)
        shrunk_texts = _shrunk(shrunk_texts, [min(text, _LEAST_TEXT) for text in shrunk_texts], width - least_room)
    room = width - _total(shrunk_texts) - len(_GAP)
    few_digits = [
        max(body, min(_longest(_split_name(head)), room))
        for body, head in zip(bodies[text_columns:], heads[text_columns:])
    ]
    lines: list[str] = []
    for block in _blocks(numbers if fits else few_digits, room):
        chosen = [*range(text_columns), *(text_columns + place for place in block)]
        of_block = _shrunk([numbers[place] for place in block], [few_digits[place] for place in block], room)
        part = [[row[column] for column in chosen] for row in rows]
        lines += [""] if lines else []
        lines += _lines([heads[column] for column in chosen], part, [*shrunk_texts, *of_block], text_columns)
    return lines


def _bound(text: str) -> str:
    return re.sub(r" (?=\W( |$))", _BOUND, text)


def _total(widths: Sequence[int]) -> int:
    return sum(widths) + len(_GAP) * max(len(widths) - 1, 0)


def _longest(parts: Iterable[str]) -> int:
    return max(map(len, parts), default=0)


def _split_name(text: str) -> list[str]:
    """Parts that a cell may break between, without the spaces."""
    return [part for word in text.split(" ") for part in _HYPHEN.split(word)]


def _shrunk(widths: Sequence[int], least: Sequence[int], room: int) -> list[int]:
    """Columns that fit, those shrunk that have most to spare; as narrow as they may be where nothing fits."""
    shrunk = list(widths)
    while _total(shrunk) > room and shrunk != list(least):
        spare = [width - few for width, few in zip(shrunk, least)]
        shrunk[spare.index(max(spare))] -= 1
    return shrunk


def _blocks(widths: Sequence[int], room: int) -> list[list[int]]:
    """Places of the columns of numbers that stand beside each other; one at least in each block."""
    blocks: list[list[int]] = [[]]
    for place in range(len(widths)):
        if blocks[-1] and _total([widths[other] for other in (*blocks[-1], place)]) > room:
            blocks.append([])
        blocks[-1].append(place)
    return blocks


def _lines(heads: Sequence[str], rows: Sequence[Sequence[str]], widths: Sequence[int], text_columns: int) -> list[str]:
    """Rows as lines, heads at the bottom of theirs, cells at the top of theirs."""
    lines = _row_lines([_cell(head, width) for head, width in zip(heads, widths)], widths, text_columns, bottom=True)
    for row in rows:
        cells = [_cell(cell, width) for cell, width in zip(row, widths)]
        lines += _row_lines(cells, widths, text_columns, bottom=False)
    return lines


def _cell(text: str, width: int) -> list[str]:
    if len(text) <= width:
        return [text]
    lines = [""]
    for word in filter(None, text.split(" ")):
        for place, part in enumerate(_HYPHEN.split(word)):
            gap = " " if lines[-1] and not place else ""
            if len(lines[-1]) + len(gap) + len(part) <= width:
                lines[-1] += gap + part
            else:
                lines += textwrap.wrap(part, max(width, 1), break_on_hyphens=False)
    return lines if lines[0] else lines[1:] or [""]


def _row_lines(cells: Sequence[Sequence[str]], widths: Sequence[int], text_columns: int, *, bottom: bool) -> list[str]:
    height = max(len(cell) for cell in cells)
    empty = [[""] * (height - len(cell)) for cell in cells]
    full = [[*none, *cell] if bottom else [*cell, *none] for cell, none in zip(cells, empty)]
    return [
        _GAP.join(
            cell[line].ljust(width) if column < text_columns else cell[line].rjust(width)
            for column, (cell, width) in enumerate(zip(full, widths))
        )
        .replace(_BOUND, " ")
        .rstrip()
        for line in range(height)
    ]
