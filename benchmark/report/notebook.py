"""What a notebook shows of a record or a scene: a table, in place of all its fields."""

from collections.abc import Sequence
from html import escape


def html_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table for ``_repr_html_``; what strangers wrote in its cells is escaped here."""

    def line(cells: Sequence[str], tag: str) -> str:
        return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"

    body = "".join(line(row, "td") for row in rows)
    return f"<table><caption>{escape(title)}</caption><thead>{line(columns, 'th')}</thead><tbody>{body}</tbody></table>"


def percent(value: float | None) -> str:
    """A share as tables have it."""
    return "–" if value is None else f"{100 * value:.2f} %"
