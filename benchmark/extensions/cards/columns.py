"""Columns of an index, said once: what the Parquet file holds, Croissant describes and the card explains."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Literal

from benchmark.machine.storage import write_bytes

Kind = Literal["text", "count", "number", "truth"]
CROISSANT_TYPE: Final[Mapping[Kind, str]] = {
    "text": "sc:Text",
    "count": "sc:Integer",
    "number": "sc:Float",
    "truth": "sc:Boolean",
}


@dataclass(frozen=True, slots=True)
class Column:
    """One column of an index: its name, with the unit where it has one, the kind of its values, and a phrase.

    Any value may be null.
    """

    name: str
    kind: Kind
    meaning: str


def write_index(path: Path, columns: Sequence[Column], rows: Sequence[Mapping[str, Any]]) -> None:
    """Write rows as a Parquet file, in place of the present one; a row has a value or ``None`` for each column."""
    import pyarrow
    from pyarrow import parquet

    types = {"text": pyarrow.string(), "count": pyarrow.int64(), "number": pyarrow.float64(), "truth": pyarrow.bool_()}
    schema = pyarrow.schema([(column.name, types[column.kind]) for column in columns])
    values = {column.name: [row[column.name] for row in rows] for column in columns}
    stream = io.BytesIO()
    parquet.write_table(pyarrow.table(values, schema=schema), stream)
    write_bytes(path, stream.getvalue())


def column_rows(columns: Sequence[Column]) -> list[str]:
    """Rows of a Markdown table of the columns."""
    return ["| column | type | what |", "|---|---|---|"] + [
        f"| `{column.name}` | {column.kind} | {column.meaning} |" for column in columns
    ]
