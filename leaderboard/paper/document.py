"""The paper's tables in its order, and one LaTeX document of them and the chart with booktabs and graphicx alone."""

from collections.abc import Mapping, Sequence
from typing import Final

from benchmark.records.ablation import AblationReport
from benchmark.records.run import RunRecord
from benchmark.records.scenes import Sheets
from benchmark.report.table import Table, escape_latex
from leaderboard.frame.sheets import by_data_set, by_name
from leaderboard.paper.appendix import hyper_parameter_tables, paper_data_set_tables, paper_runtime_tables
from leaderboard.paper.table_1 import paper_table_1

PREAMBLE: Final = r"""\documentclass[10pt]{article}
\usepackage[a4paper,margin=1.6cm]{geometry}
\usepackage{booktabs}
\usepackage{graphicx}
\makeatletter
\def\fps@table{!htbp}
\def\fps@figure{!htbp}
\makeatother
"""
"""What every table of a leaderboard needs."""


def paper_document(data_name: str, tables: Sequence[Table], charts: Sequence[tuple[str, str]]) -> str:
    """LaTeX of tables in the paper's order, and below them of charts: of each its file, and what it shows."""
    parts = [PREAMBLE, r"\begin{document}", rf"\section*{{{escape_latex(data_name)}: the paper's tables}}", ""]
    parts += [table.latex() for table in tables]
    for file, title in charts:
        parts += [
            r"\begin{figure}",
            r"  \centering",
            rf"  \includegraphics[width=0.6\linewidth]{{{file}}}",
            rf"  \caption{{{escape_latex(title)}.}}",
            r"\end{figure}",
            "",
        ]
    return "\n".join([*parts, r"\end{document}", ""])


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
