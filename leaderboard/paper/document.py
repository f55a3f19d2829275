"""One LaTeX document of the paper's tables and chart: it compiles by itself, with booktabs and graphicx alone."""

from collections.abc import Sequence
from typing import Final

from benchmark.report.table import Table, escape_latex

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
