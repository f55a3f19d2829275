"""The paper's tables in its order and Table 1's form, as one LaTeX document with booktabs and graphicx alone."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Final

from benchmark.metrics.rates import HORIZONS
from benchmark.metrics.scores import takes_maxima
from benchmark.published import DATA_SET_OF_SPLIT, TABLE_1_SOURCE
from benchmark.records.ablation import AblationReport
from benchmark.records.run import NATIVE, RunRecord
from benchmark.records.run_schema import ProtocolSummary
from benchmark.records.scene_pages import ScenePages
from benchmark.report.cells import PERCENT, UNDEFINED, TableCell, ValueSource, join_record_names
from benchmark.report.table import LatexForm, Table, build_table, escape_latex
from leaderboard.frame.rows import SPLIT_ORDER
from leaderboard.frame.runs import DataSetRuns, RunRow, row_notes
from leaderboard.frame.specification import group_by_data_set, merge_by_data_set
from leaderboard.paper.appendix import hyper_parameter_tables, paper_data_set_tables, paper_runtime_tables
from leaderboard.tables.published import find_published_rate, quote_increase, quote_number

_ORDER: Final = ("uniad", "vad", "sparsedrive", "diffusiondrive")
"""Of the paper, by the planners' own protocols: the first half stands on the left."""
_HERE, _PAPER = "here, own protocol", "paper, own protocol"
_DIGITS: Final = {"sparsedrive": 3, "diffusiondrive": 3}
"""As the paper prints them; all others have two."""
_HEADS: Final = ("AD model", *HORIZONS, "×", "avg", "×")


PlannerBlock = Mapping[str, RunRow[ProtocolSummary]]
"""One planner: its runs by split."""


def paper_table_1(data_name: str, records: Sequence[RunRecord]) -> Table | None:
    """Table 1 as the paper lays it out, each planner under the protocol of its own repository; ``None`` without runs.

    Two planners a block, those of the paper first and in its order, on the paper's three splits; published averages and
    increases have columns of their own.
    """
    blocks = _build_blocks(DataSetRuns(data_name, records))
    if not blocks:
        return None
    splits = [split for split in SPLIT_ORDER if any(split in block for block in blocks)]
    rows = [
        (split, *_format_half(left, split), *_format_half(right, split))
        for left, right in _pair_blocks(blocks)
        for split in splits
    ]
    split_names = ", ".join(f"{split} is {DATA_SET_OF_SPLIT[split]}" for split in splits)
    return build_table(
        "paper-table-1",
        f"{data_name}: performance of end-to-end driving systems across data sets, collision rate over 3 seconds (%)",
        ("data set", *_HEADS, *_HEADS),
        rows,
        notes=(
            "As in the paper, each planner is scored by the protocol of its own repository (exact if it has none): "
            f"planners are not comparable. ×: (adv − val) / val of the averages. In the paper {split_names}.",
            *row_notes([row for block in blocks for row in block.values()]),
        ),
        text_columns=2,
        groups=(("", 2), (_HERE, 5), (_PAPER, 2), ("", 1), (_HERE, 5), (_PAPER, 2)),
        sources=(TABLE_1_SOURCE,),
        latex_form=LatexForm(
            alignment=r"llrrrrrrr@{\hspace{1.5em}}lrrrrrrr",
            rules_after=tuple(range(len(splits), len(rows), len(splits))),
            # As in the paper, the name appears once, in the middle of its lines.
            once=(1, 1 + len(_HEADS)),
            bold_rows=tuple(place for place in range(len(rows)) if rows[place][0] == "adv"),
            fit=True,
        ),
    )


def _build_blocks(frame: DataSetRuns) -> list[PlannerBlock]:
    """Planners with their runs; the paper's first, then others with a protocol of their own, then the rest."""
    blocks: dict[str, dict[str, RunRow[ProtocolSummary]]] = {}
    for row in frame.judged(NATIVE):
        if row.split in SPLIT_ORDER and not takes_maxima(row.judge):
            blocks.setdefault(row.record.planner, {})[row.split] = row
    return sorted(blocks.values(), key=_sort_key)


