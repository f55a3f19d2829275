"""Rows of CSV tables by their plain column heads, for tests that look at one group of columns."""

import csv
import io


def csv_rows(text: str) -> list[dict[str, str]]:
    """Rows as dictionaries; a head is what stands before its group."""
    heads, *rows = csv.reader(io.StringIO(text))
    return [dict(zip((head.partition(" | ")[0] for head in heads), row, strict=True)) for row in rows]
