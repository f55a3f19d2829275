"""Tables read row by row and counted, without the devkit: only tokens are held in memory."""

from array import array
from collections.abc import Collection, Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from benchmark.datasets.stored_rows import PassOverRows
from benchmark.datasets.tables import Row
from benchmark.errors import InputError
from benchmark.records.statistics import TableCounts


def count_rows(folder: Path, names: Collection[str] | None) -> TableCounts:
    """Count the rows that belong to some scenes.

    Args:
        names: Names of the scenes; ``None`` for every row of the tables, linked to a scene or not.
    """
    every = names is None
    named, scene_count = _linked(folder / "scene.json", "name", names, "token")
    samples, sample_count = _linked(folder / "sample.json", "scene_token", None if every else named, "token")
    wanted = None if every else samples
    poses, data_count = _linked(folder / "sample_data.json", "sample_token", wanted, "ego_pose_token")
    instances, annotation_count = _linked(folder / "sample_annotation.json", "sample_token", wanted, "instance_token")
    return TableCounts(
        instances=_linked(folder / "instance.json", "token", None if every else instances, "token")[1],
        ego_poses=_linked(folder / "ego_pose.json", "token", None if every else poses, "token")[1],
        scenes=scene_count,
        samples=sample_count,
        sample_data=data_count,
        annotations=annotation_count,
    )


def _linked(path: Path, field: str, wanted: Collection[str] | None, gives: str) -> tuple[set[str], int]:
    """Values of one field in the rows whose other field is wanted (``None``: all rows), and how many rows these are."""
    found, count = set(), 0
    tokens = array("q")
    for row in table_rows(path, *dict.fromkeys(("token", field, gives))):
        tokens.append(hash(row["token"]))
        if wanted is None or row[field] in wanted:
            count += 1
            found.add(row[gives])
    # Eight bytes a row, as a table of trainval has millions; one in a million such tables has two tokens of one hash.
    if len(np.unique(tokens)) < len(tokens):
        raise InputError(f"{path} has two rows of one token; challenger-bench data check names them")
    return found, count


def table_rows(path: Path, *needed: str) -> Iterator[Row]:
    """Rows of one table, one after the other, as the file is read.

    Args:
        needed: Fields that must be there and be text.
    """
    for number, row in enumerate(chain.from_iterable(PassOverRows(path).batches())):
        if not all(isinstance(row.get(field), str) for field in needed):
            raise InputError(f"{path} row {number} is not an object with {' and '.join(needed)}; make the table again")
        yield row
