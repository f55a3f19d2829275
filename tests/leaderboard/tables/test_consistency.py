"""The table of plan consistency."""

import numpy as np

from leaderboard.frame.runs import DataSetRuns
from leaderboard.tables.contents import build_data_set_tables, consistency_table
from tests.benchmark.metrics.test_consistency import record_of, rows_of
from tests.benchmark.records.hand_made_records import CLEAN, hand_made


def test_distances_with_interval_and_pairs() -> None:
    poses = np.zeros((4, 3))
    rows = [
        one
        for name in ("a", "b")
        for one in rows_of(poses, lambda index: float(index % 2) * np.array([[0.6, 0.8]] * 6), scene=name)
    ]
    record = record_of(rows)
    table = consistency_table(DataSetRuns("d", [record]))
    assert table is not None and table.columns[:4] == ("planner", "split", "mean", "95 % of mean")
    assert [getattr(cell, "text", cell) for cell in table.rows[0]][2] == "1.00" and table.columns[-1] == "pairs"
    assert getattr(table.rows[0][-1], "text", table.rows[0][-1]) == "6"
    # Single samples make no table.
    assert consistency_table(DataSetRuns("d", [hand_made("p", {"a": [CLEAN], "b": [CLEAN]})])) is None
    assert "consistency" in [one.name for one in build_data_set_tables(DataSetRuns("d", [record])).front]
