"""Tables of ``challenger-bench reproduce``: published numbers beside ours, and the verdict on each."""

from typing import Final

from benchmark.records.reproduction import UNITS, ComparedNumber, Reproduction
from benchmark.report.table import Table
from leaderboard.frame.specification import Values, number_columns, tabulate, text_columns

_NAMES: Final = {"collision": "collision (%)", "l2": "L2 (m)", "samples": "samples"}


def reproduction_table(found: Reproduction) -> Table:
    """One row for each number."""
    sources = list(dict.fromkeys(number.source for number in found.numbers))
    rows = [_row(number, sources.index(number.source) + 1) for number in found.numbers]
    wrong = sum(not number.ok for number in found.numbers)
    verdict = "reproduced" if found.reproduced else f"not reproduced: {wrong} of {len(rows)} numbers differ"
    return tabulate(
        f"reproduction-{found.planner.name}",
        f"{found.planner.name} on {found.data.name}, {found.split}, protocol {found.protocol} (version "
        f"{found.version}): {found.of}",
        [*text_columns("", "number", "at"), *number_columns("expected", "ours", "difference", "allowed", "from")],
        rows,
        [*(f"{place}: {source}." for place, source in enumerate(sources, 1)), f"Verdict: {verdict}."],
    )


def _row(number: ComparedNumber, source: int) -> Values:
    digits = 0 if number.column == "samples" else 3
    return {
        "": "ok" if number.ok else "FAIL",
        "number": _NAMES[number.column],
        "at": number.horizon,
        "expected": f"{number.published:.{digits}f}",
        "ours": None if number.ours is None else f"{number.ours:.{digits}f}",
        # Adding zero turns -0.0 into 0.0.
        "difference": None if number.difference is None else f"{round(number.difference, digits) + 0.0:+.{digits}f}",
        "allowed": f"{number.allowed:g}" if UNITS[number.column] else "none",
        "from": str(source),
    }
