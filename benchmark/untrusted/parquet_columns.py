"""Columns of a Parquet file, read in the child process; what it declares is compared with its limits first."""

from typing import Any, BinaryIO

from benchmark.untrusted.answers import Unanswerable
from benchmark.untrusted.limits import PLAN_COLUMNS, Limits


def parquet_columns(stream: BinaryIO, limits: Limits) -> dict[str, Any]:
    """Numbers as arrays and texts as lists, by column.

    Args:
        stream: The file.
        limits: How many rows there may be, and how many bytes they may unpack to.

    Returns:
        As pandas would have them: missing numbers are NaN.
    """
    from pyarrow import parquet

    file = parquet.ParquetFile(stream)
    declared = file.metadata
    if declared.num_rows > limits.values or declared.num_columns > PLAN_COLUMNS:
        raise Unanswerable(f"it has {declared.num_rows} rows and {declared.num_columns} columns")
    groups = [declared.row_group(number) for number in range(declared.num_row_groups)]
    if sum(group.total_byte_size for group in groups) > limits.content_bytes:
        raise Unanswerable(f"it unpacks to more than {limits.content_bytes} bytes")
    table = file.read(use_threads=False)
    columns = {}
    for name in table.column_names:
        values = table.column(name).to_numpy()
        columns[name] = values.tolist() if values.dtype.kind == "O" else values
    return columns