def _first_row(block: PlannerBlock) -> RunRow[ProtocolSummary]:
    return next(iter(block.values()))


def _sort_key(block: PlannerBlock) -> tuple[int, int, bool, str]:
    record = _first_row(block).record
    own = record.run.planner.native_protocol
    place = _ORDER.index(own) if own in _ORDER else len(_ORDER)
    return int(own is None), place, record.run.planner.miniature, record.planner


def _pair_blocks(blocks: Sequence[PlannerBlock]) -> list[tuple[PlannerBlock, PlannerBlock | None]]:
    """Planners that stand beside each other: of those with and of those without a protocol the halves."""
    pairs: list[tuple[PlannerBlock, PlannerBlock | None]] = []
    for without in (0, 1):
        group = [block for block in blocks if _sort_key(block)[0] == without]
        half = (len(group) + 1) // 2
        pairs += itertools.zip_longest(group[:half], group[half:])
    return pairs


def compute_increase(baseline: float | None, rate: float | None) -> float | None:
    """The paper's "× increase": (rate - baseline) / baseline, ``None`` where the baseline is zero or unknown."""
    if baseline is None or rate is None or baseline == 0:
        return None
    return (rate - baseline) / baseline


def _format_half(block: PlannerBlock | None, split: str) -> tuple[str | TableCell, ...]:
    """One planner's part of a line."""
    if block is None:
        return ("",) * len(_HEADS)
    row = block.get(split)
    if row is None:
        return (_first_row(block).planner, *(UNDEFINED,) * (len(_HEADS) - 1))
    rates, digits = row.found.columns["collision"], _DIGITS.get(row.judge, 2)
    rate_cells = [row.origin.percent(rates[horizon]).shown(digits) for horizon in HORIZONS]
    return (row.with_caveats, *rate_cells, _increase_cell(row, block.get("val")), *_published_cells(row))


def _increase_cell(row: RunRow[ProtocolSummary], val: RunRow[ProtocolSummary] | None) -> TableCell:
    """Increase from val to adv, where both are whole and judged alike."""
    if row.split != "adv" or val is None or not (row.record.covers_split and val.record.covers_split):
        return TableCell("")
    both = [run_row.found for run_row in (val, row)]
    same = both[0].version == both[1].version
    value = compute_increase(*(summary.columns["collision"]["avg"].value for summary in both)) if same else None
    origin = ValueSource(row.judge, join_record_names(val.record, row.record))
    return origin.cell(value, "×", sum(summary.counted for summary in both)).shown(1, after="×")


def _published_cells(row: RunRow[ProtocolSummary]) -> tuple[TableCell, TableCell]:
    """The paper's average and increase, where they are of the same planner, protocol and split."""
    paper = find_published_rate(row.record, row.judge)
    if paper is None:
        return TableCell(""), TableCell("")
    origin = ValueSource(protocol=paper.protocol, source=TABLE_1_SOURCE)
    return quote_number(paper.percent[-1], PERCENT, origin), quote_increase(paper) or TableCell("")


PREAMBLE: Final = r"""\documentclass[10pt]{article}
\usepackage[a4paper,margin=1.6cm]{geometry}
\usepackage{booktabs}
\usepackage{graphicx}
\makeatletter
\def\fps@table{!htbp}
\def\fps@figure{!htbp}
\makeatother
"""
"""LaTeX preamble of all leaderboard tables."""


def format_paper_document(data_name: str, tables: Sequence[Table], charts: Sequence[tuple[str, str]]) -> str:
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


def build_paper_tables(
    records: Mapping[str, Sequence[RunRecord]], sheets: ScenePages, ablations: Sequence[AblationReport]
) -> dict[str, tuple[Table, ...]]:
    """Table 1, hyper-parameters, runtime and statistics by data set, of at most one run a planner and split."""
    first = {name: paper_table_1(name, runs) for name, runs in records.items()}
    return merge_by_data_set(
        [
            {name: (table,) for name, table in first.items() if table is not None},
            hyper_parameter_tables(sheets, ablations),
            group_by_data_set(sheets, paper_runtime_tables),
            group_by_data_set(sheets, paper_data_set_tables),
        ]
    )
