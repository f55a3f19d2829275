"""From run records to the files of a leaderboard; the same records give the same bytes."""

from collections.abc import Sequence
from pathlib import Path

from benchmark.errors import InputError
from benchmark.records import RunRecord
from benchmark.storage import file_name, write_bytes, writing_to
from benchmark.transfer import transfer
from leaderboard.collision import collision_table, in_table_order, published_table
from leaderboard.selection import one_run_each
from leaderboard.tables import Table
from leaderboard.transfer import transfer_table

Files = dict[str, str]
"""Text of each file by its path below the leaderboard's folder."""
TABLES_FOLDER = "tables"
"""Holds one folder for each data set and nothing else, so that what is no longer made there can be told."""


def leaderboard_tables(records: Sequence[RunRecord]) -> list[tuple[str, Table]]:
    """Every table that the records allow.

    Args:
        records: Run records of any data sets, splits and planners, in any order; `one_run_each` says which of them
            count.

    Returns:
        Pairs of data set name and table: collision by protocol, then transfer by split; the published numbers last,
        under the name ``published``.

    Raises:
        InputError: If there are no records, two records of one planner and split would share a row, or records of one
            split saw different data.
    """
    if not records:
        raise InputError("there are no run records to make tables of; run challenger-bench eval first")
    tables: list[tuple[str, Table]] = []
    chosen = one_run_each(records)
    for data_name in sorted({record.run.data.name for record in chosen}):
        runs = [record for record in chosen if record.run.data.name == data_name]
        protocols = sorted({name for record in runs for name in record.summary.protocols})
        tables += [(data_name, collision_table(data_name, name, runs)) for name in protocols]
        tables += [(data_name, table) for table in _transfer_tables(data_name, runs, protocols)]
    return [*tables, ("published", published_table())]


def leaderboard_files(records: Sequence[RunRecord]) -> Files:
    """The leaderboard as text.

    Args:
        records: See `leaderboard_tables`.

    Returns:
        ``README.md`` with all tables and, per table, LaTeX and CSV: ours below ``tables/<data set>/``, the published
        numbers apart from them below ``published/``.
    """
    files: Files = {}
    sections = ["# Leaderboard", "", "Made from run records by `challenger-bench leaderboard`; do not edit.", ""]
    *ours, (_, published) = leaderboard_tables(records)
    placed = [(f"{TABLES_FOLDER}/{file_name(data_name)}", table) for data_name, table in ours]
    for folder, table in [*placed, ("published", published)]:
        files[f"{folder}/{file_name(table.name)}.tex"] = table.latex()
        files[f"{folder}/{file_name(table.name)}.csv"] = table.csv()
        sections.append(table.markdown())
    files["README.md"] = "\n".join(sections)
    return files


def write_leaderboard(records: Sequence[RunRecord], folder: Path) -> list[Path]:
    """Write the leaderboard; tables of an earlier one that the records no longer give are removed.

    Args:
        records: See `leaderboard_tables`.
        folder: Where to.

    Returns:
        The files written.
    """
    files = leaderboard_files(records)
    for name, text in files.items():
        write_bytes(folder / name, text.encode())
    for path in _left_over(files, folder):
        with writing_to(path):
            path.unlink()
    return [folder / name for name in files]


def stale_files(records: Sequence[RunRecord], folder: Path) -> list[str]:
    """Files of a leaderboard that differ from what the records say.

    Args:
        records: See `leaderboard_tables`.
        folder: A leaderboard written earlier.

    Returns:
        One sentence for each file that is missing, differs or is left over; empty if the leaderboard is current.
    """
    found, files = [], leaderboard_files(records)
    for name, text in files.items():
        path = folder / name
        if not path.is_file():
            found.append(f"{path} is missing")
        elif path.read_bytes() != text.encode():
            found.append(f"{path} differs from what the run records say")
    return [*found, *(f"{path} is a table that the run records no longer give" for path in _left_over(files, folder))]


def _left_over(files: Files, folder: Path) -> list[Path]:
    """Tables in a leaderboard's folder that are not among its files."""
    tables = sorted((folder / TABLES_FOLDER).glob("*/*"))
    return [
        path for path in tables if path.suffix in (".tex", ".csv") and path.relative_to(folder).as_posix() not in files
    ]


def _transfer_tables(data_name: str, runs: Sequence[RunRecord], protocols: Sequence[str]) -> list[Table]:
    tables = []
    for split in sorted({record.run.split for record in runs}):
        for protocol in protocols:
            same = [
                record
                for record in in_table_order(runs)
                if record.run.split == split and protocol in record.run.protocols and record.covers_split
            ]
            if len(same) > 1:
                tables.append(transfer_table(data_name, transfer(same, protocol=protocol)))
    return tables
