"""Foreign tables of plans: CSV and JSON are looked at before pandas reads them, a child process reads Parquet."""

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from benchmark.untrusted.children import read_in_child
from benchmark.untrusted.files import PLAN_COLUMNS, PLANS, Limits, format_bytes, read_file, to_one_line
from benchmark.untrusted.text_files import parse_json

if TYPE_CHECKING:
    import pandas

_TEXTS: Final = {"sample_token": str, "scene": str, "frame": str}


def read_table(path: Path, limits: Limits = PLANS) -> "pandas.DataFrame":
    """Unchecked columns of a ``.csv``, ``.json`` or ``.parquet`` table of plans.

    Raises `InputError` if it cannot be opened or a Parquet file exceeds its limits, `ValueError` if it is none of
    these, damaged, or has more rows, columns or characters in a line; other errors are pandas' own.
    """
    kind = path.suffix.lower()
    if kind == ".csv":
        return _read_csv(read_file(path, limits), limits)
    return _read_json(read_file(path, limits), limits) if kind == ".json" else _read_parquet(path, limits)


def _read_csv(data: bytes, limits: Limits) -> "pandas.DataFrame":
    import pandas as pd

    if b"\0" in data:
        raise ValueError("it holds bytes that are not text")
    _require_few(max(data.count(b"\n"), data.count(b"\r")), limits)
    lines = data.splitlines()
    if max(map(len, lines), default=0) > limits.line_bytes:
        raise ValueError(f"a line is longer than {format_bytes(limits.line_bytes)}")
    header = next((line for line in lines if line.strip()), b"")
    # Excel's format where the comma is the decimal sign.
    between = b";" if header.count(b";") > header.count(b",") else b","
    decimal = "," if between == b";" and b"," in data else "."
    _require_narrow(header.count(between) + 1)
    table = pd.read_csv(io.BytesIO(data), dtype=_TEXTS, sep=between.decode(), decimal=decimal)
    if decimal == ",":
        _require_no_points(table)
    return table


def _require_no_points(table: "pandas.DataFrame") -> None:
    """Beside decimal commas a point may part thousands."""
    for name in table.columns.difference(_TEXTS):
        if table[name].dtype.kind == "O" and table[name].astype(str).str.contains(".", regex=False).any():
            raise ValueError(f"column {to_one_line(name, 20)} has numbers with points, and others have decimal commas")


def _read_json(data: bytes, limits: Limits) -> "pandas.DataFrame":
    import pandas as pd

    rows = parse_json(data, limits)
    if not isinstance(rows, list):
        raise ValueError("it is not a list of rows")
    _require_few(len(rows), limits)
    names: set[str] = set()
    for place, row in enumerate(rows):
        names |= row.keys() if isinstance(row, dict) else set()
        _require_numbers(place, row)
        _require_narrow(max(len(names), len(row) if isinstance(row, list) else 0))
    return pd.read_json(io.BytesIO(data), orient="records", dtype=False, convert_dates=False, precise_float=True)


def _require_numbers(place: int, row: object) -> None:
    """Pandas would read text of digits as the number that it shows."""
    for name, value in row.items() if isinstance(row, dict) else ():
        if name not in _TEXTS and isinstance(value, str):
            raise ValueError(
                f"row {place} has text {to_one_line(value, 20)!r} in numeric column {to_one_line(name, 20)}"
            )


def _read_parquet(path: Path, limits: Limits) -> "pandas.DataFrame":
    import pandas as pd

    answer = read_in_child(path, "parquet", limits)
    if answer.kind != "value":
        raise ValueError(": ".join(map(to_one_line, answer.parts)))
    columns: dict[str, Any] = answer.parts[0]
    return pd.DataFrame(columns)


def _require_few(rows: int, limits: Limits) -> None:
    if rows > limits.values:
        raise ValueError(f"it has more than {limits.values} rows")


def _require_narrow(columns: int) -> None:
    if columns > PLAN_COLUMNS:
        raise ValueError(f"it has more than {PLAN_COLUMNS} columns")
