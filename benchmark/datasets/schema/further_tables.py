"""Tables that the devkit reads by itself where they are: whoever opens the root is told what it says of them."""

from pathlib import Path

from benchmark.datasets.devkit_rows import FURTHER_TABLES, devkit_with
from benchmark.datasets.schema import FaultList
from benchmark.datasets.schema.table_checks import CheckedTables
from benchmark.errors import InputError


def check_further_tables(folder: Path, root: Path, tables: CheckedTables, faults: FaultList) -> None:
    """Note that the devkit does not open a root with such tables; asked only where nothing else is wrong."""
    there = [table for table in FURTHER_TABLES if (folder / f"{table}.json").exists()]
    if not there or any(fault.severity == "error" for fault in faults.faults):
        return
    try:
        devkit_with(root, folder.name, tables.rows)
    except InputError as error:
        faults.add("tables that the devkit refuses", there[0], "", str(error))
