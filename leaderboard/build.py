"""From run records to the files of a leaderboard; the same records give the same bytes."""

from collections.abc import Sequence
from pathlib import Path

from benchmark.errors import InputError
from benchmark.records import RunRecord
from benchmark.storage import write_bytes
from benchmark.transfer import transfer
from leaderboard.collision import collision_table, in_table_order, published_table
from leaderboard.tables import Table
from leaderboard.transfer import transfer_table

Files = dict[str, str]
"""Text of each file by its path below the leaderboard's folder."""


def leaderboard_tables(records: Sequence[RunRecord]) -> list[tuple[str, Table]]:
    """Every table that the records allow.

    Args:
        records: Run records of any data sets, splits and planners.

    Returns:
        Pairs of data set name and table: collision by protocol, then transfer by split; the published numbers last,
        under the name ``published``.

    Raises:
        InputError: If there are no records, or two records of one planner and split would share a row.
    """
    if not records:
        raise InputError("there are no run records to make tables of; run challenger-bench eval first")
    tables: list[tuple[str, Table]] = []
    for data_name in sorted({record.run.data.name for record in records}):
        runs = [record for record in records if record.run.data.name == data_name]
        _require_distinct(runs)
        protocols = sorted({name for record in runs for name in record.summary.protocols})
        tables += [(data_name, collision_table(data_name, name, runs)) for name in protocols]
        tables += [(data_name, table) for table in _transfer_tables(data_name, runs, protocols)]
    return [*tables, ("published", published_table())]


def leaderboard_files(records: Sequence[RunRecord]) -> Files:
    """The leaderboard as text.

    Args:
        records: See `leaderboard_tables`.

    Returns:
        ``README.md`` with all tables and, per table, LaTeX and CSV below the data set's name.
    """
    files: Files = {}
    sections = ["# Leaderboard", "", "Made from run records by `challenger-bench leaderboard`; do not edit.", ""]
    for data_name, table in leaderboard_tables(records):
        files[f"{data_name}/{table.name}.tex"] = table.latex()
        files[f"{data_name}/{table.name}.csv"] = table.csv()
        sections.append(table.markdown())
    files["README.md"] = "\n".join(sections)
    return files


def write_leaderboard(records: Sequence[RunRecord], folder: Path) -> list[Path]:
    """Write the leaderboard.

    Args:
        records: See `leaderboard_tables`.
        folder: Where to.

    Returns:
        The files written.
    """
    files = leaderboard_files(records)
    for name, text in files.items():
        write_bytes(folder / name, text.encode())
    return [folder / name for name in files]


def stale_files(records: Sequence[RunRecord], folder: Path) -> list[str]:
    """Files of a leaderboard that differ from what the records say.

    Args:
        records: See `leaderboard_tables`.
        folder: A leaderboard written earlier.

    Returns:
        One sentence for each file that is missing or differs; empty if the leaderboard is current.
    """
    found = []
    for name, text in leaderboard_files(records).items():
        path = folder / name
        if not path.is_file():
            found.append(f"{path} is missing")
        elif path.read_bytes() != text.encode():
            found.append(f"{path} differs from what the run records say")
    return found


def _transfer_tables(data_name: str, runs: Sequence[RunRecord], protocols: Sequence[str]) -> list[Table]:
    tables = []
    for split in sorted({record.run.split for record in runs}):
        for protocol in protocols:
            same = [
                record
                for record in in_table_order(runs)
                if record.run.split == split and protocol in record.run.protocols
            ]
            if len(same) > 1 and len({record.run.data.fingerprint for record in same}) == 1:
                tables.append(transfer_table(data_name, transfer(same, protocol=protocol)))
    return tables


def _require_distinct(runs: Sequence[RunRecord]) -> None:
    seen: dict[tuple[str, str], RunRecord] = {}
    for record in runs:
        key = (record.planner, record.run.split)
        if key in seen:
            raise InputError(
                f"{seen[key].directory} and {record.directory} both hold {record.planner} on split {record.run.split}; "
                "move one of them away or name the records' folder with --records"
            )
        seen[key] = record
