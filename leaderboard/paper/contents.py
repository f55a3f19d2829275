"""Which of the paper's tables the records of each data set give."""

from collections.abc import Mapping, Sequence

from benchmark.records.ablation import AblationReport
from benchmark.records.run import RunRecord
from benchmark.records.scenes import Sheets
from benchmark.report.table import Table
from leaderboard.frame.sheets import by_data_set, by_name
from leaderboard.paper.appendix import hyper_parameter_tables, paper_data_set_tables, paper_runtime_tables
from leaderboard.paper.table_1 import paper_table_1


def paper_tables(
    records: Mapping[str, Sequence[RunRecord]], sheets: Sheets, ablations: Sequence[AblationReport]
) -> dict[str, tuple[Table, ...]]:
    """Table 1, hyper-parameters, runtime, the data set in numbers, by name of the data set, in the order of the names.

    Runs are by name of the data set, at most one for each planner and split.
    """
    first = {name: paper_table_1(name, runs) for name, runs in records.items()}
    return by_name(
        [
            {name: (table,) for name, table in first.items() if table is not None},
            hyper_parameter_tables(sheets, ablations),
            by_data_set(sheets, paper_runtime_tables),
            by_data_set(sheets, paper_data_set_tables),
        ]
    )
