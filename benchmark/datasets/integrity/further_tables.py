"""Tables that the devkit reads by itself where they are: whoever opens the root is told what it says of them."""

from pathlib import Path
from typing import Final

from benchmark.datasets.schema import FaultList
from benchmark.errors import InputError

FURTHER_TABLES: Final = ("lidarseg", "panoptic", "image_annotations")
"""None of them is read here."""


def check_further_tables(folder: Path, root: Path, faults: FaultList) -> None:
    """Note that the devkit does not open a root with such tables; asked only where nothing else is wrong.

    Args:
        folder: Version folder.
        root: Data set root.
        faults: Gets the faults.
    """
    there = [table for table in FURTHER_TABLES if (folder / f"{table}.json").exists()]
    if not there or any(fault.severity == "error" for fault in faults.faults):
        return
    # Opening a root checks it, so that it cannot be imported before its checks are.
    from benchmark.datasets.devkit import open_tables

    try:
        open_tables(root, folder.name)
    except InputError as error:
        faults.add("tables that the devkit refuses", there[0], "", str(error))
